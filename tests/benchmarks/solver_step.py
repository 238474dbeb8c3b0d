"""Measure one step of every solver and format against a pass without arithmetic.

    python tests/benchmarks/solver_step.py [TEXELS [STATES]]

STATES (2 by default) on TEXELS² texels (2048), with the excitation of one light. The other pass reads and writes the
same textures and computes nothing but a choice. "frame" is a step of 1/60 s, "jump" one of 60 s, "dark" one of 1/60 s
without light. The goal for the default, exact in f32, is a ratio of at most 1.15.
Medians of 20, taken in turns in one process, each ratio within its turn, so that a busy machine slows both.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from statistics import median

import numpy as np

from phoslab.render.bare_state import STEADY, BareState
from phoslab.render.device import Device
from phoslab.render.solvers import SOLVERS
from phoslab.render.state_formats import FORMATS
from phoslab.solvers import Drive

RUNS = 20
WARM_UP = 2
STEP_S, JUMP_S = 1 / 60, 60.0
KR = np.array([0.2, 0.01, 1.0, 3.0])
DARK = Drive.constant(np.array(0.0))


def seconds(device: Device, work: Callable[[], None]) -> float:
    device.ctx.finish()
    start = time.perf_counter()
    work()
    device.ctx.finish()
    return time.perf_counter() - start


def in_turns(device: Device, works: dict[str, Callable[[], None]]) -> dict[str, list[float]]:
    """Return the times of each in s, after those of the warm-up."""
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(RUNS + WARM_UP):
        for name, work in works.items():
            times[name].append(seconds(device, work))
    return {name: taken[WARM_UP:] for name, taken in times.items()}


def measure(device: Device, solver: str, state_format: str, texels: int, states: int) -> None:
    rng = np.random.default_rng(0)
    a, r0 = rng.uniform(0, 1, (2, texels, texels, states))
    with device.scope():
        state = BareState(device, KR[:states], a, solver, state_format, r0)
        took = in_turns(
            device,
            {
                "copy": state.copy,
                "frame": lambda: state.advance(STEP_S, STEADY),
                "dark": lambda: state.advance(STEP_S, DARK),
            }
            | ({"jump": lambda: state.advance(JUMP_S, STEADY)} if SOLVERS[solver].closed_form else {}),
        )
    copy = took.pop("copy")
    ratios = "".join(
        f"{name:>8} {median(t / c for t, c in zip(taken, copy, strict=True)):5.2f}"
        for name, taken in took.items()
    )
    print(f"{solver:8} {state_format:8} {state.bytes_per_texel:6} {median(copy) * 1e3:9.2f}{ratios}")


def main(texels: int = 2048, states: int = 2) -> None:
    with Device() as device:
        print(f"{device.renderer}, {texels} x {texels} texels, {states} states; medians of {RUNS}")
        print("solver   format   B/texel copy [ms]  ratios to it")
        for state_format in FORMATS:
            for solver in SOLVERS:
                measure(device, solver, state_format, texels, states)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
