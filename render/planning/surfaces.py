"""What rays meet: places on surfaces, what reflects there, and how much of each lamp reaches them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.render.planning.rays import Hits, Triangles
from phoslab.render.scene import Light, Scene

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# By this share of the scene's size a ray starts off the surface.
LIFT = 1e-5


@dataclass(frozen=True, eq=False)
class Points:
    """Where rays meet surfaces, n of them.

    Args:
        place, normal: (n, 3) in world space; the normal is that of the outside.
        outside: (n,) whether the ray meets the outside.
        drawable: (n,) number from 0.
        uv: (n, 2) texture coordinates.
    """

    place: Array
    normal: Array
    outside: NDArray[np.bool_]
    drawable: Index
    uv: Array

    def __getitem__(self, which: NDArray[np.bool_] | Index) -> Points:
        return Points(*(getattr(self, f)[which] for f in ("place", "normal", "outside", "drawable", "uv")))

    @property
    def towards(self) -> Array:
        """(n, 3) the normals of the side that is met."""
        return np.where(self.outside[:, None], self.normal, -self.normal)

    @classmethod
    def together(cls, parts: Sequence[Points]) -> Points:
        """Join points."""
        fields = ("place", "normal", "outside", "drawable", "uv")
        return cls(*(np.concatenate([getattr(p, f) for p in parts]) for f in fields))


def camera_rays(
    scene: Scene, shape: tuple[int, int], size: tuple[int, int], rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return the eye (3,) and (h w, 3) directions, one anywhere in each pixel of a picture (h, w)."""
    h, w = shape
    y, x = np.meshgrid(np.arange(h), np.arange(w), indexing="ij")
    s = (np.stack([x, y], axis=-1).reshape(-1, 2) + rng.random((h * w, 2))) / [w, h] * 2 - 1
    half = np.tan(scene.camera.yfov_rad / 2)
    view = np.column_stack([s[:, 0] * half * size[0] / size[1], -s[:, 1] * half, -np.ones(h * w)])
    to_world = np.linalg.inv(scene.camera.world_to_view)
    direction = view @ to_world[:3, :3].T
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return np.asarray(to_world[:3, 3], np.float64), np.asarray(direction, np.float64)


def meet(triangles: Triangles, origin: Array, direction: Array) -> tuple[Points, Index]:
    """Return what rays meet, and which of them meet anything."""
    hits: Hits = triangles.first_hits(origin, direction)
    which = np.flatnonzero(hits.found)
    k, u, v = hits.triangle[which], hits.u[which], hits.v[which]
    share = np.stack([1 - u - v, u, v], axis=1)
    normal = np.einsum("ij,ijk->ik", share, triangles.normals[k])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    return (
        Points(
            place=origin[which] + hits.t[which, None] * direction[which],
            normal=normal,
            outside=np.einsum("ij,ij->i", triangles.face[k], direction[which]) < 0,
            drawable=triangles.drawable[k],
            uv=np.einsum("ij,ijk->ik", share, triangles.uv[k]),
        ),
        which,
    )


def reflectance_at(scene: Scene, points: Points) -> Array:
    """Return (n, K)."""
    rho = np.zeros((len(points.place), scene.transport.n))
    for k in np.unique(points.drawable):
        own = points.drawable == k
        rho[own] = looked_up(np.asarray(scene.drawables[k].reflectance), points.uv[own])
    return rho


def looked_up(texels: NDArray[np.floating], uv: Array) -> Array:
    """Return (n, ...) of (h, w, ...) texels at texture coordinates, the nearest; they repeat."""
    h, w = texels.shape[:2]
    row, column = (
        np.floor(x % 1.0 * n).astype(int).clip(0, n - 1) for x, n in ((uv[:, 1], h), (uv[:, 0], w))
    )
    return np.asarray(texels[row, column], dtype=np.float64)


def cosine_directions(normal: Array, rng: np.random.Generator) -> Array:
    """Return a direction for each normal, as often as its cosine says."""
    ball = rng.standard_normal(normal.shape)
    d = normal + ball / np.linalg.norm(ball, axis=1, keepdims=True)
    unit: Array = d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-12)
    return unit


def light_factors(lights: Sequence[Light], triangles: Triangles, points: Points, normal: Array) -> Array:
    """Return (n, n_lights) irradiance over that at 1 m on the axis, with shadows, as `lights.glsl` has it."""
    factors = np.zeros((len(points.place), len(lights)))
    lift = points.place + normal * LIFT * triangles.size_m
    for k, light in enumerate(lights):
        place = light.place
        if place.kind == "directional":
            L = np.broadcast_to(-place.direction_w, points.place.shape)
            until = np.full(len(L), np.inf)
            factor = np.einsum("ij,ij->i", normal, L)
        else:
            d = place.position_w - points.place
            until = np.maximum(np.linalg.norm(d, axis=1), 1e-6)
            L = d / until[:, None]
            factor = np.einsum("ij,ij->i", normal, L) / until**2
            if place.kind == "spot":
                inner, outer = np.cos(place.inner_cone_rad), np.cos(place.outer_cone_rad)
                c = np.clip((-L @ place.direction_w - outer) / max(1e-3, inner - outer), 0.0, 1.0)
                factor = factor * c * c
        lit = factor > 0
        shaded = triangles.blocked(lift[lit], L[lit], until[lit])
        factors[lit, k] = np.where(shaded, 0.0, factor[lit])
    return factors
