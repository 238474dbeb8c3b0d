"""Triangle meshes for the sample scenes: surfaces, solids of revolution, boxes, and a texture of boards."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TAU = 2 * np.pi


@dataclass(frozen=True, eq=False)
class Shape:
    """A triangle mesh: positions (n, 3), normals (n, 3), triangles (m, 3), and uv (n, 2) where it has any."""

    positions: Array
    normals: Array
    triangles: NDArray[np.uint32]
    uv: Array | None = None


def surface(f: Callable[[Array, Array], Array], n_u: int, n_v: int) -> Shape:
    """Return the surface f(u, v) -> (..., 3) over the unit square; its uv are one-to-one."""
    u, v = np.meshgrid(np.linspace(0, 1, n_u + 1), np.linspace(0, 1, n_v + 1))
    positions = f(u, v)
    h = 1e-4
    du = f(u + h, v) - f(u - h, v)
    dv = f(u, np.clip(v + h, 0, 1)) - f(u, np.clip(v - h, 0, 1))
    normals = np.cross(du, dv)
    # At a pole du vanishes: take the normal from just inside.
    inner = np.clip(v, 2e-3, 1 - 2e-3)
    pole = np.cross(f(u + h, inner) - f(u - h, inner), f(u, inner + h) - f(u, inner - h))
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.where(length < 1e-10, pole, normals)
    corner = (np.arange(n_v)[:, None] * (n_u + 1) + np.arange(n_u)).ravel()
    right, up = corner + 1, corner + n_u + 1
    triangles = np.concatenate([np.stack([corner, right, up], 1), np.stack([right, up + 1, up], 1)])
    return Shape(
        positions.reshape(-1, 3),
        unit(normals.reshape(-1, 3)),
        triangles.astype(np.uint32),
        np.stack([u, v], axis=-1).reshape(-1, 2),
    )


def lathe(profile: Sequence[tuple[float, float]], *, crisp: bool = False) -> Shape:
    """Turn a curve through the (radius, height) points of `profile`, from the bottom up, around y.

    Args:
        crisp: keep corners (monotone between points) instead of flowing through them.
    """
    from scipy.interpolate import CubicSpline, PchipInterpolator

    points = np.array(profile, dtype=np.float64)
    at = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    curve = (PchipInterpolator if crisp else CubicSpline)(at / at[-1], points)

    def turned(u: Array, v: Array) -> Array:
        radius, height = np.moveaxis(np.maximum(curve(v), 0.0), -1, 0)
        return np.stack([radius * np.cos(TAU * u), height, -radius * np.sin(TAU * u)], axis=-1)

    return surface(turned, 64, 80)


def sphere(radius: float) -> Shape:
    """Return a sphere that stands on y = 0."""

    def ball(u: Array, v: Array) -> Array:
        polar, around = np.pi * (1 - v), TAU * u
        return radius * np.stack(
            [np.sin(polar) * np.cos(around), 1 + np.cos(polar), -np.sin(polar) * np.sin(around)], axis=-1
        )

    return surface(ball, 72, 36)


def tube(centre: Callable[[Array], Array], radius: float, n_u: int, n_v: int = 32) -> Shape:
    """Return a closed tube around the closed curve centre(u) -> (..., 3), u in [0, 1]."""

    def around(u: Array, v: Array) -> Array:
        h = 1e-3
        tangent = unit(centre(u + h) - centre(u - h))
        bend = centre(u + h) - 2 * centre(u) + centre(u - h)
        inward = unit(bend - tangent * np.sum(bend * tangent, axis=-1, keepdims=True))
        beside = np.cross(tangent, inward)
        turn = TAU * v[..., None]
        return centre(u) + radius * (np.cos(turn) * inward + np.sin(turn) * beside)

    shape = surface(around, n_u, n_v)
    return outside_out(replace(shape, normals=_normals_of(around, n_u, n_v)))


def _normals_of(f: Callable[[Array, Array], Array], n_u: int, n_v: int) -> Array:
    """Return normals of f, which closes in v: at v = 0 and 1 the clipped difference above would tilt them."""
    u, v = np.meshgrid(np.linspace(0, 1, n_u + 1), np.linspace(0, 1, n_v + 1))
    h = 1e-4
    return unit(np.cross(f(u + h, v) - f(u - h, v), f(u, v + h) - f(u, v - h))).reshape(-1, 3)


def torus(ring: float, radius: float) -> Shape:
    """Return a torus around y that lies on y = 0."""

    def circle(u: Array) -> Array:
        return np.stack([ring * np.cos(TAU * u), np.full_like(u, radius), -ring * np.sin(TAU * u)], axis=-1)

    return tube(circle, radius, 80, 28)


def knot(size: float, radius: float) -> Shape:
    """Return a trefoil knot that stands on y = 0."""

    def trefoil(u: Array) -> Array:
        t = TAU * u
        x, y = np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t)
        return size / 3 * np.stack([x, y + 3.0 + 0.0 * t, -np.sin(3 * t)], axis=-1)

    shape = tube(trefoil, radius, 200, 20)
    return moved(shape, (0, -float(shape.positions[:, 1].min()), 0))


def bevelled_cube(size: float, bevel: float) -> Shape:
    """Return a cube with rounded edges that stands on y = 0: a sphere's points pushed out along a box. No uv."""
    n = 10
    flat = np.linspace(-1, 1, 2)
    half = size / 2 - bevel
    turn = np.tan(np.linspace(-np.pi / 4, np.pi / 4, n + 1))
    # Each face: rounded rim, flat middle, rounded rim.
    grid = np.concatenate([turn[: n // 2 + 1], turn[n // 2 :]])
    push = np.concatenate([np.full(n // 2 + 1, flat[0]), np.full(n // 2 + 1, flat[1])])
    a, b = np.meshgrid(grid, grid)
    pa, pb = np.meshgrid(push, push)
    positions: list[Array] = []
    normals: list[Array] = []
    triangles: list[NDArray[Any]] = []
    base = 0
    for axis in range(3):
        for sign in (1.0, -1.0):
            direction = np.zeros((*a.shape, 3))
            core = np.zeros((*a.shape, 3))
            i, j = (axis + 1) % 3, (axis + 2) % 3
            direction[..., axis], direction[..., i], direction[..., j] = sign, sign * a, b
            core[..., axis], core[..., i], core[..., j] = sign, sign * pa, pb
            normal = unit(direction)
            positions.append((half * core + bevel * normal).reshape(-1, 3))
            normals.append(normal.reshape(-1, 3))
            k = len(grid)
            corner = (np.arange(k - 1)[:, None] * k + np.arange(k - 1)).ravel() + base
            triangles += [
                np.stack([corner, corner + 1, corner + k], 1),
                np.stack([corner + 1, corner + k + 1, corner + k], 1),
            ]
            base += k * k
    shape = Shape(np.concatenate(positions), np.concatenate(normals), np.concatenate(triangles).astype("u4"))
    return moved(shape, (0, size / 2, 0))


def pillow(rim: Array, spine: Array, thickness: float, rings: int = 10) -> Shape:
    """Return a cushion-like solid around the z = 0 plane; both sides meet in a sharp rim. No uv.

    Args:
        rim: (n, 2) a closed outline, counter-clockwise.
        spine: (n, 2) the point of the middle line towards which each point of the rim runs.
    """
    n = len(rim)
    t = np.linspace(0, 1, rings + 1)
    positions: list[Array] = []
    triangles: list[NDArray[Any]] = []
    for side in (1.0, -1.0):
        base = len(positions) * n
        for s in t:
            xy = rim + (spine - rim) * s
            z = side * thickness * np.sqrt(1 - (1 - s) ** 2)
            positions.append(np.column_stack([xy, np.full(n, z)]))
        for ring in range(rings):
            here = base + ring * n + np.arange(n)
            there = base + ring * n + (np.arange(n) + 1) % n
            quad = [np.stack([here, there, here + n], 1), np.stack([there, there + n, here + n], 1)]
            triangles += [q if side > 0 else q[:, ::-1] for q in quad]
    points = np.concatenate(positions)
    faces = np.concatenate(triangles)
    return outside_out(Shape(points, _smooth(points, faces), faces.astype(np.uint32)))


def star(points: int, outer: float, inner: float, thickness: float) -> Shape:
    """Return a star with folded arms, centred at the origin, facing z. No uv, flat faces."""
    angle = np.pi / 2 + TAU * np.arange(2 * points) / (2 * points)
    radius = np.where(np.arange(2 * points) % 2 == 0, outer, inner)
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros_like(angle)], axis=1)
    soup = []
    for k in range(2 * points):
        a, b = rim[k], rim[(k + 1) % (2 * points)]
        soup += [[a, b, [0, 0, thickness]], [b, a, [0, 0, -thickness]]]
    positions = np.array(soup).reshape(-1, 3)
    a, b, c = np.array(soup).transpose(1, 0, 2)
    normals = np.repeat(unit(np.cross(b - a, c - a)), 3, axis=0)
    return Shape(positions, normals, np.arange(len(positions), dtype=np.uint32).reshape(-1, 3))


def moon(radius: float, thickness: float) -> Shape:
    """Return a crescent, centred at the origin, facing z. No uv."""
    n = 96
    half = np.deg2rad(128)
    outer_angle = np.linspace(-half, half, n)
    tip = radius * np.array([np.cos(half), np.sin(half)])
    centre, inner_radius = 0.5 * radius, np.hypot(tip[0] - 0.5 * radius, tip[1])
    inner_half = np.arctan2(tip[1], tip[0] - centre)
    inner_angle = np.linspace(inner_half, -inner_half, n)
    outer = radius * np.column_stack([np.cos(outer_angle), np.sin(outer_angle)])
    inner = np.column_stack([centre + inner_radius * np.cos(inner_angle), inner_radius * np.sin(inner_angle)])
    # Both arcs run through x > 0; the crescent lies to the left once mirrored.
    rim = np.concatenate([outer, inner[1:-1]])
    middle = (outer + inner[::-1]) / 2
    spine = np.concatenate([middle, middle[::-1][1:-1]])
    return pillow(rim, spine, thickness)


def box(low: Sequence[float], high: Sequence[float]) -> Shape:
    """Return an axis-aligned box with flat faces. No uv."""
    soup = []
    for axis in range(3):
        for sign, level in ((1, high[axis]), (-1, low[axis])):
            i, j = (axis + 1) % 3, (axis + 2) % 3
            corners = np.zeros((4, 3))
            corners[:, axis] = level
            corners[:, i] = [low[i], high[i], high[i], low[i]]
            corners[:, j] = [low[j], low[j], high[j], high[j]]
            soup.append((corners if sign > 0 else corners[::-1], np.eye(3)[axis] * sign))
    positions = np.concatenate([c for c, _ in soup])
    normals = np.concatenate([np.repeat(n[None], 4, axis=0) for _, n in soup])
    quad = np.array([[0, 1, 2], [0, 2, 3]])
    triangles = np.concatenate([quad + 4 * k for k in range(6)])
    return Shape(positions, normals, triangles.astype(np.uint32))


def sweep(width: float, depth: float, height: float, bend: float) -> Shape:
    """Return a studio sweep: a floor that bends up into a wall; u across, v in metres along."""
    straight = depth - bend
    arc = bend * np.pi / 2
    total = straight + arc + height - bend

    def bent(u: Array, v: Array) -> Array:
        s = v * total
        angle = np.clip((s - straight) / bend, 0, np.pi / 2)
        z = -np.minimum(s, straight) - bend * np.sin(angle)
        y = bend * (1 - np.cos(angle)) + np.clip(s - straight - arc, 0, None)
        return np.stack([(u - 0.5) * width, y, z], axis=-1)

    shape = surface(bent, 2, 96)
    assert shape.uv is not None
    return replace(shape, uv=shape.uv * [width / 1.6, total / 1.6])


def planks(texels: int, seed: int) -> NDArray[np.uint8]:
    """Return (texels, texels, 3) sRGB of pale floor boards that tile without a seam."""
    rng = np.random.default_rng(seed)
    boards, y = 4, np.arange(texels)
    image = np.empty((texels, texels, 3))
    for k in range(boards):
        columns = slice(k * texels // boards, (k + 1) * texels // boards)
        width = columns.stop - columns.start
        tone = np.array([0.80, 0.74, 0.67]) * (1 + 0.07 * rng.standard_normal())
        x = np.arange(width)
        grain = np.zeros((texels, width))
        for _ in range(14):
            fx, fy, phase = rng.integers(3, 40), rng.integers(0, 3), rng.uniform(0, TAU)
            warp = 0.8 * np.sin(TAU * y / texels * rng.integers(1, 3) + rng.uniform(0, TAU))[:, None]
            grain += np.sin(TAU * (fx * x / width + fy * y[:, None] / texels) + phase + warp) / 14
        gap = np.minimum(x, width - 1 - x)[None, :] < 1.5
        image[:, columns] = tone * (1 + 0.09 * grain[..., None]) * np.where(gap, 0.62, 1.0)[..., None]
    return np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)


def unit(v: Array) -> Array:
    """Return the vectors along the last axis at length 1."""
    of_length_1: Array = v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-30)
    return of_length_1


def outside_out(shape: Shape) -> Shape:
    """Return the closed shape with its faces and normals outwards, whichever way it was made."""
    a, b, c = shape.positions[shape.triangles].transpose(1, 0, 2)
    if np.sum(a * np.cross(b, c)) < 0:
        shape = replace(shape, triangles=shape.triangles[:, ::-1])
    a, b, c = shape.positions[shape.triangles].transpose(1, 0, 2)
    agree = np.sum(np.cross(b - a, c - a) * shape.normals[shape.triangles[:, 0]])
    return replace(shape, normals=shape.normals * np.sign(agree))


def moved(shape: Shape, by: Sequence[float]) -> Shape:
    """Return the shape, moved."""
    return replace(shape, positions=shape.positions + np.array(by))


def _smooth(points: Array, faces: NDArray[Any]) -> Array:
    """Return (n, 3) normals, averaged over the faces at a point."""
    a, b, c = points[faces].transpose(1, 0, 2)
    weighted = np.cross(b - a, c - a)
    normals = np.zeros_like(points)
    for k in range(3):
        np.add.at(normals, faces[:, k], weighted)
    return unit(normals)


def panel(corner: Sequence[float], along_u: Sequence[float], along_v: Sequence[float]) -> Shape:
    """Return a flat parallelogram; it faces where u x v points, and its uv are one-to-one."""
    p, u, v = (np.array(x, dtype=np.float64) for x in (corner, along_u, along_v))
    return Shape(
        np.array([p, p + u, p + u + v, p + v]),
        np.repeat(unit(np.cross(u, v))[None], 4, axis=0),
        np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32),
        np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]),
    )


def scraps(n: int, size: float, low: Sequence[float], high: Sequence[float], seed: int) -> Shape:
    """Return `n` equilateral triangles of side `size`, anywhere in a box and turned any way. No uv."""
    rng = np.random.default_rng(seed)
    centre = rng.uniform(low, high, (n, 1, 3))
    normal = unit(rng.standard_normal((n, 3)))
    across = unit(np.cross(normal, unit(rng.standard_normal((n, 3)))))
    beside = np.cross(normal, across)
    angle = TAU * np.arange(3) / 3
    around = across[:, None] * np.cos(angle)[:, None] + beside[:, None] * np.sin(angle)[:, None]
    return Shape(
        (centre + size / np.sqrt(3) * around).reshape(-1, 3),
        np.repeat(normal, 3, axis=0),
        np.arange(3 * n, dtype=np.uint32).reshape(-1, 3),
    )
