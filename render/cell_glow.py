"""What each cell of a scene sends: the mean radiance of its texels, and of the cells that it is made of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.render.atlas_glow import AtlasGlow
from phoslab.render.cell_forest import Patches
from phoslab.render.cell_light import CellLight
from phoslab.render.cells import Cells
from phoslab.render.device import LOOP_TURNS, Device, bind_buffers, read_texture, set_uniforms
from phoslab.render.optics import layer_count
from phoslab.render.passes import Picture

Array = NDArray[np.float64]


class CellGlow:
    """Averages the phosphors' atlases over the smallest cells, then those over the larger ones.

    Every texel counts once, with the area that it stands for, so a cell sends what its surface sends.

    Attributes:
        radiances: a buffer of (n_cells, 2, layers, 4) float32: of front and back, in units of `glow`.
        glow: the largest radiance of any cell, in the scene's units; 0 where nothing glows.
    """

    name: ClassVar[str] = "cell_glow"
    reads: ClassVar[tuple[str, ...]] = ("atlas.radiance", "cells")
    writes: ClassVar[tuple[str, ...]] = ("cell.radiance",)

    def __init__(self, device: Device, cells: Cells, glows: Sequence[AtlasGlow], n_bands: int) -> None:
        self._device, self._cells = device, cells
        self._layers = layer_count(n_bands)
        self._leaf_radiances = device.buffer(
            np.zeros((len(cells.leaf_areas), self._layers, 4), dtype=np.float32)
        )
        self.radiances = device.buffer(np.zeros((len(cells.skip), 2, self._layers, 4), dtype=np.float32))
        self._program = device.compute(self.name, {"LAYERS": self._layers, "PART": LOOP_TURNS})
        self._lists = [
            _list_texels(device, glow, cells.patches[glow.drawable.number])
            for glow in glows
            if glow.drawable.number in cells.patches
        ]
        self.glow = 0.0

    def run(self, cell_light: CellLight | None = None) -> None:
        """Average what the atlases hold now, and what cells reflect of it."""
        emitted = self.emitted()
        if cell_light is None:
            sides = np.stack([emitted, np.zeros_like(emitted)], axis=1)
        else:
            sides = cell_light.spread(emitted)
        means = self._cells.averages(sides.reshape(len(emitted), -1))
        self.glow = float(means.max(initial=0.0))
        if self.glow > 0:
            self.radiances.write((means / self.glow).astype("f4").tobytes())

    def emitted(self) -> Array:
        """Return (m, 4 layers) what the fronts of the smallest cells give off, from what the atlases hold now."""
        for texels in self._lists:
            texels.glow.radiance.use(0)
            bind_buffers(texels.ends, texels.texels, self._leaf_radiances)
            set_uniforms(self._program, radiance=0, first=texels.first, count=texels.count)
            for part in range(0, texels.most, LOOP_TURNS):
                set_uniforms(self._program, part=part)
                self._device.dispatch_items(self._program, texels.count)
        leaves = np.frombuffer(self._leaf_radiances.read(), dtype="f4").astype(np.float64)
        return leaves.reshape(len(self._cells.leaf_areas), -1)

    def release(self) -> None:
        """Give its buffers back: the cells are made anew."""
        lists = [buffer for texels in self._lists for buffer in (texels.ends, texels.texels)]
        self._device.release(self._leaf_radiances, self.radiances, *lists)

    def debug_views(self) -> dict[str, Picture]:
        """Nothing of its own: `Tiles` shows cells where they are hit."""
        return {}


class _TexelLists:
    """The texels of one phosphor's smallest cells: `count` of them from `first` on, among all leaves; `most` of one."""

    def __init__(
        self, device: Device, glow: AtlasGlow, first: int, ends: NDArray[np.intp], texels: NDArray[np.uint32]
    ) -> None:
        self.glow, self.first, self.count = glow, first, len(ends) - 1
        self.most = int(np.diff(ends).max())
        self.ends, self.texels = device.buffer(ends.astype(np.uint32)), device.buffer(texels)


def _list_texels(device: Device, glow: AtlasGlow, patches: Patches) -> _TexelLists:
    size = glow.radiance.size[:2]
    first, count = int(patches.leaf.min()), int(np.ptp(patches.leaf)) + 1
    leaf, density = _draw(device, size, patches, first)
    row, column = np.nonzero(leaf >= 0)
    of, share = leaf[row, column], density[row, column].astype(np.float64)
    # A cell too small to hold a texel's centre has the texel in its middle.
    without = np.flatnonzero(np.bincount(of, minlength=count) == 0)
    middle = np.zeros((count, 2))
    middle[patches.leaf - first] = patches.uv.mean(axis=1)
    texel = np.clip(np.floor(middle[without] * size), 0, np.array(size) - 1).astype(np.intp)
    of = np.concatenate([of, without])
    column, row = np.concatenate([column, texel[:, 0]]), np.concatenate([row, texel[:, 1]])
    share = np.concatenate([share, np.ones(len(without))])
    share /= np.bincount(of, weights=share, minlength=count)[of]
    order = np.argsort(of, kind="stable")
    ends = np.concatenate([[0], np.cumsum(np.bincount(of, minlength=count))])
    listed = np.zeros((len(of), 4), dtype=np.uint32)
    listed[:, 0], listed[:, 1] = column[order], row[order]
    listed[:, 2] = share[order].astype(np.float32).view(np.uint32)
    return _TexelLists(device, glow, first, ends, listed)


def _draw(
    device: Device, size: tuple[int, int], patches: Patches, first: int
) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Return (h, w) the leaf of each texel, -1 where there is none, and the area that it stands for."""
    with device.scope():
        target = device.texture(size, 2)
        framebuffer = device.framebuffer([target])
        program = device.program("cell_texels")
        # Relative areas: float32 holds them in scenes of any size.
        values = np.stack([patches.leaf - first, patches.density / patches.density.max()], axis=1)
        mesh = device.vertex_array(
            program,
            {
                "uv": (device.buffer(patches.uv.reshape(-1, 2).astype("f4")), "2f"),
                "value": (device.buffer(np.repeat(values, 3, axis=0).astype("f4")), "2f"),
            },
        )
        framebuffer.use()
        framebuffer.clear(-1.0, 0.0)
        device.ctx.enable_only(moderngl.NOTHING)
        mesh.render()
        drawn = read_texture(target)
    return np.rint(drawn[..., 0]).astype(np.intp), drawn[..., 1]
