"""What phosphors give off towards the camera: L = Σ_i Λ_i kr_i r_i (Nalbach 2017, eq. 8.3)."""

from __future__ import annotations

from typing import ClassVar

import moderngl

from phoslab.render.device import Device, set_uniforms
from phoslab.render.gbuffer import GBuffer
from phoslab.render.gpu_scene import GpuDrawable
from phoslab.render.optics import layer_count
from phoslab.render.passes import Picture


class Glow:
    """Adds one phosphor's radiance to the samples that see it; r is bilinear from the atlas."""

    name: ClassVar[str] = "glow"
    reads: ClassVar[tuple[str, ...]] = ("position_w", "uv", "state", "material.kr", "material.emission")
    writes: ClassVar[tuple[str, ...]] = ("radiance",)

    def __init__(self, device: Device, n_bands: int) -> None:
        self._device, self._layers = device, layer_count(n_bands)

    def run(
        self, gbuffer: GBuffer, drawable: GpuDrawable, r: moderngl.Texture, radiance: moderngl.TextureArray
    ) -> None:
        """Add the glow of `drawable`, whose state is `r`, to `radiance`."""
        material = drawable.material
        assert material is not None
        rectangle = gbuffer.rectangles[drawable.number - 1]
        if 0 in rectangle[2:]:
            return
        program = self._device.compute(self.name, {"LAYERS": self._layers, "STATES": material.n_states})
        for unit, texture in enumerate((gbuffer.uv, r, material.kr), start=1):
            texture.use(unit)
        material.emission.use(4)
        set_uniforms(program, uv=1, r=2, kr=3, emission=4)
        gbuffer.bind_samples(program, drawable.number, rectangle, unit=0)
        radiance.bind_to_image(0, read=True, write=True)
        self._device.dispatch(program, rectangle[2:])

    def debug_views(self) -> dict[str, Picture]:
        """Nothing of its own: it adds to what `DirectLight` shows."""
        return {}
