"""Solvers in float64: order, stability at the extremes, agreement with the yardstick."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from phoslab.errors import PhoslabError
from phoslab.programmes import Sine, mean
from phoslab.solvers import EULER_LIMIT, EXPLICIT_LIMIT, SOLVERS, Drive, find

EPS = np.finfo(np.float64).eps

states = st.integers(1, 4)
dts = st.floats(1e-6, 1e6)
# Zeros, denormals, and everything up to the ends of the stated ranges.
irradiances = st.floats(0, 1e12)
rates = st.floats(0, 1e6)
absorptions = st.floats(0, 1e3)


@st.composite
def problems(draw):
    n = draw(states)
    some = lambda values: np.array(draw(st.lists(values, min_size=n, max_size=n)))  # noqa: E731
    return some(st.floats(0, 1)), some(absorptions) * draw(irradiances), some(rates), np.array(draw(dts))


EXTREME = (np.array([0.5]), np.array([1e15]), np.array([1e6]), np.array(1e6))
DENORMAL = (np.array([5e-324]), np.array([5e-324]), np.array([5e-324]), np.array(1e6))


@pytest.mark.parametrize("name", [n for n in SOLVERS if n != "dop853"])
@given(problem=problems())
@example(problem=EXTREME)
@example(problem=DENORMAL)
def test_a_solver_that_does_not_refuse_stays_finite_and_inside(name, problem):
    r, a, kr, dt = problem
    # The cost of the explicit ones grows with the stiffness: keep the test short, their refusal is tested below.
    if name in ("substep", "rk23") and 300 < float(np.max((a + kr) * dt)) <= EXPLICIT_LIMIT:
        dt = dt * 300 / np.max((a + kr) * dt)
    limit = {"euler": EULER_LIMIT, "substep": EXPLICIT_LIMIT, "rk23": EXPLICIT_LIMIT}.get(name, np.inf)
    if np.max((a + kr) * dt) > limit:
        with pytest.raises(PhoslabError):
            SOLVERS[name](r, Drive.constant(a), kr, dt)
        return
    stepped = SOLVERS[name](r, Drive.constant(a), kr, dt)
    assert np.isfinite(stepped).all()
    assert ((stepped >= 0) & (stepped <= 1)).all()


@pytest.mark.parametrize("name", ["exact", "exact2"])
@given(problem=problems())
@example(problem=EXTREME)
@example(problem=DENORMAL)
def test_exact_steps_move_towards_the_equilibrium_and_never_past_it(name, problem):
    r, a, kr, dt = problem
    stepped = SOLVERS[name](r, Drive.constant(a), kr, dt)
    rest = np.where(a + kr > 0, a / np.where(a + kr > 0, a + kr, 1), r)
    assert (np.minimum(r, rest) <= stepped).all()
    assert (stepped <= np.maximum(r, rest)).all()


@pytest.mark.parametrize("name", ["exact", "exact2"])
@given(problem=problems(), longer=st.floats(1, 1e3))
def test_a_longer_exact_step_is_never_farther_from_the_equilibrium(name, problem, longer):
    r, a, kr, dt = problem
    rest = np.where(a + kr > 0, a / np.where(a + kr > 0, a + kr, 1), r)
    near = np.abs(SOLVERS[name](r, Drive.constant(a), kr, dt * longer) - rest)
    far = np.abs(SOLVERS[name](r, Drive.constant(a), kr, dt) - rest)
    # Both round once or twice at the size of r or rest.
    assert (near <= far + 4 * EPS * np.maximum(r, rest)).all()


def errors(name: str, steps: list[int]) -> np.ndarray:
    """Errors of a solver that takes 5 s of swelling light in so many steps, against the yardstick."""
    light = Sine(3.0, 0.8)
    kr, a, r0 = np.array([0.3, 0.02]), np.array([0.4, 0.1]), np.array([0.2, 0.0])

    def run(solver: str, n: int) -> np.ndarray:
        r, dt = r0, 5.0 / n
        for k in range(n):
            drive = Drive(
                lambda s, k=k: a * light.at((k + s) * dt), lambda k=k: a * mean(light, k * dt, (k + 1) * dt)
            )
            r = SOLVERS[solver](r, drive, kr, np.array(dt))
        return r

    truth = run("dop853", 1)
    return np.array([np.abs(run(name, n) - truth).max() for n in steps])


@pytest.mark.parametrize(("name", "order"), [("euler", 1), ("substep", 1), ("exact", 1), ("exact2", 2)])
def test_order_where_light_changes_within_the_step(name, order):
    coarse, fine = errors(name, [200, 400])
    # The next term of the expansion is smaller by k dt, here 0.02.
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.05)


def test_the_mean_is_found_by_quadrature_where_none_is_given():
    light, a = Sine(3.0, 0.8), np.array([0.4])
    drive = Drive(lambda s: a * light.at(s * 1.5))
    # Error of 4 Gauss nodes: h^8 (4!)^4 / (9 (8!)^3) max |f''|, for a sine of depth 0.8 over half a period.
    bound = 0.8 * np.pi**8 * 24**4 / (9 * math.factorial(8) ** 3)
    assert drive.mean == pytest.approx(a * mean(light, 0.0, 1.5), abs=a[0] * bound)


def test_rk23_keeps_its_tolerance_and_dop853_its_own():
    # One step of tolerance 1e-3 + 1e-6 a part; a handful of parts.
    assert errors("rk23", [1])[0] < 5e-3
    closed = SOLVERS["exact"](
        np.array([0.2]), Drive.constant(np.array([0.4])), np.array([0.3]), np.array(2.0)
    )
    yardstick = SOLVERS["dop853"](
        np.array([0.2]), Drive.constant(np.array([0.4])), np.array([0.3]), np.array(2.0)
    )
    assert yardstick == pytest.approx(closed, abs=1e-11)


@pytest.mark.parametrize("name", ["substep", "rk23", "dop853"])
def test_explicit_methods_refuse_what_would_take_for_ever(name):
    with pytest.raises(PhoslabError, match="exact"):
        SOLVERS[name](np.zeros(1), Drive.constant(np.array([1e6])), np.zeros(1), np.array(1.0))


@pytest.mark.parametrize("name", SOLVERS)
def test_no_time_changes_nothing(name):
    r = np.array([0.25, 0.75])
    drive = Drive.constant(np.array([0.5, 1.0]))
    assert SOLVERS[name](r, drive, np.array([0.1, 0.2]), np.array(0.0)).tolist() == r.tolist()


@pytest.mark.parametrize("name", SOLVERS)
def test_equal_inputs_give_equal_outputs(name):
    rng = np.random.default_rng(0)
    r, a, kr = rng.uniform(size=(3, 50, 2))
    drive = Drive.constant(a)
    first, second = (SOLVERS[name](r, drive, kr, np.array(0.3)) for _ in range(2))
    assert first.tobytes() == second.tobytes()


@pytest.mark.parametrize("hours", [1, 24])
@pytest.mark.parametrize("lit", [False, True])
def test_a_slow_material_keeps_its_glow_over_hours_of_display_frames(hours, lit):
    """kr = 1e-4 1/s at 60 Hz; float64 in single steps, against the closed form."""
    kr, a = np.array([1e-4]), np.array([2e-4 if lit else 0.0])
    n = hours * 3600 * 60
    # The step is the same affine map each time, so n steps are a sum that can be taken in float64 without looping.
    once = SOLVERS["exact"](np.array([1.0]), Drive.constant(a), kr, np.array(1 / 60))[0]
    rest = float(a[0] / (a[0] + kr[0]))
    keep = (once - rest) / (1 - rest)
    stepped = rest + (1 - rest) * keep**n
    closed = SOLVERS["exact"](np.array([1.0]), Drive.constant(a), kr, np.array(hours * 3600.0))[0]
    # keep is rounded to half an ulp of 1, which n steps raise to n/2 ulp.
    assert stepped == pytest.approx(closed, rel=n * EPS)


def test_an_unknown_solver_names_the_known_ones():
    with pytest.raises(PhoslabError, match=r"'magic'.*exact2"):
        find("magic")
