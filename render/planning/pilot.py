"""A look at a scene before it is rendered: what lamps, glow and each further reflection bring to a few hundred pixels.

Rays in NumPy, no device: one a pixel of a small picture, a few random walks from what it meets. A walk gathers the glow
of every surface that it comes to, so that what n reflections bring is known apart for every n. All of it is a sample:
`spread` says how far its means may be off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.colorimetry import xyz_matrix
from phoslab.render.planning.charging import Drive, charged
from phoslab.render.planning.rays import Hits, Triangles
from phoslab.render.scene import Light, Phosphor, Scene

Array = NDArray[np.float64]
Index = NDArray[np.int64]

PIXELS, WALKS, REFLECTIONS = 576, 4, 8
FEWEST = 1e-9


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


@dataclass(frozen=True, eq=False)
class Sampled:
    """The states of the points of one drawable that were met.

    Args:
        drive: what charges them.
        kr, ke_width, emission: (n, n_c), (n, n_c, K), (n, n_c, K), as `Optics`.
        glow: (T, n, 3) their XYZ.
    """

    phosphor: Phosphor
    drive: Drive
    kr: Array
    ke_width: Array
    emission: Array
    glow: Array


@dataclass(frozen=True, eq=False)
class Pilot:
    """What was seen, at T moments in P pixels.

    Args:
        moments: (T,) in s, ascending.
        shape: (h, w) of the small picture.
        lamp: (T, P, K) lamp light, reflected once.
        glow: (T, P, K) glow that comes straight.
        bounces: (n, T, P, K) glow after 1 to n reflections.
        by_source: (n + 1, T, D) mean X + Y + Z that each drawable's glow brings, straight and by n reflections.
        sampled: by the number of the drawable.
        visible: (D,) share of the pixels in which each drawable is seen.
        side_px: (D,) side of the square that each surface would fill on the picture, laid out flat at the distance
            from which it is seen.
    """

    scene: Scene
    moments: Array
    shape: tuple[int, int]
    lamp: Array
    glow: Array
    bounces: Array
    by_source: Array
    sampled: dict[int, Sampled]
    visible: Array
    side_px: Array

    @property
    def to_xyz(self) -> Array:
        """(K, 3)."""
        return xyz_matrix(self.scene.transport)

    @property
    def pictures(self) -> Array:
        """(T, h, w, 3) XYZ with all reflections."""
        return self.as_picture(self.lamp + self.glow + self.bounces.sum(axis=0))

    def as_picture(self, radiance: Array) -> Array:
        """Return (T, h, w, 3) XYZ of (T, P, K)."""
        return (radiance @ self.to_xyz).reshape(len(self.moments), *self.shape, 3)

    def means(self) -> tuple[Array, Array, Array]:
        """Return (T,), (T,), (n, T): the mean over pixels of X + Y + Z, of lamp, straight glow, each reflection."""
        lamp, glow, bounces = (
            (part @ self.to_xyz).sum(axis=-1).mean(axis=-1) for part in (self.lamp, self.glow, self.bounces)
        )
        return lamp, glow, bounces

    def spread(self) -> Array:
        """Return (T,) the standard error of the mean of all reflected glow: pixels are independent samples of it."""
        reflected = (self.bounces.sum(axis=0) @ self.to_xyz).sum(axis=-1)
        error: Array = reflected.std(axis=-1) / np.sqrt(reflected.shape[-1])
        return error


def look(scene: Scene, moments: Sequence[float], size: tuple[int, int], seed: int = 0) -> Pilot:
    """Send rays into the scene; `moments` ascend."""
    rng = np.random.default_rng(seed)
    triangles = Triangles(scene.drawables)
    at = np.asarray(moments, dtype=np.float64)
    shape = _shape(size)
    n_pixels = shape[0] * shape[1]
    eye, direction = _camera_rays(scene, shape, size, rng)
    seen, pixel = _meet(triangles, np.broadcast_to(eye, direction.shape), direction)
    K, D = scene.transport.n, len(scene.drawables)
    visible = np.bincount(seen.drawable, minlength=D) / n_pixels

    factors = light_factors(scene.lights, triangles, seen, seen.towards)
    reflectance = _reflectance(scene, seen)
    lamp = np.zeros((len(at), n_pixels, K))
    names = [light.place.name for light in scene.lights]
    for k, t in enumerate(at):
        on = scene.schedule.factors(float(t))
        E = sum(
            (on[name] * factors[:, i, None] * scene.lights[i].irradiance_at_1m for i, name in enumerate(names)),
            start=np.zeros((len(pixel), K)),
        )
        lamp[k, pixel] = reflectance * E / np.pi

    # Every point whose glow reaches a pixel: straight ones first, then those of the walks.
    points, pixels, weights, orders = [seen], [pixel], [np.ones((len(pixel), K))], [np.zeros(len(pixel), int)]
    glowing = np.array([d.phosphor is not None for d in scene.drawables])
    here, mine, weight = (np.repeat(x, WALKS, axis=0) for x in (np.arange(len(pixel)), pixel, reflectance))
    here_points, weight = seen[here], weight / WALKS
    for order in range(1, REFLECTIONS + 1):
        if not glowing.any() or not len(mine):
            break
        outgoing = _cosine(here_points.towards, rng)
        start = here_points.place + here_points.towards * 1e-5 * triangles.size_m
        met, which = _meet(triangles, start, outgoing)
        mine, weight = mine[which], weight[which]
        sends = met.outside & glowing[met.drawable]
        points.append(met[sends])
        pixels.append(mine[sends])
        weights.append(weight[sends])
        orders.append(np.full(int(sends.sum()), order))
        weight = weight * _reflectance(scene, met)
        alive = weight.max(axis=1, initial=0.0) > FEWEST
        here_points, mine, weight = met[alive], mine[alive], weight[alive]

    all_points = Points(
        *(
            np.concatenate([getattr(p, f) for p in points])
            for f in ("place", "normal", "outside", "drawable", "uv")
        )
    )
    all_pixels, all_weights, all_orders = map(np.concatenate, (pixels, weights, orders))
    by_order = np.zeros((REFLECTIONS + 1, len(at), n_pixels, K))
    by_source = np.zeros((REFLECTIONS + 1, len(at), D))
    sampled = {}
    to_xyz = xyz_matrix(scene.transport)
    for k in np.flatnonzero(glowing):
        own = np.flatnonzero(all_points.drawable == k)
        phosphor = scene.drawables[k].phosphor
        assert phosphor is not None
        if not own.size:
            continue
        # A phosphor takes the light that falls on its outside.
        at_point = all_points[own]
        drive = Drive(light_factors(scene.lights, triangles, at_point, at_point.normal), tuple(names))
        optics = phosphor.optics
        kr, ke, emission = (
            _looked_up(field, at_point.uv) for field in (optics.kr_per_s, optics.ke_width, optics.emission)
        )
        r = charged(scene.schedule, phosphor.initial, drive, kr, per_light(ke, scene), at)
        L = np.einsum("tnc,nc,nck->tnk", r, kr, emission)
        sampled[int(k)] = Sampled(phosphor, drive, kr, ke, emission, L @ to_xyz)
        arriving = L * all_weights[own]
        np.add.at(by_order.swapaxes(0, 1), (slice(None), all_orders[own], all_pixels[own]), arriving)
        brought = (arriving @ to_xyz).sum(axis=-1) / n_pixels
        for order in range(REFLECTIONS + 1):
            by_source[order, :, k] = brought[:, all_orders[own] == order].sum(axis=1)
    side_px = _sides(scene, triangles, seen, pixel, eye, direction, size)
    return Pilot(scene, at, shape, lamp, by_order[0], by_order[1:], by_source, sampled, visible, side_px)


def light_factors(lights: Sequence[Light], triangles: Triangles, points: Points, normal: Array) -> Array:
    """Return (n, n_lights) irradiance at points over that at 1 m on the axis, with shadows (shaders/include/lights.glsl)."""
    factors = np.zeros((len(points.place), len(lights)))
    lift = points.place + normal * 1e-5 * triangles.size_m
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


def _sides(
    scene: Scene,
    triangles: Triangles,
    seen: Points,
    pixel: Index,
    eye: Array,
    direction: Array,
    size: tuple[int, int],
) -> Array:
    """Return (D,) the root of each surface's area over that which a pixel sees of it; 0 where it is not seen."""
    D = len(scene.drawables)
    area = np.bincount(triangles.drawable, triangles.area, minlength=D)
    angle = 2 * np.tan(scene.camera.yfov_rad / 2) / size[1]
    distance = np.linalg.norm(seen.place - eye, axis=1)
    cosine = np.abs(np.einsum("ij,ij->i", seen.towards, direction[pixel]))
    # The finest that is seen counts: a pixel there sees the least.
    side = np.zeros(D)
    for k in np.unique(seen.drawable):
        own = seen.drawable == k
        footprint = np.quantile((distance[own] * angle) ** 2 / np.maximum(cosine[own], 0.1), 0.25)
        side[k] = np.sqrt(area[k] / footprint)
    return side


def per_light(ke_width: Array, scene: Scene) -> Array:
    """Return (n, n_lights, n_c) the excitation in 1/s that each light gives at factor 1."""
    spectra = np.array([light.irradiance_at_1m for light in scene.lights]).reshape(-1, scene.transport.n)
    excitation: Array = np.einsum("nck,lk->nlc", ke_width, spectra)
    return excitation


def _shape(size: tuple[int, int]) -> tuple[int, int]:
    scale = min(1.0, float(np.sqrt(PIXELS / (size[0] * size[1]))))
    return max(1, round(size[1] * scale)), max(1, round(size[0] * scale))


def _camera_rays(
    scene: Scene, shape: tuple[int, int], size: tuple[int, int], rng: np.random.Generator
) -> tuple[Array, Array]:
    h, w = shape
    y, x = np.meshgrid(np.arange(h), np.arange(w), indexing="ij")
    s = (np.stack([x, y], axis=-1).reshape(-1, 2) + rng.random((h * w, 2))) / [w, h] * 2 - 1
    half = np.tan(scene.camera.yfov_rad / 2)
    view = np.column_stack([s[:, 0] * half * size[0] / size[1], -s[:, 1] * half, -np.ones(h * w)])
    to_world = np.linalg.inv(scene.camera.world_to_view)
    direction = view @ to_world[:3, :3].T
    return to_world[:3, 3], direction / np.linalg.norm(direction, axis=1, keepdims=True)


def _meet(triangles: Triangles, origin: Array, direction: Array) -> tuple[Points, Index]:
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


def _reflectance(scene: Scene, points: Points) -> Array:
    """Return (n, K)."""
    rho = np.zeros((len(points.place), scene.transport.n))
    for k in np.unique(points.drawable):
        own = points.drawable == k
        rho[own] = _looked_up(np.asarray(scene.drawables[k].reflectance), points.uv[own])
    return rho


def _looked_up(texels: NDArray[np.floating], uv: Array) -> Array:
    """Return (n, ...) of (h, w, ...) texels at texture coordinates, the nearest; they repeat."""
    h, w = texels.shape[:2]
    row, column = (np.floor(x % 1.0 * n).astype(int).clip(0, n - 1) for x, n in ((uv[:, 1], h), (uv[:, 0], w)))
    return np.asarray(texels[row, column], dtype=np.float64)


def _cosine(normal: Array, rng: np.random.Generator) -> Array:
    """Return a direction for each normal, as often as its cosine says."""
    ball = rng.standard_normal(normal.shape)
    d = normal + ball / np.linalg.norm(ball, axis=1, keepdims=True)
    return d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-12)
