"""From samples to pixels: the mean of each pixel's samples, band by band."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.render.device import Device, read_array, set_uniforms
from phoslab.render.optics import layer_count
from phoslab.render.passes import Picture, false_grey


@dataclass(frozen=True)
class ResolveParameters:
    """Args:
    size: (width, height) of the picture in pixels.
    supersampling: samples along the side of a pixel.
    """

    size: tuple[int, int]
    supersampling: int


class Resolve:
    """Averages, and reads the picture back. Nothing is converted to colour here: that is the display's."""

    name: ClassVar[str] = "resolve"
    reads: ClassVar[tuple[str, ...]] = ("radiance",)
    writes: ClassVar[tuple[str, ...]] = ("pixels",)

    def __init__(self, device: Device, n_bands: int, parameters: ResolveParameters) -> None:
        self._device, self._n_bands, self._size = device, n_bands, parameters.size
        layers = layer_count(n_bands)
        self.pixels = device.texture_array(parameters.size, layers)
        self._program = device.compute(
            self.name, {"LAYERS": layers, "SUPERSAMPLING": parameters.supersampling}
        )

    def run(self, radiance: moderngl.TextureArray) -> None:
        """Average the samples of `radiance`."""
        radiance.use(0)
        set_uniforms(self._program, radiance=0)
        self.pixels.bind_to_image(0, read=False, write=True)
        self._device.dispatch(self._program, self._size)

    def read(self) -> NDArray[np.float32]:
        """Return (h, w, K) radiance, top row first."""
        return np.ascontiguousarray(read_array(self.pixels, self._n_bands)[::-1])

    def debug_views(self) -> dict[str, Picture]:
        """The sum over the bands."""
        return {"pixels": false_grey(self.read().sum(axis=-1))}
