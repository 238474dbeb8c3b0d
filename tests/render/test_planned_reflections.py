"""The number of reflections as a decision: what is left out, and which ways know more than one."""

from __future__ import annotations

import numpy as np
import pytest

from phoslab.render import load_scene
from phoslab.render.planning import transport_terms
from phoslab.render.planning.bounds import parse_bound
from phoslab.render.planning.costs import Costs, MeasuredWay
from phoslab.render.planning.pilot import look
from phoslab.render.planning.probe import PathNoise

PERCENT = parse_bound("5%")
NOISE = PathNoise(0.1)


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
