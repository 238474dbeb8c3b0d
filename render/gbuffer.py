"""What each sample of the picture sees: position and drawable, normal, coordinates; nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.render.device import Device, read_texture, set_uniforms
from phoslab.render.gltf import GltfCamera
from phoslab.render.gpu_scene import GpuDrawable
from phoslab.render.light_views import perspective
from phoslab.render.passes import Picture, false_box, false_normal

Array = NDArray[np.float64]
Rectangle = tuple[int, int, int, int]


@dataclass(frozen=True)
class GBufferParameters:
    """Args:
    size: (width, height) in samples.
    """

    size: tuple[int, int]


class GBuffer:
    """Draws what the camera sees.

    position_w is RGBA32F with the drawable's number in w (0: background), normal_w RGBA16F, uv RGBA32F with the
    atlas coordinate in xy and the texture coordinate in zw.
    """

    name: ClassVar[str] = "gbuffer"
    reads: ClassVar[tuple[str, ...]] = ("meshes", "camera")
    writes: ClassVar[tuple[str, ...]] = ("position_w", "normal_w", "uv")

    def __init__(
        self, device: Device, drawables: Sequence[GpuDrawable], parameters: GBufferParameters
    ) -> None:
        self._device, self._drawables = device, drawables
        self.size = parameters.size
        self.position_w = device.texture(self.size, 4)
        self.normal_w = device.texture(self.size, 4, dtype="f2")
        self.uv = device.texture(self.size, 4)
        self._target = device.framebuffer(
            [self.position_w, self.normal_w, self.uv], device.depth_renderbuffer(self.size)
        )
        self._program = device.program(self.name)
        self._meshes = [
            device.vertex_array(self._program, d.mesh.attributes, d.mesh.indices) for d in drawables
        ]

    @property
    def camera(self) -> GltfCamera:
        """The camera, for what knows of one alone."""
        (only,) = self.cameras
        return only

    def run(self, *cameras: GltfCamera) -> None:
        """Draw the scene as cameras see it, side by side, each in a picture of the same size, whose aspect counts."""
        self.cameras = cameras
        width = self.size[0] // len(cameras)
        self._target.use()
        self._target.clear()
        self._device.ctx.enable_only(moderngl.DEPTH_TEST)
        for k, camera in enumerate(cameras):
            self._target.viewport = (k * width, 0, width, self.size[1])
            world_to_clip = self._project(camera, width)
            set_uniforms(self._program, world_to_clip=world_to_clip)
            for drawable, mesh in zip(self._drawables, self._meshes, strict=True):
                set_uniforms(
                    self._program,
                    **drawable.placement,
                    handedness=drawable.handedness,
                    drawable=float(drawable.number),
                )
                mesh.render()
        self._device.ctx.enable_only(moderngl.NOTHING)
        self.rectangles = [
            self._rectangle(d.box_w, world_to_clip) if len(cameras) == 1 else (0, 0, *self.size)
            for d in self._drawables
        ]

    def _project(self, camera: GltfCamera, width: int) -> Array:
        half_height = np.tan(camera.yfov_rad / 2)
        corners = np.concatenate([d.box_w for d in self._drawables])
        box = np.stack([corners.min(axis=0), corners.max(axis=0)])
        eye = np.linalg.inv(camera.world_to_view)[:3, 3]
        far = camera.near_m + 1.01 * float(np.linalg.norm(np.abs(box - eye).max(axis=0)))
        half_width = half_height * width / self.size[1]
        return perspective(half_width, half_height, camera.near_m, far) @ camera.world_to_view

    def _rectangle(self, box_w: Array, world_to_clip: Array) -> Rectangle:
        """Return x, y, width, height of a rectangle in samples that holds the box; the picture if it reaches behind."""
        corners = np.array([[*np.where(mask, box_w[1], box_w[0]), 1.0] for mask in np.ndindex(2, 2, 2)])
        clip = corners @ world_to_clip.T
        if (clip[:, 3] <= 0).any():
            return (0, 0, *self.size)
        samples = (clip[:, :2] / clip[:, 3:] * 0.5 + 0.5) * self.size
        low = np.clip(np.floor(samples.min(axis=0)) - 1, 0, self.size).astype(int)
        high = np.clip(np.ceil(samples.max(axis=0)) + 1, 0, self.size).astype(int)
        return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])

    def bind_samples(
        self, shader: moderngl.ComputeShader, number: int, rectangle: Rectangle, unit: int
    ) -> None:
        """Tell a shader that includes `drawable.glsl` which samples are its own."""
        self.position_w.use(unit)
        set_uniforms(shader, position_w=unit, drawable=float(number), corner=rectangle[:2])

    def debug_views(self) -> dict[str, Picture]:
        """Position in the box of what is seen, normal, and both coordinates."""
        position = read_texture(self.position_w)[::-1]
        seen = position[..., 3] > 0
        uv = read_texture(self.uv)[::-1]
        black = np.zeros_like(uv[..., 0])
        return {
            "position": false_box(position[..., :3], seen),
            "normal": false_normal(read_texture(self.normal_w)[::-1, :, :3], seen),
            "atlas_uv": np.stack([uv[..., 0] % 1, uv[..., 1] % 1, black], axis=-1),
            "texture_uv": np.stack([uv[..., 2] % 1, uv[..., 3] % 1, black], axis=-1),
        }
