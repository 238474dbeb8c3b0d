"""Every solver in every format at the ends of its ranges: property-based, with many cases in one texture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from phoslab import solvers
from phoslab.errors import PhoslabError
from phoslab.render.bare_state import BareState
from phoslab.render.solvers import SOLVERS
from phoslab.render.state_formats import FORMATS
from phoslab.solvers import EXPLICIT_LIMIT

U = 2.0**-24
SIDE = 8

# How far a format may round a number near r away: half its last place; the least of a half is 2^-24.
ROUNDING = {
    "f32": lambda r: U * r,
    "f32c": lambda r: U * r,
    "f16": lambda r: np.maximum(2.0**-11 * r, 2.0**-25),
    "unorm16": lambda r: np.full_like(r, 0.5 / 65535 + U),
}

# Zeros, the least denormals of float64 and float32, and the least normal float32.
SMALL = (0.0, 5e-324, 1.4e-45, 1e-40, 1.2e-38)


@dataclass(repr=False)
class Cases:
    """SIDE² texels of n_c states each: concentrations, excitations ke E, rates, and one step length."""

    r: np.ndarray
    a: np.ndarray
    kr: np.ndarray
    dt: float

    @property
    def stiffness(self) -> float:
        return float((self.a + self.kr).max() * self.dt)


@st.composite
def cases(draw) -> Cases:
    """kr 0..1e6, ke 0..1e3, irradiance 0..1e12, dt 1e-6..1e6; a third of all values is special."""
    n = draw(st.integers(1, 4))
    dt = draw(st.one_of(st.sampled_from([1e-6, 1 / 60, 1.0, 1e6]), st.floats(1e-6, 1e6)))
    spread = draw(st.floats(0.1, 1.0))  # how far below the largest the others reach
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))

    def some(largest: float) -> np.ndarray:
        low = spread * np.log10(1e-12) + np.log10(largest)
        values = 10 ** rng.uniform(low, np.log10(largest), (SIDE, SIDE, n))
        special = rng.choice([*SMALL, largest], values.shape)
        return np.where(rng.random(values.shape) < 1 / 3, special, values)

    scale = draw(st.sampled_from([1.0, 1e-3, 1e-6]))
    r, ke, E, kr = some(1.0), some(1e3), some(1e12 * scale**2), some(1e6 * scale)
    return Cases(r, ke * E, kr, dt)


def many(test):
    return settings(max_examples=25, suppress_health_check=list(HealthCheck))(given(case=cases())(test))


def run(device, case: Cases, solver: str, state_format: str) -> tuple[np.ndarray, np.ndarray]:
    """The state as the format holds it, before and after one step."""
    state = BareState(device, case.kr, case.a, solver, state_format, case.r)
    before = state.read()
    state.advance(case.dt)
    return before, state.read()


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_solver_that_does_not_refuse_stays_finite_and_inside(device, solver):
    limit = SOLVERS[solver].largest_step

    @many
    def check(case: Cases) -> None:
        if case.stiffness > limit:
            with pytest.raises(PhoslabError):
                run(device, case, solver, "f32")
            # The same at the end of what it bears.
            case.dt *= 0.999 * limit / case.stiffness
        for state_format in FORMATS:
            _, after = run(device, case, solver, state_format)
            assert np.isfinite(after).all()
            assert ((after >= 0) & (after <= 1)).all()

    check()


@pytest.mark.parametrize("solver", ["exact", "exact2"])
def test_exact_steps_move_towards_the_equilibrium_and_never_past_it(device, solver):
    """The equilibrium of float32 has two roundings, of the sum and of the quotient; then the format rounds."""

    @many
    def check(case: Cases) -> None:
        for state_format in FORMATS:
            before, after = run(device, case, solver, state_format)
            k = case.a + case.kr
            rest = np.where(k > 0, case.a / np.where(k > 0, k, 1.0), before)
            slack = 4 * U * rest + ROUNDING[state_format](np.maximum(rest, before)) + 2e-38
            assert (after >= np.minimum(before, rest) - slack).all()
            assert (after <= np.maximum(before, rest) + slack).all()

    check()


@pytest.mark.parametrize("solver", SOLVERS)
def test_equal_inputs_give_equal_outputs(device, solver):
    @many
    def check(case: Cases) -> None:
        case.dt *= min(1.0, 0.999 * min(SOLVERS[solver].largest_step, 1e30) / case.stiffness)
        for state_format in FORMATS:
            (_, one), (_, two) = (run(device, case, solver, state_format) for _ in range(2))
            assert one.tobytes() == two.tobytes()

    check()


def test_the_exact_step_is_right_wherever_it_is(device):
    """All ranges in float32: 16 U of saturation (derived in test_phosphor_step) from float64."""

    @many
    def check(case: Cases) -> None:
        before, after = run(device, case, "exact", "f32")
        dt = np.float64(np.float32(case.dt))
        a, kr = (x.astype("f4").astype("f8") for x in (case.a, case.kr))
        want = solvers.exact_step(before, a, kr, dt)
        assert np.abs(after - want).max() <= 16 * U

    check()


def test_the_limits_of_the_ranges_at_once(device):
    """Everything at its largest, and everything at its least."""
    for largest in (True, False):
        full = np.full((SIDE, SIDE, 4), 1.0)
        a, kr, dt = (1e15, 1e6, 1e6) if largest else (5e-324, 5e-324, 1e-6)
        case = Cases(full * (1.0 if largest else 5e-324), full * a, full * kr, dt)
        if largest:
            assert case.stiffness > EXPLICIT_LIMIT
        for state_format in FORMATS:
            _, after = run(device, case, "exact", state_format)
            assert ((after >= 0) & (after <= 1)).all()
            assert (after == (1.0 if largest else 0.0)).all()
