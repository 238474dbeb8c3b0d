"""Repeated measurements of known decays: how often a fit is right, how its numbers scatter, how honest they are.

A function of a seed makes one measurement, fits it, and returns what came out; `Draws` runs it over many seeds.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import active_children, get_context
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting.decay import DecayFit, fit_decay
from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.decay_problem import exposed_decay
from phoslab.fitting.intervals import rate_intervals
from phoslab.fitting.screening import Screened
from phoslab.fitting.table_fit import fit_screened

Array = NDArray[np.float64]
T = TypeVar("T")

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

    def clipped(self, seed: int) -> DecayData:
        """Return one whose first value shows only 80 % of its light."""
        data = self.draw(seed)
        signal = data.signal.copy()
        signal[0] *= 0.8
        return replace(data, signal=signal)

    def electrons(self, seed: int) -> DecayData:
        """Return one of 200 electrons at the peak; σ as a camera states it, from the values themselves."""
        counts = np.random.default_rng(seed).poisson(200 * self.light).astype(float)
        return DecayData(T_S, np.zeros(T_S.size), counts, np.sqrt(np.maximum(counts, 1)))

    def response(self, variance: Array) -> Array:
        """Return (n_c, 37 * 3) by how much each log rate of a weighted fit answers to each error, to first order.

        Args:
            variance: (37, 3) of the values; infinite for one that is left out.
        """
        n, n_channels = len(self.kr), SCALES.size
        g, dg = exposed_decay(np.array(self.kr), T_S, np.zeros(T_S.size))
        derivatives = np.zeros((T_S.size, n_channels, n * (1 + n_channels)))
        for c, scale in enumerate(SCALES):
            derivatives[:, c, :n] = scale * np.array(self.amplitude) * dg
            derivatives[:, c, n * (1 + c) : n * (2 + c)] = g
        J = derivatives.reshape(-1, n * (1 + n_channels))
        weighted = J / variance.reshape(-1, 1)
        return np.asarray(np.linalg.solve(weighted.T @ J, weighted.T)[:n], float)

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
    Case("2: 0.132, 0.009, and an offset of 0.5 %", (0.132, 0.009), (0.5, 0.5), 0.002, 0.005),
)


def _free(data: DecayData, n_states: int) -> DecayFit:
    return fit_decay(data, n_states, rank_one=False, polish=False)


@dataclass(frozen=True)
class Recovered:
    """Rates of repeated draws: (n, n_c), NaN where a fit failed; and seconds of processor a fit, the median."""

    rates: Array
    seconds: float

    def within(self, truth: tuple[float, ...], share: float = 0.1) -> float:
        """Return how many of the draws have every rate so near."""
        return float(np.mean((np.abs(self.rates / truth - 1) < share).all(axis=1)))


Rates = Callable[[DecayData], Array]
"""A fit of two states or more: (n_c,) rates, fast to slow, NaN where it fails."""


def our_rates(data: DecayData, n_states: int = 2) -> Array:
    """Return (n_c,) the rates of our fit, from no guess."""
    return _free(data, n_states).kr_per_s


def _recover(case: Case, fit: Rates, seed: int) -> tuple[Array, float]:
    data = case.draw(seed)
    started = time.process_time()
    rates = fit(data)
    return rates, time.process_time() - started


def _covered(case: Case, seed: int) -> Array:
    """Return (2, n_c) whether intervals of 95 % hold each true rate: profile likelihood's, and the covariance's."""
    fit = _free(case.draw(seed), len(case.kr))
    ends = rate_intervals(fit)
    profile = (ends[:, 0] <= case.kr) & (case.kr <= ends[:, 1])
    return np.array([profile, np.abs(fit.kr_per_s - case.kr) <= 1.96 * fit.kr_standard_error], float)


def _votes(case: Case, seed: int) -> dict[str, int]:
    """Return the number of states that is chosen, and what each criterion alone would choose."""
    result = fit_screened(Screened(case.draw(seed), True, (), {}))
    return {"chosen": result.fit.n_states} | {k: v.n_states for k, v in result.selection.votes.items()}


def whole_rates(data: DecayData) -> Array:
    """Return (2,) the rates that `phoslab fit` gives for two states without offset."""
    return fit_screened(Screened(data, True, (), {}), states=2, offset="none").fit.kr_per_s


@dataclass(frozen=True)
class Situation:
    """A way to measure the usual case, with what is known of it without a fit.

    Args:
        name: for people.
        make: seed -> one measurement.
        variance: (37, 3) of its values; infinite for one that should be left out.
        peak: what the case's peak of 1 is in its values.
    """

    name: str
    make: Callable[[int], DecayData]
    variance: Array
    peak: float = 1.0


_BUT_FIRST = np.where(np.arange(T_S.size)[:, None] > 0, 1.0, np.inf)
CLIPPED = Situation("first value clipped at 80 %", USUAL.clipped, USUAL.sigma**2 * _BUT_FIRST * np.ones(3))
ELECTRONS = Situation("200 electrons at the peak", USUAL.electrons, 200 * USUAL.light, peak=200.0)


def _deviation(situation: Situation, fit: Rates, response: Array, seed: int) -> Array:
    """Return (2, n_c) the relative error of each rate, and what of it is an answer to noise, of mean 0."""
    data = situation.make(seed)
    noise = np.where(np.isfinite(situation.variance), data.signal - situation.peak * USUAL.light, 0.0)
    return np.stack([fit(data) / USUAL.kr - 1, response @ noise.ravel() / situation.peak])


class Draws:
    """Runs draws, on every core or in this process.

    Args:
        executor: runs them; None: this process.
        tick: called with the number of draws that are done.
    """

    def __init__(
        self, executor: Executor | None = None, tick: Callable[[int], None] = lambda n: None
    ) -> None:
        self._executor, self.tick = executor, tick

    def each(self, work: Callable[[int], T], n: int) -> Iterator[T]:
        """Yield what `work` makes of 0 to n - 1, in order."""
        # In pieces of a second or so: larger ones would end unevenly, smaller ones wait for one another.
        results = (
            map(work, range(n))
            if self._executor is None
            else self._executor.map(work, range(n), chunksize=max(1, min(20, n // 16)))
        )
        for result in results:
            self.tick(1)
            yield result

    def recover(self, case: Case, n: int, fit: Rates | None = None) -> Recovered:
        """Fit `n` draws."""
        chosen = fit or partial(our_rates, n_states=len(case.kr))
        rates, seconds = zip(*self.each(partial(_recover, case, chosen), n), strict=True)
        return Recovered(np.array(rates), float(np.median(seconds)))

    def coverage(self, case: Case, n: int) -> tuple[Array, Array]:
        """Return the share of intervals that hold each true rate: by profile likelihood, and by covariance alone."""
        profile, normal = np.mean(list(self.each(partial(_covered, case), n)), axis=0)
        return profile, normal

    def counted(self, case: Case, n: int) -> dict[str, float]:
        """Return how often the choice and each criterion give the true number of states."""
        votes = list(self.each(partial(_votes, case), n))
        return {name: float(np.mean([v.get(name) == len(case.kr) for v in votes])) for name in votes[0]}

    def bias(self, situation: Situation, fit: Rates, n: int) -> tuple[Array, Array]:
        """Return the mean relative error of the usual case's rates, and its standard error.

        The first-order answer to noise has mean 0 whatever the draws, and is most of the scatter: it is taken off
        each draw by as much as it goes with the error (a control variate), so that fewer draws see a small bias.
        """
        response = USUAL.response(situation.variance / situation.peak**2)
        work = partial(_deviation, situation, fit, response)
        error, answer = np.swapaxes(np.array(list(self.each(work, n))), 0, 1)
        spread = answer - answer.mean(axis=0)
        slope = (spread * error).sum(axis=0) / (spread**2).sum(axis=0)
        rest = error - slope * answer
        return rest.mean(axis=0), rest.std(axis=0, ddof=1) / np.sqrt(n)


@contextmanager
def draws_on_every_core(tick: Callable[[int], None]) -> Iterator[Draws]:
    """Yield draws that run on as many processes as there are cores, each with one thread of linear algebra."""
    # Matrices of a hundred rows gain nothing from threads and lose by them. New processes read this as they start.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if cores == 1:
        yield Draws(None, tick)
        return
    executor = ProcessPoolExecutor(cores, mp_context=get_context("spawn"))
    try:
        yield Draws(executor, tick)
    except BaseException:
        # What they are at takes seconds that nobody waits for; but first what they have not begun is dropped, or the
        # executor's own thread would stumble over it.
        executor.shutdown(wait=False, cancel_futures=True)
        time.sleep(0.1)
        for worker in active_children():
            worker.terminate()
        raise
    executor.shutdown(cancel_futures=True)
