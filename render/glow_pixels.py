"""Light that falls on pixels, on its way to the samples: shared among neighbours, then reflected.

What the ways to transport glow have in common once they know the light of each pixel.
"""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.render.device import Device, bind_buffers, read_array, set_uniforms
from phoslab.render.glow_transport import Surroundings
from phoslab.render.optics import layer_count
from phoslab.render.passes import Picture, false_grey
from phoslab.render.surfels import Extent

# What stands nearest: so far away that neighbours share light as their normals and positions allow.
FAR = 1e-20


class GlowPixels:
    """The light of each pixel: E / π in units of the frame's glow.

    Args:
        looks: directions in which a pixel looks for what stands near; the sum of 1 / distance is in `nearness`.

    Attributes:
        extent: where the scene lies.
        guide: what tells the filter of shadows' edges, light and its variance a pixel; as made, all pixels are alike.
    """

    def __init__(self, device: Device, surroundings: Surroundings, extent: Extent, looks: int = 1) -> None:
        self._device, self._around, self.extent = device, surroundings, extent
        self._n_bands = surroundings.scene.transport.n
        w, h = surroundings.size
        layers = layer_count(self._n_bands)
        self.light, self._spare = (device.texture_array((w, h), layers) for _ in range(2))
        self.nearness = device.buffer(np.full(w * h, FAR, dtype=np.float32))
        self.guide = device.buffer(np.zeros((w * h, 2), dtype=np.float32))
        self._defines = {"SUPERSAMPLING": surroundings.supersampling, "LAYERS": layers}
        self._looks = {"AIMLESS": looks}

    def bind_receivers(self, shader: moderngl.ComputeShader) -> None:
        """Tell a shader that includes `receivers.glsl` what pixels see."""
        self._around.gbuffer.position_w.use(0)
        self._around.gbuffer.normal_w.use(1)
        set_uniforms(shader, position_w=0, normal_w=1, to_cells=self.extent.uniform)

    def clear(self) -> None:
        """Make it dark."""
        self.light.write(bytes(self.light.width * self.light.height * self.light.layers * 16))

    def blur(self, stride: int) -> None:
        """Share light with the pixels `stride` to each side that see the same surface: 1 2 1."""
        shader = self._device.compute("shell_blur", self._defines)
        for along in ((stride, 0), (0, stride)):
            self._swap(shader, along)

    def share_shader(self, radius: int) -> moderngl.ComputeShader:
        """Return the shader of `shares`: whoever asks outside of a scope keeps it for what is asked inside."""
        return self._device.compute("glow_share", {**self._defines, **self._looks, "RADIUS": radius})

    def shares(self, radius: int) -> NDArray[np.float32]:
        """Return (h w,) how much of what the filter may add up it does, rows from the lowest on; 0: nothing is seen."""
        w, h = self._around.size
        shader = self.share_shader(radius)
        with self._device.scope():
            shares = self._device.buffer(np.zeros(w * h, dtype=np.float32))
            self.bind_receivers(shader)
            bind_buffers(self.nearness, self.guide, shares)
            self._device.dispatch(shader, self._around.size)
            return np.frombuffer(shares.read(), dtype=np.float32)

    def filter(self, radius: int) -> None:
        """Share light over `radius` pixels to each side, less far where something stands near."""
        shader = self._device.compute("glow_filter", {**self._defines, **self._looks, "RADIUS": radius})
        bind_buffers(self.nearness, self.guide)
        for along in ((1, 0), (0, 1)):
            self._swap(shader, along)

    def _swap(self, shader: moderngl.ComputeShader, along: tuple[int, int]) -> None:
        self.bind_receivers(shader)
        self.light.use(2)
        set_uniforms(shader, light_in=2, along=along)
        self._spare.bind_to_image(0, read=False, write=True)
        self._device.dispatch(shader, self._around.size)
        self.light, self._spare = self._spare, self.light

    def reflect(self, radiance: moderngl.TextureArray, glow: float) -> None:
        """Add to the samples of `radiance` what they reflect of it, as Lambert does; `glow` is its unit."""
        shader, gbuffer = (
            self._device.compute("glow_reflect", {**self._defines, **self._looks}),
            self._around.gbuffer,
        )
        gbuffer.normal_w.use(1)
        gbuffer.uv.use(2)
        self.light.use(4)
        self.nearness.bind_to_storage_buffer(0)
        units = {"normal_w": 1, "uv": 2, "reflectance": 3, "light": 4}
        set_uniforms(shader, **units, glow=glow, radius=self.extent.radius)
        radiance.bind_to_image(0, read=True, write=True)
        for drawable, rectangle in zip(self._around.drawables, gbuffer.rectangles, strict=True):
            if 0 in rectangle[2:]:
                continue
            drawable.reflectance.use(3)
            gbuffer.bind_samples(shader, drawable.number, rectangle, unit=0)
            self._device.dispatch(shader, rectangle[2:])

    def picture(self) -> Picture:
        """Return the sum over the bands."""
        return false_grey(read_array(self.light, self._n_bands).sum(axis=-1)[::-1])
