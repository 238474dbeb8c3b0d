"""Light that falls on points, from the smallest cells: rays that crowd as the cosine, and the nearest cell on each.

What a ray meets depends on geometry alone, and is found once; what it brings is looked up as often as light changes.
The error falls with the number of rays.
"""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.render.cells import Cells
from phoslab.render.device import Device, bind_buffers, set_uniforms
from phoslab.render.directions import patterned_points
from phoslab.render.memory import check_room

Array = NDArray[np.float64]


# The bindings of the flag and of the boxes; as in shaders/include/cell_walk.glsl and cell_boxes.glsl.
UNFINISHED, BOXES = 9, 3


class CellTree:
    """The tree of a scene's cells where shaders walk it.

    Args:
        detail, sends_on: of `Cells.walk`.
    """

    def __init__(self, device: Device, cells: Cells, *, detail: float = 1.0, sends_on: bool = True) -> None:
        self.cells, self._device = cells, device
        rows, boxes = cells.walk(detail, sends_on=sends_on)
        self._walk = device.buffer(rows)
        self._boxes = device.texture((boxes.shape[1], boxes.shape[0]), 4, boxes, dtype="u4")
        self._unfinished = device.buffer(np.zeros(1, dtype=np.uint32))

    def bind(self, shader: moderngl.ComputeShader) -> None:
        """Tell a shader that includes `cells.glsl` what it walks."""
        self._walk.bind_to_storage_buffer(0)
        self._unfinished.bind_to_storage_buffer(UNFINISHED)
        self._boxes.bind_to_image(BOXES, read=True, write=False)
        set_uniforms(shader, cell_count=len(self.cells.skip))

    def check(self) -> None:
        """Raise if a driver has ended a walk: Mesa's llvmpipe ends a shader's loops after 65535 turns, silently.

        Raises:
            PhoslabError: it has.
        """
        if np.frombuffer(self._unfinished.read(), dtype=np.uint32)[0]:
            raise PhoslabError(
                "passes more cells than this OpenGL driver lets a shader walk over",
                field="a ray of the picture",
                remedy="Give a larger --cell or --detail or, where so many pieces stand apart, --gi dss-z.",
            )

    def release(self) -> None:
        """Give its buffers back."""
        self._device.release(self._walk, self._boxes, self._unfinished)


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
            leaf_of = device.buffer(tree.cells.leaves[:, 0].astype(np.uint32))
            bind_buffers(device.buffer(packed), leaf_of, square, self._hits, first=1)
            tree.bind(shader)
            set_uniforms(shader, point_count=len(points))
            device.dispatch_items(shader, directions * len(points))
            tree.check()

    def gather(self, leaves: moderngl.Buffer, layers: int, light: moderngl.Buffer) -> None:
        """Write into `light` (n, layers, 4) E / π of each point.

        Args:
            leaves: (m, 2, layers, 4) the radiance of the front and the back of each smallest cell.
        """
        shader = self._device.compute("cell_gather", {"LAYERS": layers, "DIRECTIONS": self._directions})
        bind_buffers(self._hits, leaves, light)
        set_uniforms(shader, point_count=self._n)
        self._device.dispatch_items(shader, self._n)

    def release(self) -> None:
        """Give its buffer back."""
        self._device.release(self._hits)
