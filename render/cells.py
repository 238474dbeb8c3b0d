"""The surfaces of a scene as a tree of flat cells: what blocks light, and what sends it, at any coarseness.

A triangle that is larger than the smallest cell is halved along its longest edge until it is not: its cells cover it
without gap or overlap. Triangles that are smaller are brought together, by place and by direction, into the
parallelogram that covers them with the least to spare. So a flat wall is exact at every level, and a mesh of a million
triangles has no more cells than its area asks for.

The tree is stored in the order of a walk: a cell is followed by those that it is made of, and knows where they end.
Coordinates are those of the world, moved and scaled so that the scene lies within 1 of the origin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.render.cell_boxes import box_middles, pack, packed_distance
from phoslab.render.cell_forest import Forest, grow
from phoslab.render.cell_meshes import COPLANAR, FlatMesh
from phoslab.render.gpu_scene import GpuDrawable

Array = NDArray[np.float64]

MOST_LEAVES = 1 << 18
ERRORS = 3.0  # a likeness must be this much better than its size


@dataclass(frozen=True, eq=False)
class Cells(Forest):
    """The cells of a scene.

    Args:
        centre, radius: of the scene, in m: coordinates are (world - centre) / radius.
    """

    centre: Array
    radius: float

    def walk(
        self, detail: float = 1.0, *, sends_on: bool = True
    ) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
        """Return what a ray's walk asks: (n, 8, 4) cells as in shaders/include/cells.glsl, and their boxes, packed.

        From `apart` on, a distance of its middle, a cell may stand for its parts, and from `aim` on where what it sends
        matters; anywhere where these are negative: what is flat covers and blocks as its parts do.

        Args:
            detail: the radius of a cell over its distance, where it sends, and three times its error over its distance.
            sends_on: whether all cells send light, not those alone that glow.

        Raises:
            PhoslabError: there are too many cells.
        """
        low, high = self.boxes()
        radius, glows = np.linalg.norm(high - low, axis=1) / 2, self.glows()
        is_smallest = self.skip == np.arange(1, len(self.skip) + 1)
        least = radius + ERRORS * self.errors / detail
        apart, aim = (least + size / detail for size in (radius * (glows | sends_on), radius))
        rows = np.zeros((len(self.skip), 8, 4), dtype=np.float32)
        low, high = low - COPLANAR, high + COPLANAR
        rows[:, 0, :3], rows[:, 0, 3] = low, np.where(glows, -self.skip, self.skip)
        rows[:, 1, :3] = high
        boxes = pack(low, high, self.skip, np.where(self.is_halved | is_smallest, -1.0, apart))
        # As the walk has them: a cell that is aimed at, and then taken for too large by the walk, would be lost.
        rows[:, 2, :3] = box_middles(boxes)[: len(rows)]
        rows[:, 2, 3] = np.where(is_smallest, -1.0, packed_distance(aim))
        rows[:, 3:6] = self._planes()
        rows[self.is_halved, 6] = self._halves()
        rows[:, 7, 0], rows[:, 7, 1] = np.minimum(self.heights, 1.0), np.where(self.is_triangle, 1.0, 2.0)
        rows[:, 7, 2] = self.is_halved
        return rows, boxes

    def _planes(self) -> Array:
        """Return (n, 3, 4) planes N, U and V: the distance from the plane, and the shares of the two sides."""
        a, b, c = self.corners.transpose(1, 0, 2)
        u, v = b - a, c - a
        # U and V are dual to u and v within the plane.
        across_v, across_u = np.cross(v, self.normals), np.cross(self.normals, u)
        area = np.sum(across_v * u, axis=1, keepdims=True)
        area[area == 0] = np.inf  # what is no likeness is never hit
        planes = np.stack([self.normals, across_v / area, across_u / area], axis=1)
        return np.concatenate([planes, -np.einsum("nij,nj->ni", planes, a)[..., None]], axis=2)

    def _halves(self) -> Array:
        """Return (k, 4) planes between the halves of what is made of such, negative in the first."""
        of = np.flatnonzero(self.is_halved)
        one, other = self.corners[of + 1], self.corners[self.skip[of + 1]]
        # Where a parallelogram is halved across its first side, its halves share the other's first and third corner.
        across_first = ~self.is_triangle[of] & (one[:, 1] != self.corners[of, 1]).any(axis=1)
        along = np.where(across_first[:, None], other[:, 2], other[:, 1]) - other[:, 0]
        normal = np.cross(self.normals[of], along)
        off = -np.sum(normal * other[:, 0], axis=1)
        side = np.sum(normal * one.mean(axis=1), axis=1) + off
        planes = np.concatenate([normal, off[:, None]], axis=1)
        planes *= (-np.sign(side) / np.linalg.norm(normal, axis=1))[:, None]
        return planes

    def boxes(self) -> tuple[Array, Array]:
        """Return (n, 3) the low and the high corners of boxes around each cell and all that it stands for."""
        a, b, c = self.corners.transpose(1, 0, 2)
        points = np.stack([a, b, c, np.where(self.is_triangle[:, None], a, b + c - a)])
        # From each cell to its end; what lies between the ends of one and the begin of the next is left out.
        spans = np.stack([np.arange(len(a)), self.skip], axis=1).ravel()
        low, high = (np.concatenate([p, p[-1:]]) for p in (points.min(axis=0), points.max(axis=0)))
        return np.minimum.reduceat(low, spans)[::2], np.maximum.reduceat(high, spans)[::2]

    def glows(self) -> NDArray[np.bool_]:
        """Return (n,) whether a cell is of a surface that glows."""
        first, each = self.leaves[:, 0], np.zeros(len(self.skip), dtype=bool)
        for patches in self.patches.values():
            each |= (patches.leaf.min() <= first) & (first <= patches.leaf.max())
        return each

    def aims(self) -> NDArray[np.float32]:
        """Return (n, 3, 4) the corners, and beside the first of them the cell's area."""
        rows = np.zeros((len(self.skip), 3, 4), dtype=np.float32)
        rows[..., :3] = self.corners
        a, b, c = self.corners.transpose(1, 0, 2)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        rows[:, 0, 3] = np.where(self.is_triangle, area / 2, area)
        return rows

    def averages(self, leaf_values: Array) -> Array:
        """Return (n, K) the means over each cell's area of (m, K) values of the smallest cells."""
        weighted = np.zeros((len(self.leaf_areas) + 1, leaf_values.shape[1]))
        np.cumsum(self.leaf_areas[:, None] * leaf_values, axis=0, out=weighted[1:])
        area = np.concatenate([[0.0], np.cumsum(self.leaf_areas)])
        first, end = self.leaves.T
        means: Array = (weighted[end] - weighted[first]) / (area[end] - area[first])[:, None]
        return np.maximum(means, 0.0)


def build_cells(drawables: Sequence[GpuDrawable], cell: float) -> Cells:
    """Make the cells of everything that can send or block light.

    Args:
        cell: the radius of the smallest cells over the scene's; larger where that would be too many.
    """
    corners = np.concatenate([d.box_w for d in drawables])
    low, high = corners.min(axis=0), corners.max(axis=0)
    centre, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-30)
    meshes = {d.number: FlatMesh.of(d, centre, radius, cell) for d in drawables}
    area = sum(float(mesh.areas.sum()) for mesh in meshes.values())
    # Halved until their radius is below r, squares cover from r² to 2 r².
    forest = grow(meshes, max(cell, float(np.sqrt(area / MOST_LEAVES))))
    return Cells(**vars(forest), centre=centre, radius=radius)
