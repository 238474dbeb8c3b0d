"""The forward model of an excitation series, against an integrator that knows nothing of it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from phoslab.errors import PhoslabError
from phoslab.fitting.charging import LampCourse, Steps, Table, glow, phi

KR = np.array([0.31, 0.012])
A = np.array([[0.5, 0.02], [0.003, 0.4], [0.0, 1e-6]])


def lamp() -> LampCourse:
    """On within half a second, off as a square in 0.32 s."""
    return LampCourse(
        Table.of(lambda t: 1 - np.exp(-t / 0.08), 0.5, 8), Table.of(lambda t: (1 - t / 0.32) ** 2, 0.32)
    )


def series() -> Steps:
    """Also light that ends before it is all there, and a shutter that opens while it fades."""
    return Steps.of(
        np.array([0.2, 1.0, 8.0, 300.0]),
        np.array([0.7, 0.1, 0.65, 6.0]),
        np.array([2.0, 0.5, 4.0, 0.01]),
        lamp(),
    )


def integrated(a: np.ndarray, kr: np.ndarray, steps: Steps, frame: int) -> np.ndarray:
    """(n_places, n_c) mean of kr r over a frame's exposure, by DOP853 from step to step."""
    y = np.zeros(2 * a.size)
    for dt, level, is_open in zip(
        steps.duration_s[frame], steps.level[frame], steps.open[frame], strict=True
    ):
        if dt == 0:
            continue

        def slope(_: float, y: np.ndarray, level: float = level, is_open: bool = is_open) -> np.ndarray:
            r = y[: a.size].reshape(a.shape)
            return np.concatenate([((1 - r) * level * a - kr * r).ravel(), is_open * (kr * r).ravel()])

        y = solve_ivp(slope, (0, dt), y, method="DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
    return y[a.size :].reshape(a.shape) / steps.exposure_s[frame]


def test_curves_agree_with_a_high_order_integrator_to_1e_10():
    steps = series()
    exact = glow(A, KR, steps).value
    for frame in range(len(exact)):
        # rtol 1e-12 a step, 50 steps: 5e-11 of the largest value is what the integrator itself may be off.
        scale = exact[frame].max(axis=0)
        assert np.abs(integrated(A, KR, steps, frame) - exact[frame]).max(where=scale > 0, initial=0) <= (
            1e-10 * scale.max()
        )
        assert (np.abs(integrated(A, KR, steps, frame)[:2] / exact[frame][:2] - 1) < 1e-10).all()


def test_steps_of_a_fade_carry_all_of_its_light():
    table = Table.of(lambda t: (1 - t / 0.32) ** 2, 0.32)
    # Quadrature of degree 7 is exact for a square.
    assert table.light_s == pytest.approx(0.32 / 3, rel=1e-14)


def test_light_of_a_series_is_what_the_lamp_gave():
    steps = Steps.of(np.array([10.0]), np.array([0.5]), np.array([1.0]), LampCourse())
    assert (steps.duration_s * steps.level).sum() == pytest.approx(10.0 + 0.32 / 2, rel=1e-12)


def test_steps_of_a_fade_move_its_light_by_no_more_than_their_second_moment():
    a, kr, n = 1.0, 1.0, 32
    seen = []
    for steps_of_fade in (n, 16 * n):
        course = LampCourse(fade=Table.of(lambda t: 1 - t / 0.32, 0.32, steps_of_fade))
        steps = Steps.of(np.array([1.0]), np.array([0.6]), np.array([1.0]), course)
        seen.append(float(glow(np.array([[a]]), np.array([kr]), steps).value[0, 0, 0]))
    # Light of slope s, levelled over a step h, is moved by s h³ / 12 (light times time); n steps with s n h = 1 by
    # h² / 12. What is charged later by dt is fuller by at most a (a + kr) dt, and is seen as kr times that.
    bound = kr * a * (a + kr) * (0.32 / n) ** 2 / 12
    assert 0 < abs(seen[0] - seen[1]) <= bound


def test_a_shutter_that_opens_while_the_lamp_fades_sees_the_sample_still_charge():
    steps = series()
    lit_while_open = (steps.level[1] > 0) & steps.open[1]
    assert lit_while_open.sum() > 5


@settings(max_examples=60, deadline=None)
@given(
    log_a=st.lists(st.floats(-9, 2), min_size=2, max_size=2),
    log_kr=st.lists(st.floats(-6, 1), min_size=2, max_size=2),
)
def test_derivatives_are_those_of_the_curve(log_a, log_kr):
    a, kr = 10.0 ** np.array(log_a)[None, :], 10.0 ** np.array(log_kr)
    steps = series()
    found = glow(a, kr, steps)
    h = 1e-5
    by_a = (glow(a * (1 + h), kr, steps).value - glow(a * (1 - h), kr, steps).value) / (2 * h * a)
    by_kr = (glow(a, kr * (1 + h), steps).value - glow(a, kr * (1 - h), steps).value) / (2 * h * kr)
    # A central difference in log units errs by h² times the third derivative, 1e-10 of the value with (k t)³ up to 1e4
    # before everything saturates, and by rounding, 2e-16 / h of the value.
    slack = 1e-6 * found.value
    assert (np.abs(by_a - found.by_a) * a <= slack + 1e-6 * np.abs(found.by_a) * a).all()
    assert (np.abs(by_kr - found.by_kr) * kr <= slack + 1e-6 * np.abs(found.by_kr) * kr).all()


@given(x=st.floats(0, 1e4))
def test_phi_functions_satisfy_their_recursion(x):
    e, phi1, phi2, phi3 = (float(v) for v in phi(np.array(x)))
    # x φ1 = 1 - e and so on: relative to 1, a few roundings.
    assert x * phi1 == pytest.approx(1 - e, abs=1e-15 * 8)
    assert x * phi2 == pytest.approx(1 - phi1, abs=1e-15 * 8)
    assert x * phi3 == pytest.approx(0.5 - phi2, abs=1e-15 * 8)


def test_a_sample_that_was_not_empty_keeps_what_it_had():
    steps = Steps.of(np.array([0.0]), np.array([1.0]), np.array([1e-6]), LampCourse())
    seen = glow(np.zeros((1, 2)), KR, steps, initial=np.array([0.5, 1.0])).value[0, 0]
    # The exposure's mean lies 5e-7 s after its start.
    assert seen == pytest.approx(KR * [0.5, 1.0] * np.exp(-KR * (1.0 + 5e-7)), rel=1e-12)


@pytest.mark.parametrize(
    ("lit", "delay", "exposure"), [(-1.0, 0.6, 1.0), (1.0, np.nan, 1.0), (1.0, 0.6, 0.0)]
)
def test_impossible_times_are_refused(lit, delay, exposure):
    with pytest.raises(PhoslabError, match="negative, not finite, or an exposure of 0 s"):
        Steps.of(np.array([lit]), np.array([delay]), np.array([exposure]), LampCourse())


def test_a_table_that_runs_backwards_is_refused():
    with pytest.raises(PhoslabError, match="ascending"):
        Table(np.array([0.0, 0.2, 0.1]), np.array([1.0, 0.5]))
