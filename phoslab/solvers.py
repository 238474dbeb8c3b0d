"""Solvers of the rate equations in float64, each behind one name: a step in time of every state at once.

Each solves dr/dt = (1 - r) a - kr r (Nalbach 2017, eq. 8.1) over one step of dt seconds. A new solver is one
function here and one line in `SOLVERS`.

    euler     forward Euler with the excitation at the step's start, as Nalbach 2017, 8.5; refuses to overshoot
    substep   forward Euler in as many equal parts as stability asks for
    exact     exact for the excitation at the step's start; first order where light changes within the step
    exact2    exact for the mean excitation of the step; second order where light changes within it
    rk23      adaptive Runge-Kutta of order 2(3), the comparison of Nalbach 2017, 8.5 (Fig. 8.19)
    dop853    adaptive Runge-Kutta of order 8 at 1e-12: the yardstick, and far too dear for anything else
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError, look_up

Array = NDArray[np.float64]

# (1 - (a + kr) dt) must not be negative, or an Euler step from r = 0 or 1 leaves [0, 1].
EULER_LIMIT = 1.0
# Explicit Runge-Kutta methods take about (a + kr) dt / 3 steps whatever the tolerance: beyond this they are refused.
EXPLICIT_LIMIT = 3e4
# Nodes of the mean excitation where no exact mean is given: Gauss-Legendre, exact to degree 7.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True)
class Drive:
    """The excitation over one step.

    Args:
        at: maps the share of the step that has passed, 0..1, to (..., n_c) excitations in 1/s.
        average: gives the mean excitation (..., n_c) of the step; None: by quadrature of `at`.
    """

    at: Callable[[float], Array]
    average: Callable[[], Array] | None = None

    @property
    def mean(self) -> Array:
        """(..., n_c) mean excitation over the step, in 1/s."""
        if self.average is not None:
            return self.average()
        parts = [w / 2 * self.at((1 + x) / 2) for x, w in zip(_NODES, _WEIGHTS, strict=True)]
        total: Array = np.sum(parts, axis=0)
        return total

    @classmethod
    def constant(cls, a: Array) -> Drive:
        """Return the drive of constant excitation `a` (..., n_c)."""
        return cls(lambda _: a, lambda: a)


Step = Callable[[Array, Drive, Array, Array], Array]


def euler(r: Array, drive: Drive, kr: Array, dt: Array) -> Array:
    """Step by forward Euler; refuse a step that would overshoot.

    Raises:
        PhoslabError: (a + kr) dt > 1 somewhere.
    """
    a = drive.at(0.0)
    largest = float(np.max((a + kr) * dt, initial=0.0))
    if largest > EULER_LIMIT:
        raise PhoslabError(
            f"overshoots: (a + kr) dt is {largest:.3g}, and above {EULER_LIMIT:g} the step leaves [0, 1]",
            field="solver 'euler'",
            remedy="Take a shorter step, or use solver 'substep' or 'exact'.",
        )
    return _inside(r + dt * ((1 - r) * a - kr * r))


def substep(r: Array, drive: Drive, kr: Array, dt: Array) -> Array:
    """Step by forward Euler in as many equal parts as stability asks for; each takes the light at its start.

    Raises:
        PhoslabError: that would be more than `EXPLICIT_LIMIT` parts.
    """
    n = max(1, int(np.ceil(_stiffness("substep", drive, kr, dt) / EULER_LIMIT)))
    for m in range(n):
        a = drive.at(m / n)
        r = r + dt / n * ((1 - r) * a - kr * r)
    return _inside(r)


def exact(r: Array, drive: Drive, kr: Array, dt: Array) -> Array:
    """Step exactly under the excitation at the step's start; monotone, and never past the equilibrium."""
    return exact_step(r, drive.at(0.0), kr, dt)


def exact2(r: Array, drive: Drive, kr: Array, dt: Array) -> Array:
    """Step exactly under the mean excitation of the step.

    With K(t) the integral of a + kr up to t, the solution is r(0) e^{-K(dt)} + ∫ a(t) e^{K(t) - K(dt)} dt. The mean
    makes the first term exact; the second then errs with dt³ times the light's slope: a method of second order.
    It is a step under some constant excitation, and stays inside [0, 1] like one.
    """
    return exact_step(r, drive.mean, kr, dt)


def exact_step(r: Array, a: Array, kr: Array, dt: Array) -> Array:
    """Solve exactly for constant excitation `a` (..., n_c); monotone, and never past the equilibrium.

    k = a + kr, r_inf = a / k, r' = r + (r_inf - r) (1 - exp(-k dt))
    """
    r_inf = equilibrium(a, kr)
    # Both may exceed the range of float64 in the extreme; infinity then means "as long as it takes".
    with np.errstate(over="ignore"):
        stepped = r - (r_inf - r) * np.expm1(-(a + kr) * dt)
    # Rounding may end one ulp past the equilibrium, and past 1 with it. (k = 0: r stays.)
    return np.where(a + kr > 0, np.clip(stepped, np.minimum(r, r_inf), np.maximum(r, r_inf)), r)


def equilibrium(a: Array, kr: Array) -> Array:
    """Return a / (a + kr), 0 where both are 0."""
    k = a + kr
    return np.divide(a, k, out=np.zeros(np.broadcast_shapes(a.shape, k.shape)), where=k > 0)


def runge_kutta(method: str, rtol: float, atol: float) -> Step:
    """Return an adaptive Runge-Kutta solver of scipy; all elements share its steps.

    Args:
        method: "RK23" (Bogacki and Shampine, Matlab's ode23) or "DOP853".
        rtol, atol: tolerance of one of its steps.
    """

    def step(r: Array, drive: Drive, kr: Array, dt: Array) -> Array:
        from scipy.integrate import solve_ivp

        _stiffness(method, drive, kr, dt)
        shape = np.broadcast_shapes(r.shape, np.shape(drive.at(0.0)), np.shape(dt))
        if dt.max(initial=0.0) == 0.0:
            return np.broadcast_to(r, shape).copy()

        def slope(s: float, flat: Array) -> Array:
            x = flat.reshape(shape)
            change: Array = np.broadcast_to(dt * ((1 - x) * drive.at(s) - kr * x), shape).ravel()
            return change

        start = np.broadcast_to(r, shape).ravel()
        found = solve_ivp(slope, (0.0, 1.0), start, method=method, rtol=rtol, atol=atol)
        return _inside(found.y[:, -1].reshape(shape))

    return step


def _stiffness(name: str, drive: Drive, kr: Array, dt: Array) -> float:
    """Return the largest (a + kr) dt over the step, having refused what would take an explicit method for ever."""
    a = np.max([drive.at(s) for s in (0.0, 0.5, 1.0)], axis=0)
    with np.errstate(over="ignore"):
        stiffness = float(np.max((a + kr) * dt, initial=0.0))
    if not stiffness <= EXPLICIT_LIMIT:
        raise PhoslabError(
            f"would take about {stiffness:.1e} steps: (a + kr) dt is too large for an explicit method",
            field=f"solver {name!r}",
            remedy="Use solver 'exact' or 'exact2', which take one step whatever the rates, or a shorter dt.",
        )
    return stiffness


def _inside(r: Array) -> Array:
    """Take off what rounding, or a tolerance, puts outside [0, 1]."""
    return np.clip(r, 0.0, 1.0)


SOLVERS: dict[str, Step] = {
    "euler": euler,
    "substep": substep,
    "exact": exact,
    "exact2": exact2,
    "rk23": runge_kutta("RK23", rtol=1e-3, atol=1e-6),
    "dop853": runge_kutta("DOP853", rtol=1e-12, atol=1e-14),
}


def find(name: str) -> Step:
    """Return the solver `name`.

    Raises:
        PhoslabError: there is none of that name.
    """
    return look_up(SOLVERS, name, "solver")
