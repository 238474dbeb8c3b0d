"""Material maps: parameters that vary over a surface, as OpenEXR images in UV space.

A map is float32 with channels `s0`, `s1`, ... for a value a state, `s0.b0`, `s0.b1`, ... for a value a state
and band, `b0`, `b1`, ... for a value a band. The file's first row is v = 0, as OpenGL counts.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.exr import read_channels, write_channels
from phoslab.files import inside
from phoslab.material import Material

Map = NDArray[np.float32]


def channel_names(shape: tuple[int, ...], *, by_band: bool = False) -> list[str]:
    """Name the channels of a map whose texel has `shape`: (n_c,), (n_c, n_λ), or (n_λ,) with `by_band`.

    >>> channel_names((2, 2))
    ['s0.b0', 's0.b1', 's1.b0', 's1.b1']
    """
    if len(shape) == 1:
        return [f"{'b' if by_band else 's'}{i}" for i in range(shape[0])]
    return [f"s{i}.b{j}" for i in range(shape[0]) for j in range(shape[1])]


def write_map(path: str | PathLike[str], values: Map, *, by_band: bool = False) -> None:
    """Write (height, width, ...) values as a map; row 0 is v = 0."""
    texels = np.asarray(values, dtype=np.float32)
    flat = texels.reshape(*texels.shape[:2], -1)
    names = channel_names(texels.shape[2:], by_band=by_band)
    write_channels(path, {name: flat[..., i] for i, name in enumerate(names)}, {})


def load_maps(material: Material) -> dict[str, Map]:
    """Return a material's maps by field: (height, width) followed by the field's own shape.

    Raises:
        PhoslabError: a map is missing, has other channels, or holds a negative or non-finite value.
    """
    maps = {}
    for field, name in material.maps.items():
        folder = material.folder or Path()
        path = inside(folder, name, file=folder, field=f"maps.{field} of {material.name!r}")
        maps[field] = _read(path, np.shape(getattr(material, field)) or (material.bands.n,), field)
    return maps


def _read(path: Path, shape: tuple[int, ...], field: str) -> Map:
    channels = read_channels(path, remedy="Write it with phoslab.maps.write_map, or name another file.")
    names = channel_names(shape, by_band=field == "albedo")
    if sorted(channels) != sorted(names):
        raise PhoslabError(
            f"has the channels {', '.join(sorted(channels))}",
            file=path,
            remedy=f"A map of {field} for this material has: {', '.join(names)}.",
        )
    for name, pixels in channels.items():
        if not np.isfinite(pixels).all() or (pixels < 0).any():
            raise PhoslabError(
                "holds a negative or non-finite value",
                file=path,
                field=f"channel {name}",
                remedy="Mend that texel.",
            )
    stacked = np.stack([channels[name] for name in names], axis=-1).astype(np.float32)
    return stacked.reshape(*stacked.shape[:2], *shape)
