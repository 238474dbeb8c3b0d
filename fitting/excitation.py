"""Excitation rates from an excitation series and a decay (Nalbach 2017, 8.4.6).

`fitting.excitation_model` has the model.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from phoslab.bands import Bands
from phoslab.errors import PhoslabError
from phoslab.fitting.bounded import Search, covariance_of, reach, search
from phoslab.fitting.excitation_model import Charge, ExcitationData, Problem, ends
from phoslab.fitting.rise import half_rise

Array = NDArray[np.float64]

# What a search begins with: how far the lamp would take every state, as a / kr.
_STARTS = (0.1, 1.0, 10.0)
# A state whose saturation is known no better than this (standard error of log a) has only Λ ke.
_LOOSE = 0.3
# By this share of the brightest place's glow a model that does not hold may be off where nothing changes any more.
_FLOOR = 0.003
# Chance of chi² beyond which the model, not the noise, is what misses the data.
_CHANCE = 1e-3
# A Gaussian estimate of 0 lies above this many standard errors in 5 % of cases: the limit of detection.
_ONE_SIDED = 1.645
# A value above this many standard deviations of its noise can be compared with the model by itself.
_CLEAR = 5.0
# Places whose glow ends above this share of the brightest one's tell how fast the glow rises.
_BRIGHT = 0.1


@dataclass(frozen=True, eq=False)
class ExcitationFit:
    """Excitation rates, and what the data say about them.

    Args:
        bands: of the rates.
        kr_per_s, amplitude: (n_c,) of the joint fit.
        ke_m2_per_J: (n_c, n_bands) mean over the lamp's light in each band; 0 is "below the limit of detection".
        ke_standard_error: (n_c, n_bands); infinite where the data say nothing.
        ke_upper_limit: (n_c, n_bands) for a `ke` of 0 what it stays below with 95 %, given Λ; else NaN.
        a_per_s: (n_c,) excitation under the whole lamp, light outside the bands included.
        initial: (n_c,) r(0) of the decay: how full each state was when the lamp went off.
        initial_error: (n_c,) standard error of log r(0).
        gain_error: (n_c,) standard error of log G, which is that of log Λ.
        scale_error: (n_c,) standard error of log a: how well saturation, and with it ke and Λ apart, are known.
        shape_error: (n_c, n_bands) relative standard error of ke_ij / a_i; what saturation leaves open cancels.
        product: (n_c, n_bands) G_i ke_ij, Λ ke as the camera sees it; determined even where the factors are not.
        product_standard_error: (n_c, n_bands).
        correlation: (n_c, 2) of log a with log G (Λ) and with log r(0).
        common_shape: whether all states have the same excitation spectrum but for a factor.
        model: (n_frames, n_places) the fitted signal.
        residual: (n_frames, n_places) in standard deviations, whitened.
        chi2, dof: of excitation and decay together.
        discrepancy: 0 where the sample follows the model; else by which share of the way that a place's glow has still
            to go the model misses it, beyond noise. The decay's values are then kept, and the rise's end counts most.
        level_error: (n_places,) model / measured - 1 after the longest exposure; NaN where there is too little glow.
        rise_s: (n_places, 2) light after which the glow is at half its end, measured and modelled; NaN likewise.
        covariance: of (log kr, log A, and the rates' parameters).
        data: what was fitted.
    """

    bands: Bands
    kr_per_s: Array
    amplitude: Array
    ke_m2_per_J: Array
    ke_standard_error: Array
    ke_upper_limit: Array
    a_per_s: Array
    initial: Array
    initial_error: Array
    gain_error: Array
    scale_error: Array
    shape_error: Array
    product: Array
    product_standard_error: Array
    correlation: Array
    common_shape: bool
    model: Array
    residual: Array
    chi2: float
    dof: int
    discrepancy: float
    level_error: Array
    rise_s: Array
    covariance: Array = field(repr=False)
    data: ExcitationData = field(repr=False)

    @property
    def n_states(self) -> int:
        """Number of states, n_c."""
        return self.kr_per_s.size

    @property
    def bright(self) -> NDArray[np.bool_]:
        """(n_places,) the places that glow enough to be told of."""
        return np.isfinite(self.level_error)

    @property
    def rise_unseen(self) -> bool:
        """Whether most bright places were past half of their end after the shortest light already."""
        return bool(np.isnan(self.rise_s[self.bright, 0]).mean() > 0.5) if self.bright.any() else False

    def farthest_off(self) -> tuple[float, float]:
        """Return the length of light [s] after which the model is farthest off, and modelled over measured glow then.

        The median of the bright places, wherever half of them stand clear of their noise; (NaN, 1) if nowhere.
        """
        return max(self._ratios(), key=lambda told: abs(np.log(told[1])), default=(float("nan"), 1.0))

    def near_from(self, share: float) -> float:
        """Return the length of light [s] from which on the model is never off by more than a share; NaN if nowhere.

        Of the same medians as `farthest_off`.
        """
        told = self._ratios()
        off = [t for t, ratio in told if abs(ratio - 1) > share]
        return min((t for t, _ in told if t > max(off, default=0.0)), default=float("nan"))

    def _ratios(self) -> list[tuple[float, float]]:
        """Lengths of light [s], and modelled over measured glow then, median of the bright places."""
        told = []
        for t, signal, sigma, model in zip(
            self.data.steps.lit_s, self.data.signal, self.data.sigma, self.model, strict=True
        ):
            clear = self.bright & (signal > _CLEAR * sigma)
            if clear.sum() > self.bright.sum() / 2:
                told.append((float(t), float(max(np.median(model[clear] / signal[clear]), 1e-9))))
        return told

    @property
    def product_only(self) -> NDArray[np.bool_]:
        """(n_c,) the states of which only Λ ke is determined, not ke.

        Saturation shows in some per cent of the level; where the model misses more than noise, it is not to be told
        from what is missed.
        """
        loose: NDArray[np.bool_] = ~(self.scale_error < _LOOSE) | (self.discrepancy > 0)
        return loose

    @property
    def rise_ratio(self) -> float:
        """Modelled over measured time to half of the end, median of the bright places; NaN where none tells."""
        ratio = self.rise_s[:, 1] / self.rise_s[:, 0]
        return float(np.median(ratio[np.isfinite(ratio)])) if np.isfinite(ratio).any() else float("nan")


def fit_excitation(
    data: ExcitationData,
    charge: Charge,
    *,
    common_shape: bool | None = None,
    limits: bool = True,
) -> ExcitationFit:
    """Fit excitation rates, jointly with what the decay says.

    Args:
        common_shape: whether all states have one excitation spectrum but for a factor; None: what AICc prefers.
        limits: also find upper limits of rates that are below the limit of detection.

    Raises:
        PhoslabError: there is no light, no signal, or fewer values than parameters.
    """
    _check(data, charge)
    n_c = charge.kr_per_s.size
    shapes = [True] if common_shape or n_c == 1 else [False] if common_shape is False else [True, False]
    problems = [Problem(data, charge, common) for common in shapes]
    best = min((_searched(problem) for problem in problems), key=_Found.aicc)
    if not best.follows:
        # What is left is not noise: the decay stays what it is, and the end of the rise counts most.
        best = min((_with_discrepancy(problem) for problem in problems), key=_Found.aicc)
    return _conclude(best, data, limits)


@dataclass(frozen=True, eq=False)
class _Found:
    """A problem's best minimum; `discrepancy` says how much of the distance to the end of a rise counts as noise."""

    problem: Problem
    search: Search
    discrepancy: float = 0.0

    @property
    def dof(self) -> int:
        return self.problem.data.n_values + 2 * self.problem.n_c - self.search.theta.size

    @property
    def follows(self) -> bool:
        """Whether chance explains chi²."""
        return self.dof <= 0 or bool(chdtrc(self.dof, self.search.chi2) >= _CHANCE)

    def aicc(self) -> float:
        """Akaike's information criterion, corrected for small samples."""
        p, n = self.search.theta.size, self.dof + self.search.theta.size
        # With a discrepancy σ is not known but fitted, and its size counts.
        sigma = self.problem.data.sigma
        spread = 2 * float(np.log(sigma[np.isfinite(sigma)]).sum()) if self.discrepancy else 0.0
        return self.search.chi2 + spread + 2 * p + (2 * p * (p + 1) / (n - p - 1) if n > p + 1 else np.inf)


def _searched(problem: Problem, held: bool = False, near: Array | None = None) -> _Found:
    starts = [problem.start(x) for x in _STARTS] if near is None else [near]
    mask = np.arange(starts[0].size) < 2 * problem.n_c if held else None
    found = [search(problem.residual, start, problem.lower, mask) for start in starts]
    return _Found(problem, min(found, key=lambda s: s.chi2))


def _with_discrepancy(problem: Problem) -> _Found:
    """Fit with σ² + τ² [(S_end - S)² + (0.003 S_bright)²] for σ², and find τ.

    S_end is a place's signal after its longest exposure, S_bright that of the brightest place. Until a place has
    reached its end, a model that does not hold is off by some share of the way that is left. At the end it is off by
    much less, but where light is faint by more than the noise: three thousandths of the brightest place count like way
    that is left. So the level at rest is met first, and the way there as well as it can be (Nalbach 2017, 8.4.6, fits
    "above all the equilibrium level"). τ makes chi² of the bright places as large as the number of their values.

    What a frame repeats to counts for each value by itself here: a common error of one frame, of which there are few
    at the end, would be a cheap way out.
    """
    data = problem.data
    fresh, end = problem.fresh, ends(data, problem.fresh)
    way = np.hypot(end * fresh[:, None] - data.signal, _FLOOR * fresh[:, None] * end.max())
    noise = np.hypot(data.sigma, data.repeatability * data.signal)
    bright = end > _BRIGHT * end.max()
    share, near = 0.3, None
    for _ in range(12):
        rough = replace(problem, data=replace(data, sigma=np.hypot(noise, share * way), repeatability=0.0))
        found = replace(_searched(rough, held=True, near=near), discrepancy=share)
        near = found.search.theta
        off = found.search.residual[: data.signal.size].reshape(data.signal.shape)[:, bright]
        growth = np.sqrt((off**2).sum() / max(np.isfinite(data.sigma[:, bright]).sum(), 1))
        if abs(growth - 1) < 0.02:
            break
        share = float(np.clip(share * growth, 1e-3, 3.0))
    return found


def _check(data: ExcitationData, charge: Charge) -> None:
    n_c, n = charge.kr_per_s.size, data.n_shapes
    if data.n_values < n:
        raise PhoslabError(
            f"has {data.n_values} usable values, too few for {n} unknown rates",
            field="the excitation series",
            remedy="Measure more exposure times, expose better, or fit fewer bands.",
        )
    if n > len(data.light):
        raise PhoslabError(
            f"has {len(data.light)} places under the filter, too few to tell {n} rates apart",
            field="the excitation series",
            remedy="Take more places, or fit fewer bands.",
        )
    if not charge.light.sum() > 0 or not data.light.sum() > 0:
        raise PhoslabError(
            "holds no light", field="the lamp's spectrum", remedy="Measure it: phoslab measure lamp."
        )
    if not (charge.amplitude > 0).all() or charge.covariance.shape != (2 * n_c, 2 * n_c):
        raise PhoslabError(
            "has a state without amplitude, or lacks its covariance",
            field="the decay's fit",
            remedy="Fit the decay with fewer states first.",
        )
    if not np.isfinite(charge.covariance).all():
        raise PhoslabError(
            "does not determine its rates and amplitudes",
            field="the decay's fit",
            remedy="Fit the decay with fewer states first.",
        )
    with np.errstate(invalid="ignore"):
        seen = float(np.max(np.where(np.isfinite(data.sigma), data.signal / data.sigma, -np.inf)))
    if not seen > 5:
        raise PhoslabError(
            f"does not glow: its brightest value stands {max(seen, 0):.2g} standard deviations above the dark",
            field="the excitation series",
            remedy="Excite longer, expose longer, and check that light comes through the filter.",
        )


def _conclude(best: _Found, data: ExcitationData, limits: bool) -> ExcitationFit:
    """Turn a minimum into rates with errors. `data` has the plain noise."""
    into = data.band_means
    problem, theta, n_c = best.problem, best.search.theta, best.problem.n_c
    misfit = 1.0 if best.follows else max(1.0, best.search.chi2 / best.dof)
    # What the model misses of the series is not the decay's: that enters with errors of its own.
    jacobian = best.search.jacobian.copy()
    jacobian[: data.signal.size] /= np.sqrt(misfit)
    covariance = covariance_of(jacobian)
    fine, fine_by = problem.ke(theta)
    ke, ke_by = fine @ into.T, np.einsum("bj,ijp->ibp", into, fine_by)
    log_gain, gain_by, initial = problem.gain(theta)
    a = fine @ problem.charge.light
    with np.errstate(divide="ignore", invalid="ignore"):
        log_a_by = np.einsum("j,ijp->ip", problem.charge.light, fine_by) / a[:, None]
        shape_by = ke_by / ke[:, :, None] - log_a_by[:, None, :]
    # G = A / (kr r(0))
    initial_by = -gain_by
    initial_by[:, : 2 * n_c] += np.concatenate([-np.eye(n_c), np.eye(n_c)], axis=1)
    product, product_by = _product(problem, theta)
    product_error = _errors(product_by, covariance)
    seen = product > _ONE_SIDED * product_error
    # What glows is excited by something: where no band stands out, the estimate, however poor, is better than 0.
    seen |= (product > 0) & ~seen.any(axis=1, keepdims=True)
    if problem.common:
        # One spectrum for all: a band that excites any state excites all of them.
        seen = np.broadcast_to(seen.any(axis=0), seen.shape)
    upper = np.full(ke.shape, np.nan)
    if limits:
        allowed = best.search.chi2 + _ONE_SIDED**2 * misfit
        # One spectrum for all has one limit, found for the state that is known best, and the others' by their ratio.
        known = np.argmin(product_error.sum(axis=1) / product.sum(axis=1))
        for i, j in np.argwhere(~seen):
            if problem.common and i != known:
                continue
            largest = _largest_product(problem, best.search, int(i), int(j), allowed) / np.exp(log_gain[i])
            ratio = ke.sum(axis=1) / ke[i].sum() if problem.common else np.arange(n_c) == i
            if np.isfinite(largest):
                upper[:, j] = np.where(ratio > 0, ratio * largest, upper[:, j])
    model = problem.signal(theta)[0]
    fresh = problem.fresh
    end, end_model = ends(data, fresh), ends(replace(data, signal=model), fresh)
    bright = end > _BRIGHT * end.max()
    rise = np.stack([half_rise(data.steps.lit_s, y / fresh[:, None]) for y in (data.signal, model)], axis=1)
    return ExcitationFit(
        bands=data.bands,
        kr_per_s=np.exp(theta[:n_c]),
        amplitude=np.exp(theta[n_c : 2 * n_c]),
        ke_m2_per_J=np.where(seen, ke, 0.0),
        ke_standard_error=_errors(ke_by, covariance),
        ke_upper_limit=upper,
        a_per_s=a,
        initial=initial,
        initial_error=_errors(initial_by, covariance),
        gain_error=_errors(gain_by, covariance),
        scale_error=_errors(log_a_by, covariance),
        shape_error=_errors(np.where(ke[:, :, None] > 0, shape_by, 0.0), covariance),
        product=product,
        product_standard_error=product_error,
        correlation=np.stack(
            [_correlations(log_a_by, by, covariance) for by in (gain_by, initial_by)], axis=1
        ),
        common_shape=problem.common,
        model=model,
        residual=best.search.residual[: data.signal.size].reshape(data.signal.shape),
        chi2=best.search.chi2,
        dof=best.dof,
        discrepancy=best.discrepancy,
        level_error=np.where(
            bright, np.divide(end_model, end, out=np.ones_like(end), where=bright) - 1, np.nan
        ),
        rise_s=np.where(bright[:, None], rise, np.nan),
        covariance=covariance,
        data=data,
    )


def _product(problem: Problem, theta: Array) -> tuple[Array, Array]:
    """Return (n_c, n_bands) G_i ke_ij and (n_c, n_bands, n_θ) its derivatives."""
    ke, ke_by = problem.ke(theta)
    into = problem.data.band_means
    log_gain, gain_by, _ = problem.gain(theta)
    factor = np.exp(log_gain)
    product = factor[:, None] * (ke @ into.T)
    by = factor[:, None, None] * np.einsum("bj,ijp->ibp", into, ke_by)
    return product, by + product[:, :, None] * gain_by[:, None, :]


def _largest_product(problem: Problem, found: Search, i: int, j: int, chi2: float) -> float:
    """Return how large G_i ke_ij can be before chi² exceeds `chi2`."""

    def value(theta: Array) -> tuple[float, Array]:
        product, by = _product(problem, theta)
        return float(product[i, j]), by[i, j]

    return reach(value, problem.residual, found, problem.lower, chi2)


def _errors(by: Array, covariance: Array) -> Array:
    """Return the standard errors of quantities with gradients (..., n_θ)."""
    with np.errstate(invalid="ignore"):
        variance = np.einsum("...p,pq,...q->...", by, np.where(np.isfinite(covariance), covariance, 0.0), by)
    unknown = (by != 0) @ ~np.isfinite(np.diag(covariance))
    return np.where(unknown, np.inf, np.sqrt(np.maximum(variance, 0.0)))


def _correlations(one: Array, other: Array, covariance: Array) -> Array:
    """Return the correlation of quantities with gradients (n, n_θ) with others, one by one."""
    cross = np.einsum("ip,pq,iq->i", one, covariance, other)
    found: Array = cross / (_errors(one, covariance) * _errors(other, covariance))
    return found
