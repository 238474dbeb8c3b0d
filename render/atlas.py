"""The phosphor's atlas: coordinates in which every point of a surface has a texel of its own.

A mesh whose texture coordinates are one-to-one inside [0, 1] keeps them. Any other gets a second set from xatlas.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import moderngl
import numpy as np

from phoslab.errors import PhoslabError
from phoslab.render.device import Device, read_texture
from phoslab.render.geometry import DEGENERATE, Geometry, with_atlas

# Overlaps are looked for at this many texels a side, finer than most atlases.
CHECK_TEXELS = 1024

# Texels between charts: one for bilinear reads, one for the dilated rim of each neighbour.
PADDING = 3


@dataclass(frozen=True, eq=False)
class Atlas:
    """A mesh with its atlas coordinates, and the (width, height) of the state texture that they fit."""

    geometry: Geometry
    size: tuple[int, int]


def make_atlas(device: Device, geometry: Geometry, texels: int) -> Atlas:
    """Return the mesh with one-to-one atlas coordinates, for about `texels` texels a side.

    Raises:
        PhoslabError: xatlas cannot unfold the mesh.
    """
    if is_one_to_one(device, geometry):
        return Atlas(replace(geometry, atlas_uv=geometry.uv), (texels, texels))
    return _unfold(geometry, texels)


def is_one_to_one(device: Device, geometry: Geometry) -> bool:
    """Whether the mesh's own texture coordinates give every point a place of its own inside [0, 1].

    Counts, by additive blending, how many triangles cover each texel: none may be covered twice.
    """
    uv = geometry.uv
    if uv is None or uv.min() < 0 or uv.max() > 1:
        return False
    a, b, c = uv.astype(np.float64)[geometry.triangles].transpose(1, 0, 2)
    area = np.abs(np.linalg.det(np.stack([b - a, c - a], axis=-1)))
    if (area <= DEGENERATE * np.mean(area)).any():
        return False
    with device.scope():
        count = device.texture((CHECK_TEXELS, CHECK_TEXELS), 1)
        program = device.program("atlas_count", vertex="atlas_geometry")
        mesh = device.vertex_array(
            program,
            {"atlas_uv": (device.buffer(uv.astype("f4")), "2f")},
            device.buffer(geometry.triangles.astype("u4")),
        )
        target = device.framebuffer([count])
        target.use()
        target.clear()
        device.ctx.enable_only(moderngl.BLEND)
        device.ctx.blend_func = moderngl.ONE, moderngl.ONE
        mesh.render()
        device.ctx.enable_only(moderngl.NOTHING)
        return bool(read_texture(count).max() <= 1.0)


def _unfold(geometry: Geometry, texels: int) -> Atlas:
    import xatlas

    atlas = xatlas.Atlas()
    options = xatlas.PackOptions()
    options.resolution, options.padding, options.bilinear = texels, PADDING, True
    try:
        atlas.add_mesh(geometry.positions, geometry.triangles, geometry.normals)
        atlas.generate(pack_options=options)
        vertices, triangles, uv = atlas[0]
    except (RuntimeError, ValueError) as error:
        raise PhoslabError(
            f"cannot be unfolded into an atlas ({error})",
            field="a phosphorescent mesh",
            remedy="Give it texture coordinates that map one-to-one into [0, 1].",
        ) from error
    return Atlas(
        with_atlas(geometry, vertices.astype("u4"), triangles.astype("u4"), uv.astype("f4")),
        (int(atlas.width), int(atlas.height)),
    )
