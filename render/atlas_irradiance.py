"""K-band irradiance of the punctual lights at every atlas texel, with shadows (Nalbach 2017, 8.5)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from phoslab.render.atlas_geometry import AtlasGeometry
from phoslab.render.device import Device, read_array, set_uniforms
from phoslab.render.optics import layer_count
from phoslab.render.passes import Picture, false_grey
from phoslab.render.shadow_map import ShadowMap


class AtlasIrradiance:
    """Lights one phosphor's atlas."""

    name: ClassVar[str] = "atlas_irradiance"
    reads: ClassVar[tuple[str, ...]] = ("atlas.position_w", "atlas.normal_w", "lights", "shadow_sheet")
    writes: ClassVar[tuple[str, ...]] = ("atlas.irradiance",)

    def __init__(self, device: Device, shadows: ShadowMap, size: tuple[int, int], n_bands: int) -> None:
        self._device, self._shadows, self._size, self._n_bands = device, shadows, size, n_bands
        self.irradiance = device.texture_array(size, layer_count(n_bands))
        self._program = device.compute(self.name, {**shadows.defines, "LAYERS": layer_count(n_bands)})

    def run(self, atlas: AtlasGeometry, factors: Mapping[str, float]) -> None:
        """Write the irradiance of the lights, each at its factor (absent: off)."""
        atlas.position_w.use(0)
        atlas.normal_w.use(1)
        set_uniforms(self._program, position_w=0, normal_w=1)
        self._shadows.bind(self._program, factors, unit=2)
        self.irradiance.bind_to_image(0, read=False, write=True)
        self._device.dispatch(self._program, self._size)

    def debug_views(self) -> dict[str, Picture]:
        """The sum over the bands."""
        return {"irradiance": false_grey(read_array(self.irradiance, self._n_bands).sum(axis=-1)[::-1])}
