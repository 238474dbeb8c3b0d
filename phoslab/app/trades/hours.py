"""A slow material over hours of display frames: what becomes of increments that are smaller than a rounding.

kr = 1e-4 1/s at 60 Hz: a frame changes the state by 1.7e-6 of itself, less than 30 units in the last place of a
float32. Compared with the closed form in float64.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab import solvers

Array = NDArray[np.float64]

KR = 1e-4
CHARGING = 2e-4
DT = 1 / 60


@dataclass(frozen=True)
class HoursError:
    """Relative error of the state after so many hours, charging from empty or fading from full."""

    method: str
    hours: float
    lit: bool
    error: float


def truth(hours: float, *, lit: bool) -> float:
    """The state after `hours`, in closed form."""
    a = CHARGING if lit else 0.0
    start = np.array([0.0 if lit else 1.0])
    return float(solvers.exact_step(start, np.array([a]), np.array([KR]), np.array(hours * 3600.0))[0])


def relative_error(state: float, hours: float, *, lit: bool) -> float:
    """|state / truth - 1|."""
    return abs(state / truth(hours, lit=lit) - 1.0)


def naive_float32(hours: float) -> list[HoursError]:
    """Step frame by frame as one would write it down: r_inf + (r - r_inf) exp(-k dt), all in float32."""
    one = np.float32
    a = np.array([CHARGING, 0.0], dtype=one)
    kr, dt = one(KR), one(DT)
    keep = np.exp(-(a + kr) * dt)
    r_inf = a / (a + kr)
    r = np.array([0.0, 1.0], dtype=one)
    for _ in range(round(hours * 3600 / DT)):
        r = r_inf + (r - r_inf) * keep
    return [
        HoursError("naive float32", hours, lit, relative_error(float(state), hours, lit=lit))
        for state, lit in zip(r, (True, False), strict=True)
    ]
