"""What every pass has in common, and how its result is shown.

A pass is one class in one file, with its shader of the same name in `shaders/`. It owns what it writes, takes
what it reads as arguments of `run`, and can show what it made. There is no graph: `renderer.py` is the list.
"""

from __future__ import annotations

from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Picture = NDArray[np.float64]


@runtime_checkable
class Pass(Protocol):
    """One step on the way to a picture.

    Attributes:
        name: of the pass, its file and its shader.
        reads, writes: what it takes and what it makes, by the names that passes share.
    """

    name: ClassVar[str]
    reads: ClassVar[tuple[str, ...]]
    writes: ClassVar[tuple[str, ...]]

    def debug_views(self) -> dict[str, Picture]:
        """Return (h, w, 3) pictures in [0, 1], top row first, of what the last run made."""
        ...


def false_grey(values: ArrayLike) -> Picture:
    """Return (h, w, 3) the square root of `values` over their maximum: a look at amounts of any scale."""
    v = np.nan_to_num(np.asarray(values, dtype=np.float64))
    scaled = np.sqrt(np.clip(v / max(v.max(initial=0.0), np.finfo(float).tiny), 0.0, 1.0))
    return np.repeat(scaled[..., None], 3, axis=-1)


def false_box(vectors: ArrayLike, inside: ArrayLike) -> Picture:
    """Return (h, w, 3) vectors scaled to their own box, black where not `inside`."""
    v, mask = np.asarray(vectors, dtype=np.float64), np.asarray(inside, dtype=bool)
    if not mask.any():
        return np.zeros_like(v)
    low, high = v[mask].min(axis=0), v[mask].max(axis=0)
    return np.where(mask[..., None], (v - low) / np.maximum(high - low, 1e-30), 0.0)


def false_normal(normals: ArrayLike, inside: ArrayLike) -> Picture:
    """Return (h, w, 3) unit vectors as the usual pastel colours, black where not `inside`."""
    n, mask = np.asarray(normals, dtype=np.float64), np.asarray(inside, dtype=bool)
    return np.where(mask[..., None], np.clip(n / 2 + 0.5, 0, 1), 0.0)


def side_by_side(pictures: list[Picture]) -> Picture:
    """Return the pictures in a row, padded with black to the tallest."""
    height = max(p.shape[0] for p in pictures)
    return np.concatenate([np.pad(p, ((0, height - p.shape[0]), (0, 0), (0, 0))) for p in pictures], axis=1)
