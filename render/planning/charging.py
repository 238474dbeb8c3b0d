"""How full the states of a few points are at a few times: the rate equations in float64, without a device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.programmes import mean
from phoslab.render.light_course import Course
from phoslab.render.scene import Initial, Scene
from phoslab.render.schedule import Schedule
from phoslab.solvers import Drive as Excitation
from phoslab.solvers import Step, equilibrium, exact2

Array = NDArray[np.float64]

# Where lights change more often or vary, so many steps of mean light stand for the whole.
MOST_CHANGES = 256


@dataclass(frozen=True, eq=False)
class Drive:
    """What charges n points: each light's irradiance there over that at 1 m.

    Args:
        factors: (n, n_lights) geometry and shadows.
        names: of the lights, in that order.
    """

    factors: Array
    names: tuple[str, ...]


def charged(
    schedule: Schedule,
    initial: Initial,
    drive: Drive,
    kr: Array,
    per_light: Array,
    moments: Array | Sequence[float],
    edges: Array | None = None,
    solver: Step = exact2,
) -> Array:
    """Return (n_moments, n, n_c) the concentrations at ascending moments.

    Args:
        kr: (n, n_c) in 1/s.
        per_light: (n, n_lights, n_c) excitation in 1/s that each light gives at factor 1.
        edges: ends of the steps in s; None: every change of light, or `MOST_CHANGES` steps of mean light.
        solver: what takes a step.
    """
    a = drive.factors[:, :, None] * per_light
    alike = [schedule.courses[name] for name in drive.names]
    r = np.full(kr.shape, 1.0 if initial.state == "saturated" else 0.0)
    if initial.lights:
        on = np.array([name in initial.lights for name in drive.names], dtype=np.float64)
        r = equilibrium(np.einsum("l,nlc->nc", on, a), kr)
    if edges is None:
        edges = step_ends(schedule, float(max(moments)))
    ends = np.unique(np.concatenate([edges, np.asarray(moments, dtype=np.float64)]))
    states, at = {0.0: r}, 0.0
    for end in ends[ends > 0]:
        r = solver(r, _drive(alike, a, at, float(end)), kr, np.asarray(end - at))
        at = float(end)
        states[at] = r
    return np.stack([states[float(t)] for t in moments])


def _drive(courses: Sequence[Course], a: Array, begin_s: float, end_s: float) -> Excitation:
    """Return the (n, n_c) excitation from one time to another, of (n, n_lights, n_c) at factor 1."""

    def of(factors: list[float]) -> Array:
        together: Array = np.einsum("l,nlc->nc", np.array(factors).reshape(a.shape[1]), a)
        return together

    # At its end, the light before a jump.
    return Excitation(
        lambda s: of([course.at(begin_s + min(s, 1 - 1e-9) * (end_s - begin_s)) for course in courses]),
        lambda: of([mean_factor(course, begin_s, end_s) for course in courses]),
    )


def per_light(ke_width: Array, scene: Scene) -> Array:
    """Return (n, n_lights, n_c) the excitation in 1/s that each light gives at factor 1."""
    spectra = np.array([light.irradiance_at_1m for light in scene.lights]).reshape(-1, scene.transport.n)
    excitation: Array = np.einsum("nck,lk->nlc", ke_width, spectra)
    return excitation


def step_ends(schedule: Schedule, end_s: float, steps: int = MOST_CHANGES) -> Array:
    """Return the ends of steps from 0 to `end_s`: at every change of light, and evenly between if lights vary."""
    courses = list(schedule.alike)
    switches = [t for c in courses for on_off in c.on.intervals for t in on_off if 0 < t < end_s]
    ends = np.array([*switches, end_s])
    if schedule.piecewise_constant and sum(c.most_changes(end_s) for c in courses) <= 4 * MOST_CHANGES:
        return np.unique([*ends, *(t for c in courses for t in c.changes(0.0, end_s))])
    return np.unique([*ends, *np.linspace(0.0, end_s, steps + 1)[1:]])


def mean_factor(course: Course, begin_s: float, end_s: float) -> float:
    """Return the mean of a light's factor over a stretch."""
    total = 0.0
    for on, off in course.on.intervals:
        low, high = max(on, begin_s), min(off, end_s)
        if high > low:
            total += (high - low) * float(mean(course.programme, low, high))
    return total / (end_s - begin_s)
