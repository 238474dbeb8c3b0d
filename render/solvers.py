"""The GPU's solvers of the rate equations, by the names of `phoslab.solvers`.

A solver is a file `shaders/include/solver_NAME.glsl` that defines

    vec4 step_state(vec4 r, vec4 a, vec4 kr, float dt)

and one line in `SOLVERS`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.solvers import EULER_LIMIT

Array = NDArray[np.float64]
KeepInDark = Callable[[Array, float], Array]


@dataclass(frozen=True)
class Solver:
    """One way to step the state.

    Args:
        include: the file in shaders/include.
        any_length: whether one step may span any stretch of constant light; otherwise the renderer takes steps.
        largest_step: the largest (a + kr) dt that is stable; inf where every one is.
        keep_in_dark: (kr, dt) to (n_c,) the share of r that a step without light keeps, in float64.
    """

    include: str
    any_length: bool
    largest_step: float
    keep_in_dark: KeepInDark


SOLVERS: dict[str, Solver] = {
    "exact": Solver("solver_exact.glsl", True, np.inf, lambda kr, dt: np.exp(-kr * dt)),
    "euler": Solver("solver_euler.glsl", False, EULER_LIMIT, lambda kr, dt: 1 - kr * dt),
}


def find_solver(name: str) -> Solver:
    """Return the solver `name`.

    Raises:
        PhoslabError: there is none of that name.
    """
    if name not in SOLVERS:
        raise PhoslabError(
            f"{name!r} is unknown to the renderer",
            field="solver",
            remedy=f"Use one of: {', '.join(SOLVERS)}.",
        )
    return SOLVERS[name]


def check_step(name: str, largest_rate_per_s: float, dt_s: float, phosphor: str) -> None:
    """Refuse a step that would overshoot.

    Args:
        largest_rate_per_s: the largest a + kr of any texel.

    Raises:
        PhoslabError: (a + kr) dt is above what the solver bears.
    """
    largest = largest_rate_per_s * dt_s
    if largest > find_solver(name).largest_step:
        longest = find_solver(name).largest_step / largest_rate_per_s
        raise PhoslabError(
            f"overshoots on {phosphor!r}: (a + kr) dt is {largest:.3g}, and above "
            f"{find_solver(name).largest_step:g} the state leaves [0, 1]",
            field=f"solver {name!r}",
            remedy=f"Step by {longest:.2g} s or less (--step), or use --solver exact.",
        )
