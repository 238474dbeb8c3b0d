"""Where searches for the rates of a decay begin: the best few of a grid, which needs no guess."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.decay_problem import Problem, exposed_decay, first_colour

Array = NDArray[np.float64]

# Rates from which searches start: a few per decade, because the minimum's basin is wide in log kr.
_STARTS_PER_DECADE = 4
_KEPT_STARTS = 4


def rate_limits(data: DecayData) -> tuple[float, float]:
    """Return the rates in 1/s between which a search begins: a tenth of 1 / duration, and 3 / first step."""
    duration = data.end_s - min(0.0, data.begin_s)
    t = np.sort(data.t_s)
    steps = np.diff(t)
    # Late values that almost coincide (of two runs in one table) tell nothing of fast rates.
    steps = steps[steps > 0.01 * (t[1:] - t[0])]
    # The first steps are the short ones of a series spaced by logarithm.
    step = float(np.median(steps[: max(3, steps.size // 4)])) if steps.size else duration
    return 0.1 / duration, 3 / max(step, duration * 1e-6)


def starting_rates(stated: Problem) -> list[Array]:
    """Return the best few sets of log rates on a logarithmic grid, by a common colour, amplitudes not negative."""
    data, n_states = stated.data, stated.n_states
    low, high = rate_limits(data)
    per_decade = _STARTS_PER_DECADE if n_states < 4 else 3
    grid = np.geomspace(low, high, max(n_states + 2, int(per_decade * np.log10(high / low))))
    colour = first_colour(data)
    weight = 1 / data.total_sigma
    series_weight = np.sqrt(((weight * colour) ** 2).sum(axis=1))
    y = np.where(data.used, data.signal, 0.0) * weight
    series = np.divide(
        (y * weight * colour).sum(axis=1), series_weight, out=np.zeros(len(y)), where=series_weight > 0
    )
    g = series_weight[:, None] * exposed_decay(grid, data.t_s, data.exposure_s)[0]
    if stated.offset:
        # A constant is taken out of everything by projection.
        unit = series_weight / np.linalg.norm(series_weight)
        series = series - unit * (unit @ series)
        g = g - unit[:, None] * (unit @ g)
    chosen = np.array(list(combinations(range(grid.size), n_states)))
    # Normal equations of all combinations at once; only their ranking matters here, not their digits.
    normal, right = g.T @ g, g.T @ series
    A = normal[chosen[:, :, None], chosen[:, None, :]]
    A = A + np.eye(n_states) * (1e-10 * np.trace(A, axis1=1, axis2=2)[:, None, None] + np.finfo(float).tiny)
    x = np.linalg.solve(A, right[chosen][:, :, None])[:, :, 0]
    explained = (right[chosen] * x).sum(axis=1)
    explained[(x < 0).any(axis=1)] = -np.inf
    best = np.argsort(-explained)
    best = best[np.isfinite(explained[best])]
    kept: list[int] = []
    for k in best.tolist():
        # Neighbours on the grid lead to the same minimum.
        if all(np.abs(chosen[k] - chosen[j]).sum() > 1 for j in kept):
            kept.append(k)
        if len(kept) == _KEPT_STARTS:
            break
    if not kept:
        # Nothing decays: begin all over the grid.
        kept = np.linspace(0, len(chosen) - 1, _KEPT_STARTS).astype(int).tolist()
    return [np.log(grid[chosen[k]]) for k in kept]
