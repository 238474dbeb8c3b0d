"""The bench's sample: real trap physics, and just wrong enough for a sum of exponentials."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import minimize, nnls

from phoslab.bands import Bands
from phoslab.instruments.bench.bench import Bench
from phoslab.instruments.bench.lamp import Lamp
from phoslab.instruments.bench.sample import Sample

Array = NDArray[np.float64]

SAMPLE = Sample()


@pytest.fixture(scope="module")
def charged() -> Array:
    """A sample after 90 minutes of lamp light."""
    return SAMPLE.advance(SAMPLE.empty, 5400.0, lambda _: 0.02)[0]


def worst_misfit(t_s: Array, light: Array, n_states: int, relative_noise: Array) -> float:
    """Largest relative residual of the best positive sum of exponentials, weighted by `relative_noise`.

    Written for this test alone: rates by a simplex from a grid of starts, amplitudes by NNLS.
    """
    weight = 1 / (light * relative_noise)

    def solve(log_rates: Array) -> tuple[Array, float]:
        basis = np.exp(-np.outer(t_s, np.exp(log_rates)))
        amplitudes, residual = nnls(basis * weight[:, None], light * weight)
        return basis @ amplitudes, residual

    grid = np.log(np.geomspace(0.004, 1.5, 7))
    starts = sorted(itertools.combinations(grid, n_states), key=lambda s: solve(np.array(s))[1])[:3]
    options = {"xatol": 1e-7, "fatol": 1e-12, "maxiter": 4000, "maxfev": 4000}
    best = min(
        (
            minimize(lambda x: solve(x)[1] ** 2, np.array(s), method="Nelder-Mead", options=options)
            for s in starts
        ),
        key=lambda result: result.fun,
    )
    return float(np.abs(solve(best.x)[0] / light - 1).max())


# "Best fit" is weighted least squares with positive amplitudes; a weight is 1 over a frame's noise. Realistic:
# shutter, aperture and gain repeat to 0.5 %, and photons add 0.01 %, more where it is dim. The limits of that are
# a constant relative noise, and photon noise alone at one exposure; the requirement holds for all three.
WEIGHTS = {
    "realistic": lambda light: np.hypot(0.005, 1e-4 * np.sqrt(light[0] / light)),
    "constant": lambda light: np.full(light.size, 0.005),
    "photons": lambda light: 1e-4 * np.sqrt(light[0] / light),
}


@pytest.mark.parametrize("weights", WEIGHTS)
def test_two_exponentials_miss_the_light_by_10_to_20_percent_and_three_by_1_to_3(weights: str) -> None:
    bench = Bench(seed=0)
    bench.switch_lamp(True)
    bench.wait(5400)
    bench.switch_lamp(False)
    t_s = 0.6 + 5.0 * np.arange(37)
    light = bench.true_light(t_s)
    noise = WEIGHTS[weights](light)
    assert 0.10 < worst_misfit(t_s, light, 2, noise) < 0.20
    assert 0.01 < worst_misfit(t_s, light, 3, noise) < 0.03


def test_every_electron_that_leaves_the_traps_in_the_dark_gives_its_light(charged: Array) -> None:
    after, light = SAMPLE.advance(charged, 180.0)
    # Both are integrals to 1e-10 of the same flow; the sums over 40 depths add up to some 1e-9.
    assert light == pytest.approx(charged.sum() - after.sum(), rel=1e-7)


def test_traps_stay_between_empty_and_full(charged: Array) -> None:
    strong = SAMPLE.advance(SAMPLE.empty, 1e5, lambda _: 1e3)[0]
    for state in (charged, strong, SAMPLE.advance(strong, 1e5)[0]):
        assert (state >= -1e-12).all()
        assert (state <= SAMPLE.capacity + 1e-12).all()
    assert strong.sum() > 0.95  # overwhelming light fills all but the shallowest


def test_light_does_not_ionise_a_centre_twice() -> None:
    assert SAMPLE.light(SAMPLE.capacity, 1.0) == pytest.approx(SAMPLE.light(SAMPLE.capacity), rel=1e-12)
    assert SAMPLE.light(SAMPLE.capacity / 2, 1.0) > SAMPLE.light(SAMPLE.capacity / 2)


def test_the_solution_agrees_with_a_high_order_solver(charged: Array) -> None:
    after, _ = SAMPLE.advance(charged, 100.0)
    reference = solve_ivp(
        lambda _, n: SAMPLE._flow(n, 0.0)[0], (0, 100), charged, method="Radau", rtol=1e-11, atol=1e-15
    )
    # LSODA's local tolerance of 1e-10, over some hundreds of steps.
    np.testing.assert_allclose(after, reference.y[:, -1], rtol=1e-6, atol=1e-11)


def test_the_light_fades_ever_more_slowly_like_a_power_of_time(charged: Array) -> None:
    """An exponential's d ln L / d ln t grows like -kt without end; a power law's stays put."""
    t_s = np.array([10.0, 20.0, 100.0, 200.0, 1000.0, 2000.0])
    light = SAMPLE.afterglow(charged, t_s)
    exponents = np.log(light[1::2] / light[::2]) / np.log(2)
    assert ((-2.5 < exponents) & (exponents < -0.3)).all()


def test_the_decay_depends_on_the_charge_beyond_a_factor() -> None:
    """Retrapping: with few electrons free traps abound. A sum of independent exponentials has no such thing."""
    t_s = np.array([1.0, 100.0])
    weak, strong = (
        SAMPLE.afterglow(SAMPLE.advance(SAMPLE.empty, seconds, lambda _: 0.02)[0], t_s)
        for seconds in (2.0, 5400.0)
    )
    assert abs(np.log((weak[0] / weak[1]) / (strong[0] / strong[1]))) > 0.1


def test_only_short_waves_charge_the_sample() -> None:
    bands = Bands.uniform(40, 360.0, 760.0)
    blue, red = (np.where(mask, 1.0, 0.0) for mask in (bands.centres_nm < 450, bands.centres_nm > 550))
    assert SAMPLE.drive_per_s(red, bands) < 1e-3 * SAMPLE.drive_per_s(blue, bands)
    assert np.average(Lamp().irradiance(bands), weights=bands.widths_nm) == pytest.approx(1.0)


def test_the_lamp_is_dark_320_ms_after_it_is_switched_off() -> None:
    lamp = Lamp()
    assert lamp.level(-1.0) == lamp.level(0.0) == 1.0
    assert 0 < lamp.level(0.3) < lamp.level(0.1) < 1
    assert lamp.level(0.32) == lamp.level(5.0) == 0.0
