"""Glow that surfaces send and others reflect, gathered in tiles of the picture.

    cells          the scene as a tree of flat cells                              once, while nothing moves
    tile_groups    what each tile of 16² pixels sees, in one or two groups        once
    tile_aims      the cells that stand for what glows, as seen from each group   once
    tile_hits      the nearest cell in each direction of each pixel               once
    tile_guide     where shadows may end, for the filter                          once
    glow_guide     the same, smoothed                                             once
    glow_share     which pixels share little: these look in more directions       once
    cell_rays      what the cells see of each other                               once, where light bounces
    cell_glow      what each cell sends                                           per picture
    tile_light     the mean over a pixel's directions                             per picture
    glow_filter    shared among the pixels of a surface                           per picture
    glow_reflect   times reflectance, onto every sample                           per picture

The idea of the bounced z-buffer (Nalbach, Ritschel and Seidel 2015) without its holes: cells cover flat surfaces
exactly, and every ray is held against a choice of cells that stands for all of the scene once, so nothing leaks between
levels. Rays aim at what is bright when it goes dark, and what they meet then holds: a picture of the same view at
another time of the same night costs only the last four. All surfaces block; light leaves the outside of a surface, and
is reflected by both sides: by cells as often as is asked for (`cell_light.py`), and at last by what the camera sees.
"""

from __future__ import annotations

from typing import ClassVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.render.cell_aims import aim_rows, brightness
from phoslab.render.cell_rays import CellTree
from phoslab.render.cells import Cells
from phoslab.render.device import LOOP_TURNS, Device, bind_buffers, set_uniforms
from phoslab.render.glow_pixels import GlowPixels
from phoslab.render.glow_transport import Surroundings, TransportParameters
from phoslab.render.lit_cells import LitCells
from phoslab.render.memory import check_room
from phoslab.render.optics import layer_count, to_layers
from phoslab.render.passes import Picture
from phoslab.render.surfels import Extent
from phoslab.render.tile_looks import MORE, MOST, MOST_MORE, Looks, in_order, that_share_little

TILE = 16  # pixels along a side; as in shaders/include/tiles.glsl
GROUP_FLOATS = 12
# Directions of a run of the shader that finds hits: its loops' turns count together (`LOOP_TURNS`).
BATCH = 8


class Tiles:
    """Gathers glow; the error falls with `directions`, `cell` and `detail`."""

    name: ClassVar[str] = "tiles"
    aims: ClassVar[bool] = True
    linear: ClassVar[bool] = True
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
        self.lit_cells = LitCells(device, surroundings, parameters)
        self._looks = Looks.of(device, w * h, parameters.directions, parameters)
        more = min(MORE * parameters.directions, MOST_MORE) if parameters.filter_px else 0
        self._more = Looks.of(device, int(MOST * w * h), more, parameters, 1) if more else None
        self._order = in_order((w, h), TILE, max(1, parameters.filter_px))
        self._looks.take(self._order)
        looks = self._looks.aimless
        self._pixels = GlowPixels(device, surroundings, Extent.of(surroundings.drawables), looks=looks)
        self._defines = {
            "SUPERSAMPLING": surroundings.supersampling,
            "BATCH": BATCH,
            "PATTERN": max(1, parameters.filter_px),
            "LAYERS": layer_count(surroundings.scene.transport.n),
        }

    def _program(self, name: str, *defines: str, looks: Looks | None = None) -> moderngl.ComputeShader:
        """Return a shader with those of the defines that it uses: fewer variants are built."""
        known = {**self._defines, **({} if looks is None else looks.defines)}
        return self._device.compute(name, {d: known[d] for d in defines})

    def _hit_shader(self, looks: Looks) -> moderngl.ComputeShader:
        return self._program("tile_hits", "SUPERSAMPLING", "PATTERN", "BATCH", *looks.defines, looks=looks)

    def prepare(self) -> None:
        """Make the cells, and find what every ray meets."""
        self.lit_cells.place()
        self._pixels.extent = Extent.of(self._around.drawables)
        # Built before the scope, so that they outlive it: while things move, this is done for every picture.
        for looks in filter(None, (self._looks, self._more)):
            self._hit_shader(looks)
        p = self._parameters
        if self._more is not None:
            self._pixels.share_shader(p.filter_px)
        self._group_shader = self._program("tile_groups", "SUPERSAMPLING")
        self._guide_shaders = (
            self._program("tile_guide", "DIRECTIONS", looks=self._looks),
            self._program("glow_guide", "SUPERSAMPLING"),
        )
        self._aim_shaders = [self._device.compute("tile_aims", d) for d in ({}, {"FILL": 1})]
        n_groups = 2 * self._tiles[0] * self._tiles[1]
        with self._device.scope():
            groups = self._device.buffer(np.zeros((n_groups, GROUP_FLOATS), dtype=np.float32))
            self._bound_groups(groups)
            tree = CellTree(self._device, self.cells, detail=p.detail, sends_on=p.sends_on)
            expected = brightness(self.cells, self.lit_cells.cell_glow.emitted(), self._around.drawables)
            corners = self._device.buffer(aim_rows(self.cells, expected))
            seen = (tree, groups, *self._choose_aims(tree, groups, n_groups, corners), corners)
            self._find_hits(self._looks, *seen)
            self._find_guide(tree, corners)
            if self._more is not None:
                shares = self._pixels.shares(p.filter_px)
                self._more.take(that_share_little(shares, self._order))
                self._find_hits(self._more, *seen)

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

    def _choose_aims(
        self, tree: CellTree, groups: moderngl.Buffer, n_groups: int, corners: moderngl.Buffer
    ) -> tuple[moderngl.Buffer, moderngl.Buffer]:
        """Return where each group's list of cells begins, and the lists with what they promise."""
        device = self._device
        ends = device.buffer(np.zeros(n_groups + 1, dtype=np.uint32))
        aims = device.buffer(np.zeros((1, 2), dtype=np.uint32))
        for fill in (False, True):
            shader = self._aim_shaders[fill]
            stages = device.buffer(np.zeros((n_groups, 3), dtype=np.uint32))
            tree.bind(shader)
            bind_buffers(groups, ends, stages, corners, *([aims] if fill else []), first=1)
            set_uniforms(shader, group_count=n_groups)
            n_cells = len(self.cells.skip)
            for end in range(LOOP_TURNS, n_cells + LOOP_TURNS, LOOP_TURNS):
                set_uniforms(shader, stage_end=min(end, n_cells))
                device.dispatch(shader, (n_groups, 1), group=(16, 1))
            if not fill:
                self.aim_counts = np.frombuffer(ends.read(), dtype=np.uint32)[:-1].astype(np.int64)
                begins = np.concatenate([[0], np.cumsum(self.aim_counts)])
                n = int(begins[-1])
                check_room(n * 8, "the cells at which a picture's directions aim")
                ends.write(begins.astype(np.uint32).tobytes())
                aims = device.buffer(np.zeros((max(1, n), 2), dtype=np.uint32))
        return ends, aims

    def _find_hits(
        self,
        looks: Looks,
        tree: CellTree,
        groups: moderngl.Buffer,
        ends: moderngl.Buffer,
        aims: moderngl.Buffer,
        corners: moderngl.Buffer,
    ) -> None:
        if not looks.count:
            return
        shader = self._hit_shader(looks)
        self._pixels.bind_receivers(shader)
        tree.bind(shader)
        own = (looks.points, looks.pixels, looks.hits, self._pixels.nearness)
        bind_buffers(groups, ends, aims, corners, *own, first=1)
        set_uniforms(
            shader,
            tiles=self._tiles,
            count=looks.count,
            all_send=self._parameters.sends_on,
            is_first=looks is self._looks,
        )
        for first in range(0, looks.directions, BATCH):
            set_uniforms(shader, first=first)
            self._device.dispatch_items(shader, looks.count)
        tree.check()

    def _find_guide(self, tree: CellTree, corners: moderngl.Buffer) -> None:
        size = self._around.size
        rough = self._device.buffer(np.zeros((size[0] * size[1], 2), dtype=np.float32))
        judge, smooth = self._guide_shaders
        tree.bind(judge)
        bind_buffers(self._looks.hits, self._looks.pixels, rough, corners, first=1)
        set_uniforms(judge, count=self._looks.count)
        self._device.dispatch_items(judge, self._looks.count)
        self._pixels.bind_receivers(smooth)
        bind_buffers(rough, self._pixels.guide)
        set_uniforms(smooth, size=size)
        self._device.dispatch(smooth, size)

    def hits(self) -> NDArray[np.uint32]:
        """Return (h, w, directions) 1 + the cell whose front each direction meets, or 0; row 0 is the lowest."""
        w, h = self._around.size
        found = np.frombuffer(self._looks.hits.read(), dtype=np.uint32).reshape(h * w, -1, 2)[..., 0]
        met = np.empty_like(found)
        met[self._order] = found
        return np.where(met % 2 == 1, met // 2 + 1, 0).astype(np.uint32).reshape(h, w, -1)

    def run(self, radiance: moderngl.TextureArray) -> None:
        """Add what every sample reflects of the glow that its pixel's directions meet."""
        cell_glow = self.lit_cells.cell_glow
        cell_glow.run(self.lit_cells.cell_light)
        if cell_glow.glow == 0.0:
            return
        self._pixels.light.bind_to_image(0, read=True, write=True)
        directions = 0
        for looks in filter(None, (self._looks, self._more)):
            if not looks.count:
                continue
            shader = self._program("tile_light", "DIRECTIONS", "LAYERS", looks=looks)
            bind_buffers(looks.hits, cell_glow.radiances, looks.pixels)
            directions += looks.directions
            set_uniforms(shader, count=looks.count, share=looks.directions / directions)
            self._device.dispatch_items(shader, looks.count)
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
