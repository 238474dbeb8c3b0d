"""Work and precision of the solvers under each light programme: every method on the same problem.

A problem is a material of two states on many texels, whose irradiances span two decades, under one light
programme. The error of a method is that of the glow: at each of `CHECKPOINTS` times the root mean square over the
texels of the relative difference from the yardstick, and of these the largest. The cost is the time of a whole run,
in ns a texel and simulated second, and the number of times that the light had to be evaluated.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phoslab import history, solvers
from phoslab.errors import PhoslabError
from phoslab.programmes import Programme, Sine, Strobe, Sweep, Switched, mains_flicker, mean
from phoslab.solvers import Drive, Step

Array = NDArray[np.float64]

YARDSTICK = solvers.SOLVERS["dop853"]
KR = np.array([0.132, 0.009])  # the stickers of Nalbach 2017, Table A.1
EMISSION = np.array([1.0, 4.5])  # their re-radiation functions' ratio, in the strongest band
CHECKPOINTS = 8
EQUAL_ERROR = 1e-3
# Finer settings than the one that gets here show nothing new.
FINEST_ERROR = {
    "euler": 3e-4,
    "substep": 3e-4,
    "exact": 3e-4,
    "exact2": 1e-7,
    "closed form": 0.0,
    "rk23": 1e-7,
}
FINEST_ERROR |= {"history, 1 sample": 0.0, "history, 1024 samples": 0.0}


@dataclass(frozen=True)
class Problem:
    """A light programme over a stretch of time, on many texels.

    Args:
        name, description: for people.
        programme: the light.
        duration_s: how long.
        a: (n_texels, 2) excitation at factor 1, in 1/s.
        strength: what `a` was scaled by.
    """

    name: str
    description: str
    programme: Programme
    duration_s: float
    a: Array
    strength: float = 1.0

    def excitation(self, t: float) -> Array:
        """(n_texels, 2) excitation at a time, in 1/s."""
        return self.a * self.programme.at(t)

    def drive(self, start: float, stop: float) -> Drive:
        """The excitation over one step."""
        return Drive(
            lambda s: self.excitation(start + s * (stop - start)),
            lambda: self.a * mean(self.programme, start, stop),
        )

    @property
    def checkpoints(self) -> Array:
        """(CHECKPOINTS + 1,) the start, and the times at which the glow is compared."""
        return np.linspace(0.0, self.duration_s, CHECKPOINTS + 1)


@dataclass(frozen=True)
class Point:
    """One run of one method.

    Args:
        method: its name.
        setting: what was varied, for people ("dt = 1/60 s").
        error: see the head of this module.
        ns: time a texel and simulated second, in ns; the median of the runs.
        spread: largest over smallest time of the runs.
        lights: evaluations of the light a simulated second.
    """

    method: str
    setting: str
    error: float
    ns: float
    spread: float
    lights: float


def problems(n_texels: int, strength: float, seed: int = 1) -> list[Problem]:
    """Return every programme, on texels whose excitation spans 0.003 to 0.3 1/s, times `strength`."""
    rng = np.random.default_rng(seed)
    a = strength * 10 ** rng.uniform(-2.5, -0.5, n_texels)[:, None] * np.array([1.0, 0.4])
    passes = rng.uniform(0.5, 3.5, n_texels)[:, None]
    return [
        Problem(name, description, programme, duration_s, a * brighter, strength)
        for name, description, programme, duration_s, brighter in (
            ("constant", "a lamp that stays on", Switched(((0.0, np.inf),)), 20.0, 1),
            ("switched", "5 s on, 7 s off, 3 s on, 5 s off", Switched(((0, 5.0), (12.0, 15.0))), 20.0, 1),
            # Durations that no period divides: steps in time with the light would be right, or wrong, by luck.
            ("sinusoidal", "a period of 4 s", Sine(4.0), 20.6, 1),
            ("mains flicker", "unsmoothed, 100 Hz", mains_flicker(50.0), 2.0173, 1),
            ("strobe", "flashes of 1 ms, 20 a second", Strobe(0.05, 0.02), 4.0371, 1),
            ("laser sheet", "sweeps by once, 0.1 s", Sweep(passes, 0.05), 4.0, 20),
        )
    ]


def measure(problem: Problem, *, repeats: int, patience_s: float) -> list[Point]:
    """Run every method on one problem, each setting finer than the last, for as long as there is something to see.

    Args:
        repeats: runs of each setting, of which the median time counts.
        patience_s: a setting whose run takes longer is its method's last.
    """
    truth = glow(cut_at_changes(problem, step=YARDSTICK))
    points = []
    for method, settings in _methods(problem).items():
        for setting, run in settings:
            try:
                point, took_s = _measure_one(problem, method, setting, run, truth, repeats)
            except PhoslabError:
                continue  # the solver refuses this step, as it says it does
            points.append(point)
            if took_s > patience_s or point.error < FINEST_ERROR[method]:
                break
    return points


def _measure_one(
    problem: Problem, method: str, setting: str, run: Run, truth: Array, repeats: int
) -> tuple[Point, float]:
    times, lights, states = [], 0, np.empty(0)
    for _ in range(repeats):
        counted = _Counted(problem)
        begin = time.perf_counter()
        states = run(counted.problem)
        times.append(time.perf_counter() - begin)
        lights = counted.n
    took_s = float(np.median(times))
    return Point(
        method,
        setting,
        error(glow(states), truth),
        took_s * 1e9 / problem.duration_s / len(problem.a),
        max(times) / min(times),
        lights / problem.duration_s,
    ), took_s


@dataclass(frozen=True)
class Measured:
    """A problem and every run on it."""

    problem: Problem
    points: list[Point]

    def time_to(self, method: str, error: float = EQUAL_ERROR) -> float | None:
        """Return the time in ns at which a method reaches `error`, between its points on the log-log plot.

        None where it never does. A method that is better already at its cheapest setting is taken at that.
        """
        own = [p for p in self.points if p.method == method]
        good = [p for p in own if p.error <= error]
        if not good:
            return None
        best = min(good, key=lambda p: p.ns)
        worse = [p for p in own if p.error > error and p.ns < best.ns]
        if not worse:
            return best.ns
        near = max(worse, key=lambda p: p.ns)
        share = np.log(near.error / error) / np.log(near.error / max(best.error, np.finfo(float).tiny))
        return float(np.exp(np.log(near.ns) + share * np.log(best.ns / near.ns)))

    def gain(self, rival: str) -> tuple[float, bool] | None:
        """Return how many times faster than `rival` the best exact step reaches `EQUAL_ERROR`.

        And whether that is only a lower bound, since the rival was still worse when patience ended. None: no exact
        step got there.
        """
        own = [t for m in ("exact", "exact2", "closed form") if (t := self.time_to(m)) is not None]
        if not own:
            return None
        theirs = self.time_to(rival)
        if theirs is not None:
            return theirs / min(own), False
        return max(p.ns for p in self.points if p.method == rival) / min(own), True


Run = Callable[[Problem], Array]


class _Counted:
    """A problem that counts how often its light is asked for."""

    def __init__(self, problem: Problem) -> None:
        self.n = 0
        counter, programme = self, problem.programme

        class Counting:
            piecewise_constant = programme.piecewise_constant

            def at(self, t: ArrayLike) -> Array:
                counter.n += max(1, np.size(t) // problem.a.size)
                return programme.at(t)

            def integral(self, t: ArrayLike) -> Array:
                counter.n += 1
                return programme.integral(t)

            def changes(self, start: float, stop: float) -> Array:
                return programme.changes(start, stop)

        self.problem = replace(problem, programme=Counting())


def _methods(problem: Problem) -> dict[str, list[tuple[str, Run]]]:
    """Every method's settings, coarse to fine: steps from a checkpoint apart to 2^13 times finer, or tolerances."""
    methods: dict[str, list[tuple[str, Run]]] = {}
    for name in ("euler", "substep", "exact", "exact2"):
        step = solvers.SOLVERS[name]
        methods[name] = [
            (f"dt = {problem.duration_s / CHECKPOINTS / 2**e:.3g} s", partial(_march, step=step, n=2**e))
            for e in range(14)
        ]
    if problem.programme.piecewise_constant:
        run = partial(cut_at_changes, step=solvers.SOLVERS["exact"])
        methods["closed form"] = [("one step a change", run)]
    methods["rk23"] = [
        # Weak light makes small states: the absolute tolerance must be smaller than those.
        (
            f"rtol = {rtol:.0e}",
            partial(cut_at_changes, step=solvers.runge_kutta("RK23", rtol=rtol, atol=1e-12)),
        )
        for rtol in 10.0 ** -np.arange(1, 8)
    ]
    methods["history, 1 sample"] = [("", partial(_history, n=1))]
    methods["history, 1024 samples"] = [("", partial(_history, n=1024))]
    return methods


def _march(problem: Problem, *, step: Step, n: int) -> Array:
    """Take `n` equal steps between checkpoints; return (CHECKPOINTS, n_texels, 2) states."""
    r, states = np.zeros_like(problem.a), []
    for begin, end in pairwise(problem.checkpoints):
        for start, stop in pairwise(np.linspace(begin, end, n + 1)):
            r = step(r, problem.drive(start, stop), KR, np.array(stop - start))
        states.append(r)
    return np.array(states)


def cut_at_changes(problem: Problem, *, step: Step) -> Array:
    """Take one step from jump to jump of the light; return (CHECKPOINTS, n_texels, 2) states."""
    r, states = np.zeros_like(problem.a), []
    for begin, end in pairwise(problem.checkpoints):
        for start, stop in pairwise(np.r_[begin, problem.programme.changes(begin, end), end]):
            # Of a jump at the step's end, only the value before it belongs to the step.
            inside = _from_inside(problem, start, stop)
            r = step(r, inside, KR, np.array(stop - start))
        states.append(r)
    return np.array(states)


def _from_inside(problem: Problem, start: float, stop: float) -> Drive:
    if problem.programme.piecewise_constant:
        return Drive.constant(problem.excitation((start + stop) / 2))
    return problem.drive(start, stop)


def _history(problem: Problem, *, n: int) -> Array:
    rng = np.random.default_rng(0)
    kr = np.broadcast_to(KR, problem.a.shape)

    def past(t: Array) -> Array:
        values: Array = problem.a * problem.programme.at(t)
        return values

    return np.array([history.monte_carlo(past, kr, t, n, rng) for t in problem.checkpoints[1:]])


def glow(states: Array) -> Array:
    """(..., n_texels) glow Σ Λ_i kr_i r_i (Nalbach 2017, eq. 8.3) in one band."""
    L: Array = states @ (EMISSION * KR)
    return L


def error(glow: Array, truth: Array) -> float:
    # Before the laser sheet has passed a texel it is as dark as it was: what is relative to nothing is left out.
    lit = truth > 1e-9 * truth.max()
    relative = np.where(lit, glow / np.where(lit, truth, 1.0) - 1.0, 0.0)
    return float(np.sqrt(np.mean(relative**2, axis=1)).max())
