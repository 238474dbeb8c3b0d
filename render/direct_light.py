"""Light of the punctual lights that surfaces reflect to the camera: Lambert, K bands, with shadows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from phoslab.render.device import Device, read_array, set_uniforms
from phoslab.render.gbuffer import GBuffer
from phoslab.render.gpu_scene import GpuDrawable
from phoslab.render.optics import layer_count
from phoslab.render.passes import Picture, false_grey
from phoslab.render.shadow_map import ShadowMap


class DirectLight:
    """Writes the radiance of every sample; background is 0.

    Each drawable is lit within its own rectangle of the picture, with its own reflectance texture.
    """

    name: ClassVar[str] = "direct_light"
    reads: ClassVar[tuple[str, ...]] = (
        "position_w",
        "normal_w",
        "uv",
        "lights",
        "shadow_sheet",
        "reflectance",
    )
    writes: ClassVar[tuple[str, ...]] = ("radiance",)

    def __init__(self, device: Device, shadows: ShadowMap, size: tuple[int, int], n_bands: int) -> None:
        self._device, self._shadows, self._n_bands = device, shadows, n_bands
        self.radiance = device.texture_array(size, layer_count(n_bands))
        self._program = device.compute(self.name, {**shadows.defines, "LAYERS": layer_count(n_bands)})

    def run(self, gbuffer: GBuffer, drawables: Sequence[GpuDrawable], factors: Mapping[str, float]) -> None:
        """Write the radiance under the lights, each at its factor (absent: off)."""
        gbuffer.normal_w.use(1)
        gbuffer.uv.use(2)
        set_uniforms(self._program, normal_w=1, uv=2, reflectance=3)
        self._shadows.bind(self._program, factors, unit=4)
        self.radiance.bind_to_image(0, read=False, write=True)
        # Number 0 is the background: whatever was there before becomes black.
        whole = (0, 0, *gbuffer.size)
        for number, reflectance, rectangle in [
            (0, drawables[0].reflectance, whole),
            *((d.number, d.reflectance, gbuffer.rectangles[d.number - 1]) for d in drawables),
        ]:
            reflectance.use(3)
            gbuffer.bind_samples(self._program, number, rectangle, unit=0)
            self._device.dispatch(self._program, rectangle[2:])

    def debug_views(self) -> dict[str, Picture]:
        """The sum over the bands, with whatever later passes have added to it."""
        return {"radiance": false_grey(read_array(self.radiance, self._n_bands).sum(axis=-1)[::-1])}
