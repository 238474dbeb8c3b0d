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

from phoslab.render.cell_glow import CellGlow
from phoslab.render.cell_light import CellLight, leaf_reflectances
from phoslab.render.cell_rays import CellTree
from phoslab.render.cells import build_cells
from phoslab.render.device import Device, read_array, set_uniforms
from phoslab.render.directions import patterned_points
from phoslab.render.glow_transport import Surroundings, TransportParameters
from phoslab.render.memory import check_room
from phoslab.render.optics import layer_count, to_layers
from phoslab.render.passes import Picture, false_grey

TILE = 16  # pixels along a side; as in shaders/include/tiles.glsl
GROUP_FLOATS = 12
# Directions that a shader holds in registers: measured on llvmpipe, 32 at once take ten times as long as 4 times 8.
BATCH = 8


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
        self.n_bands = surroundings.scene.transport.n
        self._tiles = (-(-w // TILE), -(-h // TILE))
        check_room(w * h * parameters.directions * 8, "what a picture's directions hit")
        self._hits = device.buffer(np.zeros((w * h * parameters.directions, 2), dtype=np.uint32))
        self._nearness = device.buffer(np.zeros(w * h, dtype=np.float32))
        self._guide = device.buffer(np.zeros((w * h, 2), dtype=np.float32))
        layers = layer_count(self.n_bands)
        self._light, self._spare = (device.texture_array((w, h), layers) for _ in range(2))
        self._placed: list[bytes] = []
        self.cell_glow: CellGlow
        self.tree: CellTree | None = None
        self.cell_light: CellLight | None = None
        self._pattern = max(1, parameters.filter_px)
        aimed = round(parameters.directions * parameters.guided)
        aimless = parameters.directions - aimed
        points = [patterned_points(self._pattern, n, seed) for seed, n in enumerate((aimless, aimed)) if n]
        self._points = device.buffer(np.concatenate(points, axis=2).astype(np.float32))
        self._defines = {
            "SUPERSAMPLING": surroundings.supersampling,
            "DIRECTIONS": parameters.directions,
            "AIMLESS": aimless,
            "BATCH": min(BATCH, parameters.directions),
            "PATTERN": self._pattern,
            "LAYERS": layers,
            "RADIUS": parameters.filter_px,
        }

    def _program(self, name: str, *defines: str, **more: int) -> moderngl.ComputeShader:
        """Return a shader with those of the defines that it uses: fewer variants are built."""
        return self._device.compute(name, {**{d: self._defines[d] for d in defines}, **more})

    def prepare(self) -> None:
        """Make the cells, and find what every ray meets."""
        self.place()
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
            walk, *chosen = self._choose_cells(groups, n_groups)
            self._find_hits(groups, walk, *chosen)
            self._find_guide(walk)

    def place(self) -> None:
        """Make the cells, and find what they see of each other, where drawables have moved since the last time."""
        around, p, device = self._around, self._parameters, self._device
        placed = [d.drawable.model_to_world.tobytes() for d in around.drawables]
        if placed == self._placed:
            return
        if self._placed:
            for made in (self.cell_glow, self.cell_light, self.tree):
                if made is not None:
                    made.release()
        self._placed = placed
        self.cells = build_cells(around.drawables, p.cell)
        self.cell_glow = CellGlow(device, self.cells, around.glows, self.n_bands)
        self.cell_light = self.tree = None
        if p.follows_cells:
            atlases = {g.drawable.number: a for g, a in zip(around.glows, around.atlases, strict=True)}
            self.tree = CellTree(device, self.cells)
            reflectances = leaf_reflectances(self.cells, around.drawables, atlases)
            lamps = around.lamps if p.lamps else None
            self.cell_light = CellLight(device, self.tree, reflectances, self.n_bands, p.bounces, lamps)

    def _bind_receivers(self, shader: moderngl.ComputeShader) -> None:
        self._around.gbuffer.position_w.use(0)
        self._around.gbuffer.normal_w.use(1)
        to_cells = (*self.cells.centre.tolist(), 1.0 / self.cells.radius)
        set_uniforms(shader, position_w=0, normal_w=1, to_cells=to_cells)

    def _bound_groups(self, groups: moderngl.Buffer) -> None:
        shader = self._group_shader
        self._bind_receivers(shader)
        groups.bind_to_storage_buffer(0)
        set_uniforms(shader, tiles=self._tiles)
        self._device.dispatch(shader, (self._tiles[0] * self._tiles[1], 1), group=(64, 1))

    def _choose_cells(self, groups: moderngl.Buffer, n_groups: int) -> tuple[moderngl.Buffer, ...]:
        """Return the cells to walk, where each group's list begins and the last ends, the lists, and the guides."""
        device = self._device
        walk, skip = (
            device.buffer(self.cells.walk()),
            device.buffer(self.cells.skip.astype(np.uint32)),
        )
        ends = device.buffer(np.zeros(n_groups + 1, dtype=np.uint32))
        lists = guides = ends
        for fill in (False, True):
            shader = self._cell_shaders[fill]
            for k, buffer in enumerate((groups, walk, skip, ends, *([lists, guides] if fill else []))):
                buffer.bind_to_storage_buffer(k)
            set_uniforms(
                shader,
                group_count=n_groups,
                cell_count=len(self.cells.skip),
                detail=self._parameters.detail,
            )
            device.dispatch(shader, (n_groups, 1), group=(16, 1))
            if not fill:
                counts = np.frombuffer(ends.read(), dtype=np.uint32)[:-1].astype(np.int64)
                self.list_lengths = counts
                begins = np.concatenate([[0], np.cumsum(counts)])
                n = int(begins[-1])
                check_room(n * 12, "the cells of the picture's tiles")
                ends.write(begins.astype(np.uint32).tobytes())
                lists = device.buffer(np.zeros(max(1, n), dtype=np.uint32))
                guides = device.buffer(np.zeros((max(1, n), 2), dtype=np.float32))
        return walk, ends, lists, guides

    def _find_hits(
        self,
        groups: moderngl.Buffer,
        walk: moderngl.Buffer,
        ends: moderngl.Buffer,
        lists: moderngl.Buffer,
        guides: moderngl.Buffer,
    ) -> None:
        shader = self._hit_shader
        self._bind_receivers(shader)
        tests = self._device.buffer(self.cells.tests())
        made = (self._points, self._hits, self._nearness)
        for k, buffer in enumerate((groups, tests, ends, lists, *made, guides, walk)):
            buffer.bind_to_storage_buffer(k)
        set_uniforms(shader, tiles=self._tiles)
        for first in range(0, self._parameters.directions, BATCH):
            set_uniforms(shader, first=first)
            shader.run(*self._tiles, 2)
            self._device.ctx.memory_barrier()

    def _find_guide(self, walk: moderngl.Buffer) -> None:
        size = self._around.size
        rough = self._device.buffer(np.zeros((size[0] * size[1], 2), dtype=np.float32))
        judge, smooth = self._guide_shaders
        self._bind_receivers(smooth)
        for shader, buffers in ((judge, (self._hits, walk, rough)), (smooth, (rough, self._guide))):
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
        self.cell_glow.run(self.cell_light)
        if self.cell_glow.glow == 0.0:
            return
        shader = self._program("tile_light", "DIRECTIONS", "LAYERS")
        self._hits.bind_to_storage_buffer(0)
        self.cell_glow.radiances.bind_to_storage_buffer(1)
        self._light.bind_to_image(0, read=False, write=True)
        self._device.dispatch(shader, self._around.size)
        self._share(radiance, self.cell_glow.glow)

    def reflect(self, light: NDArray[np.float32], radiance: moderngl.TextureArray) -> None:
        """Add what every sample reflects of (h, w, K) light, E / π a pixel, top row first, filtered as ours is."""
        self._light.write(to_layers(light[::-1]).astype("f4").tobytes())
        self._share(radiance, 1.0)

    def _share(self, radiance: moderngl.TextureArray, glow: float) -> None:
        if self._parameters.filter_px:
            self._filter()
        self._reflect(radiance, glow)

    def _filter(self) -> None:
        shader = self._program("glow_filter", "SUPERSAMPLING", "AIMLESS", "LAYERS", "RADIUS")
        self._bind_receivers(shader)
        self._nearness.bind_to_storage_buffer(0)
        self._guide.bind_to_storage_buffer(1)
        for along in ((1, 0), (0, 1)):
            self._light.use(2)
            set_uniforms(shader, light_in=2, along=along)
            self._spare.bind_to_image(0, read=False, write=True)
            self._device.dispatch(shader, self._around.size)
            self._light, self._spare = self._spare, self._light

    def _reflect(self, radiance: moderngl.TextureArray, glow: float) -> None:
        shader, gbuffer = (
            self._program("glow_reflect", "SUPERSAMPLING", "AIMLESS", "LAYERS"),
            self._around.gbuffer,
        )
        gbuffer.normal_w.use(1)
        gbuffer.uv.use(2)
        self._light.use(4)
        self._nearness.bind_to_storage_buffer(0)
        set_uniforms(
            shader,
            normal_w=1,
            uv=2,
            reflectance=3,
            light=4,
            glow=glow,
            radius=self.cells.radius,
        )
        radiance.bind_to_image(0, read=True, write=True)
        for drawable, rectangle in zip(self._around.drawables, gbuffer.rectangles, strict=True):
            if 0 in rectangle[2:]:
                continue
            drawable.reflectance.use(3)
            gbuffer.bind_samples(shader, drawable.number, rectangle, unit=0)
            self._device.dispatch(shader, rectangle[2:])

    def debug_views(self) -> dict[str, Picture]:
        """The light that falls on each pixel, how many of its directions meet a cell's front, and the first cell."""
        hits = self.hits()[::-1]
        colours = np.random.default_rng(0).uniform(0.2, 1.0, (len(self.cells.skip) + 1, 3))
        colours[0] = 0.0
        return {
            "light": false_grey(read_array(self._light, self.n_bands).sum(axis=-1)[::-1]),
            "met": np.repeat((hits > 0).mean(axis=-1)[..., None], 3, axis=-1),
            "cells": colours[hits[..., 0]],
        }
