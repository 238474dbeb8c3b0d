"""The solver and its step, from how the light changes.

Where every light is constant between its jumps, a state jumps too: no error, whatever the step. Where one varies,
`exact2` takes the mean of each step; how wrong that is, is found by halving the step at a few points of the scene.
What an edited plan has instead is tried at these points as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.render.planning.charging import charged, per_light, step_ends
from phoslab.render.planning.pilot import Pilot
from phoslab.render.solvers import check_step, find_solver
from phoslab.solvers import SOLVERS as STEPS
from phoslab.solvers import Step

Array = NDArray[np.float64]

POINTS = 8
FEWEST_STEPS, MOST_STEPS = 8, 1 << 13
# Of a solver that no plan takes of itself, by how long a step of it takes here.
MOST_TRIED = {"euler": 2048, "substep": 512, "exact": 2048, "exact2": 2048, "rk23": 32}

# The paper's frame.
FRAME_S = 1 / 60


@dataclass(frozen=True)
class Stepped:
    """A solver, its step in s, how many steps that makes, and the relative error of the glow."""

    solver: str
    step_s: float
    steps: int
    error: float


def steps(pilot: Pilot) -> list[Stepped]:
    """Return ways to step, the longest steps first; one where light is piecewise constant."""
    schedule, end_s = pilot.scene.schedule, float(pilot.moments[-1])
    if schedule.piecewise_constant or end_s == 0 or not pilot.sampled:
        return [Stepped("exact", FRAME_S, len(step_ends(schedule, end_s)) if end_s else 0, 0.0)]
    found, n = [], FEWEST_STEPS
    coarse = _glow(pilot, step_ends(schedule, end_s, n))
    while n < MOST_STEPS:
        fine = _glow(pilot, step_ends(schedule, end_s, 2 * n))
        # Second order: what is left after halving is a third of what halving changed; the whole, four thirds.
        found.append(Stepped("exact2", end_s / n, n, 4 / 3 * _off(coarse, fine)))
        if found[-1].error < 1e-5:
            break
        coarse, n = fine, 2 * n
    return found


def judged(pilot: Pilot, known: Sequence[Stepped], solver: str, step_s: float) -> Stepped:
    """Return what another solver and step err by; `known` are those that a plan would take.

    Raises:
        PhoslabError: the step is longer than the solver bears.
    """
    schedule, end_s = pilot.scene.schedule, float(pilot.moments[-1])
    if find_solver(solver).closed_form and schedule.piecewise_constant:
        return replace(known[0], solver=solver, step_s=step_s)
    if end_s == 0 or not pilot.sampled:
        return Stepped(solver, step_s, 0, 0.0)
    _check_step(pilot, solver, step_s)
    # A longer step than the plan's errs more, not less; Euler's own is then taken in as many parts as it bears.
    tried_s = max(step_s, end_s / MOST_TRIED[solver])
    step = STEPS["substep" if solver == "euler" and tried_s > step_s else solver]
    ends = np.union1d(step_ends(schedule, end_s, 1), np.arange(1, int(end_s / tried_s) + 1) * tried_s)
    right = _glow(pilot, step_ends(schedule, end_s, known[-1].steps))
    error = known[-1].error + _off(_glow(pilot, ends, step), right)
    return Stepped(solver, step_s, int(np.ceil(end_s / step_s)), error)


def _check_step(pilot: Pilot, solver: str, step_s: float) -> None:
    courses = pilot.scene.schedule.courses
    for k, sampled in pilot.sampled.items():
        largest = np.array([courses[name].largest for name in sampled.drive.names])
        a = np.einsum(
            "nl,nlc,l->nc", sampled.drive.factors, per_light(sampled.ke_width, pilot.scene), largest
        )
        try:
            check_step(solver, float((a + sampled.kr).max()), step_s, repr(pilot.scene.drawables[k].name))
        except PhoslabError as error:
            raise PhoslabError(
                error.problem,
                field=f"the plan's choices.solver {solver!r}",
                remedy="Give a shorter choices.step_s, or the solver exact.",
            ) from error


def _off(found: Array, right: Array) -> float:
    """Return by which share of itself (T, points, 3) glow is off, at the worst moment."""
    difference = np.abs(found - right).sum(axis=(1, 2)) / np.maximum(right.sum(axis=(1, 2)), 1e-300)
    return float(difference.max())


def _glow(pilot: Pilot, ends: Array, solver: Step = STEPS["exact2"]) -> Array:
    """Return (T, points, 3) the glow of a few points, in steps that end at `ends`."""
    scene, parts = pilot.scene, []
    for sampled in pilot.sampled.values():
        some = np.unique(np.linspace(0, len(sampled.kr) - 1, POINTS).astype(int))
        drive = type(sampled.drive)(sampled.drive.factors[some], sampled.drive.names)
        per = per_light(sampled.ke_width[some], scene)
        r = charged(
            scene.schedule,
            sampled.phosphor.initial,
            drive,
            sampled.kr[some],
            per,
            pilot.moments,
            ends,
            solver,
        )
        parts.append(np.einsum("tnc,nc,nck->tnk", r, sampled.kr[some], sampled.emission[some]) @ pilot.to_xyz)
    return np.concatenate(parts, axis=1)
