"""The previous method: right without saturation, wrong with it."""

import numpy as np
import pytest

from phoslab.history import from_cache, monte_carlo
from phoslab.programmes import Sine
from phoslab.solvers import SOLVERS, Drive

KR = np.array([0.3, 0.02])


def solved(a: np.ndarray, t: float) -> np.ndarray:
    light = Sine(2.0)
    return SOLVERS["dop853"](np.zeros(2), Drive(lambda s: a * light.at(s * t)), KR, np.array(t))


def sampled(a: np.ndarray, t: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard error of 4000 independent estimates."""
    light, copies = Sine(2.0), 4000
    kr = np.broadcast_to(KR, (copies, 2))
    estimates = monte_carlo(lambda past: a * light.at(past), kr, t, n, np.random.default_rng(n))
    return estimates.mean(axis=0), estimates.std(axis=0) / np.sqrt(copies)


@pytest.mark.parametrize("n", [1, 64])
def test_it_is_unbiased_where_nothing_saturates(n):
    a = np.array([1e-6, 1e-6])
    mean, error = sampled(a, 10.0, n)
    # Saturation, left out, changes r by r itself: 1e-5 of it here. 5 standard errors: once in a million.
    assert np.abs(mean - solved(a, 10.0)).max() <= (5 * error + 2e-5 * mean).max()


def test_it_overshoots_where_the_material_saturates():
    a = np.array([0.5, 0.5])
    mean, error = sampled(a, 10.0, 64)
    assert (mean - 5 * error > 1.2 * solved(a, 10.0)).all()


def test_the_cache_gives_what_steps_give_without_saturation():
    rng = np.random.default_rng(2)
    a = 1e-9 * rng.uniform(size=(200, 3, 2))
    r = np.zeros((3, 2))
    for frame in a:
        r = SOLVERS["exact"](r, Drive.constant(frame), KR, np.array(0.1))
    # Saturation, left out, is of order r = 1e-8.
    assert from_cache(a, np.broadcast_to(KR, (3, 2)), 0.1) == pytest.approx(r, rel=1e-7)
