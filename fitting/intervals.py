"""Confidence intervals of rates by profile likelihood, which hold where the covariance does not.

The interval of a rate is every value for which the best fit with that value held is not worse than the best of all
by more than chance (Venzon and Moolgavkar 1988). It is as skew as the data say, and open where they say nothing:
a state that the data can do without has no upper rate, or no lower one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from phoslab.fitting import decay, decay_problem
from phoslab.fitting.decay import DecayFit
from phoslab.fitting.decay_problem import Problem

Array = NDArray[np.float64]

# In units of the root of chi² above the minimum: an end found to 1e-3 σ moves the coverage by 1e-4.
_NEAR_ENOUGH = 1e-3
# A state that has faded by e to this power when the first value is taken is no light that anyone has seen.
_GONE = 30.0


def rate_intervals(fit: DecayFit, *, sigma_known: bool = True, level: float = 0.95) -> Array:
    """Return (n_c, 2) the ends of the interval of each rate in 1/s; 0 or infinity where it is open.

    Args:
        sigma_known: whether σ were given, rather than estimated from these residuals.
        level: how often such intervals hold the truth.
    """
    if fit.dof <= 0 and not sigma_known:
        return np.stack([np.zeros(fit.n_states), np.full(fit.n_states, np.inf)], axis=1)
    limit = fdtri(1, fit.dof if not sigma_known else 1e9, level)
    limit *= decay.misfit(fit.chi2, fit.dof) if sigma_known else fit.chi2 / fit.dof
    stated = decay_problem.problem(fit.data, fit.n_states, offset=fit.has_offset, rank_one=fit.rank_one)
    ends = np.empty((fit.n_states, 2))
    for i in range(fit.n_states):
        profile = _Profile(fit, stated, i, float(np.sqrt(limit)))
        ends[i] = np.exp([profile.end(-1), profile.end(1)])
    return ends


class _Profile:
    """The least chi² over all other parameters, as a function of one log rate that keeps its rank.

    Args:
        index: of the rate, counted from the fastest.
        height: of the interval's ends: root of chi² above the minimum.
    """

    def __init__(self, fit: DecayFit, stated: Problem, index: int, height: float) -> None:
        self.fit, self.stated, self.index, self.height = fit, stated, index, height
        data = fit.data
        self.slowest = float(np.log(decay._SLOWEST / data.end_s))
        # What fades by as much before the first value as before any other is not told from what is faster still.
        gone = _GONE / max(data.begin_s, 1e-300)
        self.fastest = float(np.log(min(decay._FASTEST / data.shortest_step_s, gone)))
        self.warm = fit.theta

    def rise(self, value: float) -> float:
        """Return the root of chi² above the fit's with the rate held at `value`."""
        chi2, found = _constrained(self.stated, self.warm, self.index, value)
        rise = float(np.sqrt(max(0.0, chi2 - self.fit.chi2)))
        if rise <= self.height:  # from far outside there may be no way back to the valley of the fit
            self.warm = found
        return rise

    def end(self, sign: int) -> float:
        """Return the log rate at which the interval ends, below (-1) or above (1); infinite where it is open."""
        self.warm = self.fit.theta
        best = float(self.fit.theta[self.index])
        edge = self.slowest if sign < 0 else self.fastest
        room = (edge - best) * sign
        if room <= 0:
            return sign * np.inf
        error = float(np.sqrt(self.fit.covariance[self.index, self.index]))
        step = error * self.height if np.isfinite(error) else 0.5
        step = float(np.clip(step, 1e-9, 1.5))
        inner, at_inner = best, -self.height
        while True:
            outer = best + sign * min(step, room)
            at_outer = self.rise(outer) - self.height
            if at_outer >= 0:
                break
            if step >= room:
                return sign * np.inf
            inner, at_inner = outer, at_outer
            # The root of chi² is close to linear: go where it should cross, with some margin.
            grown = abs(outer - best) * min(4.0, 1.1 * self.height / max(at_outer + self.height, 1e-9))
            step = max(grown, 1.2 * step)
        return self._between(inner, at_inner, outer, at_outer)

    def _between(self, low: float, at_low: float, high: float, at_high: float) -> float:
        """Narrow a crossing down by the Illinois method."""
        if at_high < _NEAR_ENOUGH:
            return high
        side = 0
        for _ in range(60):
            middle = (low * at_high - high * at_low) / (at_high - at_low)
            value = self.rise(middle) - self.height
            if abs(value) < _NEAR_ENOUGH or abs(high - low) < 1e-12:
                return middle
            if value > 0:
                high, at_high = middle, value
                at_low = at_low / 2 if side == 1 else at_low
                side = 1
            else:
                low, at_low = middle, value
                at_high = at_high / 2 if side == -1 else at_high
                side = -1
        return middle


def _constrained(stated: Problem, start: Array, index: int, value: float) -> tuple[float, Array]:
    """Return the least chi² with rate `index` at `value`, faster ones not slower and slower ones not faster than it.

    A rate that would overtake merges with the one that is held: that is the fit with a state less.
    """
    n = stated.n_states
    theta = start.copy()
    theta[:index] = np.maximum(theta[:index], value + 1e-3)
    theta[index] = value
    theta[index + 1 : n] = np.minimum(theta[index + 1 : n], value - 1e-3)
    held = np.arange(theta.size) == index
    found = stated.solve(theta, held=held, polish=False)
    faster, slower = found.theta[:index] < value, found.theta[index + 1 : n] > value
    if not (faster.any() or slower.any()):
        return found.chi2, found.theta
    overtaking = np.concatenate([faster, [False], slower])
    keep = ~overtaking
    fewer = replace(stated, n_states=int(keep.sum()))
    theta = np.concatenate([theta[:n][keep], theta[n:]])
    place = int(keep[:index].sum())
    chi2, _ = _constrained(fewer, theta, place, value)
    return chi2, start


def bootstrap_intervals(fit: DecayFit, n_draws: int, seed: int, level: float = 0.95) -> Array:
    """Return (n_c, 2) percentile intervals of the rates from a parametric bootstrap (Efron 1979).

    Each draw is the fitted model with fresh noise, fitted from where the fit stands.
    """
    rng = np.random.default_rng(seed)
    data = fit.data
    model = fit.predict(data.t_s, data.exposure_s)
    wider = np.sqrt(decay.misfit(fit.chi2, fit.dof))
    own = np.where(data.used, data.sigma, 0.0) * wider
    shared = data.repeatability * model * wider  # of a whole frame
    rates = np.empty((n_draws, fit.n_states))
    for k in range(n_draws):
        frame = shared * rng.standard_normal((len(model), 1))
        drawn = replace(data, signal=model + own * rng.standard_normal(model.shape) + frame)
        stated = decay_problem.problem(drawn, fit.n_states, offset=fit.has_offset, rank_one=fit.rank_one)
        rates[k] = np.exp(np.sort(stated.solve(fit.theta, polish=False).theta[: fit.n_states])[::-1])
    tail = 50 * (1 - level)
    ends: Array = np.percentile(rates, [tail, 100 - tail], axis=0).T
    return ends
