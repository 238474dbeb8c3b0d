"""The number of reflections as a decision: what is left out, and which ways know more than one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from phoslab.render import load_scene
from phoslab.render.planning import transport_terms
from phoslab.render.planning.bounds import parse_bound
from phoslab.render.planning.costs import Costs, MeasuredWay
from phoslab.render.planning.pilot import look
from phoslab.render.planning.probe import PathNoise
from phoslab.sample_data.make_scenes import SCENES

PERCENT = parse_bound("5%")
NOISE, QUIET = PathNoise(0.1), PathNoise(0.0)


def costs(*bounces: int) -> Costs:
    """Tiles, measured with so many reflections each."""
    gi = tuple(MeasuredWay("tiles", {"directions": 8, "bounces": n}, 0.1, 1e-6) for n in bounces)
    return Costs(0.01, 1.5, gi, 0.6, {"start": 0.0})


@pytest.fixture
def closed_box(build, rooms):
    return look(load_scene(rooms.closed_box(build).write()), [0.0], (16, 16))


def left_out(pilot, measured: Costs) -> dict[int, float]:
    return {
        gi["bounces"]: transport_terms.judge(pilot, PERCENT, measured, NOISE, gi).left_out
        for gi in transport_terms.settings(pilot, measured)
        if gi["method"] == "tiles"
    }


def test_stopping_after_n_reflections_leaves_out_what_a_closed_box_says(closed_box):
    """Of albedo and emission 1/2: all of it is 1, and the n-th reflection brings 2^-(n+1). The walks gather without
    noise there until chance ends them after the third, so that the pilot's sample is sure of the first terms."""
    found = left_out(closed_box, costs(1, 3))
    for n in (1, 2, 3):
        assert found[n] / 100 == pytest.approx(2.0 ** -(n + 1), rel=0.1)
    assert list(found.values()) == sorted(found.values(), reverse=True)


def test_a_way_that_was_measured_with_one_reflection_is_not_trusted_with_more(closed_box):
    assert set(left_out(closed_box, costs(1))) == {1}
    assert 1 not in left_out(closed_box, costs(3))


def test_paths_leave_nothing_out(closed_box):
    pytest.importorskip("mitsuba")
    paths = [
        transport_terms.judge(closed_box, PERCENT, costs(1), NOISE, gi)
        for gi in transport_terms.settings(closed_box, costs(1))
        if gi["method"] == "reference"
    ]
    assert paths
    assert all(way.left_out == 0 for way in paths)
    # Half of the light is reflected: 0.1 of that with 16 paths, and the root of their number.
    of = {way.gi["samples"]: way.inexact for way in paths}
    assert of[16] == pytest.approx(5.0, rel=0.1)
    assert of[16] / of[64] == pytest.approx(2.0)
    assert np.all(np.diff(list(of.values())) < 0)


def test_rare_bright_light_that_few_walks_meet_is_not_taken_for_none(tmp_path, planned_scenes):
    """A thing on a floor, lit from one side, on a sixth of the picture: reflected glow is 1.2 % of the light there, by
    paths to a noise of 0.15 %. Four walks from each pixel that sees anything met none of it."""
    drawn = planned_scenes.draw(tmp_path, 9008)
    scene = load_scene(drawn.folder)
    pilot = look(scene, [scene.schedule.parse_time(drawn.time)], (64, 64))
    assert pilot.walks > 2000
    left_out = transport_terms.judge(pilot, PERCENT, costs(), NOISE, {"method": "none"}).left_out
    assert 1.2 < left_out < 5


def test_what_no_walk_met_is_three_in_as_many_as_were_sent(closed_box):
    """Of the walls' 1/2, reflected by 1/2 at each turn."""
    glow = closed_box.brightest
    for n in (0, 1):
        want = glow * 0.5 ** (n + 1) * 3 / closed_box.walks
        np.testing.assert_allclose(closed_box.unmet(n).mean(axis=(1, 2)), want, rtol=1e-6)


def test_what_a_pixel_sees_beside_its_middle_is_an_edge_over_the_picture_s_side():
    """Edges of `cornell` are lines: in a picture four times as fine a quarter of the light lies in pixels on one.

    Of 576 rays some 30 meet an edge in the coarse picture and 8 in the fine one, whose light differs: within a factor
    of two and a half."""
    scene = load_scene(SCENES / "cornell")
    moment = scene.schedule.parse_time("off+1s")
    coarse, fine = (look(scene, [moment], (n, n)).reflected_unevenness for n in (64, 256))
    assert coarse / 10 < fine < coarse / 1.6
    assert 0.01 < coarse < 0.2


def test_a_scene_that_is_less_even_than_those_of_the_trade_errs_by_so_much_more(closed_box):
    gi = {"method": "tiles", "directions": 8, "bounces": 1}
    own = closed_box.reflected_unevenness
    assert own > 0
    alike, coarse, fine = (
        transport_terms.judge(closed_box, PERCENT, replace(costs(1), unevenness=own * f), QUIET, gi).inexact
        for f in (1, 2, 0.25)
    )
    assert coarse == alike
    assert fine == pytest.approx(4 * alike)


def test_few_directions_err_as_few_paths_do_where_those_are_noisy(closed_box):
    """Tiles of 64 directions err by 6 % in the trade, of 4 by 10 %, and 4 paths by 60 % here: 0.45 of that is
    added to what 64 err by, as squares. Light that was sent on before is less noisy: a quarter of it is."""
    for bounces, share in ((1, 0.45), (3, 0.25)):
        ways = tuple(
            MeasuredWay("tiles", {"directions": n, "bounces": bounces}, error, 1e-6)
            for n, error in ((4, 0.1), (64, 0.06))
        )
        measured = replace(costs(), gi=ways, unevenness=1.0)

        def of(n: int, noise: PathNoise, measured: Costs = measured, bounces: int = bounces) -> float:
            gi = {"method": "tiles", "directions": n, "bounces": bounces}
            return transport_terms.judge(closed_box, PERCENT, measured, noise, gi).inexact

        per_error = of(4, QUIET) / 0.1
        noisy = PathNoise(0.6 / PathNoise(1.0).of(4))
        assert of(4, noisy) == pytest.approx(per_error * np.hypot(0.06, share * 0.6))
        assert of(64, noisy) < of(4, noisy)
        assert of(4, PathNoise(0.01)) == of(4, QUIET)


def test_a_number_of_reflections_that_was_not_measured_errs_as_the_nearest_that_was(closed_box):
    """As of a plan that was edited, by a trade of one's own."""
    gi = {"method": "tiles", "directions": 8, "bounces": 1}
    once, more = (transport_terms.judge(closed_box, PERCENT, costs(n), QUIET, gi).inexact for n in (1, 3))
    assert more == once > 0
