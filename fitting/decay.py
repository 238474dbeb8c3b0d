"""Decay: sums of exponentials with one colour, fitted to all channels at once (Nalbach 2017, 8.4.4).

The model of channel c at time t after lamp-off, averaged over the exposure τ that begins at t:

    S_c(t) = C_c Σ_i A_i exp(-kr_i t) φ(kr_i τ),    φ(x) = (1 - exp(-x)) / x

The spectrum of the glow is constant in time, so one colour C (its largest channel is 1) serves all states, and
one amplitude A_i and rate kr_i a state serve all channels ("rank one").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.fitting import varpro

Array = NDArray[np.float64]

MOST_STATES = 3

# Rates from which searches start: a few per decade, because the minimum's basin is wide in log kr.
_STARTS_PER_DECADE = 4
_KEPT_STARTS = 6
# Two rates nearer than this ratio are one rate written twice.
_SAME_RATE = 1.05


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
    """

    t_s: Array
    exposure_s: Array
    signal: Array
    sigma: Array
    repeatability: float = 0.0
    channels: tuple[str, ...] = ("R", "G", "B")

    def __post_init__(self) -> None:
        if not np.isfinite(self.signal[self.used]).all() or not (self.sigma > 0).all():
            raise ValueError("signal must be finite and sigma positive wherever a value is used")

    @property
    def used(self) -> NDArray[np.bool_]:
        """(n, n_channels) the values that take part."""
        return np.isfinite(self.sigma)

    @property
    def total_sigma(self) -> Array:
        """(n, n_channels) noise and repeatability together; infinite for a value that is left out."""
        return np.where(self.used, np.hypot(self.sigma, self.repeatability * self.signal), np.inf)

    def whitening(self) -> Array:
        """Return (n, n_channels, n_channels): matrices that turn a frame's errors into unit, unrelated ones.

        A frame's covariance is D (1 + u uᵀ) D with D = diag(σ) and u = repeatability * signal / σ: the noise of
        the channels is their own, the frame's scale is common. Its inverse root is closed; rows and columns of
        values that are left out are 0.
        """
        u = self.repeatability * np.where(self.used, self.signal / self.sigma, 0.0)
        u2 = (u**2).sum(axis=1)
        shrink = np.divide(1 - 1 / np.sqrt(1 + u2), u2, out=np.zeros_like(u2), where=u2 > 0)
        roots = np.eye(u.shape[1]) - shrink[:, None, None] * u[:, :, None] * u[:, None, :]
        matrices: Array = roots / self.sigma[:, None, :]
        return matrices

    @property
    def n_values(self) -> int:
        """How many values take part."""
        return int(np.count_nonzero(self.used))

    def take(self, frames: slice) -> DecayData:
        """Return the decay with only some of its frames."""
        return replace(
            self,
            t_s=self.t_s[frames],
            exposure_s=self.exposure_s[frames],
            signal=self.signal[frames],
            sigma=self.sigma[frames],
        )


@dataclass(frozen=True)
class DecayFit:
    """A fitted decay: n_c states, fast to slow.

    Args:
        kr_per_s: (n_c,) re-radiation rates.
        amplitude: (n_c,) amplitudes A_i at t = 0, in the signal's unit, of the strongest channel.
        colour: (n_channels,) C, largest 1.
        covariance: (2 n_c + n_channels - 1,)² of (log kr, colour without its largest, A), as fitted, scaled by
            chi2 / dof where that exceeds 1, so that misfit widens the errors.
        residual: (n, n_channels) in standard deviations, whitened; 0 where a value was left out.
        chi2: sum of squares of `residual`.
        dof: values less parameters.
    """

    kr_per_s: Array
    amplitude: Array
    colour: Array
    covariance: Array
    residual: Array
    chi2: float
    dof: int

    @property
    def n_states(self) -> int:
        """Number of exponentials, n_c."""
        return len(self.kr_per_s)

    @property
    def n_parameters(self) -> int:
        """Number of free parameters."""
        return len(self.covariance)

    @property
    def aicc(self) -> float:
        """Akaike's information criterion for known σ, corrected for small samples."""
        p, n = self.n_parameters, self.dof + self.n_parameters
        return self.chi2 + 2 * p + (2 * p * (p + 1) / (n - p - 1) if n > p + 1 else np.inf)

    @property
    def kr_standard_error(self) -> Array:
        """(n_c,) standard errors in 1/s."""
        errors: Array = self.kr_per_s * np.sqrt(np.diag(self.covariance)[: self.n_states])
        return errors

    @property
    def amplitude_standard_error(self) -> Array:
        """(n_c,) standard errors in the signal's unit."""
        errors: Array = np.sqrt(np.diag(self.covariance)[-self.n_states :])
        return errors

    @property
    def degenerate(self) -> bool:
        """Whether a state has died or two have the same rate: the data do not carry so many."""
        ratios = self.kr_per_s[:-1] / self.kr_per_s[1:]
        return bool((self.amplitude <= 0).any() or (ratios < _SAME_RATE).any())

    def predict(self, t_s: Array, exposure_s: Array) -> Array:
        """Return (n, n_channels) the modelled signal, averaged over exposures that begin at `t_s`."""
        g, _ = _exposed_decay(self.kr_per_s, t_s, exposure_s)
        signal: Array = (g @ self.amplitude)[:, None] * self.colour
        return signal


def fit_decay(data: DecayData, n_states: int) -> DecayFit:
    """Fit `n_states` exponentials, from starts that need no guess.

    Raises:
        PhoslabError: fewer values than parameters.
    """
    n_parameters = 2 * n_states + data.signal.shape[1] - 1
    if data.n_values <= n_parameters:
        raise PhoslabError(
            f"has {data.n_values} usable values, too few for {n_parameters} parameters",
            field="the decay",
            remedy="Take more frames, expose them better, or fit fewer states.",
        )
    W = data.whitening()
    y = (W @ np.where(data.used, data.signal, 0.0)[:, :, None])[:, :, 0]
    first_colour, series, series_weight = _first_colour(data)
    reference = int(np.argmax(first_colour))
    others = np.delete(np.arange(data.signal.shape[1]), reference)

    def basis(theta: Array) -> tuple[Array, Array]:
        colour = np.insert(theta[n_states:], reference, 1.0)
        g, dg = _exposed_decay(np.exp(theta[:n_states]), data.t_s, data.exposure_s)
        seen = W @ colour  # (n, n_channels)
        phi = seen[:, :, None] * g[:, None, :]  # (n, n_channels, n_c)
        dphi = np.zeros((theta.size, *phi.shape))
        for i in range(n_states):
            dphi[i, :, :, i] = seen * dg[:, i, None]
        for j, channel in enumerate(others):
            dphi[n_states + j] = W[:, :, channel, None] * g[:, None, :]
        return phi.reshape(y.size, n_states), dphi.reshape(theta.size, y.size, n_states)

    colour_start = first_colour[others] / first_colour[reference]
    solutions = [
        varpro.solve(basis, y.ravel(), np.concatenate([np.log(kr), colour_start]))
        for kr in _starting_rates(data, series, series_weight, n_states)
    ]
    best = min(solutions, key=lambda s: s.chi2)
    dof = data.n_values - n_parameters
    # States fast to slow, in every array.
    order = np.argsort(-best.theta[:n_states])
    permutation = np.concatenate([order, np.arange(n_states, best.theta.size), best.theta.size + order])
    cov = varpro.covariance(basis, best) * max(1.0, best.chi2 / dof)
    colour = np.insert(best.theta[n_states:], reference, 1.0)
    return DecayFit(
        kr_per_s=np.exp(best.theta[:n_states][order]),
        amplitude=best.linear[order],
        colour=colour,
        covariance=cov[np.ix_(permutation, permutation)],
        residual=best.residual.reshape(y.shape),
        chi2=best.chi2,
        dof=dof,
    )


def fit_candidates(data: DecayData, most_states: int = MOST_STATES) -> list[DecayFit]:
    """Fit 1, 2, ... `most_states` exponentials, as many as the data have values for."""
    fits = []
    for n_states in range(1, most_states + 1):
        if n_states > 1 and data.n_values <= 2 * n_states + data.signal.shape[1] - 1:
            break
        fits.append(fit_decay(data, n_states))
    return fits


def choose(fits: Sequence[DecayFit]) -> DecayFit:
    """Return the fit of smallest AICc among those whose states are all alive and distinct."""
    return min((f for f in fits if f.n_states == 1 or not f.degenerate), key=lambda f: f.aicc)


def _exposed_decay(kr: Array, t_s: Array, exposure_s: Array) -> tuple[Array, Array]:
    """Return (n, n_c) exp(-kr t) φ(kr τ) and its derivative by log kr."""
    x = exposure_s[:, None] * kr
    start = np.exp(-t_s[:, None] * kr)
    phi = np.divide(-np.expm1(-x), x, out=np.ones_like(x), where=x > 0)
    return start * phi, start * (np.exp(-x) - phi - t_s[:, None] * kr * phi)


def _first_colour(data: DecayData) -> tuple[Array, Array, Array]:
    """Return a first guess of the colour, and the decay seen through it (n,), weighted, with its weights."""
    weight = 1 / data.total_sigma
    y = np.where(data.used, data.signal, 0.0) * weight
    light, information = (y * weight).sum(axis=0), (weight**2).sum(axis=0)
    colour = np.divide(light, information, out=np.zeros_like(light), where=information > 0)
    colour /= np.abs(colour).max() or 1.0
    series_weight = np.sqrt(((weight * colour) ** 2).sum(axis=1))
    series = np.divide(
        (y * weight * colour).sum(axis=1), series_weight, out=np.zeros(len(y)), where=series_weight > 0
    )
    return colour, series, series_weight


def _starting_rates(data: DecayData, series: Array, weight: Array, n_states: int) -> list[Array]:
    """Return the best few sets of rates on a logarithmic grid, from a tenth of 1/duration to 3/first step."""
    duration = data.t_s[-1] + data.exposure_s[-1] - min(0.0, data.t_s[0])
    step = max(float(np.median(np.diff(data.t_s))) if data.t_s.size > 1 else duration, duration * 1e-4)
    low, high = 0.1 / duration, 3 / step
    grid = np.geomspace(low, high, max(n_states + 2, int(_STARTS_PER_DECADE * np.log10(high / low))))
    g = weight[:, None] * _exposed_decay(grid, data.t_s, data.exposure_s)[0]
    ranked = []
    for chosen in combinations(range(grid.size), n_states):
        phi = g[:, chosen]
        ranked.append((float(np.sum((series - phi @ varpro.linear_part(phi, series)) ** 2)), chosen))
    ranked.sort()
    return [grid[list(chosen)] for _, chosen in ranked[:_KEPT_STARTS]]
