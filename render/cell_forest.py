"""How parts become trees of cells: large ones are halved, small ones gathered into a likeness.

A likeness is the parallelogram that covers small triangles which lie together and face one way.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from phoslab.render.cell_meshes import FlatMesh
from phoslab.render.cell_shapes import halve_parallelograms, halve_triangles, radii_of

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# A cell of small triangles stands for them only if so much of their area faces one way, and fills so much of it.
COHERENT, FILLED = 0.95, 0.5
# What no distance makes good enough: such a cell is always replaced by those that it is made of.
NEVER = 1e30
# Directions that are tried for the sides of a parallelogram, over a right angle.
TURNS = 16


@dataclass
class Forest:
    """Cells as they are made, in the order of the walk; lists of arrays, one entry a cell or a whole triangle's."""

    smallest: float
    n: int = 0
    n_leaves: int = 0
    parts: dict[str, list[Array]] = field(default_factory=dict)

    def put(self, **values: Array) -> None:
        for name, value in values.items():
            self.parts.setdefault(name, []).append(value)


def add_cluster(forest: Forest, mesh: FlatMesh, of: Indices) -> None:
    """Add the cells of some triangles of a mesh."""
    if len(of) == 0:
        return
    if len(of) == 1:
        _add_part(forest, mesh, int(of[0]))
        return
    corner, normal, radius, error = _fit(mesh, of)
    is_leaf = radius <= forest.smallest and error < NEVER
    at, first_leaf = forest.n, forest.n_leaves
    forest.n += 1
    skip, leaves = np.array([0.0]), np.array([[first_leaf, 0.0]])
    forest.put(
        corners=corner[None],
        normals=normal[None],
        is_triangle=np.array([0.0]),
        errors=np.array([error]),
        is_halved=np.array([0.0]),
        skip=skip,
        leaves=leaves,
    )
    if is_leaf:
        forest.n_leaves += 1
        forest.put(leaf_areas=np.array([mesh.areas[of].sum()]))
        if mesh.uv is not None:
            _put_patches(
                forest, mesh.uv[of], mesh.is_triangle[of], np.full(len(of), first_leaf), mesh.density[of]
            )
    else:
        one, other = _split(mesh, of, forest.smallest, radius)
        add_cluster(forest, mesh, one)
        add_cluster(forest, mesh, other)
    skip[0], leaves[0, 1] = forest.n, forest.n_leaves
    assert forest.n > at


def _split(mesh: FlatMesh, of: Indices, smallest: float, radius: float) -> tuple[Indices, Indices]:
    """Halve a cluster at the median of where its triangles differ most: in place, or, once small, in direction."""
    features = np.concatenate([mesh.centres(of) / max(radius, smallest), mesh.normals[of] * 0.5], axis=1)
    axis = int(np.argmax(features.var(axis=0)))
    order = np.argsort(features[:, axis], kind="stable")
    half = len(of) // 2
    return of[order[:half]], of[order[half:]]


def _fit(mesh: FlatMesh, of: Indices) -> tuple[Array, Array, float, float]:
    """Return the parallelogram (3, 3) that stands for triangles, its normal, the radius of all, and its error."""
    areas, points = mesh.areas[of], mesh.points(of)
    facing = areas @ mesh.normals[of]
    coherence = float(np.linalg.norm(facing) / areas.sum())
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    radius = float(np.sqrt(np.max(np.sum((points - middle) ** 2, axis=1))))
    if coherence < COHERENT:
        return np.repeat(middle[None], 3, axis=0), np.array([0.0, 0.0, 1.0]), radius, NEVER
    normal = facing / np.linalg.norm(facing)
    centre = areas @ mesh.centres(of) / areas.sum()
    side = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    side /= np.linalg.norm(side)
    up = np.cross(normal, side)
    away = points - centre
    flat = away @ np.stack([side, up], axis=1)
    angle = np.pi / 2 * np.arange(TURNS) / TURNS
    c, s = np.cos(angle), np.sin(angle)
    turned = np.stack([flat @ np.array([c, s]), flat @ np.array([-s, c])], axis=2)
    low, high = turned.min(axis=0), turned.max(axis=0)
    best = int(np.argmin(np.prod(high - low, axis=1)))
    x, y = c[best] * side + s[best] * up, -s[best] * side + c[best] * up
    extent, mid = high[best] - low[best], (high[best] + low[best]) / 2
    box_area = max(float(extent.prod()), 1e-30)
    # It covers them all. What is nearest in a direction counts once, so where cells overlap nothing is added; but
    # through a gap one would look into the dark inside.
    u, v = x * extent[0], y * extent[1]
    corner = centre + mid[0] * x + mid[1] * y - (u + v) / 2
    filled = min(1.0, coherence * float(areas.sum()) / box_area)
    rim = (1.0 - np.sqrt(filled)) * float(extent.max()) / 2
    error = float(np.abs(away @ normal).max()) + rim if filled >= FILLED else NEVER
    return np.stack([corner, corner + u, corner + v]), normal, radius, error


def _add_part(forest: Forest, mesh: FlatMesh, part: int) -> None:
    """Add a triangle or parallelogram, halved until its parts are small: a complete binary tree."""
    is_triangle = mesh.is_triangle[part : part + 1]
    uv = np.zeros((1, 3, 2)) if mesh.uv is None else mesh.uv[part : part + 1]
    levels = [(mesh.corners[part : part + 1], uv)]
    halve = halve_triangles if is_triangle[0] else halve_parallelograms
    # A sliver stays a sliver: once its area is below that of small cells, more halves gain nothing.
    most = mesh.areas[part] / forest.smallest**2 * 8
    while radii_of(levels[-1][0], is_triangle).max() > forest.smallest and len(levels[-1][0]) < most:
        levels.append(halve(*levels[-1]))
    depth = len(levels) - 1
    n, n_leaves = 2 ** (depth + 1) - 1, 2**depth
    order = np.empty(n, dtype=np.intp)  # where each cell, level by level, stands in the walk
    skip, leaves = np.empty(n), np.empty((n, 2))
    at, done = np.zeros(1, dtype=np.intp), 0
    for k in range(depth + 1):
        size, below = 2 ** (depth - k + 1) - 1, 2 ** (depth - k)
        order[done : done + 2**k] = at
        skip[at] = forest.n + at + size
        leaves[at, 0] = forest.n_leaves + below * np.arange(2**k)
        leaves[at, 1] = leaves[at, 0] + below
        done += 2**k
        at = np.stack([at + 1, at + 1 + size // 2], axis=1).ravel()
    every = np.empty((n, 3, 3))
    every[order] = np.concatenate([c for c, _ in levels])
    shape = np.repeat(is_triangle, n)
    forest.put(
        corners=every,
        normals=np.repeat(mesh.normals[part : part + 1], n, axis=0),
        is_triangle=shape.astype(np.float64),
        errors=np.zeros(n),
        is_halved=(skip > forest.n + np.arange(n) + 1).astype(np.float64),
        skip=skip,
        leaves=leaves,
        leaf_areas=np.full(n_leaves, mesh.areas[part] / n_leaves),
    )
    if mesh.uv is not None:
        leaf = forest.n_leaves + np.arange(n_leaves)
        _put_patches(forest, levels[-1][1], shape[:n_leaves], leaf, np.full(n_leaves, mesh.density[part]))
    forest.n += n
    forest.n_leaves += n_leaves


def _put_patches(
    forest: Forest, uv: Array, is_triangle: NDArray[np.bool_], leaf: Indices, density: Array
) -> None:
    """Note where parts lie in the atlas: a parallelogram is two triangles."""
    a, b, c = uv.transpose(1, 0, 2)
    other = ~is_triangle
    second = np.stack([b, b + c - a, c], axis=1)[other]
    forest.put(
        uv=np.concatenate([uv, second]),
        leaf=np.concatenate([leaf, leaf[other]]).astype(np.float64),
        density=np.concatenate([density, density[other]]),
    )
