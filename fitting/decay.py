"""Decay: sums of exponentials, their rates shared by all channels (Nalbach 2017, 8.4.4).

The model of channel c at time t after lamp-off, averaged over the exposure τ that begins at t:

    S_c(t) = O_c + Σ_i A_ic exp(-kr_i t) φ(kr_i τ),    φ(x) = (1 - exp(-x)) / x

`rank_one`: the spectrum of the glow is constant in time, so one colour C (its largest channel is 1) serves all
states, A_ic = A_i C_c (the paper's form, for sessions). Otherwise each channel has amplitudes of its own (tables,
whose channels may be anything). The offset O is 0 unless it is asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.fitting import varpro
from phoslab.fitting.noise import NoiseLaw

Array = NDArray[np.float64]

MOST_STATES = 4

# Rates from which searches start: a few per decade, because the minimum's basin is wide in log kr.
_STARTS_PER_DECADE = 4
_KEPT_STARTS = 4
# Two rates nearer than this ratio are one rate written twice.
_SAME_RATE = 1.05
# A rate beyond these, by the longest and the shortest time measured, is a constant or a flash: nothing tells which.
_SLOWEST, _FASTEST = 1e-4, 1e3


@dataclass(frozen=True)
class DecayData:
    """A measured decay.

    Args:
        t_s: (n,) start of each exposure, in s since lamp-off.
        exposure_s: (n,) exposure times in s.
        signal: (n, n_channels) linear signal a second, in units of the camera.
        sigma: (n, n_channels) standard deviation of its noise; infinite for a value that is left out.
        repeatability: relative standard deviation of a whole frame (shutter, gain), shared by its channels.
        channels: names of the channels.
        law: how `sigma` depends on the signal, where that is known: the fit then takes it from its own model.
        expected: (n, n_channels) the signal that `repeatability` refers to; by default that of the fit.
    """

    t_s: Array
    exposure_s: Array
    signal: Array
    sigma: Array
    repeatability: float = 0.0
    channels: tuple[str, ...] = ("R", "G", "B")
    law: NoiseLaw | None = None
    expected: Array | None = None

    def __post_init__(self) -> None:
        if not np.isfinite(self.signal[self.used]).all() or not (self.sigma > 0).all():
            raise ValueError("signal must be finite and sigma positive wherever a value is used")

    @property
    def used(self) -> NDArray[np.bool_]:
        """(n, n_channels) the values that take part."""
        return np.isfinite(self.sigma)

    @property
    def _reference(self) -> Array:
        return self.signal if self.expected is None else self.expected

    @property
    def total_sigma(self) -> Array:
        """(n, n_channels) noise and repeatability together; infinite for a value that is left out."""
        return np.where(self.used, np.hypot(self.sigma, self.repeatability * self._reference), np.inf)

    def whitening(self) -> Array:
        """Return (n, n_channels, n_channels): matrices that turn a frame's errors into unit, unrelated ones.

        A frame's covariance is D (1 + u uᵀ) D with D = diag(σ) and u = repeatability * signal / σ: the noise of
        the channels is their own, the frame's scale is common. Its inverse root is closed; rows and columns of
        values that are left out are 0.
        """
        u = self.repeatability * np.where(self.used, self._reference / self.sigma, 0.0)
        u2 = (u**2).sum(axis=1)
        shrink = np.divide(1 - 1 / np.sqrt(1 + u2), u2, out=np.zeros_like(u2), where=u2 > 0)
        roots = np.eye(u.shape[1]) - shrink[:, None, None] * u[:, :, None] * u[:, None, :]
        matrices: Array = roots / self.sigma[:, None, :]
        return matrices

    def weighted_by(self, model: Array) -> DecayData:
        """Return the same values with the noise that they would have about `model` (n, n_channels)."""
        # A value that is left out binds the model to nothing, and a fast state may be anything there.
        largest = 10 * np.abs(np.where(self.used, self.signal, 0.0)).max(axis=0)
        model = np.where(self.used, np.clip(model, -largest, largest), 0.0)
        sigma = self.sigma if self.law is None else np.where(self.used, self.law.sigma(model), np.inf)
        return replace(self, sigma=sigma, expected=model)

    @property
    def n_values(self) -> int:
        """How many values take part."""
        return int(np.count_nonzero(self.used))

    @property
    def end_s(self) -> float:
        """When the last exposure ended."""
        return float((self.t_s + self.exposure_s).max())

    def take(self, frames: slice | NDArray[np.bool_] | NDArray[np.intp]) -> DecayData:
        """Return the decay with only some of its frames."""
        return replace(
            self,
            t_s=self.t_s[frames],
            exposure_s=self.exposure_s[frames],
            signal=self.signal[frames],
            sigma=self.sigma[frames],
            expected=None if self.expected is None else self.expected[frames],
        )


@dataclass(frozen=True)
class DecayFit:
    """A fitted decay: n_c states, fast to slow.

    Args:
        kr_per_s: (n_c,) re-radiation rates.
        amplitude: (n_c, n_channels) A at t = 0, in the signal's unit.
        offset: (n_channels,) O; 0 where none was fitted.
        rank_one: whether one colour serves all states.
        has_offset: whether O was fitted.
        theta: the searched parameters, log kr (n_c,) and, if `rank_one`, the colour without its largest.
        covariance: of (log kr, colour without its largest, A of the strongest channel, O) if `rank_one`, else of
            (log kr, A and O of channel 0, A and O of channel 1, ...); scaled by chi2 / dof where `misfit`.
        residual: (n, n_channels) in standard deviations, whitened; 0 where a value was left out.
        chi2: sum of squares of `residual`.
        dof: values less parameters.
        data: what was fitted, with the noise as it was weighted in the end.
    """

    kr_per_s: Array
    amplitude: Array
    offset: Array
    rank_one: bool
    has_offset: bool
    theta: Array
    covariance: Array
    residual: Array
    chi2: float
    dof: int
    data: DecayData

    @property
    def n_states(self) -> int:
        """Number of exponentials, n_c."""
        return len(self.kr_per_s)

    @property
    def n_parameters(self) -> int:
        """Number of free parameters."""
        return len(self.covariance)

    @property
    def colour(self) -> Array:
        """(n_channels,) amplitude of all states together, its largest 1."""
        total: Array = self.amplitude.sum(axis=0)
        return total / (np.abs(total).max() or 1.0)

    @property
    def strength(self) -> Array:
        """(n_c,) amplitude in the strongest channel."""
        strongest: Array = self.amplitude[:, int(np.argmax(self.amplitude.sum(axis=0)))]
        return strongest

    @property
    def aicc(self) -> float:
        """Akaike's information criterion for known σ, corrected for small samples."""
        p, n = self.n_parameters, self.dof + self.n_parameters
        return self.chi2 + 2 * p + (2 * p * (p + 1) / (n - p - 1) if n > p + 1 else np.inf)

    @property
    def bic(self) -> float:
        """Schwarz's Bayesian information criterion for known σ."""
        return self.chi2 + self.n_parameters * float(np.log(self.dof + self.n_parameters))

    @property
    def kr_standard_error(self) -> Array:
        """(n_c,) standard errors in 1/s."""
        errors: Array = self.kr_per_s * np.sqrt(np.diag(self.covariance)[: self.n_states])
        return errors

    @property
    def strength_standard_error(self) -> Array:
        """(n_c,) standard errors of `strength`, in the signal's unit."""
        n, deviation = self.n_states, np.sqrt(np.diag(self.covariance))
        if self.rank_one:
            start = n + self.amplitude.shape[1] - 1
        else:
            strongest = int(np.argmax(self.amplitude.sum(axis=0)))
            start = n + strongest * (n + int(self.has_offset))
        errors: Array = deviation[start : start + n]
        return errors

    @property
    def dead(self) -> NDArray[np.bool_]:
        """(n_c,) states without amplitude."""
        return np.asarray((self.amplitude <= 0).all(axis=1))

    @property
    def degenerate(self) -> bool:
        """Whether a state has died or two have the same rate: the data do not carry so many."""
        ratios = self.kr_per_s[:-1] / self.kr_per_s[1:]
        return bool(self.dead.any() or (ratios < _SAME_RATE).any())

    def predict(self, t_s: Array, exposure_s: Array) -> Array:
        """Return (n, n_channels) the modelled signal, averaged over exposures that begin at `t_s`."""
        g, _ = exposed_decay(self.kr_per_s, t_s, exposure_s)
        signal: Array = g @ self.amplitude + self.offset
        return signal


@dataclass(frozen=True)
class Problem:
    """A decay as `varpro` takes it.

    Args:
        data: the decay.
        n_states: number of exponentials.
        offset: whether each channel has a constant.
        rank_one: whether one colour serves all states.
        reference: the channel whose colour is 1.
        W: (n, n_channels, n_channels) whitening.
        y: (n_blocks, m) whitened data: one block if `rank_one`, else one a channel.
    """

    data: DecayData
    n_states: int
    offset: bool
    rank_one: bool
    reference: int
    W: Array
    y: Array

    @property
    def n_parameters(self) -> int:
        """Number of free parameters."""
        return n_parameters(self.data, self.n_states, offset=self.offset, rank_one=self.rank_one)

    @property
    def signed(self) -> NDArray[np.bool_]:
        """(n_x,) which linear parameters may be negative: offsets."""
        n_offsets = (self.data.signal.shape[1] if self.rank_one else 1) if self.offset else 0
        return np.arange(self.n_states + n_offsets) >= self.n_states

    def basis(self, theta: Array) -> tuple[Array, Array]:
        """Return Φ and dΦ/dθ, weighted."""
        data, n_states, W = self.data, self.n_states, self.W
        n, n_channels = data.signal.shape
        g, dg = exposed_decay(np.exp(theta[:n_states]), data.t_s, data.exposure_s)
        i = np.arange(n_states)
        if not self.rank_one:
            weight = np.diagonal(W, axis1=1, axis2=2).T  # (n_channels, n)
            phi = np.empty((n_channels, n, n_states + int(self.offset)), theta.dtype)
            phi[:, :, :n_states] = weight[:, :, None] * g
            phi[:, :, n_states:] = weight[:, :, None]
            dphi = np.zeros((n_states, *phi.shape), theta.dtype)
            dphi[i, :, :, i] = weight[None] * dg.T[:, None, :]
            return phi, dphi
        seen = W @ np.insert(theta[n_states:], self.reference, 1.0)  # (n, n_channels)
        n_x = n_states + n_channels * int(self.offset)
        phi = np.empty((n, n_channels, n_x), theta.dtype)
        phi[:, :, :n_states] = seen[:, :, None] * g[:, None, :]
        if self.offset:
            phi[:, :, n_states:] = W
        dphi = np.zeros((theta.size, n, n_channels, n_x), theta.dtype)
        dphi[i, :, :, i] = seen[None] * dg.T[:, :, None]
        for j, channel in enumerate(self.other_channels):
            dphi[n_states + j, :, :, :n_states] = W[:, :, channel, None] * g[:, None, :]
        return phi.reshape(1, n * n_channels, n_x), dphi.reshape(theta.size, 1, n * n_channels, n_x)

    @property
    def other_channels(self) -> NDArray[np.intp]:
        """The channels but the reference."""
        return np.delete(np.arange(self.data.signal.shape[1]), self.reference)

    def reweighted(self, model: Array) -> Problem:
        """Return the problem with the noise that the values would have about `model`."""
        return _weighted(replace(self, data=self.data.weighted_by(model)))

    def solve(self, start: Array, **options: object) -> varpro.Solution:
        """Minimise from one θ; `options` are those of `varpro.solve`."""
        return varpro.solve(self.basis, self.y, start, signed=self.signed, **options)  # type: ignore[arg-type]

    def model(self, found: varpro.Solution) -> Array:
        """Return (n, n_channels) the modelled signal of a solution."""
        amplitude, offset = self.linear(found)
        g, _ = exposed_decay(np.exp(found.theta[: self.n_states]), self.data.t_s, self.data.exposure_s)
        signal: Array = g @ amplitude + offset
        return signal

    def linear(self, found: varpro.Solution) -> tuple[Array, Array]:
        """Return amplitude (n_c, n_channels) and offset (n_channels,) of a solution."""
        n_states, n_channels = self.n_states, self.data.signal.shape[1]
        x = found.linear
        if self.rank_one:
            colour = np.insert(found.theta[n_states:], self.reference, 1.0)
            return x[0, :n_states, None] * colour, (x[0, n_states:] if self.offset else np.zeros(n_channels))
        return x[:, :n_states].T, (x[:, n_states] if self.offset else np.zeros(n_channels))


def n_parameters(data: DecayData, n_states: int, *, offset: bool, rank_one: bool) -> int:
    """Return how many parameters a fit to `data` has."""
    n_channels = int(data.signal.shape[1])
    own = n_states + n_channels - 1 if rank_one else n_states * n_channels
    return n_states + own + n_channels * int(offset)


def problem(data: DecayData, n_states: int, *, offset: bool = False, rank_one: bool = True) -> Problem:
    """State a fit of `n_states` exponentials.

    Raises:
        PhoslabError: fewer values than parameters.
    """
    if data.repeatability and not rank_one:
        raise ValueError("errors that channels share need rank one")
    empty = np.zeros(0)
    stated = Problem(data, n_states, offset, rank_one, int(np.argmax(_first_colour(data))), empty, empty)
    if data.n_values < stated.n_parameters:
        raise PhoslabError(
            f"has {data.n_values} usable values, too few for {stated.n_parameters} parameters",
            field="the decay",
            remedy="Take more frames, expose them better, or fit fewer states.",
        )
    return _weighted(stated)


def _weighted(stated: Problem) -> Problem:
    W = stated.data.whitening()
    y = (W @ np.where(stated.data.used, stated.data.signal, 0.0)[:, :, None])[:, :, 0]
    return replace(stated, W=W, y=y.reshape(1, -1) if stated.rank_one else y.T.copy())


def fit_decay(
    data: DecayData,
    n_states: int,
    *,
    offset: bool = False,
    rank_one: bool = True,
    polish: bool = True,
    near: Sequence[Array] = (),
) -> DecayFit:
    """Fit `n_states` exponentials, from starts that need no guess.

    Args:
        offset: also fit a constant for each channel.
        rank_one: one colour for all states, or amplitudes of each channel's own.
        polish: go on to the last digit.
        near: further starts, as log kr (n_c,), tried besides the grid's.

    Raises:
        PhoslabError: fewer values than parameters.
    """
    stated = problem(data, n_states, offset=offset, rank_one=rank_one)
    starts = [*_starting_rates(stated), *near]
    colours = _first_colour(data)[stated.other_channels] if rank_one else np.zeros(0)
    found = [stated.solve(np.concatenate([log_kr, colours]), polish=False) for log_kr in starts]
    best = min(found, key=lambda s: s.chi2)
    if data.law is not None or (data.repeatability and data.expected is None):
        stated, best = _iterate_weights(stated, best)
    if polish:
        best = min((stated.solve(best.theta), best), key=lambda s: s.chi2 * (1 + 1e-12 * (s is best)))
    return conclude(stated, best)


def _iterate_weights(stated: Problem, found: varpro.Solution) -> tuple[Problem, varpro.Solution]:
    """Refit with the noise about the last model until the rates stay."""
    for _ in range(30):
        stated = stated.reweighted(stated.model(found))
        again = stated.solve(found.theta, polish=False)
        still = float(np.abs(again.theta - found.theta).max()) < 1e-9
        found = again
        if still:
            break
    return stated, found


def conclude(stated: Problem, found: varpro.Solution) -> DecayFit:
    """Turn a solution into a fit: states fast to slow, in every array."""
    data, n = stated.data, stated.n_states
    n_channels = data.signal.shape[1]
    order = np.argsort(-found.theta[:n])
    n_theta, n_x = found.theta.size, found.linear.shape[1]
    blocks = np.arange(len(found.linear))[:, None] * n_x
    inside = np.concatenate([order, np.arange(n, n_x)])
    permutation = np.concatenate([order, np.arange(n, n_theta), (n_theta + blocks + inside).ravel()])
    covariance = varpro.covariance(stated.basis, found)
    amplitude, offset = stated.linear(found)
    residual = found.residual.reshape(-1, n_channels) if stated.rank_one else found.residual.T
    dof = data.n_values - stated.n_parameters
    return DecayFit(
        kr_per_s=np.exp(found.theta[order]),
        amplitude=amplitude[order],
        offset=offset,
        rank_one=stated.rank_one,
        has_offset=stated.offset,
        theta=np.concatenate([found.theta[order], found.theta[n:]]),
        covariance=covariance[np.ix_(permutation, permutation)] * misfit(found.chi2, dof),
        residual=residual,
        chi2=found.chi2,
        dof=dof,
        data=data,
    )


def misfit(chi2: float, dof: int) -> float:
    """Return chi2 / dof where it is too large for chance (1 in 1,000), else 1: errors are widened by its root.

    Widening by every chi2 / dof > 1 would widen half of all sound fits, and none of them narrowed back.
    """
    from scipy.special import chdtrc

    return chi2 / dof if dof > 0 and chdtrc(dof, chi2) < 1e-3 else 1.0


def exposed_decay(kr: Array, t_s: Array, exposure_s: Array) -> tuple[Array, Array]:
    """Return (n, n_c) exp(-kr t) φ(kr τ) and its derivative by log kr."""
    start = np.exp(-t_s[:, None] * kr)
    if not exposure_s.any():
        return start, -t_s[:, None] * kr * start
    x = exposure_s[:, None] * kr
    phi = np.divide(-np.expm1(-x), x, out=np.ones_like(x), where=x > 0)
    return start * phi, start * (np.exp(-x) - phi - t_s[:, None] * kr * phi)


def _first_colour(data: DecayData) -> Array:
    """Return (n_channels,) a first guess of the colour, its largest 1."""
    weight = 1 / data.total_sigma
    y = np.where(data.used, data.signal, 0.0) * weight
    light, information = (y * weight).sum(axis=0), (weight**2).sum(axis=0)
    colour = np.divide(light, information, out=np.zeros_like(light), where=information > 0)
    scaled: Array = colour / (np.abs(colour).max() or 1.0)
    return scaled


def rate_limits(data: DecayData) -> tuple[float, float]:
    """Return the rates in 1/s between which a search begins: a tenth of 1 / duration, and 3 / first step."""
    duration = data.end_s - min(0.0, float(data.t_s.min()))
    t = np.sort(data.t_s)
    steps = np.diff(t)
    # Late values that almost coincide (of two runs in one table) tell nothing of fast rates.
    steps = steps[steps > 0.01 * (t[1:] - t[0])]
    # The first steps are the short ones of a series spaced by logarithm.
    step = float(np.median(steps[: max(3, steps.size // 4)])) if steps.size else duration
    return 0.1 / duration, 3 / max(step, duration * 1e-6)


def _starting_rates(stated: Problem) -> list[Array]:
    """Return the best few sets of log rates on a logarithmic grid, by a common colour, amplitudes not negative."""
    data, n_states = stated.data, stated.n_states
    low, high = rate_limits(data)
    per_decade = _STARTS_PER_DECADE if n_states < 4 else 3
    grid = np.geomspace(low, high, max(n_states + 2, int(per_decade * np.log10(high / low))))
    colour = _first_colour(data)
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
