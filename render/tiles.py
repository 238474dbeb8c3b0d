"""Glow that surfaces send and others reflect, gathered in tiles of the picture.

    cells          the scene as a tree of flat cells                              once, while nothing moves
    tile_groups    what each tile of 16² pixels sees, in one or two groups        once
    tile_cells     the cells that stand for the scene, as seen from each group    once
    tile_hits      the nearest cell in each direction of each pixel               once
    tile_guide     where shadows may end, for the filter                          once
    glow_guide     the same, smoothed                                             once
    cell_rays      what the cells see of each other                               once, where light bounces
    cell_glow      what each cell sends                                           per picture
    tile_light     the mean over a pixel's directions                             per picture
    glow_filter    shared among the pixels of a surface                           per picture
    glow_reflect   times reflectance, onto every sample                           per picture

The idea of the bounced z-buffer (Nalbach, Ritschel and Seidel 2015) without its holes: cells cover flat surfaces
exactly, and every ray is held against a choice of cells that stands for all of the scene once, so nothing leaks between
levels. Since geometry alone decides what a ray meets, a picture of the same view at another time costs only the last
four. All surfaces block; light leaves the outside of a surface, and is reflected by both sides: by cells as often as is
asked for (`cell_light.py`), and at last by what the camera sees.
"""

from __future__ import annotations

from typing import ClassVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.render.cells import Cells
from phoslab.render.device import LOOP_TURNS, Device, set_uniforms
from phoslab.render.directions import mixed_points
from phoslab.render.glow_pixels import GlowPixels
from phoslab.render.glow_transport import Surroundings, TransportParameters
from phoslab.render.lit_cells import LitCells
from phoslab.render.memory import check_room
from phoslab.render.optics import layer_count, to_layers
from phoslab.render.passes import Picture
from phoslab.render.surfels import Extent

TILE = 16  # pixels along a side; as in shaders/include/tiles.glsl
GROUP_FLOATS = 12
# Directions that a shader looks in at once: on llvmpipe 8 take a quarter longer a direction, 32 ten times as long.
BATCH = 16
LONGEST_LIST = 65000  # of a tile's cells: a loop over it must end of itself (`LOOP_TURNS`)


class Tiles:
    """Gathers glow; the error falls with `directions`, `cell` and `detail`."""

    name: ClassVar[str] = "tiles"
    reads: ClassVar[tuple[str, ...]] = (
        "meshes",
        "position_w",
        "normal_w",
        "uv",
        "atlas.radiance",
        "reflectance",
    )
    writes: ClassVar[tuple[str, ...]] = ("radiance",)

    def __init__(self, device: Device, surroundings: Surroundings, parameters: TransportParameters) -> None:
        self._device, self._around, self._parameters = device, surroundings, parameters
        w, h = surroundings.size
        self._tiles = (-(-w // TILE), -(-h // TILE))
        check_room(w * h * parameters.directions * 8, "what a picture's directions hit")
        self._hits = device.buffer(np.zeros((w * h * parameters.directions, 2), dtype=np.uint32))
        self.lit_cells = LitCells(device, surroundings, parameters)
        pattern = max(1, parameters.filter_px)
        aimed = round(parameters.directions * parameters.guided)
        aimless = parameters.directions - aimed
        self._pixels = GlowPixels(device, surroundings, Extent.of(surroundings.drawables), looks=aimless)
        self._points = device.buffer(mixed_points(pattern, aimless, aimed).astype(np.float32))
        self._defines = {
            "SUPERSAMPLING": surroundings.supersampling,
            "DIRECTIONS": parameters.directions,
            "AIMLESS": aimless,
            "BATCH": min(BATCH, parameters.directions),
            "PATTERN": pattern,
            "LAYERS": layer_count(surroundings.scene.transport.n),
        }

    def _program(self, name: str, *defines: str) -> moderngl.ComputeShader:
        """Return a shader with those of the defines that it uses: fewer variants are built."""
        return self._device.compute(name, {d: self._defines[d] for d in defines})

    def prepare(self) -> None:
        """Make the cells, and find what every ray meets."""
        self.lit_cells.place()
        self._pixels.extent = Extent.of(self._around.drawables)
        # Built before the scope, so that they outlive it: while things move, this is done for every picture.
        self._hit_shader = self._program(
            "tile_hits", "SUPERSAMPLING", "DIRECTIONS", "AIMLESS", "PATTERN", "BATCH"
        )
        self._group_shader = self._program("tile_groups", "SUPERSAMPLING")
        self._guide_shaders = (
            self._program("tile_guide", "DIRECTIONS"),
            self._program("glow_guide", "SUPERSAMPLING"),
        )
        self._cell_shaders = [self._device.compute("tile_cells", d) for d in ({}, {"FILL": 1})]
        n_groups = 2 * self._tiles[0] * self._tiles[1]
        with self._device.scope():
            groups = self._device.buffer(np.zeros((n_groups, GROUP_FLOATS), dtype=np.float32))
            self._bound_groups(groups)
            chosen = self._choose_cells(groups, n_groups)
            self._find_hits(groups, *chosen)
            self._find_guide(chosen[0])

    @property
    def cells(self) -> Cells:
        """The scene's, as it stands."""
        return self.lit_cells.cells

    def _bound_groups(self, groups: moderngl.Buffer) -> None:
        shader = self._group_shader
        self._pixels.bind_receivers(shader)
        groups.bind_to_storage_buffer(0)
        set_uniforms(shader, tiles=self._tiles)
        self._device.dispatch(shader, (self._tiles[0] * self._tiles[1], 1), group=(64, 1))

    def _choose_cells(self, groups: moderngl.Buffer, n_groups: int) -> tuple[moderngl.Buffer, ...]:
        """Return the cells to walk, what each skips, where each group's list begins, the lists, and the guides."""
        device = self._device
        walk, skip = (
            device.buffer(self.cells.walk(sends_on=self._parameters.sends_on)),
            device.buffer(self.cells.skip.astype(np.uint32)),
        )
        ends = device.buffer(np.zeros(n_groups + 1, dtype=np.uint32))
        lists = guides = ends
        for fill in (False, True):
            shader = self._cell_shaders[fill]
            stages = device.buffer(np.zeros((n_groups, 3), dtype=np.uint32))
            for k, buffer in enumerate(
                (groups, walk, skip, ends, stages, *([lists, guides] if fill else []))
            ):
                buffer.bind_to_storage_buffer(k)
            set_uniforms(shader, group_count=n_groups, detail=self._parameters.detail)
            n_cells = len(self.cells.skip)
            for end in range(LOOP_TURNS, n_cells + LOOP_TURNS, LOOP_TURNS):
                set_uniforms(shader, stage_end=min(end, n_cells))
                device.dispatch(shader, (n_groups, 1), group=(16, 1))
            if not fill:
                counts = np.frombuffer(ends.read(), dtype=np.uint32)[:-1].astype(np.int64)
                self.list_lengths = counts
                check_list(int(counts.max(initial=0)))
                begins = np.concatenate([[0], np.cumsum(counts)])
                n = int(begins[-1])
                check_room(n * 12, "the cells of the picture's tiles")
                ends.write(begins.astype(np.uint32).tobytes())
                lists = device.buffer(np.zeros(max(1, n), dtype=np.uint32))
                guides = device.buffer(np.zeros((max(1, n), 2), dtype=np.float32))
        return walk, skip, ends, lists, guides

    def _find_hits(
        self,
        groups: moderngl.Buffer,
        walk: moderngl.Buffer,
        skip: moderngl.Buffer,
        ends: moderngl.Buffer,
        lists: moderngl.Buffer,
        guides: moderngl.Buffer,
    ) -> None:
        shader = self._hit_shader
        self._pixels.bind_receivers(shader)
        tests = self._device.buffer(self.cells.tests())
        made = (self._points, self._hits, self._pixels.nearness)
        for k, buffer in enumerate((groups, tests, ends, lists, *made, guides, walk, skip)):
            buffer.bind_to_storage_buffer(k)
        set_uniforms(shader, tiles=self._tiles)
        for first in range(0, self._parameters.directions, BATCH):
            set_uniforms(shader, first=first)
            shader.run(2 * self._tiles[0], self._tiles[1])
            self._device.ctx.memory_barrier()

    def _find_guide(self, walk: moderngl.Buffer) -> None:
        size = self._around.size
        rough = self._device.buffer(np.zeros((size[0] * size[1], 2), dtype=np.float32))
        judge, smooth = self._guide_shaders
        self._pixels.bind_receivers(smooth)
        for shader, buffers in ((judge, (self._hits, walk, rough)), (smooth, (rough, self._pixels.guide))):
            for k, buffer in enumerate(buffers):
                buffer.bind_to_storage_buffer(k)
            set_uniforms(shader, size=size)
            self._device.dispatch(shader, size)

    def hits(self) -> NDArray[np.uint32]:
        """Return (h, w, directions) 1 + the cell whose front each direction meets, or 0; row 0 is the lowest."""
        w, h = self._around.size
        met = np.frombuffer(self._hits.read(), dtype=np.uint32).reshape(h, w, -1, 2)[..., 0]
        return np.where(met % 2 == 1, met // 2 + 1, 0).astype(np.uint32)

    def run(self, radiance: moderngl.TextureArray) -> None:
        """Add what every sample reflects of the glow that its pixel's directions meet."""
        cell_glow = self.lit_cells.cell_glow
        cell_glow.run(self.lit_cells.cell_light)
        if cell_glow.glow == 0.0:
            return
        shader = self._program("tile_light", "DIRECTIONS", "LAYERS")
        self._hits.bind_to_storage_buffer(0)
        cell_glow.radiances.bind_to_storage_buffer(1)
        self._pixels.light.bind_to_image(0, read=False, write=True)
        self._device.dispatch(shader, self._around.size)
        self._share(radiance, cell_glow.glow)

    def reflect(self, light: NDArray[np.float32], radiance: moderngl.TextureArray) -> None:
        """Add what every sample reflects of (h, w, K) light, E / π a pixel, top row first, filtered as ours is."""
        self._pixels.light.write(to_layers(light[::-1]).astype("f4").tobytes())
        self._share(radiance, 1.0)

    def _share(self, radiance: moderngl.TextureArray, glow: float) -> None:
        if self._parameters.filter_px:
            self._pixels.filter(self._parameters.filter_px)
        self._pixels.reflect(radiance, glow)

    def debug_views(self) -> dict[str, Picture]:
        """The light that falls on each pixel, how many of its directions meet a cell's front, and the first cell."""
        hits = self.hits()[::-1]
        colours = np.random.default_rng(0).uniform(0.2, 1.0, (len(self.cells.skip) + 1, 3))
        colours[0] = 0.0
        return {
            "light": self._pixels.picture(),
            "met": np.repeat((hits > 0).mean(axis=-1)[..., None], 3, axis=-1),
            "cells": colours[hits[..., 0]],
        }


def check_list(longest: int) -> None:
    """Refuse what a shader's loop would leave out.

    Raises:
        PhoslabError: a tile has more cells than a loop has rounds.
    """
    if longest > LONGEST_LIST:
        raise PhoslabError(
            f"would hold its rays against {longest} cells, and no more than {LONGEST_LIST} are",
            field="a tile of the picture",
            remedy="Give a larger --cell or --detail or, where that many pieces stand apart, --gi dss-z or reference.",
        )
