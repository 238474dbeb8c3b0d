"""The state on the GPU against the float64 reference, within bounds that float32 arithmetic gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import phoslab
from phoslab import kinetics, solvers
from phoslab.bands import Bands
from phoslab.material import Material
from phoslab.render.bare_state import STEADY, BareState
from phoslab.render.device import Device
from phoslab.render.optics import Optics
from phoslab.solvers import Drive

U = 2.0**-24  # half a unit in the last place of a float32 near 1

SIDE = 32

DARK = Drive.constant(np.array(0.0))


def as_float32(values: np.ndarray) -> np.ndarray:
    """What both sides compute from: rounding the inputs is not an error of the solver."""
    return np.asarray(values, dtype=np.float32).astype(np.float64)


def stepped(device: Device, kr, r, a, dt: float, n: int = 1, solver: str = "exact") -> np.ndarray:
    """The state after n steps; in darkness by the step that knows of it."""
    state = BareState(device, kr, a, solver, r0=r)
    state.advance_many(dt, n, STEADY if a.any() else DARK)
    return state.read()


def spread(low: float, high: float, n: int, seed: int) -> np.ndarray:
    """(SIDE, SIDE, n) values spread evenly in their logarithm, as float32 has them."""
    exponents = np.random.default_rng(seed).uniform(np.log10(low), np.log10(high), (SIDE, SIDE, n))
    return as_float32(10.0**exponents)


def step_bound(a: np.ndarray, kr: np.ndarray, dt: float, n: int) -> np.ndarray:
    """The error after n exact steps of dt in float32, per texel and state.

    One step is r + (r_inf - r) g with g = 1 - exp(-k dt). Its sum is rounded once: U, as r <= 1. The increment has
    relative errors: k 1, k dt 2, series 6 and truncation 1, difference and product 2, r_inf 4 on itself; in all
    below 16 U g. An error of one step shrinks by 1 - g in every later one, so n of them sum to at most
    (U + 16 U g) min(n, 1 / g).
    """
    g = -np.expm1(-(a + kr) * dt)
    return (U + 16 * U * g) * np.minimum(n, 1 / g)


@pytest.mark.parametrize("n_states", [1, 2, 4])
def test_ten_thousand_charging_steps_stay_within_the_float32_bound(device, n_states):
    """10,000 steps of 1/60 s with an excitation that differs per texel: `step_bound`, derived above."""
    kr = as_float32(np.array([0.227, 0.009, 0.05, 0.001])[:n_states])
    a, dt = spread(1e-4, 1.0, n_states, seed=1), 1 / 60
    r = spread(1e-3, 1.0, n_states, seed=2)
    gpu = stepped(device, kr, r, a, dt, 10_000)
    want = solvers.exact_step(r, a, kr, np.float64(np.float32(dt)) * 10_000)
    assert (np.abs(gpu - want) <= step_bound(a, kr, dt, 10_000)).all()


def test_ten_thousand_dark_steps_stay_within_the_float32_bound(device):
    """Dark: each step rounds the factor and the product, relative to r: 2 n U."""
    kr, dt = as_float32(np.array([0.227, 0.009])), 1 / 60
    r = spread(1e-3, 1.0, 2, seed=3)
    gpu = stepped(device, kr, r, np.zeros_like(r), dt, 10_000)
    want = r * np.exp(-kr * dt * 10_000)
    assert (np.abs(gpu - want) <= 2 * 10_000 * U * want).all()


def test_anchored_jump_is_accurate_to_a_few_ulp(device):
    """One step of any length: r e + r_inf (1 - e); an exponent x of relative error 2 U gives 2 U x e^-x <= U."""
    kr = as_float32(np.array([0.227, 0.009]))
    for seed, dt in enumerate((1 / 60, 1.0, 30.0, 1000.0, 1e6)):
        a, r = spread(1e-4, 1.0, 2, seed), spread(1e-3, 1.0, 2, seed + 50)
        gpu = stepped(device, kr, r, a, dt)
        want = solvers.exact_step(r, a, kr, np.float64(np.float32(dt)))
        assert np.abs(gpu - want).max() <= 16 * U


@pytest.mark.parametrize("dt", [1 / 60, 1.0, 80.0, 2000.0])
def test_dark_jump_equals_kinetics_decay_to_the_last_bits(device, dt):
    green = phoslab.preset("green")
    r = spread(1e-3, 1.0, 1, seed=4)
    gpu = stepped(device, green.kr_per_s, r, np.zeros_like(r), dt)
    want = kinetics.decay(green, r, np.full((SIDE, SIDE), dt))
    normal = want > 1e-37
    # The factor is rounded once and the product once.
    np.testing.assert_allclose(gpu[normal], want[normal], rtol=3 * U)
    assert (gpu[~normal] < 1e-37).all()


def test_texels_in_shadow_fade_as_accurately_as_in_darkness(device):
    """a = 0 beside lit texels: r e^-x, with errors of x 2 U x, of the polynomial and the product 6 U."""
    kr = as_float32(np.array([0.227, 0.009]))
    for dt in (1e-3, 1 / 60, 1.0, 3.0, 30.0, 300.0):
        a, r = spread(1e-4, 1.0, 2, seed=8), spread(1e-3, 1.0, 2, seed=9)
        a[::2] = 0.0
        gpu = stepped(device, kr, r, a, dt)[::2]
        x = kr * np.float64(np.float32(dt))
        error = np.abs(gpu / (r[::2] * np.exp(-x)) - 1)
        assert (error <= (2 * x + 6) * U).all()


def test_euler_step_is_that_of_the_paper(device):
    kr, dt = as_float32(np.array([0.227, 0.009])), 1 / 60
    a, r = spread(1e-4, 1.0, 2, seed=5), spread(1e-3, 1.0, 2, seed=6)
    gpu = stepped(device, kr, r, a, dt, solver="euler")
    want = solvers.euler(r, solvers.Drive.constant(a), kr, np.float64(np.float32(dt)))
    # The increment is below 0.02, with some four roundings; the sum is rounded once.
    assert np.abs(gpu - want).max() <= U * (1 + 6 * 0.02)


def test_rates_of_every_texel_step_it_by_its_own(device):
    kr = spread(1e-3, 1.0, 1, seed=7)
    state = BareState(device, kr, np.zeros_like(kr), r0=1.0)
    state.advance(5.0)
    # As a texel in shadow: errors of x = kr dt, of the polynomial and of the product.
    assert (np.abs(state.read() / np.exp(-5 * kr) - 1) <= (2 * 5 * kr + 6) * U).all()


def test_optics_of_a_two_state_material_keep_its_excitation():
    """ke_width @ E in other bands is the excitation that the material's own bands give."""
    two = Material(
        name="two",
        bands=Bands.uniform(4),
        kr_per_s=[0.2, 0.02],
        ke_m2_per_J=[[0.1, 0.05, 0.0, 0.0], [0.02, 0.01, 0.004, 0.0]],
        emission=[[0, 0, 1, 0.5], [0, 0, 2, 1.0]],
        calibration="absolute",
    )
    from phoslab.bands import rebin
    from phoslab.render.optics import load_optics

    transport = Bands(np.array([380.0, 430, 470, 520, 555, 640, 720]))
    optics: Optics = load_optics(two, transport, 3.0, 1.0)
    E = np.array([1.0, 0.5, 2.0, 0.7, 0.1, 0.3])
    want = kinetics.excitation(two, 3.0 * rebin(E, transport, two.bands))
    np.testing.assert_allclose(optics.ke_width[0, 0] @ E, want, rtol=1e-12)
    energy = optics.emission[0, 0] @ transport.widths_nm
    np.testing.assert_allclose(energy, two.emission @ two.bands.widths_nm, rtol=1e-12)
    assert replace(two, name="other").n_states == optics.n_states
