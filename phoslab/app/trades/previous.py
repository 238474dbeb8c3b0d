"""What the previous method costs as the past grows longer (Glassner 1995), beside a step of the rate equations."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from phoslab import history, solvers
from phoslab.app.trades.precision import KR
from phoslab.solvers import Drive

FRAMES_PER_S = 60


@dataclass(frozen=True)
class PastCost:
    """One frame after a past of some length.

    Args:
        past_s: how long the light has been on.
        cache_bytes: of past excitation that a texel must keep, float32.
        history_ns: to sum over that cache, a texel.
        step_ns: of one exact step, a texel.
    """

    past_s: float
    cache_bytes: int
    history_ns: float
    step_ns: float


def measure(n_texels: int, repeats: int) -> list[PastCost]:
    """Time a frame of either method after pasts of ever greater length."""
    kr = np.broadcast_to(KR, (n_texels, KR.size))
    rng = np.random.default_rng(0)
    costs = []
    for past_s in (1.0, 4.0, 16.0, 64.0):
        cache = rng.uniform(0, 1e-3, size=(int(past_s * FRAMES_PER_S), n_texels, KR.size))
        r, drive, dt = np.zeros(kr.shape), Drive.constant(cache[-1]), np.array(1 / FRAMES_PER_S)
        summed = _median_ns(partial(history.from_cache, cache, kr, 1 / FRAMES_PER_S), repeats)
        stepped = _median_ns(partial(solvers.SOLVERS["exact"], r, drive, kr, dt), repeats)
        costs.append(PastCost(past_s, 4 * KR.size * len(cache), summed / n_texels, stepped / n_texels))
    return costs


def _median_ns(work: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        begin = time.perf_counter_ns()
        work()
        times.append(time.perf_counter_ns() - begin)
    return float(np.median(times))
