"""Triangles and parallelograms, given by a corner and its two neighbours: middles, radii, halves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def centres_of(corners: Array, is_triangle: NDArray[np.bool_]) -> Array:
    a, b, c = corners.transpose(1, 0, 2)
    centres: Array = np.where(is_triangle[:, None], (a + b + c) / 3, (b + c) / 2)
    return centres


def radii_of(corners: Array, is_triangle: NDArray[np.bool_]) -> Array:
    """Return (k,) the distance of the farthest corner from the centre; a parallelogram's fourth is its first's."""
    away = corners - centres_of(corners, is_triangle)[:, None]
    radii: Array = np.sqrt(np.max(np.sum(away**2, axis=2), axis=1))
    return radii


def halve(corners: Array, uv: Array, is_triangle: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Halve each triangle across its longest edge, each parallelogram across its longer side.

    Args:
        corners, uv: (p, k, 3, 3) and (p, k, 3, 2) of k parts each of p shapes; those of a parallelogram are all alike.
        is_triangle: (p,).

    Returns:
        (p, 2 k, 3, 3) and (p, 2 k, 3, 2), the halves of one part after another.
    """
    halves_c = np.empty((len(corners), 2 * corners.shape[1], 3, 3))
    halves_uv = np.empty((*halves_c.shape[:3], 2))
    for of, some in ((is_triangle, _halve_triangles), (~is_triangle, _halve_parallelograms)):
        halves_c[of], halves_uv[of] = some(corners[of], uv[of])
    return halves_c, halves_uv


def _halve_triangles(corners: Array, uv: Array) -> tuple[Array, Array]:
    edges = np.sum((np.roll(corners, -1, axis=2) - np.roll(corners, -2, axis=2)) ** 2, axis=3)
    turn = (np.argmax(edges, axis=2)[..., None] + np.arange(3)) % 3

    def halves(values: Array) -> Array:
        a, b, c = np.moveaxis(np.take_along_axis(values, turn[..., None], axis=2), 2, 0)
        m = (b + c) / 2
        return _in_a_row([np.stack([a, b, m], axis=2), np.stack([a, m, c], axis=2)])

    return halves(corners), halves(uv)


def _halve_parallelograms(corners: Array, uv: Array) -> tuple[Array, Array]:
    # As the first of each: halves that are alike to rounding must not be cut in two ways.
    a, b, c = np.moveaxis(corners[:, 0], 1, 0)
    along_u = (np.sum((b - a) ** 2, axis=1) >= np.sum((c - a) ** 2, axis=1))[:, None, None, None]

    def halves(values: Array) -> Array:
        a, b, c = np.moveaxis(values, 2, 0)
        m, n = (a + b) / 2, (a + c) / 2
        one = np.where(along_u, np.stack([a, m, c], axis=2), np.stack([a, b, n], axis=2))
        other = np.where(along_u, np.stack([m, b, c + m - a], axis=2), np.stack([n, b + n - a, c], axis=2))
        return _in_a_row([one, other])

    return halves(corners), halves(uv)


def _in_a_row(pair: list[Array]) -> Array:
    """Return (p, 2 k, ...) of two (p, k, ...): one part's two halves, then the next one's."""
    both = np.stack(pair, axis=2)
    return both.reshape(len(both), 2 * both.shape[1], *both.shape[3:])
