"""Errors that are predicted on the pilot's own picture."""

from __future__ import annotations

import numpy as np
import pytest

from phoslab.render import load_scene
from phoslab.render.planning.bounds import parse_bound
from phoslab.render.planning.pilot import look
from phoslab.render.planning.sensitivity import SMALL, Sensitivity


@pytest.fixture(scope="module")
def pilot(tmp_path_factory, planned_scenes):
    drawn = planned_scenes.draw(tmp_path_factory.mktemp("drawn"), 6113)
    scene = load_scene(drawn.folder)
    return look(scene, [scene.schedule.parse_time(drawn.time)], (64, 64))


def test_what_each_surface_gives_sums_to_all_glow(pilot):
    glow = (pilot.glow + pilot.bounces.sum(axis=0)) @ pilot.to_xyz
    # The same numbers in another order, in float64.
    np.testing.assert_allclose(sum(pilot.from_each.values()), glow, rtol=1e-9, atol=1e-12 * glow.max())


def test_a_share_of_all_light_is_that_many_per_cent(pilot):
    assert Sensitivity(pilot, parse_bound("1%")).of(np.full_like(pilot.total, 0.03)) == pytest.approx(3.0)


def test_light_that_is_a_tenth_of_the_picture_counts_a_tenth(pilot):
    """Whichever pixels it lies in: the mean over all of them is what a bound in per cent is of."""
    few = np.zeros_like(pilot.total)
    few[:, : few.shape[1] // 3] = 0.5
    want = 100 * (few * pilot.total).sum() / pilot.total.sum()
    assert Sensitivity(pilot, parse_bound("1%")).of(few) == pytest.approx(want)


@pytest.mark.parametrize("unit", ["dE", "flip"])
def test_no_direction_of_a_small_change_is_worse_than_the_one_that_is_taken(pilot, unit):
    if unit == "flip":
        pytest.importorskip("flip_evaluator", reason="the extra phoslab[reference] is not installed")
    bound = parse_bound(f"0.5{unit}")
    sensitivity = Sensitivity(pilot, bound)
    predicted = sensitivity.of(np.full_like(pilot.total, SMALL))
    changed = pilot.pictures * (1 + SMALL * np.array([1.0, 0.0, -1.0]))
    assert 0 < sensitivity.between(changed) <= predicted


def test_what_is_dark_does_not_change(pilot):
    assert Sensitivity(pilot, parse_bound("1dE")).of(np.zeros_like(pilot.total)) == 0.0
