"""Repeated measurements of known decays: how often a fit is right, how its numbers scatter, how honest they are."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting.decay import DecayData, DecayFit, fit_decay
from phoslab.fitting.intervals import rate_intervals
from phoslab.fitting.screening import Screened
from phoslab.fitting.table_fit import fit_screened

Array = NDArray[np.float64]

T_S: Array = np.linspace(0.0, 180.0, 37)
SCALES = np.array([1.0, 0.6, 0.25])


@dataclass(frozen=True)
class Case:
    """A decay of three channels: rates, amplitudes of a peak of 1, σ and offset of the peak."""

    name: str
    kr: tuple[float, ...]
    amplitude: tuple[float, ...]
    sigma: float
    offset: float = 0.0

    @property
    def light(self) -> Array:
        """(37, 3) without noise."""
        signal: Array = np.exp(-np.outer(T_S, self.kr)) @ np.array(self.amplitude)
        return np.asarray(signal[:, None] * SCALES + self.offset)

    def draw(self, seed: int) -> DecayData:
        """Return one measurement."""
        noise = np.random.default_rng(seed).normal(0, self.sigma, self.light.shape)
        return DecayData(T_S, np.zeros(T_S.size), self.light + noise, np.full(noise.shape, self.sigma))

    @property
    def bound(self) -> Array:
        """(n_c,) the Cramér-Rao bound of the rates, amplitudes of each channel free."""
        exact = replace(self.draw(0), signal=self.light)
        return fit_decay(exact, len(self.kr), rank_one=False).kr_standard_error


USUAL = Case("0.132 and 0.009 1/s", (0.132, 0.009), (0.7, 0.3), 0.002)
NEAR = Case("0.03 and 0.02 1/s", (0.03, 0.02), (0.5, 0.5), 0.001)
COUNTED = (
    Case("1: 0.03", (0.03,), (1.0,), 0.002),
    Case("2: 0.132, 0.009", (0.132, 0.009), (0.5, 0.5), 0.002),
    Case("2: 0.1, 0.05", (0.1, 0.05), (0.5, 0.5), 0.002),
    Case("3: 0.3, 0.1, 0.03", (0.3, 0.1, 0.03), (1 / 3, 1 / 3, 1 / 3), 0.0005),
    Case("2 and an offset of 0.5 %", (0.132, 0.009), (0.5, 0.5), 0.002, 0.005),
)


def _free(data: DecayData, n_states: int) -> DecayFit:
    return fit_decay(data, n_states, rank_one=False, polish=False)


@dataclass(frozen=True)
class Recovered:
    """Rates of repeated draws: (n, n_c), and seconds of processor a fit."""

    rates: Array
    seconds: float

    def within(self, truth: tuple[float, ...], share: float = 0.1) -> float:
        """Return how many of the draws have every rate so near."""
        return float(np.mean((np.abs(self.rates / truth - 1) < share).all(axis=1)))


def recover(case: Case, n: int, fit: Callable[[DecayData], Array] | None = None) -> Recovered:
    """Fit `n` draws; `fit` returns rates, fast to slow, or NaN where it fails."""
    chosen = fit or (lambda data: _free(data, len(case.kr)).kr_per_s)
    started = time.process_time()
    rates = np.array([chosen(case.draw(seed)) for seed in range(n)])
    return Recovered(rates, (time.process_time() - started) / n)


def curve_fit_rates(start: tuple[float, float]) -> Callable[[DecayData], Array]:
    """Return a fit by scipy's curve_fit, amplitudes from 1, rates from `start`: NaN where it gives up."""
    import warnings

    from scipy.optimize import OptimizeWarning, curve_fit

    warnings.simplefilter("ignore", OptimizeWarning)

    def model(t: Array, k1: float, k2: float, *a: float) -> Array:
        g = np.exp(-np.outer(T_S, (k1, k2)))
        signal: Array = (g @ np.reshape(a, (2, 3))).T.ravel()
        return signal

    def fit(data: DecayData) -> Array:
        try:
            with np.errstate(all="ignore"):
                found, _ = curve_fit(
                    model,
                    np.tile(T_S, 3),
                    data.signal.T.ravel(),
                    [*start, *[1.0] * 6],
                    data.sigma.T.ravel(),
                    maxfev=5000,
                )
        except (RuntimeError, ValueError):
            return np.full(2, np.nan)
        return np.sort(found[:2])[::-1]

    return fit


def coverage(case: Case, n: int) -> tuple[Array, Array]:
    """Return how often intervals of 95 % held each true rate: by profile likelihood, and by the covariance alone."""
    profile, normal = np.zeros(len(case.kr)), np.zeros(len(case.kr))
    for seed in range(n):
        fit = _free(case.draw(seed), len(case.kr))
        ends = rate_intervals(fit)
        profile += (ends[:, 0] <= case.kr) & (case.kr <= ends[:, 1])
        normal += np.abs(fit.kr_per_s - case.kr) <= 1.96 * fit.kr_standard_error
    return profile / n, normal / n


def counted(case: Case, n: int) -> dict[str, float]:
    """Return how often the choice and each criterion give the true number of states."""
    right: dict[str, int] = {}
    for seed in range(n):
        result = fit_screened(Screened(case.draw(seed), True, (), {}))
        votes = {"chosen": result.fit.n_states} | {k: v.n_states for k, v in result.selection.votes.items()}
        for name, states in votes.items():
            right[name] = right.get(name, 0) + (states == len(case.kr))
    return {name: count / n for name, count in right.items()}


def biases(n: int) -> Iterator[tuple[str, Array, Array]]:
    """Yield a situation, the relative bias of the two rates, and its standard error."""
    truth = np.array(USUAL.kr)

    def clipped(seed: int) -> DecayData:
        data = USUAL.draw(seed)
        signal = data.signal.copy()
        signal[0] *= 0.8
        return replace(data, signal=signal)

    def electrons(seed: int) -> DecayData:
        counts = np.random.default_rng(seed).poisson(200 * USUAL.light).astype(float)
        return DecayData(T_S, np.zeros(T_S.size), counts, np.sqrt(np.maximum(counts, 1)))

    def whole(data: DecayData) -> Array:
        return fit_screened(Screened(data, True, (), {}), states=2, offset="none").fit.kr_per_s

    for name, make, fit in (
        ("first value clipped at 80 %, phoslab", clipped, whole),
        ("first value clipped at 80 %, kept", clipped, lambda d: _free(d, 2).kr_per_s),
        ("200 electrons at the peak, phoslab", electrons, whole),
        ("200 electrons at the peak, weights from the data", electrons, lambda d: _free(d, 2).kr_per_s),
    ):
        rates = np.array([fit(make(seed)) for seed in range(n)]) / truth
        yield name, rates.mean(axis=0) - 1, rates.std(axis=0) / np.sqrt(n)
