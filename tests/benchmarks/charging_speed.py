"""Measure the exact steps of an excitation series against a general ODE solver on the same light.

    python tests/benchmarks/charging_speed.py [PLACES]

14 exposures to the lamp from 1 to 512 s, PLACES places (31 by default), two states, rise and fade of the lamp in steps.
scipy's DOP853 at rtol 1e-12 takes each step of constant light by itself, all places at once, and gives the curve alone;
the exact steps give the curve and its derivatives by both rates. The goal is a ratio of at least 29 with curves that
agree to 1e-10. Both are timed in one process, in turns, medians of 5.
"""

from __future__ import annotations

import sys
import time
from statistics import median

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from phoslab.fitting.charging import LampCourse, Steps, Table, glow

Array = NDArray[np.float64]

RUNS = 5
KR = np.array([0.31, 0.012])


def general(a: Array, kr: Array, steps: Steps) -> Array:
    """(n_frames, n_places, n_c) by DOP853."""
    curves = []
    for durations, levels, shutter in zip(steps.duration_s, steps.level, steps.open, strict=True):
        y = np.zeros(2 * a.size)
        for dt, level, is_open in zip(durations, levels, shutter, strict=True):
            if dt:

                def slope(_: float, y: Array, lit: Array = level * a, seen: bool = is_open) -> Array:
                    r = y[: a.size].reshape(a.shape)
                    return np.concatenate([((1 - r) * lit - kr * r).ravel(), seen * (kr * r).ravel()])

                y = solve_ivp(slope, (0, dt), y, method="DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
        curves.append(y[a.size :].reshape(a.shape))
    return np.array(curves) / steps.exposure_s[:, None, None]


def main() -> None:
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 31
    lit = np.concatenate([2.0 ** np.arange(10), [11.3, 22.6, 45.3, 90.5]])
    lamp = LampCourse(Table.of(lambda t: 1 - np.exp(-t / 0.08), 0.5, 8), Table.fade(0.32))
    steps = Steps.of(lit, np.full(14, 0.65), np.full(14, 2.0), lamp)
    a = np.random.default_rng(0).uniform(0, 0.5, (n, 2))
    times: dict[str, list[float]] = {"exact": [], "general": []}
    for _ in range(RUNS):
        start = time.perf_counter()
        exact = glow(a, KR, steps).value
        middle = time.perf_counter()
        reference = general(a, KR, steps)
        times["exact"].append(middle - start)
        times["general"].append(time.perf_counter() - middle)
    t_exact, t_general = median(times["exact"]), median(times["general"])
    print(f"{n} places, {steps.duration_s.shape[0]} frames of {steps.duration_s.shape[1]} steps")
    print(
        f"exact, with derivatives {1e3 * t_exact:.3g} ms, DOP853 {1e3 * t_general:.4g} ms: {t_general / t_exact:.0f}x"
    )
    print(f"curves differ by at most {np.abs(exact / reference - 1).max():.1e}")


if __name__ == "__main__":
    main()
