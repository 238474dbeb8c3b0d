"""A triangle or parallelogram, halved until its parts are small: a complete binary tree of cells."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.render.cell_meshes import FlatMesh
from phoslab.render.cell_shapes import halve, radii_of

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Halved:
    """Parts of a mesh that are halved equally often.

    Args:
        parts: (p,).
        levels: of each level k, (p, 2^k, 3, 3) the corners.
        uv: (p, 2^depth, 3, 2) atlas coordinates of the smallest.
    """

    parts: Indices
    levels: list[Array]
    uv: Array

    @property
    def n_leaves(self) -> int:
        """How many smallest cells each part has."""
        return int(self.levels[-1].shape[1])

    @property
    def n(self) -> int:
        """How many cells."""
        return 2 * self.n_leaves - 1

    def in_order(self) -> tuple[Array, Indices, Indices]:
        """Return (p, n, 3, 3) corners in the order of the walk, (n,) where each cell ends, (n, 2) its leaves."""
        depth = len(self.levels) - 1
        every = np.empty((len(self.parts), self.n, 3, 3))
        skip, leaves = np.empty(self.n, dtype=np.intp), np.empty((self.n, 2), dtype=np.intp)
        at = np.zeros(1, dtype=np.intp)
        for k, corners in enumerate(self.levels):
            size, below = 2 ** (depth - k + 1) - 1, 2 ** (depth - k)
            every[:, at], skip[at] = corners, at + size
            leaves[at, 0] = below * np.arange(2**k)
            leaves[at, 1] = leaves[at, 0] + below
            at = np.stack([at + 1, at + 1 + size // 2], axis=1).ravel()
        return every, skip, leaves


def halve_all(mesh: FlatMesh, parts: Indices, smallest: float) -> Iterator[Halved]:
    """Halve parts until their radius is `smallest`; yield those that are so after equally many times together."""
    levels, uv = [mesh.corners[parts, None]], mesh.uv[parts, None]
    while len(parts):
        is_triangle, count = mesh.is_triangle[parts], levels[-1].shape[1]
        each = radii_of(levels[-1].reshape(-1, 3, 3), np.repeat(is_triangle, count))
        # A sliver stays a sliver: once its area is below that of small cells, more halves gain nothing.
        left = (each.reshape(-1, count).max(axis=1) > smallest) & (
            count < mesh.areas[parts] / smallest**2 * 8
        )
        if not left.all():
            yield Halved(parts[~left], [c[~left] for c in levels], uv[~left])
            parts, levels, uv = parts[left], [c[left] for c in levels], uv[left]
        halves, uv = halve(levels[-1], uv, mesh.is_triangle[parts])
        levels.append(halves)
