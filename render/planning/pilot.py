"""A look at a scene before it is rendered: what lamps, glow and each further reflection bring to a few hundred pixels.

Rays in NumPy, no device: one a pixel of a small picture, a few random walks from what it meets. A walk gathers the glow
of every surface that it comes to, so that what n reflections bring is known apart for every n. All of it is a sample:
`spread` says how far its means may be off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phoslab.colorimetry import xyz_matrix
from phoslab.render.frames import auto_exposure
from phoslab.render.planning.charging import Drive, charged, per_light
from phoslab.render.planning.rays import Triangles
from phoslab.render.planning.surfaces import (
    LIFT,
    Points,
    camera_rays,
    cosine_directions,
    light_factors,
    looked_up,
    meet,
    reflectance_at,
)
from phoslab.render.scene import Phosphor, Scene

Array = NDArray[np.float64]
Index = NDArray[np.int64]

PIXELS, WALKS, REFLECTIONS = 576, 4, 24

# Where few pixels see anything, each sends more walks, so that as many are sent in all; but no more than so many.
MOST_WALKS = 64

# What none of n samples met is, 19 times of 20, rarer than this over n (the rule of three).
UNMET = 3.0

# Rays around each that is sent through a pixel, half a pixel of the picture away.
AROUND = 4

# After so many reflections a walk goes on by chance, and counts for more if it does.
SURE_REFLECTIONS = 3


@dataclass(frozen=True, eq=False)
class Sampled:
    """The states of the points of one drawable that were met.

    Args:
        drive: what charges them.
        kr, ke_width, emission: (n, n_c), (n, n_c, K), (n, n_c, K), as `Optics`.
        r: (T, n, n_c) their concentrations.
        glow: (T, n, 3) their XYZ.
    """

    phosphor: Phosphor
    drive: Drive
    kr: Array
    ke_width: Array
    emission: Array
    r: Array
    glow: Array


@dataclass(frozen=True, eq=False)
class Pilot:
    """What was seen, at T moments in P pixels.

    Args:
        moments: (T,) in s, ascending.
        shape: (h, w) of the small picture.
        lamp: (T, P, K) lamp light, reflected once.
        lamp_twice: (T, P, 3) XYZ of lamp light that is reflected twice, which no plan models.
        glow: (T, P, K) glow that comes straight.
        bounces: (n, T, P, K) glow after 1 to n reflections.
        from_each: (T, P, 3) the XYZ of each drawable's glow, straight and reflected, by the drawable's number.
        brightest: (T, 3) XYZ of the brightest glow that was met.
        whiteness: (P,) mean reflectance of what is seen.
        unevenness: (P,) how much a pixel of the picture sees beside what is in its middle: the share of rays half a
            pixel away that meet another drawable, or nothing, and the mean of |n - n'| of the others.
        walks: how many walks were sent.
        sampled: by the number of the drawable.
        visible: (D,) share of the pixels in which each drawable is seen.
        side_px: (D,) side of the square that each surface would fill on the picture, laid out flat at the distance
            from which it is seen.
    """

    scene: Scene
    moments: Array
    shape: tuple[int, int]
    lamp: Array
    lamp_twice: Array
    glow: Array
    bounces: Array
    from_each: dict[int, Array]
    brightest: Array
    whiteness: Array
    unevenness: Array
    walks: int
    sampled: dict[int, Sampled]
    visible: Array
    side_px: Array

    @cached_property
    def to_xyz(self) -> Array:
        """(K, 3)."""
        return xyz_matrix(self.scene.transport)

    @cached_property
    def pictures(self) -> Array:
        """(T, h, w, 3) XYZ with all reflections."""
        return self.as_picture(self.lamp + self.glow + self.bounces.sum(axis=0))

    @cached_property
    def exposures(self) -> tuple[float, ...]:
        """(T,) what brings the luminance of each moment to display white."""
        found = []
        for t in self.moments:
            exposure = [e for e in self.scene.exposures if e.from_s <= t][-1]
            factor = exposure.factor
            if factor is None:
                first = int(np.argmax(self.moments >= exposure.from_s))
                factor = auto_exposure(self.pictures[first].astype(np.float32))
            found.append(factor)
        return tuple(found)

    @cached_property
    def total(self) -> Array:
        """(T, P) X + Y + Z of the picture."""
        summed: Array = self.pictures.sum(axis=-1).reshape(len(self.moments), -1)
        return summed

    def share(self, light: Array) -> Array:
        """Return (T, P) what (T, P) X + Y + Z is of each pixel's light; 0 where there is none."""
        return np.divide(light, self.total, out=np.zeros_like(light), where=self.total > 0)

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

    @cached_property
    def reflected_unevenness(self) -> float:
        """The mean of the unevenness, weighted by the glow that is reflected, at all moments."""
        reflected = (self.bounces.sum(axis=(0, 1)) @ self.to_xyz).sum(axis=-1)
        return float(reflected @ self.unevenness / max(reflected.sum(), 1e-300))

    def unmet(self, reflections: int) -> Array:
        """Return (T, h, w, 3) XYZ that glow after more reflections may bring though no walk met it: bright and rare."""
        reflected = self.whiteness ** (reflections + 1) * UNMET / max(self.walks, 1)
        return (self.brightest[:, None] * reflected[:, None]).reshape(len(self.moments), *self.shape, 3)


@dataclass(frozen=True, eq=False)
class _Arrivals:
    """Points whose glow reaches a pixel: which, by what share (n, K), and after how many reflections."""

    points: Points
    pixel: Index
    weight: Array
    order: Index


def look(scene: Scene, moments: Sequence[float], size: tuple[int, int], seed: int = 0) -> Pilot:
    """Send rays into the scene; `moments` ascend."""
    rng = np.random.default_rng(seed)
    triangles = Triangles(scene.drawables)
    at = np.asarray(moments, dtype=np.float64)
    shape = _shape(size)
    n_pixels, K, D = shape[0] * shape[1], scene.transport.n, len(scene.drawables)
    eye, direction = camera_rays(scene, shape, size, rng)
    # Under which a pixel of the picture is seen, in rad.
    angle = 2 * float(np.tan(scene.camera.yfov_rad / 2)) / size[1]
    seen, pixel = meet(triangles, np.broadcast_to(eye, direction.shape), direction)
    lamp = np.zeros((len(at), n_pixels, K))
    lamp[:, pixel] = _lamp_light(scene, triangles, seen, at)

    to_xyz = xyz_matrix(scene.transport)
    lamp_twice = np.zeros((len(at), n_pixels, 3))
    lamp_twice[:, pixel] = _lamp_twice(scene, triangles, seen, at, rng) @ to_xyz
    walks = min(max(WALKS, WALKS * PIXELS // max(len(pixel), 1)), MOST_WALKS)
    arrivals = _walk(scene, triangles, seen, pixel, walks, rng)
    whiteness = np.zeros(n_pixels)
    whiteness[pixel] = reflectance_at(scene, seen).mean(axis=1)
    brightest = np.zeros((len(at), 3))
    by_order = np.zeros((REFLECTIONS + 1, len(at), n_pixels, K))
    sampled, from_each = {}, {}
    for k, drawable in enumerate(scene.drawables):
        own = np.flatnonzero(arrivals.points.drawable == k)
        if drawable.phosphor is None or not own.size:
            continue
        sampled[k], L = _glow(scene, drawable.phosphor, triangles, arrivals.points[own], at)
        glow = sampled[k].glow
        most = glow[np.arange(len(at)), glow.sum(axis=-1).argmax(axis=1)]
        brightest = np.where(most.sum(axis=-1) > brightest.sum(axis=-1), most.T, brightest.T).T
        arriving = L * arrivals.weight[own]
        from_each[k] = np.zeros((len(at), n_pixels, 3))
        np.add.at(from_each[k].swapaxes(0, 1), arrivals.pixel[own], (arriving @ to_xyz).swapaxes(0, 1))
        order = arrivals.order[own]
        for n in np.unique(order):
            np.add.at(
                by_order[n].swapaxes(0, 1),
                arrivals.pixel[own][order == n],
                arriving[:, order == n].swapaxes(0, 1),
            )
    return Pilot(
        scene=scene,
        moments=at,
        shape=shape,
        lamp=lamp,
        lamp_twice=lamp_twice,
        glow=by_order[0],
        bounces=by_order[1:],
        from_each=from_each,
        brightest=brightest,
        whiteness=whiteness,
        unevenness=_unevenness(triangles, seen, pixel, eye, direction, angle),
        walks=walks * len(pixel),
        sampled=sampled,
        visible=np.bincount(seen.drawable, minlength=D) / n_pixels,
        side_px=_sides(scene, triangles, seen, pixel, eye, direction, angle),
    )


def _lamp_light(scene: Scene, triangles: Triangles, seen: Points, at: Array) -> Array:
    """Return (T, n, K) what points reflect of the lamps."""
    factors = light_factors(scene.lights, triangles, seen, seen.towards)
    spectra = np.array([light.irradiance_at_1m for light in scene.lights]).reshape(-1, scene.transport.n)
    on = np.array([[scene.schedule.factors(float(t))[x.place.name] for x in scene.lights] for t in at])
    E = np.einsum("tl,nl,lk->tnk", on.reshape(len(at), -1), factors, spectra)
    reflected: Array = reflectance_at(scene, seen) * E / np.pi
    return reflected


def _lamp_twice(
    scene: Scene, triangles: Triangles, seen: Points, at: Array, rng: np.random.Generator
) -> Array:
    """Return (T, n, K) what points reflect of the lamp light that other surfaces reflect, of one ray from each."""
    light = np.zeros((len(at), len(seen.place), scene.transport.n))
    if any(factor > 0 for t in at for factor in scene.schedule.factors(float(t)).values()):
        origin = seen.place + seen.towards * LIFT * triangles.size_m
        there, which = meet(triangles, origin, cosine_directions(seen.towards, rng))
        light[:, which] = _lamp_light(scene, triangles, there, at)
    return light * reflectance_at(scene, seen)


def _walk(
    scene: Scene, triangles: Triangles, seen: Points, pixel: Index, walks: int, rng: np.random.Generator
) -> _Arrivals:
    """Walk on from what the pixels see, and return all that glows on the way; what is seen itself comes first."""
    K = scene.transport.n
    glowing = np.array([d.phosphor is not None for d in scene.drawables])
    first = glowing[seen.drawable]
    parts = [
        _Arrivals(
            seen[first], pixel[first], np.ones((int(first.sum()), K)), np.zeros(int(first.sum()), np.int64)
        )
    ]
    start = np.repeat(np.arange(len(pixel)), walks)
    here, mine, weight = seen[start], pixel[start], reflectance_at(scene, seen)[start] / walks
    for order in range(1, REFLECTIONS + 1):
        if not glowing.any() or not len(mine):
            break
        origin = here.place + here.towards * LIFT * triangles.size_m
        here, which = meet(triangles, origin, cosine_directions(here.towards, rng))
        mine, weight = mine[which], weight[which]
        sends = here.outside & glowing[here.drawable]
        parts.append(_Arrivals(here[sends], mine[sends], weight[sends], np.full(int(sends.sum()), order)))
        rho = reflectance_at(scene, here)
        chance = np.ones(len(rho)) if order < SURE_REFLECTIONS else rho.max(axis=1, initial=0.0)
        goes_on = rng.random(len(rho)) < chance
        here, mine = here[goes_on], mine[goes_on]
        weight = weight[goes_on] * rho[goes_on] / chance[goes_on, None]
    return _Arrivals(
        Points.together([p.points for p in parts]),
        *(np.concatenate([getattr(p, f) for p in parts]) for f in ("pixel", "weight", "order")),
    )


def _glow(
    scene: Scene, phosphor: Phosphor, triangles: Triangles, points: Points, at: Array
) -> tuple[Sampled, Array]:
    """Return the states of points of one phosphor, and (T, n, K) what they give; they take light on their outside."""
    names = tuple(light.place.name for light in scene.lights)
    drive = Drive(light_factors(scene.lights, triangles, points, points.normal), names)
    optics = phosphor.optics
    kr, ke, emission = (looked_up(f, points.uv) for f in (optics.kr_per_s, optics.ke_width, optics.emission))
    r = charged(scene.schedule, phosphor.initial, drive, kr, per_light(ke, scene), at)
    L: Array = np.einsum("tnc,nc,nck->tnk", r, kr, emission)
    return Sampled(phosphor, drive, kr, ke, emission, r, L @ xyz_matrix(scene.transport)), L


def _unevenness(
    triangles: Triangles, seen: Points, pixel: Index, eye: Array, direction: Array, angle: float
) -> Array:
    """Return (P,) how much what a pixel sees differs within it; 0 where its middle sees nothing."""
    # Numbers of its own, so that walks are the same whether this is asked for or not.
    rng = np.random.default_rng(0)
    found = np.zeros(len(direction))
    for _ in range(AROUND):
        aside = rng.normal(size=(len(pixel), 3))
        aside -= np.einsum("ij,ij->i", aside, direction[pixel])[:, None] * direction[pixel]
        aside /= np.linalg.norm(aside, axis=1, keepdims=True)
        towards = direction[pixel] + angle / 2 * aside
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        beside, which = meet(triangles, np.broadcast_to(eye, towards.shape), towards)
        differs = np.ones(len(pixel))
        turned = np.linalg.norm(beside.towards - seen.towards[which], axis=1)
        differs[which] = np.where(beside.drawable == seen.drawable[which], turned, 1.0)
        found[pixel] += differs / AROUND
    return found


def _sides(
    scene: Scene,
    triangles: Triangles,
    seen: Points,
    pixel: Index,
    eye: Array,
    direction: Array,
    angle: float,
) -> Array:
    """Return (D,) the root of each surface's area over that which a pixel sees of it; 0 where it is not seen."""
    D = len(scene.drawables)
    area = np.bincount(triangles.drawable, triangles.area, minlength=D)
    distance = np.linalg.norm(seen.place - eye, axis=1)
    cosine = np.abs(np.einsum("ij,ij->i", seen.towards, direction[pixel]))
    # The finest that is seen counts: a pixel there sees the least.
    side = np.zeros(D)
    for k in np.unique(seen.drawable):
        own = seen.drawable == k
        footprint = np.quantile((distance[own] * angle) ** 2 / np.maximum(cosine[own], 0.1), 0.25)
        side[k] = np.sqrt(area[k] / footprint)
    return side


def _shape(size: tuple[int, int]) -> tuple[int, int]:
    scale = min(1.0, float(np.sqrt(PIXELS / (size[0] * size[1]))))
    return max(1, round(size[1] * scale)), max(1, round(size[0] * scale))
