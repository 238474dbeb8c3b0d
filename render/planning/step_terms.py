"""The solver and its step, from how the light changes.

Where every light is constant between its jumps, a state jumps too: no error, whatever the step. Where one varies,
`exact2` takes the mean of each step; how wrong that is, is found by halving the step at a few points of the scene.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phoslab.render.planning.charging import charged, per_light, step_ends
from phoslab.render.planning.pilot import Pilot

POINTS = 8
FEWEST_STEPS, MOST_STEPS = 8, 1 << 13

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


def _glow(pilot: Pilot, n: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return (T, points, 3) the glow of a few points with n steps in all."""
    scene, parts = pilot.scene, []
    for sampled in pilot.sampled.values():
        some = np.unique(np.linspace(0, len(sampled.kr) - 1, POINTS).astype(int))
        drive = type(sampled.drive)(sampled.drive.factors[some], sampled.drive.names)
        edges = step_ends(scene.schedule, float(pilot.moments[-1]), n)
        per = per_light(sampled.ke_width[some], scene)
        r = charged(
            scene.schedule, sampled.phosphor.initial, drive, sampled.kr[some], per, pilot.moments, edges
        )
        parts.append(np.einsum("tnc,nc,nck->tnk", r, sampled.kr[some], sampled.emission[some]) @ pilot.to_xyz)
    return np.concatenate(parts, axis=1)
