"""Where rays meet a scene's triangles, in NumPy: a few ten thousand rays without a device.

The triangles are sorted along a Morton curve, eight to a leaf; boxes of pairs make the tree, one array a level. Rays
walk down it all at once, a level at a time, as pairs of a ray and a box.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.render.scene import Drawable

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LEAF = 8

# Pairs of a ray and a leaf that are looked at together: memory for no more than this.
_AT_ONCE = 1 << 17


@dataclass(frozen=True, eq=False)
class Hits:
    """What rays meet first, (n,) each: the distance (inf: nothing), the triangle, and its two inner coordinates."""

    t: Array
    triangle: Index
    u: Array
    v: Array

    @property
    def found(self) -> NDArray[np.bool_]:
        """(n,) whether there is anything."""
        return np.isfinite(self.t)


class Triangles:
    """All triangles of a scene in world space.

    Attributes:
        drawable: (m,) the number of each triangle's drawable, from 0.
        corners: (m, 3, 3) in m.
        normals: (m, 3, 3) of the vertices, of length 1.
        uv: (m, 3, 2); 0 where there are none.
        face: (m, 3) unit normals, counter-clockwise seen from outside.
    """

    def __init__(self, drawables: Sequence[Drawable]) -> None:
        parts = [_in_world(d) for d in drawables]
        number = np.concatenate([np.full(len(p[0]), k) for k, p in enumerate(parts)])
        corners, normals, uv = (np.concatenate([p[k] for p in parts]) for k in range(3))
        order = _morton_order(corners.mean(axis=1))
        self.drawable, self.corners, self.normals, self.uv = (
            x[order] for x in (number, corners, normals, uv)
        )
        self._a = self.corners[:, 0]
        self._e1, self._e2 = self.corners[:, 1] - self._a, self.corners[:, 2] - self._a
        cross = np.cross(self._e1, self._e2)
        self.face = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)
        self.area = np.linalg.norm(cross, axis=1) / 2
        self._levels = _boxes(self.corners)
        self.size_m = float(np.linalg.norm(np.ptp(self.corners.reshape(-1, 3), axis=0)))

    def first_hits(self, origin: Array, direction: Array) -> Hits:
        """Return what (n, 3) rays meet first, from (n, 3) origins; both sides of a triangle block."""
        n = len(origin)
        t = np.full(n, np.inf)
        triangle, u, v = np.zeros(n, dtype=np.int64), np.zeros(n), np.zeros(n)
        for low in range(0, n, 4096):
            part = slice(low, min(low + 4096, n))
            t[part], triangle[part], u[part], v[part] = self._first(origin[part], direction[part])
        return Hits(t, triangle, u, v)

    def blocked(self, origin: Array, direction: Array, until: Array) -> NDArray[np.bool_]:
        """Return (n,) whether anything lies on a ray before the distance (n,) `until`."""
        return self.first_hits(origin, direction).t < until

    def _first(self, origin: Array, direction: Array) -> tuple[Array, Index, Array, Array]:
        inverse = 1 / np.where(np.abs(direction) < 1e-12, 1e-12, direction)
        ray = np.arange(len(origin))
        box = np.zeros(len(origin), dtype=np.int64)
        for boxes in self._levels:
            low = (boxes[box, 0] - origin[ray]) * inverse[ray]
            high = (boxes[box, 1] - origin[ray]) * inverse[ray]
            enter, leave = np.minimum(low, high).max(axis=1), np.maximum(low, high).min(axis=1)
            met = (leave >= np.maximum(enter, 0.0)) & np.isfinite(enter)
            ray, box = ray[met], box[met]
            if boxes is not self._levels[-1]:
                ray, box = np.repeat(ray, 2), np.stack([2 * box, 2 * box + 1], axis=1).ravel()
        best = (np.full(len(origin), np.inf), np.zeros(len(origin), np.int64), *np.zeros((2, len(origin))))
        for at in range(0, len(ray), _AT_ONCE):
            self._leaves(origin, direction, ray[at : at + _AT_ONCE], box[at : at + _AT_ONCE], best)
        return best

    def _leaves(
        self,
        origin: Array,
        direction: Array,
        ray: Index,
        leaf: Index,
        best: tuple[Array, Index, Array, Array],
    ) -> None:
        """Lower `best` to the nearest hit in these leaves (Möller and Trumbore 1997)."""
        k = (leaf[:, None] * LEAF + np.arange(LEAF)).ravel()
        ray = np.repeat(ray, LEAF)
        inside = k < len(self._a)
        k, ray = k[inside], ray[inside]
        d, e1, e2 = direction[ray], self._e1[k], self._e2[k]
        p = np.cross(d, e2)
        det = np.einsum("ij,ij->i", e1, p)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = origin[ray] - self._a[k]
            u = np.einsum("ij,ij->i", s, p) / det
            q = np.cross(s, e1)
            v = np.einsum("ij,ij->i", d, q) / det
            t = np.einsum("ij,ij->i", e2, q) / det
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        ray, k, t, u, v = (x[hit] for x in (ray, k, t, u, v))
        nearest = np.lexsort((t, ray))
        ray, k, t, u, v = (x[nearest] for x in (ray, k, t, u, v))
        first = np.ones(len(ray), dtype=bool)
        first[1:] = ray[1:] != ray[:-1]
        ray, k, t, u, v = (x[first] for x in (ray, k, t, u, v))
        nearer = t < best[0][ray]
        for into, value in zip(best, (t, k, u, v), strict=True):
            into[ray[nearer]] = value[nearer]


def _in_world(drawable: Drawable) -> tuple[Array, Array, Array]:
    g, m = drawable.geometry, drawable.model_to_world
    positions = g.positions.astype(np.float64) @ m[:3, :3].T + m[:3, 3]
    normals = g.normals.astype(np.float64) @ np.linalg.inv(m[:3, :3])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    uv = np.zeros((len(positions), 2)) if g.uv is None else g.uv.astype(np.float64)
    triangles = g.triangles if np.linalg.det(m[:3, :3]) > 0 else g.triangles[:, ::-1]
    return positions[triangles], normals[triangles], uv[triangles]


def _morton_order(points: Array) -> Index:
    low, extent = points.min(axis=0), max(float(np.ptp(points, axis=0).max()), 1e-30)
    cells = ((points - low) / extent * 1023).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def _boxes(corners: Array) -> list[Array]:
    """Return the boxes (n, 2, 3) of each level, the root first, those of the leaves last; empty ones are never met."""
    leaves = -(-len(corners) // LEAF)
    depth = int(np.ceil(np.log2(leaves))) if leaves > 1 else 0
    low, high = np.full((2**depth * LEAF, 3), np.inf), np.full((2**depth * LEAF, 3), -np.inf)
    low[: len(corners)], high[: len(corners)] = corners.min(axis=1), corners.max(axis=1)
    boxes = np.stack([low.reshape(-1, LEAF, 3).min(axis=1), high.reshape(-1, LEAF, 3).max(axis=1)], axis=1)
    levels = [boxes]
    while len(boxes) > 1:
        boxes = np.stack(
            [boxes[:, 0].reshape(-1, 2, 3).min(axis=1), boxes[:, 1].reshape(-1, 2, 3).max(axis=1)], 1
        )
        levels.append(boxes)
    return levels[::-1]
