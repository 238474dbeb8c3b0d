"""Trials of quick ways to transport glow, against what is known of them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from phoslab.render import load_scene
from phoslab.render.planning.bounds import parse_bound
from phoslab.render.planning.costs import load_costs
from phoslab.render.planning.pilot import look
from phoslab.render.planning.planner import Planner, Request
from phoslab.render.planning.reduced import whole
from phoslab.render.planning.trial import UNSURE, trial_error, trial_size
from phoslab.sample_data.make_scenes import SCENES

BOUND, SIZE = parse_bound("2%"), (48, 48)
PATHS = {"method": "reference", "samples": 64, "full": True}


@pytest.fixture(scope="module")
def cornell():
    scene = load_scene(SCENES / "cornell")
    return scene, look(scene, [scene.schedule.parse_time("off+1s")], SIZE)


def tried(cornell, device, **gi):
    scene, pilot = cornell
    choices = whole(scene)
    return trial_error(pilot, BOUND, SIZE, replace(choices, gi=gi), replace(choices, gi=PATHS), device)


def test_a_trial_picture_keeps_its_shape_and_is_never_larger_than_what_is_asked_for():
    assert trial_size((768, 512)) == (96, 64)
    assert trial_size((512, 512)) == (96, 96)
    assert trial_size((64, 48)) == (64, 48)


def test_without_reflections_a_trial_finds_the_share_of_what_is_reflected(cornell, device):
    """56 % of the light in `cornell`, by the pilot's walks, which know it to a few per cent; a tenth is allowed."""
    pytest.importorskip("mitsuba")
    _, pilot = cornell
    lamp, glow, bounces = (float(m.sum()) for m in pilot.means())
    share = bounces / (lamp + glow + bounces)
    assert tried(cornell, device, method="none") == pytest.approx(100 * share, rel=0.1)


def test_the_noise_of_the_truth_is_taken_off(cornell, device):
    """Of ever more paths only their own noise is left, which falls at least with the root of their number: 8 times less
    for 64 times as many. What may be left of the truth's own is `UNSURE` of it: the mean of two pictures of 64 paths,
    each four times as noisy as 1024 at least."""
    pytest.importorskip("mitsuba")
    few, many = (tried(cornell, device, **{**PATHS, "samples": n}) for n in (16, 1024))
    of_truth = few / 2 / 2**0.5
    assert many < few / 8 + UNSURE * of_truth + 0.1 * few
    assert many > UNSURE * few / 16


def test_where_paths_take_long_what_is_quicker_is_tried_and_counts_as_it_does_here(cornell, device):
    pytest.importorskip("mitsuba")
    scene, _ = cornell
    request = Request(scene, (512, 512), ("off+1s",), (scene.schedule.parse_time("off+1s"),), BOUND)
    planner = Planner(request, load_costs(), device)
    chosen, holds = planner.choose()
    assert holds
    rival = planner.rival(chosen) if chosen.gi["method"] == "reference" else chosen
    assert rival.gi["method"] == "tiles"
    assert planner.was_tried(rival.gi)
    other = Planner(request, load_costs(), device)
    elsewhere, here = other.way(rival.gi), planner.way(rival.gi)
    assert not other.was_tried(rival.gi)
    assert here.left_out == elsewhere.left_out
    assert here.error < elsewhere.error  # of the trade the worst scene counts, which cornell is not
    assert not planner.try_quicker(replace(chosen, gi={**PATHS, "samples": 361}))
