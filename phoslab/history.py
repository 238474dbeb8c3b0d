"""The previous method, as a baseline: glow as an integral over past irradiance (Glassner 1995).

Glassner's closed form has no saturation and no state: the concentration at t is the past excitation, weighted by
the decay since, which is eq. 8.1 of Nalbach 2017 with (1 - r) replaced by 1:

    r(t) = ∫_0^t a(s) exp(-kr (t - s)) ds

It is estimated by Monte Carlo, past times importance-sampled by the decay (Nalbach 2017, Fig. 8.16: 1 and 1024
samples). Each sample asks for the light at a past time, so either that is computed again or all of it is kept.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def monte_carlo(
    excitation_at: Callable[[Array], Array], kr: Array, t: float, n_samples: int, rng: np.random.Generator
) -> Array:
    """Estimate r(t) of a phosphor that was empty at 0, without saturation.

    Args:
        excitation_at: maps (n_samples, ..., n_c) past times in s to excitations of that shape in 1/s.
        kr: (..., n_c) re-radiation rates in 1/s, more than 0; its shape is that of the elements to estimate.
        t: now, in s.
        n_samples: past times for each element and state, independent of each other.
        rng: source of the samples.

    Returns:
        (..., n_c) unbiased estimates.
    """
    u = rng.random((n_samples, *kr.shape))
    # The density kr exp(-kr τ) / (1 - exp(-kr t)) on [0, t], by inversion.
    reached = -np.expm1(-kr * t)
    tau = -np.log1p(-u * reached) / kr
    estimate: Array = reached / kr * excitation_at(t - tau).mean(axis=0)
    return estimate


def from_cache(excitations: Array, kr: Array, dt: float) -> Array:
    """Sum over a cache of past excitations: r after n frames of dt each, without saturation.

    The cost and the cache grow with the number of frames.

    Args:
        excitations: (n, ..., n_c) mean excitation in 1/s of each frame, oldest first.
        kr: (..., n_c) re-radiation rates in 1/s, more than 0.
        dt: length of a frame in s.

    Returns:
        (..., n_c), exact where the excitation is constant within each frame.
    """
    age = dt * np.arange(len(excitations) - 1, -1, -1).reshape(-1, *np.ones(kr.ndim, int))
    total: Array = (excitations * np.exp(-kr * age)).sum(axis=0) * -np.expm1(-kr * dt) / kr
    return total
