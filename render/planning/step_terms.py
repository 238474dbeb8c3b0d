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
    coarse = _glow(pilot, n)
    while n < MOST_STEPS:
        fine = _glow(pilot, 2 * n)
        difference = np.abs(coarse - fine).sum(axis=(1, 2)) / np.maximum(fine.sum(axis=(1, 2)), 1e-300)
        # Second order: what is left after halving is a third of what halving changed; the whole, four thirds.
        found.append(Stepped("exact2", end_s / n, n, float(4 / 3 * difference.max())))
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
    edges = np.union1d(step_ends(schedule, end_s, 1), np.arange(1, int(end_s / tried_s) + 1) * tried_s)
    right, found = _glow(pilot, known[-1].steps), _glow(pilot, 0, edges, step)
    difference = np.abs(found - right).sum(axis=(1, 2)) / np.maximum(right.sum(axis=(1, 2)), 1e-300)
    return Stepped(solver, step_s, int(np.ceil(end_s / step_s)), known[-1].error + float(difference.max()))


def _check_step(pilot: Pilot, solver: str, step_s: float) -> None:
    largest = np.array([course.largest for course in pilot.scene.schedule.courses.values()])
    for k, sampled in pilot.sampled.items():
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


def _glow(
    pilot: Pilot, n: int, edges: Array | None = None, solver: Step = STEPS["exact2"]
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return (T, points, 3) the glow of a few points with n steps in all, or with those that end at `edges`."""
    scene, parts = pilot.scene, []
    for sampled in pilot.sampled.values():
        some = np.unique(np.linspace(0, len(sampled.kr) - 1, POINTS).astype(int))
        drive = type(sampled.drive)(sampled.drive.factors[some], sampled.drive.names)
        ends = step_ends(scene.schedule, float(pilot.moments[-1]), n) if edges is None else edges
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
