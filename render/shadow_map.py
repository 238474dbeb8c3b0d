"""Shadow maps of the punctual lights: one square tile a view in one depth texture.

A spot has one view, a directional light one, a point light six. (One sheet of tiles rather than an array texture:
moderngl has no depth arrays, and a sheet needs no geometry shader.) Other shaders read it through
`include/lights.glsl`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import moderngl
import numpy as np

from phoslab.render.device import Device, bind_buffers, set_uniforms
from phoslab.render.gpu_scene import GpuDrawable
from phoslab.render.light_views import pack_lights, pack_spectra, views_of
from phoslab.render.passes import Picture, false_grey
from phoslab.render.scene import Light


@dataclass(frozen=True)
class ShadowMapParameters:
    """Args:
    tile: texels along the side of a view.
    pcf_radius: texels to each side over which a shadow's edge is softened.
    """

    tile: int = 2048
    pcf_radius: int = 2


class ShadowMap:
    """Draws every light's depth views, and holds the lights for the shaders that use them."""

    name: ClassVar[str] = "shadow_map"
    reads: ClassVar[tuple[str, ...]] = ("meshes", "lights")
    writes: ClassVar[tuple[str, ...]] = ("shadow_sheet",)

    def __init__(
        self,
        device: Device,
        lights: Sequence[Light],
        drawables: Sequence[GpuDrawable],
        n_bands: int,
        parameters: ShadowMapParameters,
    ) -> None:
        self._device, self._lights, self._drawables = device, lights, drawables
        self.parameters = parameters
        self._look()
        clips = self._clips
        self.tiles_per_side = max(1, int(np.ceil(np.sqrt(len(clips)))))
        side = self.tiles_per_side * parameters.tile if clips else 1
        self.sheet = device.depth_texture((side, side))
        self._target = device.framebuffer([], self.sheet)
        self._program = device.program(self.name)
        self._meshes = [
            device.vertex_array(self._program, d.mesh.attributes, d.mesh.indices) for d in drawables
        ]
        self._light_buffer = device.buffer(pack_lights(lights, self.views, {}))
        self._view_buffer = device.buffer(np.array([c.T for c in clips], dtype=np.float32))
        self._spectra_buffer = device.buffer(pack_spectra(lights, n_bands) if lights else np.zeros(4, "f4"))

    def _look(self) -> None:
        """Find each light's views of the scene, as both are placed now."""
        corners = np.concatenate([d.box_w for d in self._drawables])
        box = np.stack([corners.min(axis=0), corners.max(axis=0)])
        # The filter reads its radius and half a bilinear texel beyond a point that is lit.
        guard = self.parameters.pcf_radius + 2
        self.views = [views_of(light.place, box, self.parameters.tile, guard) for light in self._lights]
        self._clips = [clip for view in self.views for clip in view.world_to_clip]

    def place(self, lights: Sequence[Light]) -> None:
        """Take over where lights and drawables are now: each light has as many views as before."""
        self._lights = lights
        self._look()
        if self._clips:
            self._view_buffer.write(np.array([c.T for c in self._clips], dtype=np.float32).tobytes())

    @property
    def defines(self) -> dict[str, int | str]:
        """What a shader that includes `lights.glsl` must define, `LAYERS` apart."""
        return {"PCF_RADIUS": self.parameters.pcf_radius}

    def run(self) -> None:
        """Draw every view. Once is enough while neither lights nor drawables move."""
        tile = self.parameters.tile
        self._target.use()
        self._target.clear(depth=1.0)
        self._device.ctx.enable_only(moderngl.DEPTH_TEST)
        for k, clip in enumerate(self._clips):
            row, column = divmod(k, self.tiles_per_side)
            self._target.viewport = (column * tile, row * tile, tile, tile)
            for drawable, mesh in zip(self._drawables, self._meshes, strict=True):
                set_uniforms(self._program, model_to_clip=clip @ drawable.drawable.model_to_world)
                mesh.render()
        self._device.ctx.enable_only(moderngl.NOTHING)

    def bind(self, shader: moderngl.ComputeShader, factors: Mapping[str, float], unit: int) -> None:
        """Give `shader` the lights, each at its factor (0: off), and the shadows at texture unit `unit`."""
        if self._lights:
            self._light_buffer.write(pack_lights(self._lights, self.views, factors).tobytes())
        bind_buffers(self._light_buffer, self._view_buffer, self._spectra_buffer)
        self.sheet.use(unit)
        set_uniforms(
            shader, light_count=len(self._lights), shadow_sheet=unit, tiles_per_side=self.tiles_per_side
        )

    def debug_views(self) -> dict[str, Picture]:
        """The sheet of depths, near dark."""
        self.sheet.compare_func = ""
        depth = np.frombuffer(self.sheet.read(), dtype="f4").reshape(self.sheet.height, self.sheet.width)
        self.sheet.compare_func = "<="
        step = max(1, self.sheet.width // 1024)
        near = depth.min()
        return {"shadow_sheet": false_grey((depth[::-step, ::step] - near) ** 2)}
