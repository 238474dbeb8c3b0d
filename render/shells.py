"""Shells of surfels on the levels of the hierarchical interleaved framebuffer (Nalbach 2017, 4.2.2; BZB 2015, 4.3).

A surfel lights what is near finely and what is far coarsely. On level l a shell, from half its outer radius on and
twice as large on each level, is splatted into one of 4^l sub-buffers, each of which holds one pixel of every block of
2^l x 2^l: so all levels cost alike, and together they reach 2^l times as far.

One level is held at a time. A splat is a rectangle of its sub-buffer, cut to it, around the sphere of its outer radius;
splats that reach no receiver are left out before they are drawn, by the frustum and by a min/max MIP map.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np

from phoslab.render.device import Device, bind_buffers, set_uniforms
from phoslab.render.glow_pixels import GlowPixels
from phoslab.render.glow_transport import MOST_LEVELS, Surroundings
from phoslab.render.prefix_sums import prefix_sums, sum_buffer
from phoslab.render.surfels import Extent, Surfels

SPLAT_BYTES = 32  # of shaders/include/shells.glsl: an ivec4 and a uint, padded
BLOCK = 4  # pixels along the side of the finest boxes
MOST_BOUNDS = 16
DIAMETER = 2.0  # of a scene, in the coordinates of the surfels
SEED = 1


@dataclass(frozen=True, eq=False)
class Splats:
    """What is drawn into one level: `count` splats of `fragments` pixels in all."""

    buffer: moderngl.Buffer
    count: int

    def fragments(self) -> int:
        """Return how many pixels they cover."""
        rectangles = np.frombuffer(self.buffer.read(), dtype="i4").reshape(-1, 8)[: self.count, :4]
        return int(np.prod(rectangles[:, 2:] - rectangles[:, :2], axis=1).sum())


class ShellLevels:
    """The levels: what pixels see in the order of their sub-buffers, and which splats reach them.

    Attributes:
        size: (width, height) that holds the sub-buffers of every level.
        position, normal: of the level that was shuffled last; position.w is 0 where nothing is seen.
    """

    def __init__(
        self,
        device: Device,
        surroundings: Surroundings,
        pixels: GlowPixels,
        extent: Extent,
        levels: int,
        *,
        culled: bool = True,
    ) -> None:
        self._device, self._around, self._pixels = device, surroundings, pixels
        self.levels = levels
        self.picture_size = w, h = surroundings.size
        coarsest = 1 << levels - 1
        self.size = (-(-w // coarsest) * coarsest, -(-h // coarsest) * coarsest)
        self.position = device.texture(self.size, 4)
        self.normal = device.texture(self.size, 4, dtype="f2")
        self._supersampling = {"SUPERSAMPLING": surroundings.supersampling}
        camera = surroundings.gbuffer.camera
        to_metres = np.linalg.inv(extent.from_world)
        self._to_view = np.diag([*(3 * [1 / extent.radius]), 1.0]) @ camera.world_to_view @ to_metres
        focal = h / 2 / float(np.tan(camera.yfov_rad / 2))
        self._camera: dict[str, Any] = {
            "to_view": self._to_view,
            "focal": (focal, focal),
            "near_limit": camera.near_m / extent.radius,
        }
        self._bounds = _bound_sizes(self.picture_size)
        n_boxes = sum(x * y for x, y, _ in self._bounds)
        self._boxes = device.reserve(n_boxes * 32)
        self._culled = culled

    @property
    def made(self) -> tuple[moderngl.Buffer | moderngl.Texture, ...]:
        """What it holds on the device."""
        return (self.position, self.normal, self._boxes)

    def prepare(self) -> None:
        """Bound what is seen."""
        before = (0, 0, 0)
        for m, (x, y, first) in enumerate(self._bounds):
            defines = {**self._supersampling, **({} if m else {"BASE": 1})}
            shader = self._device.compute("receiver_bounds", defines)
            self._pixels.bind_receivers(shader)
            self._boxes.bind_to_storage_buffer(0)
            set_uniforms(shader, size=(x, y), first=first, size_below=before[:2], first_below=before[2])
            self._device.dispatch(shader, (x, y))
            before = (x, y, first)

    def shuffle(self, level: int) -> None:
        """Bring what pixels see into the order of the sub-buffers of `level`."""
        shader = self._device.compute("shell_receivers", self._supersampling)
        self._pixels.bind_receivers(shader)
        self.position.bind_to_image(0, read=False, write=True)
        self.normal.bind_to_image(1, read=False, write=True)
        set_uniforms(shader, level=level, seed=SEED)
        self._device.dispatch(shader, self.size)

    def find_splats(
        self,
        surfels: Surfels,
        radiances: moderngl.Buffer,
        level: int,
        defines: dict[str, int],
        **uniforms: float,
    ) -> Splats:
        """Return the splats of `level`; they live as long as the scope of the device that is open.

        Args:
            defines, uniforms: of the shells, as `shell_cull.comp.glsl` has them.
        """
        device, n = self._device, surfels.count
        bounds = [*self._bounds, *((MOST_BOUNDS - len(self._bounds)) * [(0, 0, 0)])]
        sums = sum_buffer(device, n)
        splats, count = sums, 0
        for fill in (False, True):
            shader = device.compute("shell_cull", {**defines, **({"FILL": 1} if fill else {})})
            bind_buffers(surfels.buffer, radiances, self._boxes, sums, splats)
            set_uniforms(
                shader,
                **{**self._camera, **uniforms},
                count=n,
                size=self.picture_size,
                level=level,
                seed=SEED,
                culled=self._culled,
                bounds=bounds,
                bounds_levels=len(self._bounds),
            )
            if n:
                device.dispatch_items(shader, n)
            if not fill:
                count = prefix_sums(device, sums, n)
                splats = device.reserve(count * SPLAT_BYTES)
        return Splats(splats, count)

    def bind_shuffled(self, program: moderngl.Program) -> None:
        """Tell a program that draws splats what the pixels of its sub-buffers see."""
        self.position.use(0)
        self.normal.use(1)
        set_uniforms(program, shuffled_position=0, shuffled_normal=1, target_size=self.size)


def first_shell(radius: float, epsilon: float) -> float:
    """Return how far the brightest disks reach on level 0: to a form factor r² / (d² + r²) of epsilon."""
    return radius * float(np.sqrt(1 / epsilon - 1))


def radius_of(surfels: Surfels, share: float) -> float:
    """Return the radius below which `share` of the area is."""
    radii = np.sort(surfels.read()[:, 3].astype(np.float64))
    area = np.cumsum(radii**2)
    return float(radii[np.searchsorted(area, share * area[-1])])


def choose_levels(wanted: int, surfels: Surfels, epsilon: float, size: tuple[int, int]) -> int:
    """Return how many levels there are: `wanted`, or, for 0, as many as bring light across the scene.

    A tenth of the area may be of disks that do not reach quite as far.
    """
    if wanted or not surfels.count:
        return max(1, wanted)
    first = first_shell(radius_of(surfels, 0.1), epsilon)
    coarsest = int(np.ceil(np.log2(max(1.0, DIAMETER / first))))
    # Where a block is the picture nothing is gained by larger ones.
    return 1 + min(coarsest, MOST_LEVELS - 1, int(np.log2(max(1, min(size)))))


def _bound_sizes(size: tuple[int, int]) -> list[tuple[int, int, int]]:
    """Return width, height and first box of each level of the min/max MIP map, down to one box."""
    x, y = (-(-n // BLOCK) for n in size)
    sizes, first = [(x, y, 0)], 0
    while (x, y) != (1, 1):
        first += x * y
        x, y = -(-x // 2), -(-y // 2)
        sizes.append((x, y, first))
    return sizes
