"""The GPU's solvers of the rate equations, by the names of `phoslab.solvers`.

A solver is a file `shaders/include/solver_NAME.glsl` that defines

    void step_state(STATE r, STATE kr_dt, Drive drive, out STATE from, out STATE change)

and one line in `SOLVERS`. The new state is from + change: a format that keeps more than the sum can then do so.
"""

from __future__ import annotations

import decimal
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phoslab.errors import PhoslabError, look_up
from phoslab.solvers import EULER_LIMIT, EXPLICIT_LIMIT, Drive

Array = NDArray[np.float64]

# The quadratics in the share of the step, by their coefficients: the constant 1; and those that are 1 at the start,
# the middle or the end of the step, and 0 at the two others.
CONSTANT = np.array([[1.0, 0.0, 0.0]])
THROUGH = np.array([[1.0, -3.0, 2.0], [0.0, 4.0, -4.0], [0.0, -1.0, 2.0]])


def at_start(drive: Drive) -> list[Array]:
    """Return the light at the step's start."""
    return [drive.at(0.0)]


def at_mean(drive: Drive) -> list[Array]:
    """Return the mean light of the step."""
    return [drive.mean]


def throughout(drive: Drive) -> list[Array]:
    """Return the light at the step's start, middle and end; the shader takes the quadratic through them."""
    return [drive.at(s) for s in (0.0, 0.5, 1.0)]


@dataclass(frozen=True)
class Solver:
    """One way to step the state.

    Args:
        include: the file in shaders/include.
        light: what it takes of the light over a step: one value, or those at its start, middle and end.
        closed_form: whether it solves constant light exactly, so that one step may span any stretch of it.
        largest_step: the largest (a + kr) dt that it bears; inf where that is any.
        short: the file for steps of (a + kr) dt up to `SHORT`, where there is one that costs less.
    """

    include: str
    light: Callable[[Drive], list[Array]]
    closed_form: bool = False
    largest_step: float = np.inf
    short: str | None = None

    def include_for(self, largest_step: float) -> str:
        """Return the file for a step in which no texel's (a + kr) dt exceeds `largest_step`."""
        return self.short if self.short and largest_step <= SHORT else self.include

    @property
    def basis(self) -> Array:
        """(n, 3) the quadratic in the share of the step that belongs to each value of `light`: its coefficients."""
        return THROUGH if self.light is throughout else CONSTANT

    def course(self, drives: Sequence[Drive]) -> Array:
        """Return (n, 3) the coefficients of each scalar drive over the step, as the shader takes them."""
        return np.array([self.light(drive) for drive in drives]) @ self.basis


# The largest (a + kr) dt of `Solver.short`. Its polynomial is as good a thousandth beyond: roundings do not matter.
SHORT = 1 / 8

# The default: the first where every light is constant between its jumps, the second where one is not.
DEFAULT, DEFAULT_IN_VARYING_LIGHT = "exact", "exact2"

SOLVERS: dict[str, Solver] = {
    "euler": Solver("solver_euler.glsl", at_start, largest_step=EULER_LIMIT),
    "substep": Solver("solver_substep.glsl", throughout, largest_step=EXPLICIT_LIMIT),
    "exact": Solver("solver_exact.glsl", at_start, closed_form=True, short="solver_exact_short.glsl"),
    "exact2": Solver("solver_exact.glsl", at_mean, closed_form=True, short="solver_exact_short.glsl"),
    "rk23": Solver("solver_rk23.glsl", throughout, largest_step=EXPLICIT_LIMIT),
}


def find_solver(name: str) -> Solver:
    """Return the solver `name`.

    Raises:
        PhoslabError: there is none of that name.
    """
    return look_up(SOLVERS, name, "the renderer's solver")


def check_step(
    name: str, largest_rate_per_s: float, dt_s: float, where: str, strictest_per_s: float = 0.0
) -> None:
    """Refuse a step that would overshoot, or take an explicit method for ever.

    Args:
        largest_rate_per_s: what no texel's a + kr exceeds.
        where: what is stepped, for the message.
        strictest_per_s: what no a + kr of any other material or time exceeds: the step that is advised suits them too.

    Raises:
        PhoslabError: dt is negative or not finite, or (a + kr) dt is above what the solver bears.
    """
    if not 0 <= dt_s < np.inf:
        raise PhoslabError(f"is {dt_s:g}", field="dt", remedy="Time runs forwards; give seconds.")
    limit = find_solver(name).largest_step
    largest = largest_rate_per_s * dt_s
    if largest > limit:
        advised = limit / max(largest_rate_per_s, strictest_per_s)
        what = "overshoots" if limit == EULER_LIMIT else "would take too many parts"
        raise PhoslabError(
            f"{what} on {where}: (a + kr) dt reaches {largest:.3g}, and it bears {limit:g}",
            field=f"solver {name!r}",
            remedy=f"Step by {_rounded_down(advised):g} s or less (--step), or use --solver exact.",
        )


def _rounded_down(value: float) -> float:
    """Return two digits of a positive value, never more than it, and less by what the end of a step may be moved."""
    context = decimal.Context(prec=2, rounding=decimal.ROUND_FLOOR)
    return float(context.create_decimal_from_float(value * (1 - 1e-5)))


def share_in_dark(kr: ArrayLike, dt_s: float) -> tuple[Array, Array]:
    """Return (stay, move), each (n_c,), of an exact step without light: r' = stay r + move r, in float64.

    Over a short step stay is 1 and move is minus the share that is lost, which so keeps its bits; over a long one
    stay is 0 and move the share that is kept.
    """
    x = np.asarray(kr, dtype=np.float64) * dt_s
    stay = x < np.log(2)
    return stay.astype(np.float64), np.where(stay, np.expm1(-x), np.exp(-x))
