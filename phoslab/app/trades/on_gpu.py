"""The renderer's solvers and state formats, in GLSL on textures: what a step costs, and what rounding does."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from phoslab.app.trades import precision
from phoslab.app.trades.extremes import Corners, Stepper
from phoslab.app.trades.hours import CHARGING, DT, HoursError, relative_error
from phoslab.app.trades.hours import KR as SLOW_KR
from phoslab.app.trades.precision import CHECKPOINTS, KR, Point, Problem
from phoslab.programmes import mean
from phoslab.render.bare_state import BareState
from phoslab.render.device import Device
from phoslab.render.solvers import SOLVERS
from phoslab.render.state_formats import FORMATS
from phoslab.solvers import Drive

Array = NDArray[np.float64]

DARK = Drive.constant(np.array(0.0))

# Spacing of each format's numbers near 1; a step rounds a few times in float32 and once more when it is stored.
RESOLUTION = {"f32": 4 * 2.0**-24, "f16": 2.0**-11, "unorm16": 1 / 65535, "f32c": 4 * 2.0**-24}


@dataclass(frozen=True)
class StepCost:
    """One step of one solver in one format.

    Args:
        bytes_per_texel: of the state, two states.
        ns: of a step of 1/60 s a texel, the median.
        over_copy: of that to a pass with the same reads and writes and no arithmetic, timed in turns with it.
        jump_over_copy: the same of a step of a minute; None for a solver that would take many.
        dark_over_copy: the same of a step of 1/60 s without light.
        error: of the glow after 20 s of 60 Hz steps under switched light, as in `precision`.
    """

    solver: str
    state_format: str
    bytes_per_texel: int
    ns: float
    over_copy: float
    jump_over_copy: float | None
    dark_over_copy: float
    error: float


def costs(device: Device, side: int, repeats: int) -> Iterator[StepCost]:
    """Yield the cost of every solver in every format, on side x side texels of two states."""
    a = np.random.default_rng(0).uniform(0, 0.3, (side, side, KR.size))
    switched = next(p for p in precision.problems(256, 1.0) if p.name == "switched")
    truth = precision.glow(precision.cut_at_changes(switched, step=precision.YARDSTICK))
    for solver, state_format in product(SOLVERS, FORMATS):
        with device.scope():
            state = BareState(device, KR, a, solver, state_format, 0.5)
            works: list[Callable[[], None]] = [
                state.copy,
                partial(state.advance, 1 / 60),
                partial(state.advance, 1 / 60, DARK),
            ]
            if SOLVERS[solver].closed_form:
                works.append(partial(state.advance, 60.0))
            took, ratios = _in_turns(device, works, repeats)
        with device.scope():
            states = _march(
                device, switched, solver, state_format, n=150
            )  # 20 s in 8 parts: 150 steps of 1/60 s each
        yield StepCost(
            solver,
            state_format,
            FORMATS[state_format].bytes_per_texel(KR.size),
            took[1] * 1e9 / side**2,
            ratios[1],
            ratios[3] if SOLVERS[solver].closed_form else None,
            ratios[2],
            precision.error(precision.glow(states), truth),
        )


def work_precision(device: Device, problem: Problem, finest: int) -> Iterator[Point]:
    """Yield every solver of the renderer in float32 on one problem, with steps from a checkpoint apart to finer."""
    truth = precision.glow(precision.cut_at_changes(problem, step=precision.YARDSTICK))
    for solver in SOLVERS:
        for e in range(finest + 1):
            steps = CHECKPOINTS * 2**e
            if SOLVERS[solver].largest_step < float(
                (problem.a.max() * 2 + KR.max()) * problem.duration_s / steps
            ):
                continue  # refused, or nearly: the light may double for a moment
            with device.scope():
                device.ctx.finish()
                begin = time.perf_counter()
                states = _march(device, problem, solver, "f32", n=2**e)
                took = time.perf_counter() - begin
            setting = f"dt = {problem.duration_s / steps:.3g} s"
            ns = took * 1e9 / problem.duration_s / len(problem.a)
            yield Point(solver, setting, precision.error(precision.glow(states), truth), ns, 1.0, steps)


def over_hours(device: Device, hours: float, *, anchored: bool) -> Iterator[HoursError]:
    """Yield what becomes of a slow material: in one step in the default format; or in 60 Hz steps in each."""
    for lit, state_format in product((True, False), ("f32",) if anchored else FORMATS):
        a, r0 = (CHARGING, 0.0) if lit else (0.0, 1.0)
        with device.scope():
            state = BareState(device, [SLOW_KR], np.full((1, 1, 1), a), "exact", state_format, r0)
            if anchored:
                state.advance(hours * 3600)
            else:
                state.advance_many(DT, round(hours * 3600 / DT))
            error = relative_error(float(state.read()[0, 0, 0]), hours, lit=lit)
        name = f"{state_format}, anchored (the default)" if anchored else f"{state_format}, stepped"
        yield HoursError(name, hours, lit, error)


def in_texture(device: Device, state_format: str) -> Stepper:
    """Return a stepper that puts every corner into a texel, one texture for each step length."""

    def step(solver: str, corners: Corners) -> Array:
        stepped = np.empty_like(corners.r)
        for dt in np.unique(corners.dt):
            own = corners.dt[:, 0] == dt
            r, a, kr = (x[own][None] for x in (corners.r, corners.a, corners.kr))
            with device.scope():
                state = BareState(device, kr, a, solver, state_format, r)
                state.advance(float(dt))
                stepped[own] = state.read()[0]
        return stepped

    return step


def _march(device: Device, problem: Problem, solver: str, state_format: str, *, n: int) -> Array:
    """Take `n` equal steps between checkpoints; return (CHECKPOINTS, n_texels, 2) states."""
    state = BareState(device, KR, problem.a[None], solver, state_format)
    states = []
    for begin, end in pairwise(problem.checkpoints):
        for start, stop in pairwise(np.linspace(begin, end, n + 1)):
            state.advance(stop - start, _factors(problem, start, stop))
        states.append(state.read()[0])
    return np.array(states)


def _factors(problem: Problem, start: float, stop: float) -> Drive:
    """The light over a step as factors on the excitation: a texture once, a few numbers a step."""
    return Drive(
        lambda s: np.asarray(problem.programme.at(start + s * (stop - start))),
        lambda: np.asarray(mean(problem.programme, start, stop)),
    )


def _in_turns(
    device: Device, works: Sequence[Callable[[], None]], repeats: int
) -> tuple[list[float], list[float]]:
    """Take turns at all works.

    Returns:
        The median time of each in s, and the median ratio of each to the first in the same turn: of these a busy
        machine, which slows a whole turn, changes little.
    """
    times = np.empty((repeats + 1, len(works)))
    for turn in times:
        for k, work in enumerate(works):
            device.ctx.finish()
            begin = time.perf_counter()
            work()
            device.ctx.finish()
            turn[k] = time.perf_counter() - begin
    counted = times[1:]
    return np.median(counted, axis=0).tolist(), np.median(counted / counted[:, :1], axis=0).tolist()
