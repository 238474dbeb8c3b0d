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
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from phoslab.render.gpu_scene import GpuDrawable

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# A cell of small triangles stands for them only if so much of their area faces one way, and fills so much of it.
COHERENT, FILLED = 0.95, 0.5
# What no distance makes good enough: such a cell is always replaced by those that it is made of.
NEVER = 1e30
# Nearer to a plane than this, in units of the scene's radius, a point lies in it: float32 of G-buffer and atlas.
COPLANAR = 2e-5
# Directions that are tried for the sides of a parallelogram, over a right angle.
TURNS = 16
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

    def walk(self) -> NDArray[np.float32]:
        """Return (n, 5, 4) what a walk through the tree asks: sphere, corners, (error, is triangle, sends, 0)."""
        rows = np.zeros((len(self.skip), 5, 4), dtype=np.float32)
        rows[:, 0] = self.spheres
        rows[:, 1:4, :3] = self.corners
        rows[:, 4, 0], rows[:, 4, 1] = self.errors, self.is_triangle
        for patches in self.patches.values():
            first = self.leaves[:, 0]
            rows[(patches.leaf.min() <= first) & (first <= patches.leaf.max()), 4, 2] = 1.0
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


@dataclass
class _Forest:
    """Cells as they are made, in the order of the walk; lists of arrays, one entry a cell or a whole triangle's."""

    smallest: float
    n: int = 0
    n_leaves: int = 0
    parts: dict[str, list[Array]] = field(default_factory=dict)

    def put(self, **values: Array) -> None:
        for name, value in values.items():
            self.parts.setdefault(name, []).append(value)


def build_cells(drawables: Sequence[GpuDrawable], cell: float) -> Cells:
    """Make the cells of everything that can send or block light.

    Args:
        cell: the radius of the smallest cells over the scene's; larger where that would be too many.
    """
    corners = np.concatenate([d.box_w for d in drawables])
    low, high = corners.min(axis=0), corners.max(axis=0)
    centre, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-30)
    meshes = [_Mesh.of(drawable, centre, radius, cell) for drawable in drawables]
    area = sum(float(mesh.areas.sum()) for mesh in meshes)
    # Halved until their radius is below r, squares cover from r² to 2 r².
    forest = _Forest(max(cell, float(np.sqrt(area / MOST_LEAVES))))
    patches, owners = {}, [0]
    for drawable, mesh in zip(drawables, meshes, strict=True):
        begin = len(forest.parts.get("uv", []))
        _add_cluster(forest, mesh, np.arange(len(mesh.areas)))
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


@dataclass(frozen=True, eq=False)
class _Mesh:
    """One drawable's flat parts, in the scene's own coordinates: its triangles, large ones in pairs where they fit.

    Args:
        corners: (m, 3, 3) a corner and its two neighbours.
        is_triangle: (m,); else a parallelogram.
        normals, areas: (m, 3) and (m,).
        uv: (m, 3, 2) atlas coordinates of the corners; None where it does not glow.
        density: (m,) area over that in the atlas.
    """

    corners: Array
    is_triangle: NDArray[np.bool_]
    normals: Array
    areas: Array
    uv: Array | None
    density: Array

    @staticmethod
    def of(drawable: GpuDrawable, centre: Array, radius: float, smallest: float) -> _Mesh:
        geometry, to_world = drawable.geometry, drawable.drawable.model_to_world
        positions = geometry.positions.astype(np.float64) @ to_world[:3, :3].T + to_world[:3, 3]
        triangles = geometry.triangles if drawable.handedness > 0 else geometry.triangles[:, ::-1]
        corners = ((positions - centre) / radius)[triangles]
        doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(doubled, axis=1)
        # A transform may flatten what was sound: without area it neither sends nor blocks.
        sound = length > 1e-16
        corners, doubled, length = corners[sound], doubled[sound], length[sound]
        uv, density = None, np.ones(len(corners))
        if drawable.material is not None:
            assert geometry.atlas_uv is not None
            uv = geometry.atlas_uv.astype(np.float64)[triangles[sound]]
            atlas_area = np.abs(np.linalg.det(uv[:, 1:] - uv[:, :1])) / 2
            density = length / 2 / np.maximum(atlas_area, 1e-30)
        mesh = _Mesh(
            corners, np.ones(len(corners), dtype=bool), doubled / length[:, None], length / 2, uv, density
        )
        return _paired(mesh, np.flatnonzero(_radii(corners, mesh.is_triangle) > smallest))

    def points(self, of: Indices) -> Array:
        """Return (k, 3) all corners of some parts; a triangle's first counts twice."""
        a, b, c = self.corners[of].transpose(1, 0, 2)
        fourth = np.where(self.is_triangle[of, None], a, b + c - a)
        return np.concatenate([a, b, c, fourth])

    def centres(self, of: Indices) -> Array:
        """Return (k, 3)."""
        return _centres(self.corners[of], self.is_triangle[of])


def _paired(mesh: _Mesh, large: Indices) -> _Mesh:
    """Return the mesh with large triangles joined two by two where they make a parallelogram.

    Most walls are made of such pairs, and halves of a parallelogram stay as wide as they are long.
    """
    if len(large) < 2:
        return mesh
    corners = mesh.corners[large]
    rounded = np.round(corners.reshape(-1, 3) / COPLANAR).astype(np.int64)
    vertex = np.unique(rounded, axis=0, return_inverse=True)[1].reshape(-1, 3)
    # Edge k of a triangle lies opposite its corner k.
    edges = np.sort(np.stack([np.roll(vertex, -1, axis=1), np.roll(vertex, -2, axis=1)], axis=2), axis=2)
    order = np.lexsort(edges.reshape(-1, 2).T)
    same = (np.diff(edges.reshape(-1, 2)[order], axis=0) == 0).all(axis=1)
    one, other = order[:-1][same], order[1:][same]
    t, k, t2, k2 = one // 3, one % 3, other // 3, other % 3
    apex, apex2 = corners[t, k], corners[t2, k2]
    b, c = corners[t, (k + 1) % 3], corners[t, (k + 2) % 3]
    fits = (np.abs(b + c - apex - apex2).max(axis=1) < COPLANAR) & (t != t2)
    fits &= np.sum(mesh.normals[large[t]] * mesh.normals[large[t2]], axis=1) > 1 - 1e-6
    if mesh.uv is not None:
        uv = mesh.uv[large]
        off = uv[t, (k + 1) % 3] + uv[t, (k + 2) % 3] - uv[t, k] - uv[t2, k2]
        fits &= np.abs(off).max(axis=1) < 1e-5
    # The squarest first: each triangle is in one pair at most.
    skew = np.abs(np.sum((b - apex) * (c - apex), axis=1))
    taken: set[int] = set()
    kept = []
    for i in np.flatnonzero(fits)[np.argsort(skew[fits], kind="stable")]:
        if not taken & {int(t[i]), int(t2[i])}:
            taken |= {int(t[i]), int(t2[i])}
            kept.append(i)
    first = np.array(kept, dtype=np.intp)
    turn = (k[first, None] + np.arange(3)) % 3
    alone = np.setdiff1d(np.arange(len(mesh.areas)), large[sorted(taken)])
    of = large[t[first]]

    def joined(values: Array, pairs: Array) -> Array:
        return np.concatenate([values[alone], pairs])

    return _Mesh(
        joined(mesh.corners, np.take_along_axis(mesh.corners[of], turn[..., None], axis=1)),
        np.concatenate([np.ones(len(alone), dtype=bool), np.zeros(len(first), dtype=bool)]),
        joined(mesh.normals, mesh.normals[of]),
        joined(mesh.areas, 2 * mesh.areas[of]),
        None
        if mesh.uv is None
        else joined(mesh.uv, np.take_along_axis(mesh.uv[of], turn[..., None], axis=1)),
        joined(mesh.density, mesh.density[of]),
    )


def _add_cluster(forest: _Forest, mesh: _Mesh, of: Indices) -> None:
    """Add the cells of some triangles of a mesh."""
    if len(of) == 0:
        return
    if len(of) == 1:
        _add_part(forest, mesh, int(of[0]))
        return
    corner, normal, sphere, error = _fit(mesh, of)
    is_leaf = bool(sphere[3] <= forest.smallest and error < NEVER)
    at, first_leaf = forest.n, forest.n_leaves
    forest.n += 1
    skip, leaves = np.array([0.0]), np.array([[first_leaf, 0.0]])
    forest.put(
        corners=corner[None],
        normals=normal[None],
        is_triangle=np.array([0.0]),
        spheres=sphere[None],
        errors=np.array([error]),
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
        one, other = _split(mesh, of, forest.smallest, float(sphere[3]))
        _add_cluster(forest, mesh, one)
        _add_cluster(forest, mesh, other)
    skip[0], leaves[0, 1] = forest.n, forest.n_leaves
    assert forest.n > at


def _split(mesh: _Mesh, of: Indices, smallest: float, radius: float) -> tuple[Indices, Indices]:
    """Halve a cluster at the median of where its triangles differ most: in place, or, once small, in direction."""
    features = np.concatenate([mesh.centres(of) / max(radius, smallest), mesh.normals[of] * 0.5], axis=1)
    axis = int(np.argmax(features.var(axis=0)))
    order = np.argsort(features[:, axis], kind="stable")
    half = len(of) // 2
    return of[order[:half]], of[order[half:]]


def _fit(mesh: _Mesh, of: Indices) -> tuple[Array, Array, Array, float]:
    """Return the parallelogram (3, 3) that stands for triangles, its normal, sphere and error."""
    areas, points = mesh.areas[of], mesh.points(of)
    facing = areas @ mesh.normals[of]
    coherence = float(np.linalg.norm(facing) / areas.sum())
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    sphere = np.array([*middle, np.sqrt(np.max(np.sum((points - middle) ** 2, axis=1)))])
    if coherence < COHERENT:
        return np.repeat(middle[None], 3, axis=0), np.array([0.0, 0.0, 1.0]), sphere, NEVER
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
    return np.stack([corner, corner + u, corner + v]), normal, sphere, error


def _add_part(forest: _Forest, mesh: _Mesh, part: int) -> None:
    """Add a triangle or parallelogram, halved until its parts are small: a complete binary tree."""
    is_triangle = mesh.is_triangle[part : part + 1]
    uv = np.zeros((1, 3, 2)) if mesh.uv is None else mesh.uv[part : part + 1]
    levels = [(mesh.corners[part : part + 1], uv)]
    halve = _halve_triangles if is_triangle[0] else _halve_parallelograms
    # A sliver stays a sliver: once its area is below that of small cells, more halves gain nothing.
    most = mesh.areas[part] / forest.smallest**2 * 8
    while _radii(levels[-1][0], is_triangle).max() > forest.smallest and len(levels[-1][0]) < most:
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
        spheres=np.concatenate([_centres(every, shape), _radii(every, shape)[:, None]], axis=1),
        errors=np.zeros(n),
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
    forest: _Forest, uv: Array, is_triangle: NDArray[np.bool_], leaf: Indices, density: Array
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


def _centres(corners: Array, is_triangle: NDArray[np.bool_]) -> Array:
    a, b, c = corners.transpose(1, 0, 2)
    centres: Array = np.where(is_triangle[:, None], (a + b + c) / 3, (b + c) / 2)
    return centres


def _radii(corners: Array, is_triangle: NDArray[np.bool_]) -> Array:
    """Return (k,) the distance of the farthest corner from the centre; a parallelogram's fourth is its first's."""
    away = corners - _centres(corners, is_triangle)[:, None]
    radii: Array = np.sqrt(np.max(np.sum(away**2, axis=2), axis=1))
    return radii


def _halve_triangles(corners: Array, uv: Array) -> tuple[Array, Array]:
    """Return the halves of (k, 3, 3) triangles, and of their (k, 3, 2) coordinates: two in a row for each."""
    edges = np.sum((np.roll(corners, -1, axis=1) - np.roll(corners, -2, axis=1)) ** 2, axis=2)
    turn = (np.argmax(edges, axis=1)[:, None] + np.arange(3)) % 3

    def halves(values: Array) -> Array:
        a, b, c = np.take_along_axis(values, turn[..., None], axis=1).transpose(1, 0, 2)
        m = (b + c) / 2
        pair = np.stack([np.stack([a, b, m], axis=1), np.stack([a, m, c], axis=1)], axis=1)
        return pair.reshape(-1, *values.shape[1:])

    return halves(corners), halves(uv)


def _halve_parallelograms(corners: Array, uv: Array) -> tuple[Array, Array]:
    """As `_halve_triangles`: across the longer side; all of them are alike."""
    a, b, c = corners[0]
    along_u = np.sum((b - a) ** 2) >= np.sum((c - a) ** 2)

    def halves(values: Array) -> Array:
        a, b, c = values.transpose(1, 0, 2)
        if along_u:
            m = (a + b) / 2
            pair = [np.stack([a, m, c], axis=1), np.stack([m, b, c + m - a], axis=1)]
        else:
            m = (a + c) / 2
            pair = [np.stack([a, b, m], axis=1), np.stack([m, b + m - a, c], axis=1)]
        return np.stack(pair, axis=1).reshape(-1, *values.shape[1:])

    return halves(corners), halves(uv)
