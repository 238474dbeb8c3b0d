"""Surfels: disks of about one size on the screen that stand for surfaces (Nalbach 2017, 4.2.1; BZB 2015, 4.3).

Both passes of the papers run in compute shaders, which lifts the limits of the tessellator:

one pass    each triangle becomes as many disks as fit its area best, one at least; their areas sum to its own
two passes  large triangles are split, fine disks are placed on the parts, and thinned until each that is left has the
            ideal area at its own place; triangles smaller than a disk share one

Disks are thinned by one running sum over the whole mesh, not each by its own dice: so the areas sum to the mesh's to
within one disk. The ideal radius follows the distance from the eye, where the papers take the depth, which would make
all that lies beside the camera as fine as what is nearest, out of sight. What is off-screen, turned away or seen at a
grazing angle gets its disks like all else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.render.device import Device, bind_buffers, set_uniforms
from phoslab.render.gltf import GltfCamera
from phoslab.render.gpu_scene import GpuDrawable
from phoslab.render.memory import check_room
from phoslab.render.prefix_sums import prefix_sums, sum_buffer

Array = NDArray[np.float64]

# Floats of a triangle and of a surfel, as in shaders/include/surfels.glsl.
TRIANGLE_FLOATS, SURFEL_FLOATS = 20, 12
# Surfels shrink no more where they are nearer to the eye than this share of the scene's radius.
NEAREST = 1 / 50
# No surfel is larger than this share of the box around its drawable: what is small and far still has a few.
LARGEST = 1 / 16
MOST_POINTS = 1 << 23
STEPS = {"PARTS": 0, "POINTS": 1, "SHARES": 2, "SURFELS": 3}
# Of the total of the shares: 24 bits after the point, and one half that the sum begins at.
FRACTION_BITS = 24


@dataclass(frozen=True)
class Extent:
    """Where a scene lies: surfels have coordinates (world - centre) / radius, so that scenes of any size are alike.

    Args:
        centre: (3,) in m.
        radius: in m.
    """

    centre: tuple[float, float, float]
    radius: float

    @staticmethod
    def of(drawables: Sequence[GpuDrawable]) -> Extent:
        """Return the extent of what is drawn."""
        corners = np.concatenate([d.box_w for d in drawables])
        low, high = corners.min(axis=0), corners.max(axis=0)
        x, y, z = (low + high) / 2
        return Extent((float(x), float(y), float(z)), max(float(np.linalg.norm(high - low)) / 2, 1e-30))

    @property
    def from_world(self) -> Array:
        """(4, 4) world to surfels."""
        matrix = np.eye(4) / self.radius
        matrix[:3, 3] = -np.array(self.centre) / self.radius
        matrix[3, 3] = 1.0
        return matrix

    @property
    def uniform(self) -> tuple[float, float, float, float]:
        """As `receivers.glsl` takes it."""
        return (*self.centre, 1.0 / self.radius)


@dataclass(frozen=True, eq=False)
class View:
    """From where surfels are as large as they should be.

    Args:
        eye: (3,) in coordinates of the surfels.
        per_distance: the radius of a surfel over its distance.
        nearest: the distance below which surfels shrink no more.
    """

    eye: Array
    per_distance: float
    nearest: float

    @staticmethod
    def of(camera: GltfCamera, extent: Extent, radius: float) -> View:
        """Return the view of `camera`; `radius` is a surfel's on the screen, over half the picture's height."""
        eye = np.linalg.inv(camera.world_to_view)[:3, 3]
        return View(
            np.asarray((eye - extent.centre) / extent.radius, dtype=np.float64),
            radius * float(np.tan(camera.yfov_rad / 2)),
            max(camera.near_m / extent.radius, NEAREST),
        )

    @property
    def uniforms(self) -> dict[str, object]:
        """As `surfelization.glsl` takes them."""
        return {
            "eye": tuple(self.eye.tolist()),
            "per_distance": self.per_distance,
            "nearest": self.nearest,
        }


@dataclass(frozen=True, eq=False)
class Surfels:
    """The disks of some drawables.

    Args:
        buffer: (count, 12) float32: centre, radius; normal, number of the drawable; atlas coordinate, level of
            detail, 0.
        count: how many.
    """

    buffer: moderngl.Buffer
    count: int

    def read(self) -> NDArray[np.float32]:
        """Return (count, 12)."""
        return np.frombuffer(self.buffer.read(), dtype="f4").reshape(-1, SURFEL_FLOATS)[: self.count]


def surfelize(
    device: Device, drawables: Sequence[GpuDrawable], extent: Extent, view: View, *, two_pass: bool = True
) -> Surfels:
    """Make the surfels of `drawables`, in the order of their triangles.

    Raises:
        PhoslabError: they would be too many.
    """
    with device.scope():
        triangles, n_triangles = _gather_triangles(device, drawables, extent)
        defines = dict(STEPS) | ({} if two_pass else {"ONE_PASS": 1})

        def run(step: str, n: int, bound: Sequence[moderngl.Buffer], **uniforms: int) -> None:
            shader = device.compute("surfelize", {**defines, "STEP": step})
            bind_buffers(*bound)
            set_uniforms(shader, count=n, **view.uniforms, **uniforms)
            device.dispatch_items(shader, n)

        parts = sum_buffer(device, n_triangles)
        run("PARTS", n_triangles, (triangles, parts, parts, parts))
        n_parts = prefix_sums(device, parts, n_triangles)
        points = sum_buffer(device, n_parts)
        run("POINTS", n_parts, (triangles, parts, points, points), triangle_count=n_triangles)
        n_points = prefix_sums(device, points, n_parts)
        if n_points > MOST_POINTS:
            raise PhoslabError(
                f"would be {n_points:.2g} before they are thinned, and {MOST_POINTS} are the most",
                field="the surfels",
                remedy="Use larger ones (--surfel).",
            )
        check_room(n_points * 4 * (2 + SURFEL_FLOATS), "the surfels")
        sums = sum_buffer(device, n_points)
        of = {"triangle_count": n_triangles, "part_count": n_parts}
        run("SHARES", n_points, (triangles, parts, points, sums), **of)
        total = prefix_sums(device, sums, n_points)
        count = (total + (1 << FRACTION_BITS - 1)) >> FRACTION_BITS
        buffer = device.reserve(count * SURFEL_FLOATS * 4, outlive=True)
        run("SURFELS", n_points, (triangles, parts, points, sums, buffer), **of)
    return Surfels(buffer, count)


def _gather_triangles(
    device: Device, drawables: Sequence[GpuDrawable], extent: Extent
) -> tuple[moderngl.Buffer, int]:
    n = sum(len(d.geometry.triangles) for d in drawables)
    triangles = device.buffer(np.zeros((max(1, n), TRIANGLE_FLOATS), dtype=np.float32))
    shader = device.compute("surfel_triangles")
    first = 0
    for drawable in drawables:
        count = len(drawable.geometry.triangles)
        attributes = drawable.mesh.attributes
        bind_buffers(attributes["position"][0], attributes["atlas_uv"][0], drawable.mesh.indices, triangles)
        set_uniforms(
            shader,
            to_surfels=extent.from_world @ drawable.drawable.model_to_world,
            number=float(drawable.number),
            handedness=drawable.handedness,
            atlas_size=tuple(map(float, drawable.atlas_size or (1, 1))),
            largest=float(np.ptp(drawable.box_w, axis=0) @ np.ptp(drawable.box_w, axis=0)) ** 0.5
            / extent.radius
            * LARGEST,
            first=first,
            count=count,
        )
        device.dispatch_items(shader, count)
        first += count
    return triangles, n
