"""Light of surfaces that falls on a phosphor: gathered at a few texels of its atlas, and read between them.

With it a glow charges what no lamp reaches: other materials, and its own where emission and excitation overlap.
"""

from __future__ import annotations

import numpy as np

from phoslab.render.atlas_geometry import AtlasGeometry
from phoslab.render.atlas_irradiance import AtlasIrradiance
from phoslab.render.cell_light import CellLight, scaled
from phoslab.render.cell_rays import Array, CellRays, CellTree
from phoslab.render.device import Device, read_texture, set_uniforms
from phoslab.render.optics import layer_count

# Along the longer side of an atlas, at most: between them irradiance from surfaces is smooth, but for contacts.
FEW = 86
# Rays of each: what they miss stays in the state.
DIRECTIONS = 256


class AtlasGather:
    """The few texels of one atlas, and what their rays meet."""

    def __init__(self, device: Device, tree: CellTree, atlas: AtlasGeometry, n_bands: int) -> None:
        self._device, self._atlas, self._layers = device, atlas, layer_count(n_bands)
        size = np.array(atlas.size)
        step = -(-int(size.max()) // FEW)
        w, h = -(-size // step)
        position, normal = (read_texture(t) for t in (atlas.position_w, atlas.normal_w))
        row, column = _covered(position[..., 3] > 0, step, (int(h), int(w)))
        position, normal = position[row, column], normal[row, column]
        length = np.linalg.norm(normal[..., :3], axis=-1, keepdims=True)
        normal[..., :3] /= np.maximum(length, 1e-30)
        self._position = device.texture((int(w), int(h)), 4, position)
        self._normal = device.texture((int(w), int(h)), 4, normal)
        points = (position[..., :3].reshape(-1, 3).astype(np.float64) - tree.cells.centre) / tree.cells.radius
        there = position[..., 3].ravel() > 0
        normals = normal[..., :3].reshape(-1, 3).astype(np.float64)
        self._rays = CellRays(device, tree, points, normals, there, DIRECTIONS)
        self._light = device.buffer(np.zeros((len(points), self._layers, 4), dtype=np.float32))

    def release(self) -> None:
        """Give its buffers back."""
        self._device.release(self._position, self._normal, self._light)
        self._rays.release()

    def add(self, cell_light: CellLight, radiances: Array, light: AtlasIrradiance) -> None:
        """Add to an atlas's irradiance what (m, 2, 4 layers) radiances of the cells' sides bring."""
        scale = scaled(self._device, cell_light.leaves, radiances)
        if scale == 0.0:
            return
        self._rays.gather(cell_light.leaves, self._layers, self._light)
        shader = self._device.compute("atlas_add", {"LAYERS": self._layers})
        textures = (self._atlas.position_w, self._atlas.normal_w, self._position, self._normal)
        for unit, texture in enumerate(textures):
            texture.use(unit)
        set_uniforms(shader, position_w=0, normal_w=1, few_position=2, few_normal=3, scale=scale)
        self._light.bind_to_storage_buffer(0)
        light.irradiance.bind_to_image(0, read=True, write=True)
        self._device.dispatch(shader, self._atlas.size)


def _covered(
    covered: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], step: int, shape: tuple[int, int]
) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.intp]], np.ndarray[tuple[int, ...], np.dtype[np.intp]]]:
    """Return the row and column of one texel of each block of `step`²: the nearest to its middle that is covered."""
    h, w = shape
    padded = np.zeros((h * step, w * step), dtype=bool)
    padded[: covered.shape[0], : covered.shape[1]] = covered
    blocks = padded.reshape(h, step, w, step).transpose(0, 2, 1, 3).reshape(h, w, -1)
    y, x = np.divmod(np.arange(step * step), step)
    away = (y - (step - 1) / 2) ** 2 + (x - (step - 1) / 2) ** 2
    best = np.argmin(np.where(blocks, away, 1e9), axis=-1)
    row = np.minimum(np.arange(h)[:, None] * step + y[best], covered.shape[0] - 1)
    column = np.minimum(np.arange(w)[None, :] * step + x[best], covered.shape[1] - 1)
    return row, column
