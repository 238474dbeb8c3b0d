"""What solvers make of the ends of every range: finite, inside [0, 1], never past the equilibrium, or refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import cast

import numpy as np
from numpy.typing import NDArray

from phoslab import solvers
from phoslab.solvers import EULER_LIMIT, EXPLICIT_LIMIT, Drive

Array = NDArray[np.float64]

# Steps, irradiances times ke, rates and concentrations at and between the ends of the ranges that are promised.
DT = (1e-6, 1e-3, 1.0, 1e3, 1e6)
IRRADIANCE = (0.0, 5e-324, 1e-3, 1.0, 1e6, 1e12)
KE = (0.0, 1e-6, 1.0, 1e3)
KR = (0.0, 5e-324, 1e-6, 1.0, 1e3, 1e6)
R = (0.0, 5e-324, 1e-3, 0.5, 1.0)

LIMIT = {"euler": EULER_LIMIT, "substep": EXPLICIT_LIMIT, "rk23": EXPLICIT_LIMIT}


@dataclass(frozen=True)
class Corners:
    """Every combination of the values above, (n, 1) each: one state an element."""

    r: Array
    a: Array
    kr: Array
    dt: Array

    @classmethod
    def all(cls) -> Corners:
        """Return all corners."""
        dt, E, ke, kr, r = np.array(list(product(DT, IRRADIANCE, KE, KR, R))).T[:, :, None]
        return cls(r=r, a=ke * E, kr=kr, dt=dt)

    def take(self, chosen: NDArray[np.bool_]) -> Corners:
        """Return some of them."""
        return Corners(self.r[chosen], self.a[chosen], self.kr[chosen], self.dt[chosen])

    @property
    def stiffness(self) -> Array:
        """(n,) (a + kr) dt."""
        k: Array = ((self.a + self.kr) * self.dt)[:, 0]
        return k


@dataclass(frozen=True)
class Verdict:
    """How many of all corners a solver refused, and how many of the others came out wrong.

    Args:
        past: beyond the equilibrium, by more than rounding in the format.
    """

    solver: str
    arithmetic: str
    n: int
    refused: int
    not_finite: int
    outside: int
    past: int


# (solver, corners) -> (n, 1) states after the step
Stepper = Callable[[str, Corners], Array]


def judge(solver: str, arithmetic: str, step: Stepper, resolution: float) -> Verdict:
    """Step every corner that the solver does not refuse.

    Args:
        resolution: the spacing of the format near 1, which rounding may go past the equilibrium.
    """
    corners = Corners.all()
    accepted = corners.stiffness <= LIMIT.get(solver, np.inf)
    tried = corners.take(accepted)
    stepped = step(solver, tried)
    finite = np.isfinite(stepped)
    k = tried.a + tried.kr
    rest = np.where(k > 0, np.divide(tried.a, k, out=np.zeros_like(k), where=k > 0), tried.r)
    low, high = np.minimum(tried.r, rest) - resolution, np.maximum(tried.r, rest) + resolution
    return Verdict(
        solver=solver,
        arithmetic=arithmetic,
        n=len(corners.r),
        refused=int(np.count_nonzero(~accepted)),
        not_finite=int(np.count_nonzero(~finite)),
        outside=int(np.count_nonzero(finite & ((stepped < 0) | (stepped > 1)))),
        past=int(np.count_nonzero(finite & ((stepped < low) | (stepped > high)))),
    )


def in_numpy(dtype: type[np.float32] | type[np.float64]) -> Stepper:
    """Return the stepper of phoslab.solvers, in float64 or with every input rounded to float32."""

    def step(solver: str, c: Corners) -> Array:
        with np.errstate(over="ignore", under="ignore"):
            # The solvers are written for float64; NumPy carries float32 through the same formulas.
            r, a, kr, dt = (cast(Array, x.astype(dtype)) for x in (c.r, c.a, c.kr, c.dt))
            return solvers.SOLVERS[solver](r, Drive.constant(a), kr, dt).astype(np.float64)

    return step
