"""What a phosphor gives off, texel by texel of its atlas: the light that it sends (Nalbach 2017, eq. 8.3)."""

from __future__ import annotations

from typing import ClassVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.render.atlas_geometry import AtlasGeometry
from phoslab.render.device import Device, read_array, set_uniforms
from phoslab.render.gpu_scene import GpuDrawable
from phoslab.render.optics import layer_count
from phoslab.render.passes import Picture, false_grey


class AtlasGlow:
    """Writes one phosphor's K-band radiance into a texture over its atlas.

    Attributes:
        radiance: in the scene's units; 0 where the atlas is empty and the state is.
    """

    name: ClassVar[str] = "atlas_glow"
    reads: ClassVar[tuple[str, ...]] = ("state", "atlas.uv", "material.kr", "material.emission")
    writes: ClassVar[tuple[str, ...]] = ("atlas.radiance",)

    def __init__(self, device: Device, drawable: GpuDrawable, atlas: AtlasGeometry, n_bands: int) -> None:
        assert drawable.material is not None
        self._device, self._atlas, self._n_bands = device, atlas, n_bands
        self.drawable, self._material = drawable, drawable.material
        layers = layer_count(n_bands)
        self.radiance = device.texture_array(atlas.size, layers)
        self._program = device.compute(self.name, {"LAYERS": layers, "STATES": self._material.n_states})

    def run(self, r: moderngl.Texture) -> None:
        """Write the radiance of the state `r`."""
        for unit, texture in enumerate((r, self._atlas.uv, self._material.kr)):
            texture.use(unit)
        self._material.emission.use(3)
        set_uniforms(self._program, r=0, atlas_uv=1, kr=2, emission=3)
        self.radiance.bind_to_image(0, read=False, write=True)
        self._device.dispatch(self._program, self._atlas.size)

    def clear(self) -> None:
        """Write that nothing glows."""
        w, h, layers = self.radiance.size
        self.radiance.write(bytes(16 * w * h * layers))

    def read(self) -> NDArray[np.float32]:
        """Return (height, width, K) radiance; row 0 is v = 0."""
        return read_array(self.radiance, self._n_bands)

    def debug_views(self) -> dict[str, Picture]:
        """The sum over the bands."""
        return {"radiance": false_grey(self.read().sum(axis=-1)[::-1])}
