"""Directions in which pixels look for light: even over every block of pixels.

Each place of a square pattern has a few points of its own, which become directions. All of a pattern's together are a
(0, 2)-sequence, so that they are even; places are numbered so that those of any small block are far apart in it, so
that each block's are nearly as even. A tent as wide as two patterns weighs each place alike, wherever it lies.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Of a plane of patterns, per pattern to the right and upwards, shifts that lie far apart: powers of the root of
# x^5 = x + 1 (Roberts 2018).
SHIFTS = np.array([[0.8566748838, 0.7338918566], [0.6287067210, 0.5385972572]])


def ordered_places(side: int) -> NDArray[np.intp]:
    """Return (side, side) the numbers 0 .. side² - 1 as ordered dithering has them (Bayer 1973); side is 2^n."""
    places = np.zeros((1, 1), dtype=np.intp)
    while len(places) < side:
        places = np.block([[4 * places, 4 * places + 2], [4 * places + 3, 4 * places + 1]])
    return places


def patterned_points(side: int, per_place: int, seed: int = 0) -> Array:
    """Return (side, side, per_place, 2) points of the unit square, even over the whole pattern and nearly over parts.

    Args:
        side: of the pattern in pixels: 2^n.
        per_place: points of one pixel.
        seed: of the scrambling of the sequence (Owen 1995).
    """
    from scipy.stats import qmc

    sequence = qmc.Sobol(2, scramble=True, rng=np.random.default_rng(seed))
    points = sequence.random_base2(strata(side, per_place).bit_length() - 1)[: side * side * per_place]
    each: Array = points.reshape(side * side, per_place, 2)[ordered_places(side)]
    return each


def strata(side: int, per_place: int) -> int:
    """Return into how many parts either side of the unit square falls, each with one of the points at most: 2^n."""
    return 1 << max(side * side * per_place - 1, 0).bit_length()


def mixed_points(side: int, aimless: int, aimed: int, draw: int = 0) -> Array:
    """Return (side, side, aimless + aimed, 2) the points of a pixel's directions: first of those that do not aim.

    Each kind is even on its own, as `patterned_points` has it; draws of other numbers share no point.
    """
    kinds = [patterned_points(side, n, 2 * draw + kind) for kind, n in enumerate((aimless, aimed)) if n]
    return np.concatenate(kinds, axis=2)


def over_picture(points: Array, size: tuple[int, int]) -> Array:
    """Return (height, width, per_place, 2) the points of every pixel, as the shader has them.

    Each pattern has them elsewhere in their strata: what the filter brings together are not the same few points again.
    """
    side, n = points.shape[0], strata(points.shape[0], points.shape[2])
    y, x = np.indices(size[::-1])
    shift = np.stack([x // side, y // side], axis=-1) @ SHIFTS
    stratum = points[y % side, x % side] * n
    moved: Array = (np.floor(stratum) + (stratum + shift[:, :, None]) % 1.0) / n
    return moved


def on_hemisphere(points: Array) -> Array:
    """Return (..., 3) the directions about +z of (..., 2) points of the unit square: as the shader has them."""
    u, v = np.moveaxis(points, -1, 0)
    angle = 2 * np.pi * v
    return np.stack([np.sqrt(u) * np.cos(angle), np.sqrt(u) * np.sin(angle), np.sqrt(1.0 - u)], axis=-1)
