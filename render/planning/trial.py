"""What a quick way to transport glow errs by in one scene: a small picture of it, held to one of paths.

What was measured elsewhere is that of the worst scene. Where a plan would trace paths for minutes, a little of that
time tells what the quick way does here. Pixels are few, so that a filter over some of them blurs more than in the
picture itself: the quick way looks worse than it is. The noise of the paths is known from two pictures of them, and
taken off.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from phoslab.model_plan import Choices
from phoslab.render.device import Device
from phoslab.render.planning.bounds import Bound
from phoslab.render.planning.drawn import render_choices
from phoslab.render.planning.pilot import Pilot
from phoslab.render.planning.probe import SUPERSAMPLING, most_reflected

# Pixels along the longer side.
SIDE = 96

# Squares of errors and of noise add where they are alike. How far that may be off, as a share of the noise.
UNSURE = 0.3


def trial_size(size: tuple[int, int]) -> tuple[int, int]:
    """Return the size of the small picture of a large one."""
    shrink = max(1.0, max(size) / SIDE)
    return max(1, round(size[0] / shrink)), max(1, round(size[1] / shrink))


def trial_error(
    pilot: Pilot, bound: Bound, size: tuple[int, int], quick: Choices, truth: Choices, device: Device | None
) -> float:
    """Return what a quick way errs by, in the bound's unit, when reflected glow is the most of the light.

    Args:
        size: of the picture that is asked for.
        quick, truth: they differ in how glow is transported.
    """
    at = most_reflected(pilot)
    moment, exposure = float(pilot.moments[at]), pilot.exposures[at]

    def picture(choices: Choices) -> NDArray[np.floating]:
        small = trial_size(size)
        frames = render_choices(
            pilot.scene, choices, [moment], small, supersampling=SUPERSAMPLING, device=device
        )
        return frames[0].xyz

    one, other = (picture(replace(truth, gi={**truth.gi, "seed": seed})) for seed in (1, 2))
    off = bound.error(picture(quick), (one + other) / 2, exposure)
    # The difference of two has sqrt(2) of the noise of one, which is sqrt(2) of that of their mean.
    noise = bound.error(one, other, exposure) / 2
    return math.sqrt(max(off**2 - noise**2, 0.0) + (UNSURE * noise) ** 2)
