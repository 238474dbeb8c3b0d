"""Triangle meshes as the renderer takes them: indexed, finite, with normals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Indices = NDArray[np.uint32]

# Twice a triangle's area over its longest edge squared: below this it has no direction in float32.
DEGENERATE = 1e-7


@dataclass(frozen=True, eq=False)
class Geometry:
    """An indexed triangle mesh in its own space.

    Args:
        positions: (n, 3).
        normals: (n, 3), of length 1.
        triangles: (m, 3) vertex indices.
        uv: (n, 2) texture coordinates, or None.
        atlas_uv: (n, 2) one-to-one coordinates of the phosphor state, or None where there is no state.
    """

    positions: Floats
    normals: Floats
    triangles: Indices
    uv: Floats | None = None
    atlas_uv: Floats | None = None


def build(positions: Floats, normals: Floats | None, triangles: Indices, uv: Floats | None) -> Geometry:
    """Return the mesh without its degenerate triangles; give it flat normals if it has none.

    A triangle without area receives no light and covers no pixel, but would spoil normals and atlases.
    Normals that are missing, zero or not finite become the triangles' own, as glTF 2.0 asks.
    """
    triangles = triangles[_is_sound(positions, triangles)]
    if normals is not None:
        length = np.linalg.norm(normals.astype(np.float64), axis=1, keepdims=True)
        if (np.isfinite(length) & (length > 0)).all():
            return Geometry(positions, (normals / length).astype(np.float32), triangles, uv)
    split = triangles.reshape(-1)
    flat = face_normals(positions, triangles).repeat(3, axis=0).astype(np.float32)
    alone = np.arange(split.size, dtype=np.uint32).reshape(-1, 3)
    return Geometry(positions[split], flat, alone, None if uv is None else uv[split])


def face_normals(positions: Floats, triangles: Indices) -> NDArray[np.float64]:
    """Return (m, 3) the triangles' unit normals, counter-clockwise seen from outside."""
    a, b, c = positions.astype(np.float64)[triangles].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    unit: NDArray[np.float64] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return unit


def bounds(geometry: Geometry, model_to_world: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (2, 3) the corners of the axis-aligned box around the mesh in world space."""
    used = geometry.positions[np.unique(geometry.triangles)].astype(np.float64)
    world = used @ model_to_world[:3, :3].T + model_to_world[:3, 3]
    return np.stack([world.min(axis=0), world.max(axis=0)])


def with_atlas(geometry: Geometry, vertices: Indices, triangles: Indices, atlas_uv: Floats) -> Geometry:
    """Return the mesh re-indexed for an atlas: new vertex k is old vertex `vertices[k]`."""
    return replace(
        geometry,
        positions=geometry.positions[vertices],
        normals=geometry.normals[vertices],
        uv=None if geometry.uv is None else geometry.uv[vertices],
        triangles=triangles,
        atlas_uv=atlas_uv,
    )


def _is_sound(positions: Floats, triangles: Indices) -> NDArray[np.bool_]:
    a, b, c = positions.astype(np.float64)[triangles].transpose(1, 0, 2)
    doubled_area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.max([np.sum((p - q) ** 2, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    sound: NDArray[np.bool_] = doubled_area > DEGENERATE * longest
    return sound
