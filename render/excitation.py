"""Excitation a_i = Σ_j ke_ij E_j Δλ_j of every atlas texel (Nalbach 2017, eq. 8.1)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from phoslab.render.atlas_geometry import AtlasGeometry
from phoslab.render.atlas_irradiance import AtlasIrradiance
from phoslab.render.device import Device, read_array, set_uniforms
from phoslab.render.gpu_scene import MaterialTextures
from phoslab.render.optics import layer_count
from phoslab.render.passes import Picture, false_grey
from phoslab.render.state_formats import image_format

Array = NDArray[np.float64]


class Excitation:
    """Turns one phosphor's irradiance into rates, in 1/s: an array texture of n_c channels (3 take 4).

    Excitation is linear in the light: each layer is that of some lights at factor 1.
    """

    name: ClassVar[str] = "excitation"
    reads: ClassVar[tuple[str, ...]] = ("atlas.irradiance", "atlas.uv", "material.ke_width")
    writes: ClassVar[tuple[str, ...]] = ("atlas.excitation",)

    def __init__(
        self, device: Device, material: MaterialTextures, size: tuple[int, int], n_bands: int, layers: int
    ) -> None:
        self._device, self._material, self._size = device, material, size
        self.excitation = device.texture_array(size, layers, components=material.n_states)
        self._program = device.compute(
            self.name,
            {
                "LAYERS": layer_count(n_bands),
                "STATES": material.n_states,
                "IMAGE_FORMAT": image_format(material.n_states),
            },
        )

    def run(self, atlas: AtlasGeometry, light: AtlasIrradiance, layer: int = 0) -> None:
        """Write into `layer` the excitation under the irradiance of the last run of `light`."""
        light.irradiance.use(0)
        self._material.ke_width.use(1)
        atlas.uv.use(2)
        set_uniforms(self._program, irradiance=0, ke_width=1, atlas_uv=2, layer=layer)
        self.excitation.bind_to_image(0, read=False, write=True)
        self._device.dispatch(self._program, self._size)

    @property
    def layers(self) -> int:
        """How many layers there are."""
        return int(self.excitation.layers)

    def largest_rates(self) -> Array:
        """Return (layers,) the largest a_i of any texel and state, in 1/s."""
        n = self.excitation.components
        values = read_array(self.excitation, self.layers * n).astype(np.float64)
        largest: Array = values.reshape(-1, self.layers, n).max(axis=(0, 2))
        return largest

    def debug_views(self) -> dict[str, Picture]:
        """The sum over the states and layers."""
        values = read_array(self.excitation, self.layers * self.excitation.components)
        return {"excitation": false_grey(values.sum(axis=-1)[::-1])}
