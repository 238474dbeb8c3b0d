"""Excitation rates from the glow after exposures of growing length through the LVF (Nalbach 2017, 8.4.6).

Place s under the filter gets the light M_sj in band j (lamp times transmission, W/m²), and so is excited by
a_is = Σ_j ke_ij M_sj. A frame f sees there

    S_fs = g_s Σ_i G_i <kr_i r_is>_f        G_i = A_i / q_i

<kr r> is the mean over the exposure, through rise and fade of the lamp, delay and decay (`fitting.charging`); g_s is the
paint's brightness there. G_i is Λ_i seen by the camera. The decay says how bright a state was, A_i, after the whole lamp
had charged it to r_i(0): q_i = kr_i r_i(0) is computed by the same steps, with r(0) < 1. So decay and excitation share
kr_i, A_i and ke_ij, and are fitted jointly: the decay enters by its own fit's values with their covariance.

Where a state stays far from saturation (a << kr) in all of both, scaling its ke up and its Λ down changes nothing: only
the product is determined, and is what is reported.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from phoslab.bands import Bands
from phoslab.errors import PhoslabError
from phoslab.fitting.bounded import Search, covariance_of, reach, search
from phoslab.fitting.charging import Steps, glow, phi

Array = NDArray[np.float64]

# What a search begins with: how far the lamp would take every state, as a / kr.
_STARTS = (0.1, 1.0, 10.0)
# A state whose saturation is known no better than this (standard error of log a) has only Λ ke.
_LOOSE = 0.3
# A lamp that takes a state to less than this share of saturation takes it there linearly, as far as any camera tells.
_LINEAR = 1e-3
# By this share of the brightest place's glow a model that does not hold may be off where nothing changes any more.
_FLOOR = 0.01
# Chance of chi² beyond which the model, not the noise, is what misses the data.
_CHANCE = 1e-3
# Rise of chi² at the end of an interval that lies below the truth in 5 % of cases: 1.645².
_ONE_SIDED = 2.706


@dataclass(frozen=True, eq=False)
class Charge:
    """The decay's own fit, and how its sample had been charged.

    Args:
        kr_per_s: (n_c,).
        amplitude: (n_c,) A_i at lamp-off, in the signal's unit of the strongest channel.
        covariance: (2 n_c, 2 n_c) of (log kr, log A).
        steps: one frame, to whose shutter nothing but the lamp's course matters: `Steps.of` with the charge's length
            and a delay beyond the fade.
        light: (n_bands,) the whole lamp in each band, in W/m² of the lamp's own unit.
    """

    kr_per_s: Array
    amplitude: Array
    covariance: Array
    steps: Steps
    light: Array


@dataclass(frozen=True, eq=False)
class ExcitationData:
    """A measured excitation series.

    Args:
        steps: of the n_frames frames.
        signal: (n_frames, n_places) linear signal a second, of the channel that `Charge.amplitude` refers to.
        sigma: (n_frames, n_places) standard deviation of its noise; infinite for a value that is left out.
        light: (n_places, n_bands) what the filter lets through at each place, in the unit of `Charge.light`.
        bands: the n_bands bands in which `ke` is taken to be constant.
        response: (n_places,) g_s, relative to the region in which the decay was measured.
        repeatability: relative standard deviation of a whole frame (shutter, gain), shared by its places.
    """

    steps: Steps
    signal: Array
    sigma: Array
    light: Array
    bands: Bands
    response: Array
    repeatability: float = 0.0

    def __post_init__(self) -> None:
        shape = (len(self.steps.duration_s), len(self.light))
        good = self.signal.shape == self.sigma.shape == shape and self.response.shape == shape[1:]
        if not good or self.light.shape[1] != self.bands.n:
            raise ValueError("frames, places and bands of an excitation series do not fit together")
        used = np.isfinite(self.sigma)
        if not np.isfinite(self.signal[used]).all() or not (self.sigma > 0).all():
            raise ValueError("signal must be finite and sigma positive wherever a value is used")

    @property
    def n_values(self) -> int:
        """How many values take part."""
        return int(np.isfinite(self.sigma).sum())

    def whiten(self, values: Array) -> Array:
        """Turn errors (n_frames, n_places, ...) into unit, unrelated ones; 0 where a value is left out.

        A frame's covariance is D (1 + u uᵀ) D, with D = diag(σ) and u = repeatability * signal / σ.
        """
        sigma = self.sigma.reshape(*self.sigma.shape, *([1] * (values.ndim - 2)))
        scaled = values / sigma
        u = np.where(np.isfinite(self.sigma), self.repeatability * self.signal / self.sigma, 0.0)
        u2 = (u**2).sum(axis=1)
        shrink = np.divide(1 - 1 / np.sqrt(1 + u2), u2, out=np.zeros_like(u2), where=u2 > 0)
        along = np.einsum("fs,fs...->f...", u, scaled)
        whitened: Array = scaled - np.einsum("f,fs,f...->fs...", shrink, u, along)
        return whitened


@dataclass(frozen=True, eq=False)
class ExcitationFit:
    """Excitation rates, and what the data say about them.

    Args:
        bands: the bands of all that follows.
        kr_per_s, amplitude: (n_c,) of the joint fit.
        ke_m2_per_J: (n_c, n_bands); 0 is "below the limit".
        ke_standard_error: (n_c, n_bands); infinite where the data say nothing.
        ke_upper_limit: (n_c, n_bands) for a `ke` of 0 the value that it stays below with 95 %, else NaN.
        a_per_s: (n_c,) excitation under the whole lamp.
        initial: (n_c,) r(0) of the decay: how full each state was when the lamp went off.
        scale_error: (n_c,) standard error of log a: how well saturation, and with it ke and Λ apart, are known.
        product: (n_c, n_bands) G_i ke_ij, Λ ke as the camera sees it; determined even where the factors are not.
        product_standard_error: (n_c, n_bands).
        correlation: (n_c, 2) of log a with log G (Λ) and with log r(0).
        common_shape: whether all states have the same excitation spectrum but for a factor.
        model: (n_frames, n_places) the fitted signal.
        residual: (n_frames, n_places) in standard deviations, whitened.
        chi2, dof: of excitation and decay together.
        discrepancy: 0 where the sample follows the model; else by which share of the way that a place's glow has still to
            go the model misses it, beyond noise. The decay's values are then kept, and the end of the rise counts most.
        covariance: of (log kr, log A, and the rates' parameters), widened by chi2 / dof where chance does not explain it.
        warnings: one sentence each.
    """

    bands: Bands
    kr_per_s: Array
    amplitude: Array
    ke_m2_per_J: Array
    ke_standard_error: Array
    ke_upper_limit: Array
    a_per_s: Array
    initial: Array
    scale_error: Array
    product: Array
    product_standard_error: Array
    correlation: Array
    common_shape: bool
    model: Array
    residual: Array
    chi2: float
    dof: int
    discrepancy: float
    covariance: Array = field(repr=False)
    warnings: tuple[str, ...] = ()

    @property
    def n_states(self) -> int:
        """Number of states, n_c."""
        return self.kr_per_s.size

    @property
    def product_only(self) -> NDArray[np.bool_]:
        """(n_c,) the states of which only Λ ke is determined, not ke."""
        loose: NDArray[np.bool_] = ~(self.scale_error < _LOOSE)
        return loose


@dataclass(frozen=True, eq=False)
class _Problem:
    """The joint problem; θ = (log kr, log A, rates), the rates being ke_ij or, with one shape, (log ρ_i, s_j)."""

    data: ExcitationData
    charge: Charge
    common: bool
    # A transform of (log kr, log A) into unit, unrelated errors: from the decay's covariance.
    prior: Array

    @property
    def n_c(self) -> int:
        return self.charge.kr_per_s.size

    @property
    def lower(self) -> Array:
        """(n_θ,) rates are not negative, logarithms are free."""
        n = self.data.bands.n
        return np.concatenate([np.full(self.n_logs, -np.inf), np.zeros(n if self.common else self.n_c * n)])

    @property
    def n_logs(self) -> int:
        return 2 * self.n_c + (self.n_c - 1 if self.common else 0)

    @property
    def fresh(self) -> Array:
        """(n_frames,) the decay's signal at the delay of each frame, averaged over its exposure."""
        kr, steps = self.charge.kr_per_s, self.data.steps
        faded = np.exp(-kr * steps.delay_s[:, None]) * phi(kr * steps.exposure_s[:, None])[1]
        total: Array = faded @ self.charge.amplitude
        return total

    def ke(self, theta: Array) -> tuple[Array, Array]:
        """Return (n_c, n_bands) ke and its derivatives (n_c, n_bands, n_θ)."""
        n_c, n = self.n_c, self.data.bands.n
        slope = np.zeros((n_c, n, theta.size))
        if not self.common:
            ke = theta[2 * n_c :].reshape(n_c, n)
            slope[:, :, 2 * n_c :] = np.eye(n_c * n).reshape(n_c, n, n_c * n)
            return ke, slope
        ratio = np.exp(np.append(0.0, theta[2 * n_c : self.n_logs]))
        shape = theta[self.n_logs :]
        ke = ratio[:, None] * shape
        for i in range(n_c):
            slope[i, :, self.n_logs :] = ratio[i] * np.eye(n)
            if i:
                slope[i, :, 2 * n_c + i - 1] = ke[i]
        return ke, slope

    def camera_gain(self, theta: Array) -> tuple[Array, Array, Array, Array]:
        """Return (n_c,) log G; its derivatives by log kr and by a (n_c,) at constant A; and r(0)."""
        kr = np.exp(theta[: self.n_c])
        ke, _ = self.ke(theta)
        seen = glow((ke @ self.charge.light)[None, :], kr, self.charge.steps)
        q, q_a, q_kr = seen.value[0, 0], seen.by_a[0, 0], seen.by_kr[0, 0]
        # The frame's mean is q e^(-kr d) φ1(kr τ) if nothing but decay happens after the lamp has gone off.
        fall, fall_kr = _fall(kr, self.charge.steps)
        r0 = q / (kr * fall)
        log_q_kr = kr * (q_kr / q - fall_kr / fall)
        return theta[self.n_c : 2 * self.n_c] - np.log(q / fall), -log_q_kr, -q_a / q, r0

    def signal(self, theta: Array) -> tuple[Array, Array]:
        """Return (n_frames, n_places) the signal and (n_frames, n_places, n_θ) its derivatives."""
        data, n_c = self.data, self.n_c
        kr = np.exp(theta[:n_c])
        ke, ke_by = self.ke(theta)
        log_gain, gain_kr, gain_a, _ = self.camera_gain(theta)
        seen = glow(data.light @ ke.T, kr, data.steps)
        factor = data.response[None, :, None] * np.exp(log_gain)
        parts = factor * seen.value
        slope = np.zeros((*data.signal.shape, theta.size))
        slope[:, :, :n_c] = factor * seen.by_kr * kr + parts * gain_kr
        slope[:, :, n_c : 2 * n_c] = parts
        by_place = np.einsum("sj,ijp->sip", data.light, ke_by)
        by_lamp = np.einsum("j,ijp->ip", self.charge.light, ke_by)
        slope += np.einsum("fsi,sip->fsp", factor * seen.by_a, by_place)
        slope += (parts * gain_a) @ by_lamp
        return parts.sum(axis=2), slope

    def residual(self, theta: Array) -> tuple[Array, Array]:
        """Return (m,) whitened residuals, model less data, and their Jacobian (m, n_θ)."""
        model, slope = self.signal(theta)
        data, n = self.data, theta.size
        used = np.isfinite(data.sigma)
        apart = data.whiten(np.where(used, model - data.signal, 0.0)).ravel()
        J = data.whiten(slope).reshape(-1, n)
        logs = np.concatenate([np.log(self.charge.kr_per_s), np.log(self.charge.amplitude)])
        known = self.prior @ (theta[: logs.size] - logs)
        J_known = np.hstack([self.prior, np.zeros((logs.size, n - logs.size))])
        wall, J_wall = self._wall(theta)
        return np.concatenate([apart, known, wall]), np.concatenate([J, J_known, J_wall])

    def _wall(self, theta: Array) -> tuple[Array, Array]:
        """Return (n_c,) what keeps a search from walking on for ever where ke has no lower end; 0 short of it."""
        ke, ke_by = self.ke(theta)
        a = ke @ self.charge.light
        beyond = np.log(_LINEAR) + theta[: self.n_c] - np.log(np.maximum(a, 1e-300))
        by = -np.einsum("j,ijp->ip", self.charge.light, ke_by) / np.maximum(a, 1e-300)[:, None]
        by[:, : self.n_c] += np.eye(self.n_c)
        active = beyond > 0
        return np.where(active, beyond, 0.0), np.where(active[:, None], by, 0.0)

    def start(self, saturation: float) -> Array:
        """Return (n_θ,) flat rates under which the lamp excites every state by `saturation` times its kr."""
        kr = self.charge.kr_per_s
        flat = saturation * kr / self.charge.light.sum()
        logs = np.concatenate([np.log(kr), np.log(self.charge.amplitude)])
        n = self.data.bands.n
        if self.common:
            return np.concatenate([logs, np.log(flat[1:] / flat[0]), np.full(n, flat[0])])
        return np.concatenate([logs, np.repeat(flat, n)])


def fit_excitation(
    data: ExcitationData, charge: Charge, *, common_shape: bool | None = None, limits: bool = True
) -> ExcitationFit:
    """Fit excitation rates, jointly with what the decay says.

    Args:
        common_shape: whether all states have one excitation spectrum but for a factor; None: what AICc prefers.
        limits: also find upper limits of rates that came out 0 (the slowest part).

    Raises:
        PhoslabError: there is no light, no signal, or fewer values than parameters.
    """
    _check(data, charge)
    n_c = charge.kr_per_s.size
    shapes = [True] if common_shape or n_c == 1 else [False] if common_shape is False else [True, False]
    root = np.linalg.cholesky(np.linalg.inv(charge.covariance)).T
    problems = [_Problem(data, charge, common, root) for common in shapes]
    best = min((_searched(problem) for problem in problems), key=_Found.aicc)
    if not best.follows:
        # What is left is not noise: the decay stays what it is, and the end of the rise counts most.
        best = min((_with_discrepancy(problem) for problem in problems), key=_Found.aicc)
    return _conclude(best, limits)


@dataclass(frozen=True, eq=False)
class _Found:
    """A problem's best minimum; `discrepancy` says how much of the distance to the end of a rise counts as noise."""

    problem: _Problem
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
        p, n = self.search.theta.size, self.dof + self.search.theta.size
        # With a discrepancy σ is not known but fitted, and its size counts.
        sigma = self.problem.data.sigma
        spread = 2 * float(np.log(sigma[np.isfinite(sigma)]).sum()) if self.discrepancy else 0.0
        return self.search.chi2 + spread + 2 * p + (2 * p * (p + 1) / (n - p - 1) if n > p + 1 else np.inf)


def _searched(problem: _Problem, held: bool = False, near: Array | None = None) -> _Found:
    starts = [problem.start(x) for x in _STARTS] if near is None else [near]
    mask = np.arange(starts[0].size) < 2 * problem.n_c if held else None
    found = [search(problem.residual, start, problem.lower, mask) for start in starts]
    return _Found(problem, min(found, key=lambda s: s.chi2))


def _with_discrepancy(problem: _Problem) -> _Found:
    """Fit with σ² + τ² [(S_end - S)² + (S_bright / 100)²] for σ², and find τ.

    S_end is a place's signal after its longest exposure, S_bright that of the brightest place. Until a place has reached
    its end, a model that does not hold is off by some share of the way that is left. At the end it is off by much less,
    but where light is faint by more than the noise: a hundredth of the brightest place counts like way that is left.
    So the level at rest is met first, and the way there as well as it can be (Nalbach 2017, 8.4.6, fits "above all the
    equilibrium level"). τ is what makes chi² as large as its degrees of freedom.
    """
    data = problem.data
    fresh, end = problem.fresh, ends(data, problem.fresh)
    way = np.hypot(end * fresh[:, None] - data.signal, _FLOOR * fresh[:, None] * end.max())
    share, near = 0.3, None
    for _ in range(12):
        rough = replace(problem, data=replace(data, sigma=np.hypot(data.sigma, share * way)))
        found = replace(_searched(rough, held=True, near=near), discrepancy=share)
        near = found.search.theta
        growth = np.sqrt(found.search.chi2 / max(found.dof, 1))
        if abs(growth - 1) < 0.02:
            break
        share = float(np.clip(share * growth, 1e-3, 3.0))
    return found


def ends(data: ExcitationData, fresh: Array) -> Array:
    """Return (n_places,) the signal after the longest exposure to the lamp, as a share of `fresh`; by its frames' noise.

    Args:
        fresh: (n_frames,) what delay and exposure time leave of any glow: frames differ in them.
    """
    last = data.steps.lit_s >= 0.999 * data.steps.lit_s.max()
    scaled, sigma = data.signal[last] / fresh[last, None], data.sigma[last] / fresh[last, None]
    weight = np.where(np.isfinite(sigma), 1 / sigma**2, 0.0)
    total = weight.sum(axis=0)
    signal = (weight * np.where(weight > 0, scaled, 0.0)).sum(axis=0)
    return np.divide(signal, total, out=np.zeros_like(total), where=total > 0)


def _check(data: ExcitationData, charge: Charge) -> None:
    n_c, n = charge.kr_per_s.size, data.bands.n
    if data.n_values < n:
        raise PhoslabError(
            f"has {data.n_values} usable values, too few for {n} bands",
            field="the excitation series",
            remedy="Measure more exposure times, expose better, or fit fewer bands.",
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


def _conclude(best: _Found, limits: bool) -> ExcitationFit:
    problem, found = best.problem, best.search
    data, charge, n_c = problem.data, problem.charge, problem.n_c
    theta = found.theta
    n_decay = 2 * n_c
    misfit = 1.0 if best.follows else found.chi2 / best.dof
    covariance = covariance_of(found.jacobian) * misfit
    ke, ke_by = problem.ke(theta)
    log_gain, gain_kr, gain_a, initial = problem.camera_gain(theta)
    a = ke @ charge.light
    by_lamp = np.einsum("j,ijp->ip", charge.light, ke_by)
    # log G and log r(0) as functions of θ, at first order: G = A / (kr r(0)).
    gain_by = gain_a[:, None] * by_lamp
    gain_by[:, n_c:n_decay] += np.eye(n_c)
    gain_by[:, :n_c] += np.diag(gain_kr)
    initial_by = -gain_by.copy()
    initial_by[:, n_c:n_decay] += np.eye(n_c)
    initial_by[:, :n_c] -= np.eye(n_c)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_a_by = by_lamp / a[:, None]
        error_of_scale = _errors(log_a_by, covariance)
        correlation = np.stack(
            [_correlations(log_a_by, other, covariance) for other in (gain_by, initial_by)], axis=1
        )
    product = np.exp(log_gain)[:, None] * ke
    product_by = np.exp(log_gain)[:, None, None] * (ke_by + ke[:, :, None] * gain_by[:, None, :])
    upper = np.full(ke.shape, np.nan)
    if limits:
        allowed = found.chi2 + _ONE_SIDED * misfit
        for i, j in zip(*np.nonzero(ke == 0), strict=True):
            upper[i, j] = _largest_ke(problem, found, int(i), int(j), allowed)
    n_used = data.signal.size
    return ExcitationFit(
        bands=data.bands,
        kr_per_s=np.exp(theta[:n_c]),
        amplitude=np.exp(theta[n_c:n_decay]),
        ke_m2_per_J=ke,
        ke_standard_error=_errors(ke_by, covariance),
        ke_upper_limit=upper,
        a_per_s=a,
        initial=initial,
        scale_error=error_of_scale,
        product=product,
        product_standard_error=_errors(product_by, covariance),
        correlation=correlation,
        common_shape=problem.common,
        model=problem.signal(theta)[0],
        residual=found.residual[:n_used].reshape(data.signal.shape),
        chi2=found.chi2,
        dof=best.dof,
        discrepancy=best.discrepancy,
        covariance=covariance,
    )


def _largest_ke(problem: _Problem, found: Search, i: int, j: int, chi2: float) -> float:
    """Return how large ke_ij can be before chi² exceeds `chi2`."""

    def rate(theta: Array) -> tuple[float, Array]:
        ke, ke_by = problem.ke(theta)
        return float(ke[i, j]), ke_by[i, j]

    return reach(rate, problem.residual, found, problem.lower, chi2)


def _fall(kr: Array, steps: Steps) -> tuple[Array, Array]:
    """Return (n_c,) e^(-kr d) φ1(kr τ) of the only frame of `steps`, from lamp-off on, and its derivative by kr."""
    delay, exposure = steps.delay_s[0], steps.exposure_s[0]
    x = kr * exposure
    e, phi1, phi2, _ = phi(x)
    fall = np.exp(-kr * delay)
    return fall * phi1, fall * (exposure * (phi2 - phi1) - delay * phi1)


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
