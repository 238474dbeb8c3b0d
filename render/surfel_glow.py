"""What each surfel sends: the mean of its phosphor's radiance in the atlas over the area of the disk.

Where that is asked for, also what the surface reflects, on both of its sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import moderngl
import numpy as np

from phoslab.render.atlas_geometry import AtlasGeometry
from phoslab.render.atlas_glow import AtlasGlow
from phoslab.render.device import Device, bind_buffers, set_uniforms
from phoslab.render.lit_cells import LitCells, cells_around
from phoslab.render.optics import layer_count
from phoslab.render.passes import Picture
from phoslab.render.surfels import Surfels

# Sides of the copies are multiples of it: five MIP levels are then exact means, and Mesa 22 loses none (of odd sizes it
# empties all levels but the first, where there are several layers).
MULTIPLE = 32


class SurfelGlow:
    """Reads radiance for surfels from the MIP maps of the atlases; texels between charts are left out.

    Args:
        lit: cells whose reflections surfels send, too; then these have two sides. None: what glows, glows to the front.

    Attributes:
        sides: 1 or 2.
        radiances: a buffer of (count, sides, layers, 4) float32, in units of `glow`; 0 for what does not glow.
        glow: the largest radiance of any surfel, in the scene's units; 0 where nothing glows.
    """

    name: ClassVar[str] = "surfel_glow"
    reads: ClassVar[tuple[str, ...]] = ("atlas.radiance", "atlas.position_w", "surfels")
    writes: ClassVar[tuple[str, ...]] = ("surfel.radiance",)

    def __init__(
        self,
        device: Device,
        surfels: Surfels,
        glows: Sequence[AtlasGlow],
        atlases: Sequence[AtlasGeometry],
        n_bands: int,
        lit: LitCells | None,
    ) -> None:
        self._device, self._surfels, self._layers = device, surfels, layer_count(n_bands)
        self._sources = [
            (glow, atlas, device.texture_array(_padded(atlas.size), self._layers + 1))
            for glow, atlas in zip(glows, atlases, strict=True)
        ]
        self._lit, self.sides = lit, 1 if lit is None else 2
        if lit is not None:
            self._around = cells_around(lit.cells, lit.drawables, surfels.read())
        empty = np.zeros((surfels.count, self.sides, self._layers, 4), dtype=np.float32)
        self.radiances = device.buffer(empty)
        self.glow = 0.0

    def run(self) -> None:
        """Average what the atlases hold now."""
        device, count = self._device, self._surfels.count
        defines = {"LAYERS": self._layers}
        copy = device.compute("surfel_atlas", defines)
        read = device.compute(self.name, {**defines, "SIDES": self.sides})
        self.radiances.clear()
        for glow, atlas, covered in self._sources:
            glow.radiance.use(0)
            atlas.position_w.use(1)
            covered.bind_to_image(0, read=False, write=True)
            set_uniforms(copy, radiance=0, position_w=1)
            device.dispatch(copy, covered.size[:2])
            covered.build_mipmaps()
            covered.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
            covered.use(0)
            bind_buffers(self._surfels.buffer, self.radiances)
            share = tuple(n / m for n, m in zip(atlas.size, covered.size[:2], strict=True))
            set_uniforms(read, covered=0, share=share, number=float(glow.drawable.number), count=count)
            device.dispatch_items(read, count)
        values = np.frombuffer(self.radiances.read(), dtype="f4")[: count * self.sides * self._layers * 4]
        if self._lit is not None:
            leaf, weight = self._around
            reflected = self._lit.reflected().reshape(-1, 2 * self._layers * 4).astype(np.float32)
            values = values.reshape(count, -1).copy()
            for k in range(leaf.shape[1]):
                values += weight[:, k, None].astype(np.float32) * reflected[leaf[:, k]]
        self.glow = float(values.max(initial=0.0))
        if self.glow > 0:
            self.radiances.write((values / np.float32(self.glow)).tobytes())

    @property
    def made(self) -> tuple[moderngl.Buffer | moderngl.TextureArray, ...]:
        """What it holds on the device."""
        return (self.radiances, *(covered for _, _, covered in self._sources))

    def debug_views(self) -> dict[str, Picture]:
        """Nothing of its own: surfels are shown where the camera sees them."""
        return {}


def _padded(size: tuple[int, int]) -> tuple[int, int]:
    w, h = (-(-n // MULTIPLE) * MULTIPLE for n in size)
    return w, h
