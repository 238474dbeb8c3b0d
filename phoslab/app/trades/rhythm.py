"""Does the glow depend on how often it is drawn? The same light, stepped at different frame rates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from phoslab import solvers
from phoslab.app.trades import precision
from phoslab.app.trades.precision import Problem

Array = NDArray[np.float64]

COMPARED = ("euler", "exact", "exact2")


@dataclass(frozen=True)
class RhythmError:
    """The largest relative error of the glow at common times, of one solver at one rhythm under one light."""

    light: str
    solver: str
    rhythm: str
    error: float


def measure(n_texels: int = 64) -> Iterator[RhythmError]:
    """Yield the error of each solver, rhythm and light; the lights are those that change slowly enough to be seen."""
    for problem in precision.problems(n_texels, 1.0):
        if problem.name not in ("switched", "sinusoidal"):
            continue
        truth = precision.glow(precision.cut_at_changes(problem, step=precision.YARDSTICK))
        for solver in COMPARED:
            for rhythm in ("24 Hz", "60 Hz", "144 Hz", "uneven"):
                states = _march(problem, solver, rhythm)
                yield RhythmError(
                    problem.name, solver, rhythm, precision.error(precision.glow(states), truth)
                )


def _march(problem: Problem, solver: str, rhythm: str) -> Array:
    """Step frame by frame, cut at the checkpoints; return (CHECKPOINTS, n_texels, 2) states."""
    r, states = np.zeros_like(problem.a), []
    rng = np.random.default_rng(0)
    for begin, end in pairwise(problem.checkpoints):
        for start, stop in pairwise(_frames(begin, end, rhythm, rng)):
            r = solvers.SOLVERS[solver](r, problem.drive(start, stop), precision.KR, np.array(stop - start))
        states.append(r)
    return np.array(states)


def _frames(begin: float, end: float, rhythm: str, rng: np.random.Generator) -> Array:
    """The frame times from `begin` to `end`, both included."""
    if rhythm == "uneven":
        # A game that stutters: 60 Hz on average, every frame between a fifth and nine fifths of that.
        steps = rng.uniform(0.2, 1.8, size=int(2 * (end - begin) * 60)) / 60
        times = begin + np.cumsum(steps)
    else:
        rate = float(rhythm.removesuffix(" Hz"))
        times = np.arange(np.floor(begin * rate) + 1, np.ceil(end * rate)) / rate
    return np.concatenate([[begin], times[(begin < times) & (times < end)], [end]])
