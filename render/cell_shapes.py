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


def halve_triangles(corners: Array, uv: Array) -> tuple[Array, Array]:
    """Return the halves of (k, 3, 3) triangles, and of their (k, 3, 2) coordinates: two in a row for each."""
    edges = np.sum((np.roll(corners, -1, axis=1) - np.roll(corners, -2, axis=1)) ** 2, axis=2)
    turn = (np.argmax(edges, axis=1)[:, None] + np.arange(3)) % 3

    def halves(values: Array) -> Array:
        a, b, c = np.take_along_axis(values, turn[..., None], axis=1).transpose(1, 0, 2)
        m = (b + c) / 2
        pair = np.stack([np.stack([a, b, m], axis=1), np.stack([a, m, c], axis=1)], axis=1)
        return pair.reshape(-1, *values.shape[1:])

    return halves(corners), halves(uv)


def halve_parallelograms(corners: Array, uv: Array) -> tuple[Array, Array]:
    """As `halve_triangles`: across the longer side; all of them are alike."""
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
