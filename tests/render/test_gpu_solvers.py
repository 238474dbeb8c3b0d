"""Each solver on the GPU against its float64 namesake, within bounds that float32 arithmetic gives."""

from __future__ import annotations

import numpy as np
import pytest

from phoslab import solvers
from phoslab.programmes import Sine, Sweep, mean
from phoslab.render.bare_state import BareState
from phoslab.render.device import Device
from phoslab.render.solvers import SHORT, SOLVERS
from phoslab.solvers import EXPLICIT_LIMIT, Drive

U = 2.0**-24  # half a unit in the last place of a float32 near 1
SIDE = 12
KR = np.array([0.25, 0.0078125, 0.5, 2.0])  # as float32 has them


def problem(n_states: int, largest: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(SIDE, SIDE, n) excitations over three decades and concentrations, as float32 has them."""
    rng = np.random.default_rng(seed)
    a = largest * 10 ** rng.uniform(-3, 0, (SIDE, SIDE, n_states))
    a[0], r = 0.0, rng.uniform(0, 1, a.shape)
    r[:, 0], r[:, 1] = 0.0, 1.0
    return a.astype("f4").astype("f8"), r.astype("f4").astype("f8")


def texel_by_texel(solver: str, r: np.ndarray, a: np.ndarray, kr: np.ndarray, dt: float) -> np.ndarray:
    """Step in float64, every texel by itself: its parts are then its own, as on the GPU."""
    step = solvers.SOLVERS[solver]
    rows = [
        step(texel, Drive.constant(light), kr, np.array(dt))
        for texel, light in zip(r.reshape(-1, kr.size), a.reshape(-1, kr.size), strict=True)
    ]
    return np.array(rows).reshape(r.shape)


def error_bound(solver: str, k: np.ndarray, dt: float) -> np.ndarray:
    """The largest difference between one step in float32 and in float64; per texel.

    exact, exact2: 16 U, derived in `test_phosphor_step`. euler: the sum U, and some 6 U of an increment below 1.
    substep: each of n parts rounds the sum of increments (U), the state that it starts from (U times what the part
    changes), and 6 U of its increment, which are 1 in all; earlier errors only shrink. rk23: a part may err by 1e-3 of
    r in the root mean square over n_c states, and the errors of parts fade by exp(-k dt / n) from one to the next, with
    k dt / n of 0.5 at least where n is not 1: 2.5 of them in all; its namesake the same.
    """
    if solver == "rk23":
        return np.full(k.shape[:-1], 2 * 2.5 * np.sqrt(k.shape[-1]) * (1e-3 + 1e-6))
    n = np.ceil(k.max(axis=-1) * dt) if solver == "substep" else np.ones(k.shape[:-1])
    return {"euler": 8 * n, "substep": 2 * n + 8}.get(solver, 16 * n) * U


@pytest.mark.parametrize("n_states", [1, 2, 3, 4])
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_step_is_that_of_the_float64_namesake(device, solver, n_states):
    a, r = problem(n_states, largest=2.0, seed=n_states)
    kr = KR[:n_states]
    for dt in (1 / 64, 0.25) if solver == "euler" else (1 / 64, 0.25, 1.0, 8.0):
        state = BareState(device, kr, a, solver, r0=r)
        state.advance(dt)
        error = np.abs(state.read() - texel_by_texel(solver, r, a, kr, dt)).max(axis=-1)
        assert (error <= error_bound(solver, a + kr, dt)).all()


@pytest.mark.parametrize("share", [1e-6, 1e-3, 0.5, 1.0, 1.01])
def test_charging_from_nothing_keeps_its_digits_on_either_side_of_the_short_step(device, share):
    """Relative to what is gained, not to 1: an increment that is small must not be wrong.

    dt times a factor, their product with a, and the sum with kr dt round (3 U); 1 minus a term of at most 1/16 rounds
    (1.1 U), the product with a dt once more (U), and the polynomial errs by 0.3 U: 5.4 U. The longer step's exponential
    is good to 3 U, its quotient and two products add as many.
    """
    dt = SHORT * share / 2.5  # of the largest a + kr
    a = np.linspace(0.01, 2.0, SIDE * SIDE).reshape(SIDE, SIDE, 1).astype("f4").astype("f8")
    state = BareState(device, [0.5], a, "exact")
    state.advance(dt)
    want = solvers.exact_step(np.zeros(1), a, np.array([0.5]), np.array(dt))
    assert np.abs(state.read() / want - 1).max() <= (5.4 if share <= 1 else 8) * U


def test_what_is_short_is_told_by_the_largest_rate_of_all():
    exact = SOLVERS["exact"]
    assert exact.include_for(SHORT) == exact.short != exact.include_for(1.001 * SHORT)
    assert exact.include_for(np.inf) == exact.include
    assert SOLVERS["euler"].include_for(0.0) == SOLVERS["euler"].include


@pytest.mark.parametrize("solver", ["substep", "rk23"])
def test_a_stiff_step_ends_at_the_equilibrium(device, solver):
    """(a + kr) dt up to the limit: thousands of parts a texel, and what is left of any start is below 1e-3 or U."""
    a = np.geomspace(10, 0.9 * EXPLICIT_LIMIT, SIDE * SIDE).reshape(SIDE, SIDE, 1)
    state = BareState(device, [1.0], a, solver, r0=0.0)
    state.advance(1.0)
    # Forward Euler in parts of k dt / n <= 1 and n >= 10; the rounding of n parts contracts by 1 - k dt / n: few count.
    tolerance = 3e-3 if solver == "rk23" else np.exp(-10) + 16 * U
    assert np.abs(state.read() - a / (a + 1)).max() <= tolerance


@pytest.mark.parametrize("solver", SOLVERS)
def test_no_time_changes_nothing(device, solver):
    a, r = problem(2, largest=1.0, seed=5)
    state = BareState(device, KR[:2], a, solver, r0=r)
    state.advance(0.0)
    np.testing.assert_array_equal(state.read(), r)


@pytest.mark.parametrize("solver", SOLVERS)
def test_equal_inputs_give_equal_outputs(device, solver):
    a, r = problem(2, largest=1.0, seed=6)
    states = [BareState(device, KR[:2], a, solver, r0=r) for _ in range(2)]
    for state in states:
        state.advance_many(0.25, 10)
    assert states[0].read().tobytes() == states[1].read().tobytes()


def sine_error(device: Device, solver: str, n: int) -> float:
    """The error after 5 s of a swelling light in n steps, against the yardstick."""
    light, dt, span = Sine(3.0, 0.8), 5.0 / n, np.array(5.0)
    kr, a, r0 = np.array([0.25, 0.0078125]), np.full((1, 1, 2), [0.5, 0.125]), np.array([0.25, 0.0])
    state = BareState(device, kr, a, solver, "f32c", r0)
    for k in range(n):
        begin, end = k * dt, (k + 1) * dt
        state.advance(
            dt, Drive(lambda s, t=begin: light.at(t + s * dt), lambda b=begin, e=end: mean(light, b, e))
        )
    truth = solvers.SOLVERS["dop853"](r0, Drive(lambda s: a[0, 0] * light.at(5 * s)), kr, span)
    return float(np.abs(state.read()[0, 0] - truth).max())


@pytest.mark.parametrize(("solver", "order"), [("euler", 1), ("substep", 1), ("exact", 1), ("exact2", 2)])
def test_order_where_light_changes_within_the_step(device, solver, order):
    """As in float64; the next term of the expansion is smaller by k dt, here 0.06, and float32 by far more."""
    coarse, fine = (sine_error(device, solver, n) for n in (80, 160))
    assert fine > 100 * U
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.1)


def test_rk23_follows_the_light_within_a_step_as_its_tolerance_says(device):
    """Steps of 0.25 s of a 3 s period: the quadratic errs by (π/12)³ 0.8 / 27 of the light, below the tolerance."""
    assert sine_error(device, "rk23", 20) < 2.5e-3


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_light_of_its_own_for_every_texel_is_stepped_as_in_float64(device, solver):
    """A laser sheet that passes each texel at another moment: the drive of the float64 solvers, as it is."""
    rng = np.random.default_rng(3)
    kr, a = KR[:2], np.full((SIDE, SIDE, 2), 0.5)
    sheet = Sweep(rng.uniform(0, 1, (SIDE, SIDE, 1)), 0.25)
    state, want, dt = BareState(device, kr, a, solver), np.zeros_like(a), 1 / 32
    for k in range(32):
        drive = Drive(
            lambda s, k=k: a * sheet.at((k + s) * dt), lambda k=k: a * mean(sheet, k * dt, (k + 1) * dt)
        )
        state.advance(dt, drive)
        want = solvers.SOLVERS[solver](want, drive, kr, np.array(dt))
    # A step's sum rounds once, and its increment, of 1/32 at most, has some 16 roundings and the light its own.
    tolerance = 32 * 2 * U if solver != "rk23" else 2e-3
    assert np.abs(state.read() - want).max() <= tolerance


@pytest.mark.parametrize("solver", ["substep", "rk23"])
def test_light_between_the_values_that_are_known_is_never_negative(device, solver):
    """Light at the step's start alone: the quadratic through it dips below 0, which must not drain the state."""
    flash = Drive(lambda s: np.array(float(s == 0)))
    state = BareState(device, [0.0], np.full((2, 2, 1), 8.0), solver, r0=0.5)
    state.advance(1.0, flash)
    # 1 - 3 s + 2 s² has an integral of 5/24 where it is above 0, and -1/24 where it is not.
    kept, drained = (1 - 0.5 * np.exp(-8 * light) for light in (5 / 24, 4 / 24))
    assert state.read()[0, 0, 0] > (kept + drained) / 2


@pytest.mark.parametrize(
    ("solver", "says"),
    [("euler", "overshoots"), ("substep", "too many parts"), ("rk23", "too many parts")],
)
def test_a_step_beyond_what_a_solver_bears_is_refused(device, refuses, solver, says):
    state = BareState(device, [1.0], np.full((2, 2, 1), 1.1 * EXPLICIT_LIMIT), solver)
    message = refuses(state.advance, 1.0)
    assert says in message
    assert "--solver exact" in message
    assert (state.read() == 0).all()


@pytest.mark.parametrize("light", [np.nan, -1.0, np.inf])
def test_light_that_is_no_light_is_refused(device, refuses, light):
    state = BareState(device, [1.0], np.ones((2, 2, 1)))
    assert "Rates and light are 0 or more" in refuses(state.advance, 1.0, Drive.constant(np.array(light)))
    assert "holds a negative" in refuses(BareState, device, [1.0], np.full((2, 2, 1), light))
    assert "holds a negative" in refuses(BareState, device, [light], np.ones((2, 2, 1)))


@pytest.mark.parametrize("dt", [-1.0, np.nan, np.inf])
def test_time_that_runs_backwards_is_refused(device, refuses, dt):
    assert "Time runs forwards" in refuses(BareState(device, [1.0], np.ones((2, 2, 1))).advance, dt)


@pytest.mark.parametrize("name", ["magic", "dop853"])
def test_a_solver_that_the_gpu_has_not_names_those_that_it_has(device, refuses, name):
    message = refuses(BareState, device, [1.0], np.ones((2, 2, 1)), name)
    assert f"the renderer's solver {name!r} is unknown" in message
    assert "euler, substep, exact, exact2, rk23" in message


@pytest.mark.parametrize("solver", SOLVERS)
def test_every_gpu_solver_has_its_reference(solver):
    assert solver in solvers.SOLVERS
