"""Deep screen space with visibility: the bounced z-buffer (BZB 2015; Nalbach 2017, ch. 6).

surfelize          disks of about one size on the screen, of all that blocks   once, while nothing moves
receiver_bounds    least and greatest coordinates of blocks of pixels          once
shell_receivers    what pixels see, in the order of a level's sub-buffers      once, per level
shell_cull         the splats that reach a pixel                               once, per level
bounce_directions  where each pixel looks: at random, and at what glows        once
bounce_begin       the directions of a level's pixels, and an empty z-buffer   once, per level
bounce_splat       the nearest disk that each direction meets                  once, per level
bounce_hits        back to the pixels; what a finer level found stands         once, per level
surfel_glow        what each disk sends                                        per picture
bounce_light       the mean over a pixel's directions                          per picture
glow_filter        shared among the pixels of a surface                        per picture
glow_reflect       times reflectance, onto every sample                        per picture

Disks of nominal area leave holes between them, so they are enlarged by `INFLATION`, which makes them protrude instead:
the error stalls there, however many directions a pixel has. Shells are told by the distance of the hit, not by that of
the centre: a large disk seen at a grazing angle then has no gap between two levels.
"""

from __future__ import annotations

from typing import Any, ClassVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.render.device import Device, read_texture, set_uniforms
from phoslab.render.directions import mixed_points
from phoslab.render.glow_pixels import GlowPixels
from phoslab.render.glow_transport import Surroundings, TransportParameters
from phoslab.render.guides import GUIDES, make_guides
from phoslab.render.lit_cells import LitCells
from phoslab.render.memory import check_room
from phoslab.render.optics import layer_count
from phoslab.render.passes import Picture, false_normal
from phoslab.render.shells import SEED, ShellLevels, choose_levels, first_shell, radius_of
from phoslab.render.surfel_glow import SurfelGlow
from phoslab.render.surfel_picture import colours, picture_of
from phoslab.render.surfels import Extent, View, surfelize

# Radius within which a disk is hit, over that of its nominal area.
INFLATION = 1.4
# Hits nearer than this share of a disk's radius are the receiver's own surface.
OWN = 0.05
FARTHEST = 2.0  # across the scene


class BouncedZBuffer:
    """Keeps the nearest surfel in each of a pixel's directions; the error falls with `directions` until it stalls."""

    name: ClassVar[str] = "dss-z"
    aims: ClassVar[bool] = False
    linear: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = (
        "meshes",
        "camera",
        "position_w",
        "normal_w",
        "uv",
        "atlas.radiance",
        "reflectance",
    )
    writes: ClassVar[tuple[str, ...]] = ("radiance",)
    shells_culled: ClassVar[bool] = True  # False: draws what reaches no receiver, too

    def __init__(self, device: Device, surroundings: Surroundings, parameters: TransportParameters) -> None:
        self._device, self._around, self._parameters = device, surroundings, parameters
        w, h = surroundings.size
        aimed = parameters.aimed(parameters.directions, usual=1 / 2)
        aimless = parameters.directions - aimed
        n, pattern = parameters.directions, max(1, parameters.filter_px)
        check_room(5 * w * h * n * 4, "what a picture's directions hit")
        self._layers = layer_count(surroundings.scene.transport.n)
        self._pixels = GlowPixels(device, surroundings, Extent.of(surroundings.drawables), looks=aimless)
        self.lit_cells = LitCells(device, surroundings, parameters) if parameters.follows_cells else None
        self._made: list[Any] = []
        self._points = device.buffer(mixed_points(pattern, aimless, aimed).astype(np.float32))
        self._hits, self._looks = device.reserve(w * h * n * 4), device.reserve(w * h * n * 8)
        self._guides = device.reserve(GUIDES * 32)
        self._directions = {"DIRECTIONS": n}
        self._defines = {"DIRECTIONS": n, "SUPERSAMPLING": surroundings.supersampling}
        self._choice = {"AIMLESS": aimless, "PATTERN": pattern, "GUIDES": GUIDES}
        self._program = device.program("bounce_splat", defines=self._directions)
        self._quads = device.vertex_array(self._program)

    def prepare(self) -> None:
        """Make the surfels, and find what every direction meets."""
        device, p, around = self._device, self._parameters, self._around
        device.release(*self._made)
        self.extent = self._pixels.extent = Extent.of(around.drawables)
        view = View.of(around.gbuffer.camera, self.extent, p.surfel)
        if self.lit_cells is not None:
            self.lit_cells.place()
        self.surfels = surfelize(device, around.drawables, self.extent, view)
        n_bands = around.scene.transport.n
        lit = self.lit_cells if p.sends_on else None
        self.surfel_glow = SurfelGlow(device, self.surfels, around.glows, around.atlases, n_bands, lit)
        self._made = [self.surfels.buffer, *self.surfel_glow.made]
        self._choose_directions()
        levels = choose_levels(p.levels, self.surfels, p.epsilon, around.size)
        self.first_shell = first_shell(radius_of(self.surfels, 0.5), p.epsilon)
        self._surfel_bits = max(1, int(self.surfels.count - 1).bit_length())
        self._hits.write(bytes(self._hits.size))
        with device.scope():
            self.shells = ShellLevels(
                device, around, self._pixels, self.extent, levels, culled=self.shells_culled
            )
            self.shells.prepare()
            texels = self.shells.size[0] * self.shells.size[1]
            depths, directions = (device.reserve(texels * p.directions * 4) for _ in range(2))
            target = device.empty_framebuffer(self.shells.size)
            for level in range(levels):
                with device.scope():
                    self.shells.shuffle(level)
                    self._begin(level, self.shells, depths, directions, self._hits)
                    self._splat(level, depths, directions, target)
                    self._find_hits(level, depths)

    def _bind(self, **buffers: moderngl.Buffer) -> None:
        for name, place in BINDINGS.items():
            if name in buffers:
                buffers[name].bind_to_storage_buffer(place)

    def _choose_directions(self) -> None:
        disks = self.surfels.read()
        glows = [d.number for d in self._around.drawables if d.material is not None]
        self._guides.write(make_guides(disks, np.isin(disks[:, 7], glows)).tobytes())
        shader = self._device.compute("bounce_directions", {**self._defines, **self._choice})
        self._pixels.bind_receivers(shader)
        self._bind(points=self._points, looks=self._looks, guides=self._guides)
        self._device.dispatch(shader, self._around.size)

    def _begin(
        self,
        level: int,
        shells: ShellLevels,
        depths: moderngl.Buffer,
        directions: moderngl.Buffer,
        hits: moderngl.Buffer,
    ) -> None:
        shader = self._device.compute("bounce_begin", self._defines)
        self._pixels.bind_receivers(shader)
        self._bind(depths=depths, directions=directions, looks=self._looks, hits=hits)
        shells.position.bind_to_image(0, read=True, write=True)
        set_uniforms(shader, level=level, seed=SEED, row=shells.size[0])
        self._device.dispatch(shader, shells.size)

    def _splat(
        self,
        level: int,
        depths: moderngl.Buffer,
        directions: moderngl.Buffer,
        target: moderngl.Framebuffer,
    ) -> None:
        last = level == self.shells.levels - 1
        splats = self.shells.find_splats(
            self.surfels,
            self.surfel_glow.radiances,
            level,
            {"BOUNCED": 1},
            first_shell=self.first_shell,
            inflation=INFLATION,
            last=last,
        )
        outer = self.first_shell * 2**level
        shell = (outer / 2 if level else OWN * radius_of(self.surfels, 0.5), FARTHEST if last else outer)
        target.use()
        self._bind(surfels=self.surfels.buffer, depths=depths, directions=directions, splats=splats.buffer)
        self.shells.bind_shuffled(self._program)
        set_uniforms(
            self._program,
            level=level,
            inflation=INFLATION,
            row=self.shells.size[0],
            shell=shell,
            surfel_bits=self._surfel_bits,
        )
        self._device.ctx.enable_only(moderngl.NOTHING)
        if splats.count:
            self._quads.render(vertices=6 * splats.count)
        self._device.ctx.memory_barrier()

    def _find_hits(self, level: int, depths: moderngl.Buffer) -> None:
        shader = self._device.compute("bounce_hits", self._defines)
        self._bind(depths=depths, hits=self._hits)
        set_uniforms(
            shader,
            level=level,
            seed=SEED,
            size=self._around.size,
            row=self.shells.size[0],
            surfel_bits=self._surfel_bits,
        )
        self._device.dispatch(shader, self._around.size)

    def hits(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return (h, w, directions) the surfel that each direction meets, or -1, and the level that found it."""
        w, h = self._around.size
        words = np.frombuffer(self._hits.read(), dtype=np.uint32).reshape(h, w, -1).astype(np.int64)
        return (words & ((1 << LEVEL_BIT) - 1)) - 1, words >> LEVEL_BIT

    def run(self, radiance: moderngl.TextureArray) -> None:
        """Add what every sample reflects of the glow that its pixel's directions meet."""
        self.surfel_glow.run()
        if self.surfel_glow.glow == 0.0:
            return
        shader = self._device.compute(
            "bounce_light",
            {
                **self._defines,
                "LAYERS": self._layers,
                "SIDES": self.surfel_glow.sides,
                "AIMLESS": self._choice["AIMLESS"],
            },
        )
        self._pixels.bind_receivers(shader)
        self._bind(
            surfels=self.surfels.buffer,
            radiances=self.surfel_glow.radiances,
            looks=self._looks,
            hits=self._hits,
            nearness=self._pixels.nearness,
        )
        self._pixels.light.bind_to_image(0, read=False, write=True)
        self._device.dispatch(shader, self._around.size)
        if self._parameters.filter_px:
            self._pixels.filter(self._parameters.filter_px)
        self._pixels.reflect(radiance, self.surfel_glow.glow)

    def directions(self) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Return (h, w, n, 3) each pixel's directions, in the world, and (h, w, n) their weights; row 0 lies
        lowest.
        """
        w, h = self._around.size
        looks = np.frombuffer(self._looks.read(), dtype=np.uint32).reshape(h, w, -1, 2)
        packed = np.ascontiguousarray(looks[..., 0]).view(np.int16).reshape(h, w, -1, 2)
        xy = np.maximum(packed / 32767.0, -1.0)
        z = 1.0 - np.abs(xy).sum(axis=-1, keepdims=True)
        folded = (1.0 - np.abs(xy[..., ::-1])) * np.where(xy >= 0, 1.0, -1.0)
        d = np.concatenate([np.where(z >= 0, xy, folded), z], axis=-1)
        unit: NDArray[np.float64] = d / np.linalg.norm(d, axis=-1, keepdims=True)
        return unit, looks[..., 1].view(np.float32)

    def debug_views(self) -> dict[str, Picture]:
        """The light that falls on each pixel, the surfels where they are seen, and of each pixel's first direction:
        where it goes, the surfel that it meets, the level that found it, and where in that level's shell (dark: near).
        """
        surfel, level = (values[::-1, :, 0] for values in self.hits())
        seen = read_texture(self._around.gbuffer.position_w)
        step = self._around.supersampling
        seen = seen[step // 2 :: step, step // 2 :: step][::-1]
        position = (seen[..., :3] - self.extent.centre) / self.extent.radius
        centres = self.surfels.read()[:, :3]
        away = np.linalg.norm(centres[surfel] - position, axis=-1) if len(centres) else np.zeros(surfel.shape)
        share = np.where(surfel >= 0, away / (self.first_shell * 2.0**level), 0.0)
        met = (surfel >= 0)[..., None]
        return {
            "light": self._pixels.picture(),
            "surfels": picture_of(self.surfels, self._around.gbuffer, self.extent),
            "directions": false_normal(self.directions()[0][::-1, :, 0], seen[..., 3] > 0),
            "hits": np.where(met, colours(surfel), 0.0),
            "levels": np.where(met, colours(level), 0.0),
            "shells": np.repeat(np.clip(share, 0.0, 1.0)[..., None], 3, axis=-1),
        }


# Storage buffers by the places that the shaders give them; see shaders/include/bounces.glsl for the hits.
BINDINGS = {
    "surfels": 0,
    "radiances": 1,
    "depths": 2,
    "directions": 3,
    "splats": 4,
    "points": 5,
    "hits": 6,
    "nearness": 7,
    "looks": 8,
    "guides": 9,
}
LEVEL_BIT = 28
