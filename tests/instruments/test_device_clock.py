"""The controller's clock against the host's: the truth always lies within what is claimed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

from phoslab.instruments.device_clock import DeviceClock

# A device in its drift's bounds; delays of a USB adapter, unlike on the two ways; exchanges at any time.
OFFSET = st.floats(-1e5, 1e5)
RATE = st.floats(1 - 5e-3, 1 + 5e-3)
EXCHANGES = st.lists(
    st.tuples(st.floats(0.0, 2000.0), st.floats(0.0, 0.05), st.floats(0.0, 0.05)), min_size=1, max_size=60
)


def _clock(offset: float, rate: float, exchanges: list[tuple[float, float, float]]) -> DeviceClock:
    """Host time = offset + rate * device time."""
    clock = DeviceClock()
    for device_s, out_s, back_s in sorted(exchanges):
        host_s = offset + rate * device_s
        clock.add(host_s - out_s, device_s, host_s + back_s)
    return clock


@given(OFFSET, RATE, EXCHANGES, st.floats(-100.0, 3000.0))
def test_the_truth_is_never_further_off_than_is_said(
    offset: float, rate: float, exchanges: list[tuple[float, float, float]], device_s: float
) -> None:
    found = _clock(offset, rate, exchanges).mono_s(device_s)
    assert found is not None
    # 1e-9: a float of 1e5 holds 1.5e-11.
    assert abs(found[0] - (offset + rate * device_s)) <= found[1] + 1e-9


@given(OFFSET, RATE, EXCHANGES, st.floats(-100.0, 3000.0))
def test_no_exchange_could_narrow_it_more(
    offset: float, rate: float, exchanges: list[tuple[float, float, float]], device_s: float
) -> None:
    """The two ends are the optima of the linear programme, as a general solver finds them."""
    clock = _clock(offset, rate, exchanges)
    found = clock.mono_s(device_s)
    assert found is not None
    kept = np.array(list(clock._kept.values()))
    at, low, high = kept.T
    origin = low[0]
    lines = np.column_stack([np.ones_like(at), at - device_s])
    limits = np.concatenate([high - origin, origin - low])
    ends = []
    for sign in (1, -1):  # unknowns: host time at device_s, less `origin`, and the rate
        best = linprog(
            [sign, 0.0],
            A_ub=np.concatenate([lines, -lines]),
            b_ub=limits,
            bounds=[(None, None), (1 - 6e-3, 1 + 6e-3)],
        )
        if best.status != 0:
            return  # delays of zero leave it no room by its own tolerance
        ends.append(origin + best.x[0])
    # HiGHS keeps its constraints to 1e-7, over lever arms of up to 3000 s / 10 s.
    assert found[0] - found[1] == pytest.approx(ends[0], abs=1e-4)
    assert found[0] + found[1] == pytest.approx(ends[1], abs=1e-4)


@given(OFFSET, RATE, EXCHANGES, st.floats(0.0, 3000.0))
def test_there_and_back_is_where_one_was(
    offset: float, rate: float, exchanges: list[tuple[float, float, float]], device_s: float
) -> None:
    clock = _clock(offset, rate, exchanges)
    found = clock.mono_s(device_s)
    assert found is not None
    back_s = clock.device_s(found[0])
    # Three steps, each leaving a share of 0.006 of an error of at most 0.006 * 3000 s + 0.1 s.
    assert back_s == pytest.approx(device_s, abs=0.006**3 * 18.1 + 1e-6)


def test_before_the_first_exchange_nothing_is_known() -> None:
    assert DeviceClock().mono_s(1.0) is None
    assert DeviceClock().device_s(1.0) is None


def test_half_an_hour_of_heartbeats_gives_a_millisecond() -> None:
    """One exchange of 10 ms is good to 5 ms; many, with delays that vary, are good to their luckiest."""
    rng = np.random.default_rng(1)
    clock = DeviceClock()
    for device_s in np.arange(0.0, 1800.0, 0.5):
        out_s, back_s = 0.0005 + rng.exponential(0.004, 2)
        clock.add(100 + 1.0004 * device_s - out_s, device_s, 100 + 1.0004 * device_s + back_s)
    found = clock.mono_s(1800.0)
    assert found is not None
    assert found[0] == pytest.approx(100 + 1.0004 * 1800, abs=found[1])
    assert found[1] < 1e-3


def test_a_rate_that_changes_is_followed() -> None:
    """A resonator that warms up by 100 ppm: no one rate fits, and old exchanges are given up."""
    clock = DeviceClock()
    host_s = 0.0
    for device_s in np.arange(0.0, 1000.0, 0.5):
        host_s += 0.5 * (1.0 + 100e-6 * device_s / 1000)
        clock.add(host_s - 0.0005, device_s, host_s + 0.0005)
    found = clock.mono_s(float(device_s))
    assert found is not None
    assert found[0] == pytest.approx(host_s, abs=0.001)  # the last exchange's own width
    assert len(clock._kept) < 32


def test_a_reset_begins_anew() -> None:
    clock = DeviceClock()
    clock.add(100.0, 50.0, 100.01)
    clock.forget()
    clock.add(200.0, 0.5, 200.01)
    found = clock.mono_s(0.5)
    assert found is not None
    assert found[0] == pytest.approx(200.005)
