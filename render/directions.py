"""Directions in which pixels look for light: crowded as the cosine, and even over every block of pixels.

Each place of a square pattern has a few directions of its own. All of a pattern's together are a (0, 2)-sequence, so
that they are even; places are numbered so that those of any small block are far apart in it, so that each block's are
nearly as even. A box as wide as the pattern sees each direction once, wherever it lies.
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


def cosine_directions(side: int, per_place: int, seed: int = 0) -> Array:
    """Return (side, side, per_place, 3) unit vectors about +z, whose density is the cosine over π.

    Args:
        side: of the pattern in pixels: 2^n.
        per_place: directions of one pixel.
        seed: of the scrambling of the sequence (Owen 1995).
    """
    from scipy.stats import qmc

    sequence = qmc.Sobol(2, scramble=True, rng=np.random.default_rng(seed))
    n = side * side * per_place
    points = sequence.random_base2(int(np.ceil(np.log2(n))) if n > 1 else 0)[:n]
    directions = on_hemisphere(points).reshape(side * side, per_place, 3)
    return directions[ordered_places(side)]


def on_hemisphere(points: Array) -> Array:
    """Return (n, 3) the directions of (n, 2) points of the unit square: their density is the cosine over π."""
    z = np.sqrt(1.0 - points[:, 0])
    radius, angle = np.sqrt(points[:, 0]), 2 * np.pi * points[:, 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
