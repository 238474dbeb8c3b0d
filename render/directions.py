"""Directions in which pixels look for light: even over every block of pixels.

Each place of a square pattern has a few points of its own, which become directions. All of a pattern's together are a
(0, 2)-sequence, so that they are even; places are numbered so that those of any small block are far apart in it, so
that each block's are nearly as even. A tent as wide as two patterns weighs each place alike, wherever it lies.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
    n = side * side * per_place
    points = sequence.random_base2(int(np.ceil(np.log2(n))) if n > 1 else 0)[:n]
    each: Array = points.reshape(side * side, per_place, 2)[ordered_places(side)]
    return each


def mixed_points(side: int, aimless: int, aimed: int, draw: int = 0) -> Array:
    """Return (side, side, aimless + aimed, 2) the points of a pixel's directions: first of those that do not aim.

    Each kind is even on its own, as `patterned_points` has it; draws of other numbers share no point.
    """
    kinds = [patterned_points(side, n, 2 * draw + kind) for kind, n in enumerate((aimless, aimed)) if n]
    return np.concatenate(kinds, axis=2)


def on_hemisphere(points: Array) -> Array:
    """Return (..., 3) the directions about +z of (..., 2) points of the unit square: as the shader has them."""
    u, v = np.moveaxis(points, -1, 0)
    angle = 2 * np.pi * v
    return np.stack([np.sqrt(u) * np.cos(angle), np.sqrt(u) * np.sin(angle), np.sqrt(1.0 - u)], axis=-1)
