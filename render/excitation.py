"""Excitation a_i = Σ_j ke_ij E_j Δλ_j of every atlas texel (Nalbach 2017, eq. 8.1)."""

from __future__ import annotations

from typing import ClassVar

from phoslab.render.atlas_geometry import AtlasGeometry
from phoslab.render.atlas_irradiance import AtlasIrradiance
from phoslab.render.device import Device, read_texture, set_uniforms
from phoslab.render.gpu_scene import MaterialTextures
from phoslab.render.optics import layer_count
from phoslab.render.passes import Picture, false_grey


class Excitation:
    """Turns one phosphor's irradiance into rates, in 1/s: a texture of n_c channels (3 take 4)."""

    name: ClassVar[str] = "excitation"
    reads: ClassVar[tuple[str, ...]] = ("atlas.irradiance", "atlas.uv", "material.ke_width")
    writes: ClassVar[tuple[str, ...]] = ("atlas.excitation",)

    def __init__(
        self, device: Device, material: MaterialTextures, size: tuple[int, int], n_bands: int
    ) -> None:
        self._device, self._material = device, material
        self.excitation = device.texture(size, material.n_states)
        self._target = device.framebuffer([self.excitation])
        self._program = device.program(
            self.name,
            vertex="fullscreen",
            defines={"LAYERS": layer_count(n_bands), "STATES": material.n_states},
        )
        self._everywhere = device.vertex_array(self._program)

    def run(self, atlas: AtlasGeometry, light: AtlasIrradiance) -> None:
        """Write the excitation under the irradiance of the last run of `light`."""
        light.irradiance.use(0)
        self._material.ke_width.use(1)
        atlas.uv.use(2)
        set_uniforms(self._program, irradiance=0, ke_width=1, atlas_uv=2)
        self._target.use()
        self._everywhere.render(vertices=3)

    def largest_rate(self) -> float:
        """Return the largest a_i of any texel and state, in 1/s."""
        return float(read_texture(self.excitation).max())

    def debug_views(self) -> dict[str, Picture]:
        """The sum over the states."""
        return {"excitation": false_grey(read_texture(self.excitation).sum(axis=-1)[::-1])}
