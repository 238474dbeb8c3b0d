"""How long light takes to bring the glow to half of where it ends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def half_rise(lit_s: Array, glow: Array) -> Array:
    """Return (n_places,) the length of light after which the glow is at half of its last value.

    Between two exposures the glow is a straight line over the logarithm of time. NaN where it is never below half.

    Args:
        lit_s: (n_frames,) lengths of exposure to the lamp, in any order; of equal ones the first counts.
        glow: (n_frames, n_places).

    >>> half_rise(np.array([1.0, 4.0, 64.0]), np.array([[0.25], [0.75], [1.0]])).round(6).tolist()
    [2.0]
    """
    order = np.argsort(lit_s, kind="stable")
    order = order[np.append(True, np.diff(lit_s[order]) > 1e-3 * lit_s[order][1:])]
    t, level = np.log(lit_s[order]), glow[order] / np.where(glow[order][-1] > 0, glow[order][-1], np.nan)
    found = np.full(glow.shape[1], np.nan)
    for s, y in enumerate(level.T):
        above = np.flatnonzero(y >= 0.5)
        if above.size and above[0] > 0:
            k = above[0]
            found[s] = np.exp(np.interp(0.5, y[k - 1 : k + 1], t[k - 1 : k + 1]))
    return found
