"""Deep screen space: glow splatted from surfels onto the pixels, without visibility (Nalbach 2017, ch. 4; DSS 2014).

surfelize          disks of about one size on the screen, of what glows alone     once, while nothing moves
receiver_bounds    least and greatest coordinates of blocks of pixels             once
surfel_glow        what each disk sends                                           per picture
shell_receivers    what pixels see, in the order of a level's sub-buffers         per level
shell_cull         the splats that reach a pixel                                  per level
shell_splat        form factor times radiance, added up                           per level
shell_unshuffle    back to the pixels; coarse levels are shared along surfaces    per level
glow_reflect       times reflectance, onto every sample                           per picture

Nothing blocks light here, so it leaks through whatever stands between: `BouncedZBuffer` has visibility. The cost
follows what glows and what is seen, not the scene.
"""

from __future__ import annotations

from typing import Any, ClassVar

import moderngl

from phoslab.errors import PhoslabError
from phoslab.render.device import Device, read_texture, set_uniforms
from phoslab.render.glow_pixels import GlowPixels
from phoslab.render.glow_transport import Surroundings, TransportParameters
from phoslab.render.lit_cells import LitCells
from phoslab.render.optics import layer_count
from phoslab.render.passes import Picture, false_grey, side_by_side
from phoslab.render.shells import SEED, ShellLevels, Splats, choose_levels
from phoslab.render.surfel_glow import SurfelGlow
from phoslab.render.surfel_picture import picture_of
from phoslab.render.surfels import Extent, View, surfelize

# Colours that OpenGL draws into at once, at least, of four bands each.
MOST_LAYERS = 8


class DeepScreenSpace:
    """Adds up form factors; the error, but for what blocks, falls with `surfel` and `epsilon` and as `levels` rise."""

    name: ClassVar[str] = "dss"
    aims: ClassVar[bool] = False
    # How far a disk's light is followed depends on how bright it is.
    linear: ClassVar[bool] = False
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
        n_bands = surroundings.scene.transport.n
        self._layers = layer_count(n_bands)
        if self._layers > MOST_LAYERS:
            raise PhoslabError(
                f"are {n_bands}, and dss draws {4 * MOST_LAYERS} at most",
                field="the bands of the scene",
                remedy="Give fewer (bands_nm), or use --gi tiles.",
            )
        self._pixels = GlowPixels(device, surroundings, Extent.of(surroundings.drawables))
        self.lit_cells = LitCells(device, surroundings, parameters) if parameters.follows_cells else None
        self._sends_on = parameters.sends_on
        self._defines = {"LAYERS": self._layers, "SIDES": 2 if self._sends_on else 1}
        self._made: list[Any] = []
        self._program = device.program("shell_splat", defines=self._defines)
        self._quads = device.vertex_array(self._program)

    def prepare(self) -> None:
        """Make the surfels, and bound what is seen."""
        device, p, around = self._device, self._parameters, self._around
        device.release(*self._made)
        self.extent = self._pixels.extent = Extent.of(around.drawables)
        view = View.of(around.gbuffer.camera, self.extent, p.surfel)
        if self.lit_cells is not None:
            self.lit_cells.place()
        senders = [d for d in around.drawables if d.material is not None or self._sends_on]
        self.surfels = surfelize(device, senders, self.extent, view)
        n_bands = around.scene.transport.n
        lit = self.lit_cells if self._sends_on else None
        self.surfel_glow = SurfelGlow(device, self.surfels, around.glows, around.atlases, n_bands, lit)
        levels = choose_levels(p.levels, self.surfels, p.epsilon, around.size)
        self.shells = ShellLevels(
            device, around, self._pixels, self.extent, levels, culled=self.shells_culled
        )
        self._targets = [device.texture(self.shells.size, 4) for _ in range(self._layers)]
        self._framebuffer = device.framebuffer(self._targets)
        self._made = [
            *(self.surfels.buffer, *self.surfel_glow.made, *self.shells.made),
            *(self._framebuffer, *self._targets),
        ]
        self.shells.prepare()

    def run(self, radiance: moderngl.TextureArray) -> None:
        """Add what every sample reflects of the glow, level by level, the coarsest first."""
        self.surfel_glow.run()
        if self.surfel_glow.glow == 0.0:
            return
        self._pixels.clear()
        for level in reversed(range(self.shells.levels)):
            with self._device.scope():
                self._light_level(level)
            self._unshuffle(level)
            if level > 0:
                self._pixels.blur(1 << level - 1)
        self._pixels.reflect(radiance, self.surfel_glow.glow)

    def _light_level(self, level: int) -> None:
        self.shells.shuffle(level)
        self._framebuffer.use()
        self._framebuffer.clear()
        for side in range(self._defines["SIDES"]):
            self.splat(level, self.find_splats(level, side), side)

    def find_splats(self, level: int, side: int = 0) -> Splats:
        """Return what is to be drawn into `level` of light to the front (0) or the back (1)."""
        return self.shells.find_splats(
            self.surfels,
            self.surfel_glow.radiances,
            level,
            self._defines,
            side=side,
            last=self._is_last(level),
            epsilon=self._parameters.epsilon,
        )

    def splat(self, level: int, splats: Splats, side: int = 0) -> None:
        """Add splats to the sub-buffers of `level`, whose receivers are shuffled."""
        ctx = self._device.ctx
        self._framebuffer.use()
        ctx.enable_only(moderngl.BLEND)
        ctx.blend_func = moderngl.ONE, moderngl.ONE
        for k, buffer in ((0, self.surfels.buffer), (1, self.surfel_glow.radiances), (4, splats.buffer)):
            buffer.bind_to_storage_buffer(k)
        self.shells.bind_shuffled(self._program)
        shell = {"last": self._is_last(level), "epsilon": self._parameters.epsilon}
        set_uniforms(self._program, level=level, side=side, **shell)
        if splats.count:
            self._quads.render(vertices=6 * splats.count)
        ctx.enable_only(moderngl.NOTHING)
        ctx.blend_func = moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA

    def _is_last(self, level: int) -> bool:
        """Whether a level's shells have no end: the coarsest, unless the number of levels was asked for."""
        return self._parameters.levels == 0 and level == self.shells.levels - 1

    def _unshuffle(self, level: int) -> None:
        shader = self._device.compute("shell_unshuffle")
        for layer, target in enumerate(self._targets):
            target.use(0)
            self._pixels.light.bind_to_image(0, read=True, write=True)
            set_uniforms(shader, shuffled_light=0, layer=layer, level=level, seed=SEED)
            self._device.dispatch(shader, self._around.size)

    def debug_views(self) -> dict[str, Picture]:
        """The light that falls on each pixel, the surfels where they are seen, and all levels: the light that each
        adds, and the shells that it is of, in their sub-buffers.
        """
        views = {
            "light": self._pixels.picture(),
            "surfels": picture_of(self.surfels, self._around.gbuffer, self.extent),
        }
        added, shells = [], []
        for level in range(self.shells.levels):
            with self._device.scope():
                self._light_level(level)
            shells.append(false_grey(read_texture(self._targets[0])[::-1].sum(axis=-1)))
            self._pixels.clear()
            self._unshuffle(level)
            added.append(self._pixels.picture())
        return views | {"levels": side_by_side(added), "shells": side_by_side(shells)}
