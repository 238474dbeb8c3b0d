"""The exact steps of an excitation series against a general ODE solver on the same piecewise constant light.

14 exposures to the lamp from 1 to 512 s, two states, rise and fade of the lamp in steps. scipy's DOP853 at rtol 1e-12
takes each step of constant light by itself, all places at once, and gives the curve alone; the exact steps give the
curve and its derivatives by both rates. Both are timed in one process, in turns.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from phoslab.fitting.charging import LampCourse, Steps, Table, glow

Array = NDArray[np.float64]

_KR = np.array([0.31, 0.012])


@dataclass(frozen=True)
class Charging:
    """What was measured: places, seconds of each (medians), and the largest relative difference of the curves."""

    places: int
    frames: int
    steps: int
    exact_s: float
    general_s: float
    difference: float

    @property
    def gain(self) -> float:
        """How many times as fast the exact steps are."""
        return self.general_s / self.exact_s


def measure(places: int, runs: int, tick: Callable[[int], None] = lambda n: None) -> Charging:
    """Time both."""
    lit = np.concatenate([2.0 ** np.arange(10), [11.3, 22.6, 45.3, 90.5]])
    lamp = LampCourse(Table.of(lambda t: 1 - np.exp(-t / 0.08), 0.5, 8), Table.fade(0.32))
    steps = Steps.of(lit, np.full(14, 0.65), np.full(14, 2.0), lamp)
    a = np.random.default_rng(0).uniform(0, 0.5, (places, 2))
    exact_s, general_s = [], []
    for _ in range(runs):
        start = time.perf_counter()
        exact = glow(a, _KR, steps).value
        middle = time.perf_counter()
        reference = _general(a, steps)
        exact_s.append(middle - start)
        general_s.append(time.perf_counter() - middle)
        tick(1)
    frames, per_frame = steps.duration_s.shape
    worst = float(np.abs(exact / reference - 1).max())
    return Charging(places, frames, per_frame, median(exact_s), median(general_s), worst)


def _general(a: Array, steps: Steps) -> Array:
    """(n_frames, n_places, n_c) by DOP853."""
    curves = []
    for durations, levels, shutter in zip(steps.duration_s, steps.level, steps.open, strict=True):
        y = np.zeros(2 * a.size)
        for dt, level, is_open in zip(durations, levels, shutter, strict=True):
            if dt:

                def slope(_: float, y: Array, lit: Array = level * a, seen: bool = is_open) -> Array:
                    r = y[: a.size].reshape(a.shape)
                    return np.concatenate([((1 - r) * lit - _KR * r).ravel(), seen * (_KR * r).ravel()])

                y = solve_ivp(slope, (0, dt), y, method="DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
        curves.append(y[a.size :].reshape(a.shape))
    return np.array(curves) / steps.exposure_s[:, None, None]
