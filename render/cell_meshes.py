"""A drawable's flat parts, before they become cells: large triangles that make a parallelogram are one part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from phoslab.render.cell_shapes import centres_of, radii_of
from phoslab.render.gpu_scene import GpuDrawable

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# Nearer to a plane than this, in units of the scene's radius, a point lies in it: float32 of G-buffer and atlas.
COPLANAR = 2e-5


@dataclass(frozen=True, eq=False)
class FlatMesh:
    """One drawable's flat parts, in the scene's own coordinates: its triangles, large ones in pairs where they fit.

    Args:
        corners: (m, 3, 3) a corner and its two neighbours.
        is_triangle: (m,); else a parallelogram.
        normals, areas: (m, 3) and (m,).
        uv: (m, 3, 2) atlas coordinates of the corners; not a number where it does not glow.
        density: (m,) area over that in the atlas.
    """

    corners: Array
    is_triangle: NDArray[np.bool_]
    normals: Array
    areas: Array
    uv: Array
    density: Array

    @staticmethod
    def of(drawable: GpuDrawable, centre: Array, radius: float, smallest: float) -> FlatMesh:
        geometry, to_world = drawable.geometry, drawable.drawable.model_to_world
        positions = geometry.positions.astype(np.float64) @ to_world[:3, :3].T + to_world[:3, 3]
        triangles = geometry.triangles if drawable.handedness > 0 else geometry.triangles[:, ::-1]
        corners = ((positions - centre) / radius)[triangles]
        doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(doubled, axis=1)
        # A transform may flatten what was sound: without area it neither sends nor blocks.
        sound = length > 1e-16
        corners, doubled, length = corners[sound], doubled[sound], length[sound]
        uv, density = np.full((len(corners), 3, 2), np.nan), np.ones(len(corners))
        if drawable.material is not None:
            assert geometry.atlas_uv is not None
            uv = geometry.atlas_uv.astype(np.float64)[triangles[sound]]
            atlas_area = np.abs(np.linalg.det(uv[:, 1:] - uv[:, :1])) / 2
            density = length / 2 / np.maximum(atlas_area, 1e-30)
        mesh = FlatMesh(
            corners, np.ones(len(corners), dtype=bool), doubled / length[:, None], length / 2, uv, density
        )
        return _paired(mesh, np.flatnonzero(radii_of(corners, mesh.is_triangle) > smallest))

    @staticmethod
    def joined(meshes: Sequence[FlatMesh]) -> FlatMesh:
        """Return the parts of all meshes, one after the other."""
        return FlatMesh(*(np.concatenate([getattr(m, f.name) for m in meshes]) for f in fields(FlatMesh)))

    def points(self, of: Indices) -> Array:
        """Return (4, k, 3) all corners of some parts; a triangle's first is there twice."""
        a, b, c = self.corners[of].transpose(1, 0, 2)
        fourth = np.where(self.is_triangle[of, None], a, b + c - a)
        return np.stack([a, b, c, fourth])

    def centres(self, of: Indices) -> Array:
        """Return (k, 3)."""
        return centres_of(self.corners[of], self.is_triangle[of])


def _paired(mesh: FlatMesh, large: Indices) -> FlatMesh:
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
    uv = mesh.uv[large]
    off = uv[t, (k + 1) % 3] + uv[t, (k + 2) % 3] - uv[t, k] - uv[t2, k2]
    fits &= ~(np.abs(off).max(axis=1) >= 1e-5)  # of what does not glow it is not a number
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

    return FlatMesh(
        joined(mesh.corners, np.take_along_axis(mesh.corners[of], turn[..., None], axis=1)),
        np.concatenate([np.ones(len(alone), dtype=bool), np.zeros(len(first), dtype=bool)]),
        joined(mesh.normals, mesh.normals[of]),
        joined(mesh.areas, 2 * mesh.areas[of]),
        joined(mesh.uv, np.take_along_axis(mesh.uv[of], turn[..., None], axis=1)),
        joined(mesh.density, mesh.density[of]),
    )
