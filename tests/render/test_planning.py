"""Plans of scenes drawn at random, held against the same scenes with everything on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from phoslab.model_plan import Choices
from phoslab.render import load_scene
from phoslab.render.planning import make_plan
from phoslab.render.planning.bounds import parse_bound
from phoslab.render.planning.drawn import render_choices

SIZE = (32, 32)
FULL = {"method": "reference", "samples": 529, "full": True, "seed": 1}


@pytest.mark.parametrize("seed", [5003, 5009])
def test_the_true_error_of_a_plan_stays_within_its_bound(
    seed: int, tmp_path: Path, planned_scenes: ModuleType
) -> None:
    """A bound of 10 %; the truth's own noise is below a fifth of it, which its two halves tell."""
    pytest.importorskip("mitsuba", reason="the extra phoslab[reference] is not installed")
    from phoslab.render.planning.reduced import whole

    drawn = planned_scenes.draw(tmp_path, seed)
    scene, time = load_scene(drawn.folder), drawn.time
    bound = parse_bound("10%")
    plan = make_plan(scene, "10%", [time], size=SIZE)
    everything: Choices = whole(scene)

    def picture(choices: Choices) -> np.ndarray:
        return render_choices(scene, choices, [time], SIZE)[0].xyz

    truth = picture(replace(everything, gi=FULL))
    half = picture(replace(everything, gi={**FULL, "samples": 132, "seed": 2}))
    # A quarter of the paths has twice the noise, or more: their difference is sqrt(5) of the truth's own.
    assert bound.error(half, truth) / np.sqrt(5) < bound.value / 5
    assert plan.predicted_error <= bound.value
    assert bound.error(picture(plan.choices), truth) <= bound.value
