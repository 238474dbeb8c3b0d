"""What lies under each texel of a phosphor's atlas: position, normal, texture coordinate.

Triangles are drawn as outlines first and filled over, so that one too thin to cover a texel's centre still has
texels; then the charts are widened, so that bilinear reads at their edges find what belongs to them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import moderngl

from phoslab.render.device import Device, read_texture, set_uniforms
from phoslab.render.gpu_scene import GpuDrawable
from phoslab.render.passes import Picture, false_box, false_normal


@dataclass(frozen=True)
class AtlasGeometryParameters:
    """Args:
    gutter: texels by which charts are widened.
    """

    gutter: int = 2


class AtlasGeometry:
    """Draws one phosphor's mesh into its atlas."""

    name: ClassVar[str] = "atlas_geometry"
    reads: ClassVar[tuple[str, ...]] = ("meshes",)
    writes: ClassVar[tuple[str, ...]] = ("atlas.position_w", "atlas.normal_w", "atlas.uv")

    def __init__(self, device: Device, drawable: GpuDrawable, parameters: AtlasGeometryParameters) -> None:
        assert drawable.atlas_size is not None
        self._device, self._drawable = device, drawable
        self.parameters = parameters
        size = drawable.atlas_size
        self.size = size
        self._targets = [[device.texture(size, n) for n in (4, 4, 4)] for _ in range(2)]
        self._framebuffers = [device.framebuffer(target) for target in self._targets]
        self._program = device.program(self.name)
        self._mesh = device.vertex_array(self._program, drawable.mesh.attributes, drawable.mesh.indices)
        self._dilate = device.program("atlas_dilate", vertex="fullscreen")
        self._everywhere = device.vertex_array(self._dilate)
        self.position_w, self.normal_w, self.uv = self._targets[0]

    def run(self) -> None:
        """Draw, then widen the charts. Once is enough while the mesh stands still."""
        ctx = self._device.ctx
        ctx.enable_only(moderngl.NOTHING)
        self._framebuffers[0].use()
        self._framebuffers[0].clear()
        set_uniforms(self._program, **self._drawable.placement)
        for ctx.wireframe in (True, False):
            self._mesh.render()
        current = 0
        for _ in range(self.parameters.gutter):
            for unit, texture in enumerate(self._targets[current]):
                texture.use(unit)
            set_uniforms(self._dilate, position_in=0, normal_in=1, uv_in=2)
            current = 1 - current
            self._framebuffers[current].use()
            self._everywhere.render(vertices=3)
        self.position_w, self.normal_w, self.uv = self._targets[current]

    def debug_views(self) -> dict[str, Picture]:
        """Positions in the mesh's own box, and normals; black where the atlas is empty."""
        position = read_texture(self.position_w)[::-1]
        covered = position[..., 3] > 0
        return {
            "position": false_box(position[..., :3], covered),
            "normal": false_normal(read_texture(self.normal_w)[::-1, :, :3], covered),
        }
