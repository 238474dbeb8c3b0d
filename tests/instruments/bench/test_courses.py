"""What lamp and door have done, as functions of time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phoslab.instruments.bench.courses import Bulb, DoorCourse, Hinge, LampCourse

pauses = st.lists(st.floats(0.001, 2000.0), min_size=1, max_size=8)


@given(pauses, st.floats(0, 1))
def test_light_is_continuous_and_between_none_and_full(gaps: list[float], share: float) -> None:
    lamp, t, on = LampCourse(), 0.0, True
    moments = []
    for gap in gaps:
        lamp.switch(t, on)
        moments.append(t)
        t, on = t + gap, not on
    for t in moments:
        # Nothing changes by more than its steepest slope allows: 1 / rise_s.
        assert abs(lamp.level(t + 1e-6) - lamp.level(t - 1e-6)) < 4e-6 / min(Bulb().rise_s, Bulb().fade_s)
    for t in (moments[0] + share * (moments[-1] - moments[0] + 10), -5.0):
        assert 0 <= lamp.level(t) <= 1
        assert 0 <= lamp.warmth(t) <= 1
        assert 0 <= lamp.warming(t) <= Bulb().heat_C


def test_the_lamp_is_dark_320_ms_after_it_was_switched_off_and_not_before() -> None:
    lamp = LampCourse()
    lamp.switch(0.0, True)
    lamp.switch(100.0, False)
    assert lamp.level(100.31) > 0
    assert lamp.level(100.3201) == 0
    assert lamp.dark(100.32, 200.0)
    assert not lamp.dark(100.0, 100.32)
    assert lamp.changes(50.0, 200.0) == [100.0, pytest.approx(100.32)]


def test_it_drifts_until_it_is_warm() -> None:
    lamp = LampCourse()
    lamp.switch(0.0, True)
    assert lamp.level(5.0) == pytest.approx(1 - Bulb().cold, abs=1e-3)
    assert lamp.level(3000.0) == pytest.approx(1.0, abs=1e-5)


@given(st.floats(0.01, 0.9), st.booleans())
def test_the_moment_at_which_light_crosses_a_level_is_that_moment(share: float, rising: bool) -> None:
    lamp = LampCourse()
    lamp.switch(0.0, True)
    if not rising:
        lamp.switch(10.0, False)
    at_s = lamp.crosses(share, 0.0)
    assert at_s is not None
    assert lamp._relative(at_s) == pytest.approx(share, abs=1e-9)
    assert lamp.crosses(share, at_s + 1e-3) is None


@given(st.lists(st.tuples(st.floats(0.0, 0.6), st.sampled_from([0.0, 1.0, None])), min_size=1, max_size=10))
def test_a_door_is_never_more_than_open_and_moves_no_faster_than_it_can(
    drives: list[tuple[float, float | None]],
) -> None:
    door, t = DoorCourse(), 0.0
    for gap, to in drives:
        t += gap
        door.drive(t, to, Hinge().travel_s)
    times = np.linspace(-0.1, t + 1.0, 400)
    shares = np.array([door.share(x) for x in times])
    assert (shares >= 0).all()
    assert (shares <= 1).all()
    assert (np.abs(np.diff(shares)) <= np.diff(times) / Hinge().travel_s + 1e-9).all()


def test_a_door_shakes_when_it_stops_and_then_rests() -> None:
    door = DoorCourse()
    door.drive(0.0, 1.0, 0.28)
    assert door.arrives_s(0.0) == pytest.approx(0.28)
    assert door.shake_mm(0.1) == 0.0
    assert door.shake_mm(0.281) > 0.2
    assert abs(door.shake_mm(1.5)) < 1e-4
    assert door.changes(-1.0, 1.0) == [0.0, pytest.approx(0.28)]
