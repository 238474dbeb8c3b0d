"""Fit a decay: rates that all channels share, with their errors; the model is in `decay_problem.py`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting import varpro
from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.decay_problem import Problem, exposed_decay, first_colour, problem
from phoslab.fitting.decay_starts import starting_rates

Array = NDArray[np.float64]

MOST_STATES = 4

# Two rates nearer than this ratio are one rate written twice.
_SAME_RATE = 1.05
# A rate beyond these, by the longest and the shortest time measured, is a constant or a flash: nothing tells which.
_SLOWEST, _FASTEST = 1e-4, 1e3


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
    def aic(self) -> float:
        """Akaike's information criterion for known σ."""
        return self.chi2 + 2 * self.n_parameters

    @property
    def aicc(self) -> float:
        """The same, corrected for small samples."""
        p, n = self.n_parameters, self.dof + self.n_parameters
        return self.aic + (2 * p * (p + 1) / (n - p - 1) if n > p + 1 else np.inf)

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
        if not self.rank_one:
            strongest = int(np.argmax(self.amplitude.sum(axis=0)))
            return self.free_standard_error[: self.n_states, strongest]
        start = self.n_states + self.amplitude.shape[1] - 1
        errors: Array = np.sqrt(np.diag(self.covariance))[start : start + self.n_states]
        return errors

    @property
    def misses(self) -> bool:
        """Whether it misses the data by more than chance: then there is no true rate to bracket."""
        return misfit(self.chi2, self.dof) > 1

    def farthest_off(self) -> tuple[float, float]:
        """Return the exposure's middle, in s, at which the fit is farthest off by clearly more than noise, and by which
        share of the signal."""
        data = self.data
        off = np.abs(self.predict(data.t_s, data.exposure_s) - data.signal)
        clear = (off > 3 * data.total_sigma) & (data.signal != 0)
        share = np.divide(off, np.abs(data.signal), out=np.zeros_like(off), where=clear)
        frame = int(np.argmax(share.max(axis=1)))
        return float(data.middle_s[frame]), float(share[frame].max())

    @property
    def free_standard_error(self) -> Array:
        """(n_c, or n_c + 1 with an offset, n_channels) standard errors of A and O, where channels are free."""
        errors: Array = np.sqrt(np.diag(self.covariance)[self.n_states :])
        return errors.reshape(self.amplitude.shape[1], -1).T

    @property
    def dead(self) -> NDArray[np.bool_]:
        """(n_c,) states without amplitude."""
        return np.asarray((self.amplitude <= 0).all(axis=1))

    @property
    def degenerate(self) -> bool:
        """Whether a state has died, is a second constant, or has another's rate: the data do not carry so many."""
        ratios = self.kr_per_s[:-1] / self.kr_per_s[1:]
        constant = self.has_offset and self.kr_per_s[-1] * self.data.end_s < _SLOWEST
        return bool(self.dead.any() or constant or (ratios < _SAME_RATE).any())

    def predict(self, t_s: Array, exposure_s: Array) -> Array:
        """Return (n, n_channels) the modelled signal, averaged over exposures that begin at `t_s`."""
        g, _ = exposed_decay(self.kr_per_s, t_s, exposure_s)
        signal: Array = g @ self.amplitude + self.offset
        return signal


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
    starts = [*starting_rates(stated), *near]
    colours = first_colour(data)[stated.other_channels] if rank_one else np.zeros(0)
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
