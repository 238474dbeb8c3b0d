"""Fits of single pixels: how many a second, how many right, and how they scatter.

The usual case of three channels; no guess. A fit is right if both rates are within 10 %. The scatter is compared with
the Cramér-Rao bound of the pixels' model: rates and amplitudes shared by the channels, a free colour.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from statistics import median

import numpy as np
from numpy.typing import NDArray

from phoslab.app.trades.fit_draws import SCALES, T_S, USUAL
from phoslab.app.trades.fit_peers import Peer, rates_or_nan
from phoslab.fitting.pixel_decay import PixelFits, PixelNoise, PixelProblem, fit_pixels

Array = NDArray[np.float64]

_NEAR_START = (0.1, 0.01)
"""From which every peer finds rates."""

_SLOWEST_PER_S, _FASTEST_PER_S = 0.1 / T_S[-1], 3 / (T_S[1] - T_S[0])


@dataclass(frozen=True, eq=False)
class Pixels:
    """Fits of `n` pixels.

    Args:
        start: what they began with.
        fits_per_s: (n_runs,) by the clock.
        fits_per_cpu_s: the median, a second of one processor.
        within: share with both rates within 10 %.
        worst: the largest relative error of a rate.
        scatter: (2,) of log rates over the bound.
    """

    start: str
    n: int
    fits_per_s: tuple[float, ...]
    fits_per_cpu_s: float
    within: float
    worst: float
    scatter: Array


def measure(n: int, runs: int, tick: Callable[[int], None]) -> list[Pixels]:
    """Fit `n` pixels `runs` times, from a grid of starts alone, and with the rates of the whole image besides."""
    rng = np.random.default_rng(0)
    y = np.empty((n, *USUAL.light.shape), np.float32)
    for some in np.array_split(np.arange(n), max(1, n // 50_000)):
        y[some] = USUAL.light + rng.normal(0, USUAL.sigma, (some.size, *USUAL.light.shape))
    noise = PixelNoise(np.full(USUAL.light.shape, USUAL.sigma**2), np.zeros(USUAL.light.shape))
    mean = y[:1000].mean(axis=0, dtype=float)
    problem = PixelProblem(T_S, np.zeros(T_S.size), noise, mean, 2, (_SLOWEST_PER_S, _FASTEST_PER_S))
    # Compiled, or read from where that is kept, before anything is timed.
    coarse = fit_pixels(problem, y.mean(axis=0, dtype=float, keepdims=True).astype(np.float32))
    tick(1)
    near = replace(problem, near_per_s=coarse.kr_per_s[0].astype(float))
    found = []
    for start, here in (("a grid", problem), ("a grid, and the whole image's rates", near)):
        clock, used = [], []
        for _ in range(runs):
            began, cpu = time.perf_counter(), time.process_time()
            fits = fit_pixels(here, y)
            clock.append(time.perf_counter() - began)
            used.append(time.process_time() - cpu)
            tick(1)
        found.append(_judged(start, fits, [n / s for s in clock], n / median(used)))
    return found


@dataclass(frozen=True)
class Beside:
    """A peer's fits of single decays a second of one processor, and the share with both rates within 10 %."""

    peer: str
    fits_per_cpu_s: float
    within: float


def beside(peer: Peer, n: int) -> Beside:
    """Time a peer on draws of the same case from a start near the truth: `n` in one call where it can, else 20."""
    decays = [USUAL.draw(seed) for seed in range(n if peer.many else 20)]
    rates_or_nan(peer.name, _NEAR_START, decays[0])  # what it imports is not its fit's time
    began = time.process_time()
    if peer.many:
        rates = peer.many(decays, _NEAR_START)
    else:
        rates = np.array([rates_or_nan(peer.name, _NEAR_START, d) for d in decays])
    fits_per_s = len(decays) / (time.process_time() - began)
    off = np.abs(np.sort(rates)[:, ::-1] / USUAL.kr - 1)
    return Beside(peer.name, fits_per_s, float((off < 0.1).all(axis=1).mean()))


def _judged(start: str, fits: PixelFits, fits_per_s: list[float], fits_per_cpu_s: float) -> Pixels:
    off = np.abs(fits.kr_per_s / USUAL.kr - 1)
    scatter = np.log(fits.kr_per_s.astype(float)).std(axis=0)
    within = float((off < 0.1).all(axis=1).mean())
    return Pixels(
        start, len(off), tuple(fits_per_s), fits_per_cpu_s, within, float(off.max()), scatter / _bound()
    )


def _bound() -> Array:
    """(2,) the least standard deviation of log kr."""
    kr, amplitude = np.array(USUAL.kr), np.array(USUAL.amplitude)
    g = np.exp(-T_S[:, None] * kr)
    m = g @ amplitude
    J = np.zeros((SCALES.size, T_S.size, 6))
    for c, scale in enumerate(SCALES):
        J[c, :, :2] = scale * amplitude * -T_S[:, None] * kr * g
        J[c, :, 2:4] = scale * g
    J[1, :, 4], J[2, :, 5] = m, m
    J = J.reshape(-1, 6) / USUAL.sigma
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(J.T @ J))[:2]))
