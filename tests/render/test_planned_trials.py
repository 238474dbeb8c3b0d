"""Trials of quick ways to transport glow, against what is known of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from phoslab.render import load_scene
from phoslab.render.planning import trial
from phoslab.render.planning.bounds import parse_bound
from phoslab.render.planning.costs import load_costs
from phoslab.render.planning.pilot import look
from phoslab.render.planning.planner import Planner, Request
from phoslab.render.planning.reduced import whole
from phoslab.render.planning.trial import ROUNDS, SIDE, SIGMAS, WINDOWS, Trial, trial_size, windows
from phoslab.sample_data.make_scenes import SCENES

BOUND, SIZE, AT = parse_bound("2%"), (192, 128), "off+1s"
THREE = (380.0, 480.0, 580.0, 780.0)


@pytest.fixture(scope="module")
def cornell():
    scene = load_scene(SCENES / "cornell")
    edges = scene.transport.edges_nm
    few = tuple(float(edges[np.abs(edges - nm).argmin()]) for nm in THREE)
    plain = replace(whole(scene), bands_nm=(edges[0], *few[1:-1], edges[-1]))
    return plain, look(scene, [scene.schedule.parse_time(AT)], SIZE)


def tried(cornell, device, paths=(16, 64), **gi):
    plain, pilot = cornell
    made = Trial(pilot, SIZE, replace(plain, gi=gi), device)
    for samples in paths:
        made.follow(samples)
    return made


def test_windows_lie_in_the_picture_and_see_its_pixels_as_large_as_they_are():
    """Corners of windows, back on the picture, lie in their part of it; a window covers as many pixels as it has: near
    the corners of a picture, where a pixel is seen aslant, to a few per cent."""
    camera = load_scene(SCENES / "cornell").camera
    found, (w, h) = windows(camera, SIZE)
    assert (w, h) == (SIDE, SIDE)
    assert len(found) == WINDOWS**2
    for k, window in enumerate(found):
        half = np.tan(window.yfov_rad / 2)
        corners = np.array(
            [[x, y, -1.0] for x, y in ((-half, -half), (half, -half), (half, half), (-half, half))]
        )
        back = corners @ (camera.world_to_view[:3, :3] @ window.world_to_view[:3, :3].T).T
        focal = SIZE[1] / 2 / np.tan(camera.yfov_rad / 2)
        x, y = (back[:, :2] / -back[:, 2:] * focal * [1, -1] + np.array(SIZE) / 2).T
        row, column = divmod(k, WINDOWS)
        slack = 0.1 * SIDE
        assert x.min() > column * SIZE[0] / WINDOWS - slack
        assert x.max() < (column + 1) * SIZE[0] / WINDOWS + slack
        assert y.min() > row * SIZE[1] / WINDOWS - slack
        assert y.max() < (row + 1) * SIZE[1] / WINDOWS + slack
        area = 0.5 * abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1)))
        assert area == pytest.approx(SIDE**2, rel=0.05)


def test_a_small_picture_is_one_window():
    camera = load_scene(SCENES / "cornell").camera
    assert windows(camera, (64, 48)) == ([camera], (64, 48))
    assert trial_size((64, 48)) == (64, 48)
    assert trial_size((768, 512)) == (WINDOWS * SIDE, WINDOWS * SIDE)


def test_light_that_a_way_loses_is_found(cornell, device):
    """Of tiles of one reflection, held to paths of two, what the second brings is missed."""
    pytest.importorskip("mitsuba")
    plain, pilot = cornell
    made = Trial(pilot, SIZE, replace(plain, gi={"method": "tiles", "directions": 64}), device)
    made._reflections = 2
    for samples in ROUNDS[:2]:
        made.follow(samples)
    first, second = (float(m) for m in pilot.means()[2][:2, 0])
    # The pilot's walks know it to some per cent, and windows are a sample of the picture.
    assert made.error() == pytest.approx(second / (first + second), rel=0.25)


def test_the_noise_of_the_paths_is_taken_off_and_what_is_left_of_it_is_told(cornell, device):
    """A way without error but its noise: paths themselves. What is found falls with the root of their number, whatever
    they are held to; and the standard error with what they are held to."""
    pytest.importorskip("mitsuba")
    coarse = tried(cornell, device, (16,), method="tiles", directions=8, bounces=2)
    fine = tried(cornell, device, (16, 64, 256), method="tiles", directions=8, bounces=2)
    low, high = (coarse.error(s * SIGMAS) for s in (-1, 1))
    assert low < fine.error() < high
    assert fine.error(SIGMAS) - fine.error(-SIGMAS) < high - low


def test_where_paths_take_long_what_is_quicker_is_tried_and_counts_as_it_does_here(cornell, device):
    pytest.importorskip("mitsuba")
    scene = cornell[1].scene
    request = Request(scene, (512, 512), (AT,), (scene.schedule.parse_time(AT),), BOUND)
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
    paths = {"method": "reference", "samples": 361, "full": True}
    assert not planner.try_quicker(replace(chosen, gi=paths))


def test_a_trial_ends_when_it_is_known_whether_a_way_will_do(cornell, device, monkeypatch):
    """A bound that is far from what tiles err by takes the first round alone."""
    pytest.importorskip("mitsuba")
    rounds = []
    follow = Trial.follow
    monkeypatch.setattr(trial.Trial, "follow", lambda self, n: (rounds.append(n), follow(self, n)))
    scene = cornell[1].scene
    request = Request(scene, (512, 512), (AT,), (scene.schedule.parse_time(AT),), parse_bound("0.2%"))
    planner = Planner(request, load_costs(), device)
    assert planner.choose()[0].gi["method"] == "reference"
    assert rounds == [ROUNDS[0]]
