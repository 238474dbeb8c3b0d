"""The float64 rate equations: the reference that every other solver is held against."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import phoslab
from phoslab import kinetics
from phoslab.bands import Bands
from phoslab.errors import PhoslabError
from phoslab.material import Material

EPS = np.finfo(np.float64).eps


def one_band(kr: list[float], ke: list[float]) -> Material:
    """A material with one band 1 nm wide, so that the excitation is ke E."""
    n = len(kr)
    return Material(
        name="test",
        bands=Bands(np.array([500.0, 501.0])),
        kr_per_s=np.array(kr),
        ke_m2_per_J=np.array(ke)[:, None],
        emission=np.ones((n, 1)),
        calibration="relative",
    )


rates = st.floats(0, 1e6)
wide = st.floats(0, 1e12)


def test_rate_is_that_of_equation_8_1():
    m = one_band([0.1, 0.2], [0.3, 0.4])
    r, E = np.array([0.25, 0.5]), np.array([2.0])
    assert kinetics.rate(m, r, E) == pytest.approx([0.75 * 0.6 - 0.1 * 0.25, 0.5 * 0.8 - 0.2 * 0.5])


def test_excitation_integrates_ke_times_irradiance_over_the_bands():
    green = phoslab.preset("green")
    E = np.arange(8.0)
    by_hand = sum(green.ke_m2_per_J[0, j] * E[j] * 37.5 for j in range(8))
    assert kinetics.excitation(green, E) == pytest.approx([by_hand])


def test_dark_decay_is_equation_8_4_over_any_leading_shape():
    m = one_band([0.132, 0.009], [0, 0])
    r = np.random.default_rng(0).uniform(size=(3, 4, 2))
    t = np.array([0.0, 1.0, 10.0, 100.0])
    assert kinetics.decay(m, r, t) == pytest.approx(r * np.exp(-m.kr_per_s * t[:, None]))


def test_exact_step_of_any_length_equals_many_small_ones():
    m = one_band([0.132, 0.009], [0.4, 0.2])
    r, E = np.array([0.1, 0.9]), np.array([0.3])
    jumped = kinetics.advance(m, r, E, 20.0)
    for _ in range(1000):
        r = kinetics.advance(m, r, E, 0.02)
    # Each step rounds r a few times, each by at most half an ulp of 1; errors of earlier steps shrink.
    assert np.abs(r - jumped).max() <= 1000 * 4 * EPS


def test_exact_step_solves_the_equation_that_an_independent_integrator_solves():
    from scipy.integrate import solve_ivp

    m = one_band([0.3, 0.02], [0.5, 0.05])
    E, r0 = np.array([0.7]), np.array([0.0, 1.0])
    truth = solve_ivp(
        lambda _, r: kinetics.rate(m, r, E), (0, 30), r0, method="DOP853", rtol=1e-12, atol=1e-14
    )
    # rtol holds per step; DOP853 took this many steps.
    tolerance = 1e-12 * len(truth.t) + 1e-13
    assert np.abs(kinetics.advance(m, r0, E, 30.0) - truth.y[:, -1]).max() < tolerance


@given(r=st.floats(0, 1), kr=rates, ke=st.floats(0, 1e3), E=wide, dt=st.floats(1e-6, 1e6))
def test_exact_step_never_leaves_unit_interval_nor_passes_equilibrium(r, kr, ke, E, dt):
    m = one_band([kr], [ke])
    light = np.array([E])
    (stepped,) = kinetics.advance(m, [r], light, dt)
    (rest,) = kinetics.equilibrium(m, light) if kr + ke * E > 0 else [r]
    assert 0 <= stepped <= 1
    assert min(r, rest) <= stepped <= max(r, rest)


@given(r=st.floats(0, 1), kr=st.floats(0, 1e4), a=st.floats(0, 1e4), dt=st.floats(0, 1))
def test_substep_stays_in_unit_interval_where_euler_would_overshoot(r, kr, a, dt):
    (stepped,) = kinetics.advance(one_band([kr], [1.0]), [r], np.array([a]), dt, solver="substep")
    # n parts round n times; each part is a convex combination but for rounding.
    n = max(1.0, (a + kr) * dt + 1)
    assert -4 * n * EPS <= stepped <= 1 + 4 * n * EPS


def test_euler_refuses_to_overshoot_and_says_what_to_do():
    m = one_band([2.0], [0.0])
    with pytest.raises(PhoslabError, match=r"overshoots.*shorter step"):
        kinetics.advance(m, [1.0], [0.0], 0.6, solver="euler")
    assert kinetics.advance(m, [1.0], [0.0], 0.5, solver="euler") == pytest.approx([0.0])


def test_euler_error_falls_in_proportion_to_the_step():
    m, E = one_band([0.2], [0.3]), np.array([1.0])
    exact = kinetics.advance(m, [0.0], E, 1.0)[0]

    def error(n: int) -> float:
        r = np.zeros(1)
        for _ in range(n):
            r = kinetics.advance(m, r, E, 1.0 / n, solver="euler")
        return abs(r[0] - exact)

    # First order: halving the step halves the error, up to the next term, k dt / 3 relative (k = 0.5, dt = 1/100).
    assert error(100) / error(200) == pytest.approx(2.0, rel=0.01)


def test_a_callable_irradiance_is_taken_at_the_start_of_the_step():
    m = one_band([0.1], [0.2])
    moving = kinetics.advance(m, [0.0], lambda t: [5.0 if t == 0 else np.nan], 1.0)
    assert moving == kinetics.advance(m, [0.0], [5.0], 1.0)


def test_a_state_without_rates_keeps_what_it_has():
    assert kinetics.advance(one_band([0.0], [0.0]), [0.3], [1.0], 1e6) == [0.3]


def test_emitted_radiance_is_equation_8_3():
    m = phoslab.preset("stickers-2")
    L = kinetics.emitted_radiance(m, [[1.0, 0.5]])
    by_hand = m.emission[0] * 0.132 * 1.0 + m.emission[1] * 0.009 * 0.5
    assert L == pytest.approx(by_hand[None])


def test_light_where_ke_was_never_measured_names_the_band():
    E = np.zeros(8)
    E[2] = 1.0
    with pytest.raises(PhoslabError, match=r"ke_m2_per_J.*'gloves'.*475-512.5 nm"):
        kinetics.excitation(phoslab.preset("gloves"), E)
    assert kinetics.excitation(phoslab.preset("gloves"), np.zeros(8)) == [0.0]


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"irradiance": [np.nan]}, "irradiance"),
        ({"irradiance": [-1.0]}, "irradiance"),
        ({"irradiance": [1.0, 1.0]}, "irradiance"),
        ({"dt": -1.0}, "dt"),
        ({"dt": np.inf}, "dt"),
        ({"r": [1.5]}, "r "),
        ({"r": [np.nan]}, "r "),
        ({"r": [0.5, 0.5]}, "r "),
        ({"solver": "magic"}, "solver 'magic'.*exact"),
    ],
)
def test_bad_input_is_refused_by_name(changed, named):
    given_ = {"r": [0.5], "irradiance": [1.0], "dt": 1.0, "solver": "exact"} | changed
    with pytest.raises(PhoslabError, match=named):
        kinetics.advance(one_band([0.1], [0.1]), **given_)
