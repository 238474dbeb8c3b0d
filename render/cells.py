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

from phoslab.render.cell_forest import Forest, add_cluster
from phoslab.render.cell_meshes import COPLANAR, FlatMesh
from phoslab.render.gpu_scene import GpuDrawable

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

MOST_LEAVES = 1 << 18


@dataclass(frozen=True, eq=False)
class Cells:
    """A forest of cells; n of them, m of which are the smallest.

    Args:
        corners: (n, 3, 3) the corner and its two neighbours: of a triangle, or of a parallelogram.
        normals: (n, 3) to the outside.
        is_triangle: (n,).
        spheres: (n, 4) centre and radius around all that a cell stands for.
        errors: (n,) how far that reaches from the cell's plane; `NEVER` where it is no likeness.
        skip: (n,) the index after a cell's last descendant.
        leaves: (n, 2) first and end of the smallest cells below, in their own count.
        leaf_areas: (m,).
        patches: by the number of each drawable that glows, where its leaves lie in its atlas.
        owners: (n_drawables + 1,) the first of the smallest cells of each drawable, and their end.
        centre, radius: of the scene, in m: coordinates are (world - centre) / radius.
    """

    corners: Array
    normals: Array
    is_triangle: NDArray[np.bool_]
    spheres: Array
    errors: Array
    skip: Indices
    leaves: Indices
    leaf_areas: Array
    patches: dict[int, Patches]
    owners: Indices
    centre: Array
    radius: float

    def tests(self) -> NDArray[np.float32]:
        """Return (n, 4, 4) what a ray is held against: planes N, U, V, and (error, u + v at most, 0, 0).

        N·p is the distance from the plane; U·p and V·p are the shares of the two sides.
        """
        a, b, c = self.corners.transpose(1, 0, 2)
        u, v = b - a, c - a
        # U and V are dual to u and v within the plane.
        across_v, across_u = np.cross(v, self.normals), np.cross(self.normals, u)
        area = np.sum(across_v * u, axis=1, keepdims=True)
        area[area == 0] = np.inf  # what is no likeness is never hit
        planes = np.stack([self.normals, across_v / area, across_u / area], axis=1)
        rows = np.zeros((len(a), 4, 4), dtype=np.float32)
        rows[:, :3, :3] = planes
        rows[:, :3, 3] = -np.einsum("nij,nj->ni", planes, a)
        rows[:, 3, 0] = np.minimum(self.errors, 1.0) + COPLANAR
        rows[:, 3, 1] = np.where(self.is_triangle, 1.0, 2.0)
        return rows

    def walk(self, *, sends_on: bool) -> NDArray[np.float32]:
        """Return (n, 5, 4) what a walk through the tree asks: sphere, corners, (error, is triangle, glows, sends).

        Args:
            sends_on: whether all cells send light, not those alone that glow.
        """
        rows = np.zeros((len(self.skip), 5, 4), dtype=np.float32)
        rows[:, 0] = self.spheres
        rows[:, 1:4, :3] = self.corners
        rows[:, 4, 0], rows[:, 4, 1] = self.errors, self.is_triangle
        for patches in self.patches.values():
            first = self.leaves[:, 0]
            rows[(patches.leaf.min() <= first) & (first <= patches.leaf.max()), 4, 2:] = 1.0
        if sends_on:
            rows[:, 4, 3] = 1.0
        return rows

    def averages(self, leaf_values: Array) -> Array:
        """Return (n, K) the means over each cell's area of (m, K) values of the smallest cells."""
        weighted = np.zeros((len(self.leaf_areas) + 1, leaf_values.shape[1]))
        np.cumsum(self.leaf_areas[:, None] * leaf_values, axis=0, out=weighted[1:])
        area = np.concatenate([[0.0], np.cumsum(self.leaf_areas)])
        first, end = self.leaves.T
        means: Array = (weighted[end] - weighted[first]) / (area[end] - area[first])[:, None]
        return np.maximum(means, 0.0)


@dataclass(frozen=True, eq=False)
class Patches:
    """Where the smallest cells of one drawable lie in its atlas, as a soup of triangles.

    Args:
        uv: (k, 3, 2) atlas coordinates.
        leaf: (k,) the smallest cell that each is of.
        density: (k,) area in the world over area in the atlas.
    """

    uv: Array
    leaf: Indices
    density: Array


def build_cells(drawables: Sequence[GpuDrawable], cell: float) -> Cells:
    """Make the cells of everything that can send or block light.

    Args:
        cell: the radius of the smallest cells over the scene's; larger where that would be too many.
    """
    corners = np.concatenate([d.box_w for d in drawables])
    low, high = corners.min(axis=0), corners.max(axis=0)
    centre, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-30)
    meshes = [FlatMesh.of(drawable, centre, radius, cell) for drawable in drawables]
    area = sum(float(mesh.areas.sum()) for mesh in meshes)
    # Halved until their radius is below r, squares cover from r² to 2 r².
    forest = Forest(max(cell, float(np.sqrt(area / MOST_LEAVES))))
    patches, owners = {}, [0]
    for drawable, mesh in zip(drawables, meshes, strict=True):
        begin = len(forest.parts.get("uv", []))
        add_cluster(forest, mesh, np.arange(len(mesh.areas)))
        owners.append(forest.n_leaves)
        if mesh.uv is not None and len(mesh.areas):
            each = {name: np.concatenate(forest.parts[name][begin:]) for name in ("uv", "leaf", "density")}
            patches[drawable.number] = Patches(each["uv"], each["leaf"].astype(np.intp), each["density"])
    whole = {name: np.concatenate(parts) for name, parts in forest.parts.items() if parts}
    return Cells(
        corners=whole["corners"],
        normals=whole["normals"],
        is_triangle=whole["is_triangle"].astype(bool),
        spheres=whole["spheres"],
        errors=whole["errors"],
        skip=whole["skip"].astype(np.intp),
        leaves=whole["leaves"].astype(np.intp),
        leaf_areas=whole["leaf_areas"],
        patches=patches,
        owners=np.array(owners, dtype=np.intp),
        centre=centre,
        radius=radius,
    )
