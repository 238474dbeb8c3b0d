"""Light that falls on points, from the smallest cells: rays that crowd as the cosine, and the nearest cell on each.

What a ray meets depends on geometry alone, and is found once; what it brings is looked up as often as light changes.
The error falls with the number of rays.
"""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.render.cells import Cells
from phoslab.render.device import Device, set_uniforms
from phoslab.render.directions import patterned_points
from phoslab.render.memory import check_room

Array = NDArray[np.float64]


class CellTree:
    """The tree of a scene's cells where shaders walk it."""

    def __init__(self, device: Device, cells: Cells) -> None:
        self.cells, self._device = cells, device
        skip = np.stack([cells.skip, cells.leaves[:, 0]], axis=1).astype(np.uint32)
        self.spheres = device.buffer(cells.spheres.astype(np.float32))
        self.skip, self.tests = device.buffer(skip), device.buffer(cells.tests())

    def release(self) -> None:
        """Give its buffers back."""
        self._device.release(self.spheres, self.skip, self.tests)


class CellRays:
    """What the rays of some points meet.

    Args:
        points: (n, 3) in the coordinates of the cells.
        normals: (n, 3) of length 1: about these the rays crowd.
        there: (n,) False where there is no point after all.
        directions: rays a point.
    """

    def __init__(
        self,
        device: Device,
        tree: CellTree,
        points: Array,
        normals: Array,
        there: NDArray[np.bool_],
        directions: int,
    ) -> None:
        self._device, self._n, self._directions = device, len(points), directions
        check_room(4 * len(points) * directions, "what the rays of surfaces meet")
        packed = np.zeros((len(points), 2, 4), dtype=np.float32)
        packed[:, 0, :3], packed[:, 0, 3], packed[:, 1, :3] = points, there, normals
        self._hits = device.buffer(np.zeros((len(points), directions), dtype=np.uint32))
        shader = device.compute("cell_rays", {"DIRECTIONS": directions})  # outlives the scope: built once
        with device.scope():
            square = device.buffer(patterned_points(1, directions)[0, 0].astype(np.float32))
            buffers = (device.buffer(packed), tree.spheres, tree.skip, tree.tests, square, self._hits)
            for k, buffer in enumerate(buffers):
                buffer.bind_to_storage_buffer(k)
            set_uniforms(shader, point_count=len(points), cell_count=len(tree.cells.skip))
            device.dispatch_items(shader, directions * len(points))

    def gather(self, leaves: moderngl.Buffer, layers: int, light: moderngl.Buffer) -> None:
        """Write into `light` (n, layers, 4) E / π of each point.

        Args:
            leaves: (m, 2, layers, 4) the radiance of the front and the back of each smallest cell.
        """
        shader = self._device.compute("cell_gather", {"LAYERS": layers, "DIRECTIONS": self._directions})
        for k, buffer in enumerate((self._hits, leaves, light)):
            buffer.bind_to_storage_buffer(k)
        set_uniforms(shader, point_count=self._n)
        self._device.dispatch_items(shader, self._n)

    def release(self) -> None:
        """Give its buffer back."""
        self._device.release(self._hits)
