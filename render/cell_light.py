"""Light from surface to surface, before it reaches what the camera sees: what the smallest cells reflect.

Every cell gathers, on both sides, what the others send, and sends its reflectance's share of it on, as often as is
asked for. What lamps shine on the cells joins in where that is asked for, taken at each cell's middle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.render.atlas_geometry import AtlasGeometry
from phoslab.render.cell_rays import CellRays, CellTree
from phoslab.render.cells import Cells
from phoslab.render.device import Device, read_array, read_texture, set_uniforms
from phoslab.render.gpu_scene import GpuDrawable
from phoslab.render.optics import layer_count
from phoslab.render.shadow_map import ShadowMap
from phoslab.render.superposition import Superposition

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

# Rays of each side of a cell: what they miss is spread over the many cells that a pixel sees.
DIRECTIONS = 64
_ROW = 1024  # cells along the side of the texture in which lamps shine on them


@dataclass(eq=False)
class Lamps:
    """The lamps as they are at the picture's time.

    Args:
        shadows: that of their shadows.
        factors: of each lamp; absent: off.
    """

    shadows: ShadowMap
    factors: Mapping[str, float] = field(default_factory=dict)


class CellLight:
    """What smallest cells reflect.

    Args:
        bounces: reflections on the way to the camera in all; the last is not that of a cell.
        reflectances: (m, K) of the smallest cells.
        lamps: whose light joins in; None: glow alone.
    """

    def __init__(
        self,
        device: Device,
        tree: CellTree,
        reflectances: Array,
        n_bands: int,
        bounces: int,
        lamps: Lamps | None,
    ) -> None:
        self._device, self._cells, self._n_bands = device, tree.cells, n_bands
        self._bounces, self._lamps, self.layers = bounces, lamps, layer_count(n_bands)
        m = len(tree.cells.leaf_areas)
        self._reflectances = np.zeros((m, 1, 4 * self.layers))
        self._reflectances[:, 0, :n_bands] = reflectances
        self.points, self.normals = middles(tree.cells)
        zeros = np.zeros((m, 2, self.layers, 4), dtype=np.float32)
        self.leaves, self._light = device.buffer(zeros), device.buffer(zeros)
        self._sums = Superposition(self._followed)
        self._rays: CellRays | None = None
        if bounces > 1:
            sides = np.stack([self.normals, -self.normals], axis=1).reshape(-1, 3)
            there = np.ones(2 * m, dtype=bool)
            self._rays = CellRays(device, tree, np.repeat(self.points, 2, axis=0), sides, there, DIRECTIONS)

    def release(self) -> None:
        """Give its buffers back."""
        self._device.release(self.leaves, self._light)
        if self._rays is not None:
            self._rays.release()

    def spread(self, emitted: Array, factors: Mapping[str, float] | None = None) -> Array:
        """Return (m, 2, 4 layers) the radiance of the front and back of each smallest cell.

        Args:
            emitted: (m, 4 layers) what the fronts give off.
            factors: of the lamps; None: those of the picture.
        """
        sent = np.zeros((len(emitted), 2, emitted.shape[1]))
        sent[:, 0] = emitted
        if self._lamps is not None:
            sent += self._reflectances * self._lamp_light(self._lamps, factors) / np.pi
        return sent if self._rays is None else self._sums.of(sent)

    def _followed(self, sent: Array) -> Array:
        """Return (m, 2, 4 layers) what cells send, with what they reflect of that."""
        total = sent.copy()
        for _ in range(self._bounces - 1):
            scale = float(np.abs(sent).max())
            if scale == 0.0:
                break
            sent = scale * self._reflectances * self._gathered(sent / scale)
            total += sent
        return total

    def _gathered(self, sent: Array) -> Array:
        """Return (m, 2, 4 layers) E / π on each side, from what they send."""
        assert self._rays is not None
        self.leaves.write(sent.astype(np.float32).tobytes())
        self._rays.gather(self.leaves, self.layers, self._light)
        return np.frombuffer(self._light.read(), dtype="f4").reshape(sent.shape).astype(np.float64)

    def _lamp_light(self, lamps: Lamps, factors: Mapping[str, float] | None) -> Array:
        """Return (m, 2, 4 layers) the lamps' irradiance at the middle of each cell, on both sides."""
        factors = lamps.factors if factors is None else factors
        m, layers = len(self.points), self.layers
        if not any(factors.values()):
            return np.zeros((m, 2, 4 * layers))
        device, size = self._device, (_ROW, -(-2 * m // _ROW))
        with device.scope():
            position, normal = (np.zeros((size[0] * size[1], 4)) for _ in range(2))
            world = self.points * self._cells.radius + self._cells.centre
            position[: 2 * m, :3], position[: 2 * m, 3] = np.repeat(world, 2, axis=0), 1.0
            normal[: 2 * m, :3] = np.stack([self.normals, -self.normals], axis=1).reshape(-1, 3)
            shaped = (size[1], size[0], 4)
            device.texture(size, 4, position.reshape(shaped)).use(0)
            device.texture(size, 4, normal.reshape(shaped)).use(1)
            irradiance = device.texture_array(size, layers)
            program = device.compute("atlas_irradiance", {**lamps.shadows.defines, "LAYERS": layers})
            set_uniforms(program, position_w=0, normal_w=1)
            lamps.shadows.bind(program, factors, unit=2)
            irradiance.bind_to_image(0, read=False, write=True)
            device.dispatch(program, size)
            flat = read_array(irradiance, 4 * layers).reshape(-1, 4 * layers)[: 2 * m]
        return flat.reshape(m, 2, -1).astype(np.float64)


def middles(cells: Cells) -> tuple[Array, Array]:
    """Return (m, 3) the middle of each smallest cell, in their coordinates, and its normal."""
    leaf = np.flatnonzero(cells.skip == np.arange(1, len(cells.skip) + 1))
    a, b, c = cells.corners[leaf].transpose(1, 0, 2)
    middle = np.where(cells.is_triangle[leaf, None], (a + b + c) / 3, (b + c) / 2)
    return middle, cells.normals[leaf]


def leaf_reflectances(
    cells: Cells, drawables: Sequence[GpuDrawable], atlases: Mapping[int, AtlasGeometry]
) -> Array:
    """Return (m, K) the reflectance of each smallest cell: that of a phosphor in its middle, else its drawable's mean.

    Args:
        atlases: by the number of each drawable that glows.
    """
    each = []
    for k, drawable in enumerate(drawables):
        rho = drawable.drawable.reflectance
        h, w = rho.shape[:2]
        first, end = cells.owners[k], cells.owners[k + 1]
        if (h, w) == (1, 1) or drawable.number not in cells.patches:
            mean = rho.mean(axis=(0, 1), dtype=np.float64)
            each.append(np.broadcast_to(mean, (end - first, len(mean))))
            continue
        patches, atlas = cells.patches[drawable.number], atlases[drawable.number]
        middle = np.zeros((end - first, 2))
        middle[patches.leaf - first] = patches.uv.mean(axis=1)
        texel = np.clip(np.floor(middle * atlas.size), 0, np.array(atlas.size) - 1).astype(np.intp)
        uv = read_texture(atlas.uv)[texel[:, 1], texel[:, 0], :2] % 1.0
        column = np.floor(uv[:, 0] * w).astype(int).clip(0, w - 1)
        row = np.floor(uv[:, 1] * h).astype(int).clip(0, h - 1)
        each.append(rho[row, column].astype(np.float64))
    return np.concatenate(each)


def scaled(device: Device, leaves: moderngl.Buffer, radiances: Array) -> float:
    """Write (m, 2, 4 layers) radiances over their largest into a buffer; return that."""
    scale = float(radiances.max(initial=0.0))
    if scale > 0:
        leaves.write((radiances / scale).astype(np.float32).tobytes())
    return scale
