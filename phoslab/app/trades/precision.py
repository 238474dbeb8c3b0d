"""Work and precision of the solvers under each light programme: every method on the same problem.

A problem is a material of two states on many texels, whose irradiances span two decades, under one light
programme. The error of a method is that of the glow: at each of `CHECKPOINTS` times the root mean square over the
texels of the relative difference from the yardstick, and of these the largest. The cost is the time of a whole run,
in ns a texel and simulated second, and the number of times that the light had to be evaluated.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phoslab import history, solvers
from phoslab.errors import PhoslabError
from phoslab.programmes import Programme, Sine, Strobe, Sweep, Switched, mains_flicker, mean
from phoslab.solvers import Drive, Step

Array = NDArray[np.float64]

KR = np.array([0.132, 0.009])  # the stickers of Nalbach 2017, Table A.1
EMISSION = np.array([1.0, 4.5])  # their re-radiation functions' ratio, in the strongest band
CHECKPOINTS = 8
EQUAL_ERROR = 1e-3


@dataclass(frozen=True)
class Problem:
    """A light programme over a stretch of time, on many texels.

    Args:
        name, description: for people.
        programme: the light.
        duration_s: how long.
        a: (n_texels, 2) excitation at factor 1, in 1/s.
    """

    name: str
    description: str
    programme: Programme
    duration_s: float
    a: Array

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
        Problem("constant", "a lamp that stays on", Switched(((0.0, np.inf),)), 20.0, a),
        Problem(
            "switched",
            "on for 5 s, off for 7 s, on for 3 s, off",
            Switched(((0, 5.0), (12.0, 15.0))),
            20.0,
            a,
        ),
        Problem("sinusoidal", "swells and fades with a period of 4 s", Sine(4.0), 20.0, a),
        Problem("mains flicker", "an unsmoothed lamp at 50 Hz mains: 100 Hz", mains_flicker(50.0), 2.0, a),
        Problem("strobe", "flashes of 1 ms, 20 a second", Strobe(0.05, 0.02), 4.0, a),
        Problem("laser sheet", "sweeps by once, 0.1 s at each place", Sweep(passes, 0.05), 4.0, 20 * a),
    ]


def measure(problem: Problem, *, repeats: int, finest: int) -> list[Point]:
    """Run every method with every setting on one problem.

    Args:
        repeats: runs of each, of which the median time counts.
        finest: exponent of two of the most steps between two checkpoints.
    """
    truth = _glow(_cut_at_changes(problem, solvers.SOLVERS["dop853"]))
    points = []
    for method, setting, run in _methods(problem, finest):
        try:
            times, lights = [], 0
            for _ in range(repeats):
                counted = _Counted(problem)
                begin = time.perf_counter()
                states = run(counted.problem)
                times.append(time.perf_counter() - begin)
                lights = counted.n
        except PhoslabError:
            continue  # the solver refuses this step, as it says it does
        per_texel = 1e9 / problem.duration_s / len(problem.a)
        points.append(
            Point(
                method,
                setting,
                _error(_glow(states), truth),
                float(np.median(times)) * per_texel,
                max(times) / min(times),
                lights / problem.duration_s,
            )
        )
    return points


def time_to(points: list[Point], method: str, error: float = EQUAL_ERROR) -> float | None:
    """Return the time at which a method reaches `error`, between its points on the log-log plot; None: never.

    A method that is at its cheapest setting already better is taken at that setting.
    """
    own = sorted((p for p in points if p.method == method), key=lambda p: p.ns)
    good = [p for p in own if p.error <= error]
    if not good:
        return None
    best = min(good, key=lambda p: p.ns)
    worse = [p for p in own if p.error > error and p.ns < best.ns]
    if not worse:
        return best.ns
    near = max(worse, key=lambda p: p.ns)
    share = np.log(near.error / error) / np.log(near.error / max(best.error, 1e-300))
    return float(np.exp(np.log(near.ns) + share * np.log(best.ns / near.ns)))


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

        self.problem = Problem(problem.name, problem.description, Counting(), problem.duration_s, problem.a)


Run = Callable[[Problem], Array]


def _methods(problem: Problem, finest: int) -> Iterator[tuple[str, str, Run]]:
    """Yield (method, setting, run): every solver with steps from a checkpoint apart to 2^finest times finer."""
    for name in ("euler", "substep", "exact", "exact2"):
        for e in range(finest + 1):
            dt = problem.duration_s / CHECKPOINTS / 2**e
            yield name, f"dt = {dt:.3g} s", lambda p, n=2**e, s=solvers.SOLVERS[name]: _march(p, s, n)
    if problem.programme.piecewise_constant:
        yield "closed form", "one step a change", lambda p: _cut_at_changes(p, solvers.SOLVERS["exact"])
    for tolerance in 10.0 ** -np.arange(1, 8):
        # Weak light makes small states: the absolute tolerance must be smaller than those.
        step = solvers.runge_kutta("RK23", rtol=tolerance, atol=1e-12)
        yield "rk23", f"rtol = {tolerance:.0e}", lambda p, s=step: _cut_at_changes(p, s)
    for n in (1, 1024):
        if n * len(problem.a) <= 2**21:
            yield f"history, {n} sample{'s' if n > 1 else ''}", "a checkpoint", lambda p, n=n: _history(p, n)


def _march(problem: Problem, step: Step, n: int) -> Array:
    """Take `n` equal steps between checkpoints; return (CHECKPOINTS, n_texels, 2) states."""
    r, states = np.zeros_like(problem.a), []
    for begin, end in pairwise(problem.checkpoints):
        for start, stop in pairwise(np.linspace(begin, end, n + 1)):
            r = step(r, problem.drive(start, stop), KR, np.array(stop - start))
        states.append(r)
    return np.array(states)


def _cut_at_changes(problem: Problem, step: Step) -> Array:
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


def _history(problem: Problem, n: int) -> Array:
    rng = np.random.default_rng(0)
    kr = np.broadcast_to(KR, problem.a.shape)

    def past(t: Array) -> Array:
        values: Array = problem.a * problem.programme.at(t)
        return values

    return np.array([history.monte_carlo(past, kr, t, n, rng) for t in problem.checkpoints[1:]])


def _glow(states: Array) -> Array:
    """(..., n_texels) glow Σ Λ_i kr_i r_i (Nalbach 2017, eq. 8.3) in one band."""
    L: Array = states @ (EMISSION * KR)
    return L


def _error(glow: Array, truth: Array) -> float:
    # Before the laser sheet has passed a texel it is as dark as it was: what is relative to nothing is left out.
    lit = truth > 1e-9 * truth.max()
    relative = np.where(lit, glow / np.where(lit, truth, 1.0) - 1.0, 0.0)
    return float(np.sqrt(np.mean(relative**2, axis=1)).max())
