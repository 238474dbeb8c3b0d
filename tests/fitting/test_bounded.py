"""Least squares with bounds, against closed forms and another solver."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from phoslab.fitting.bounded import covariance_of, reach, search


def linear(seed: int, m: int = 30, n: int = 5):
    rng = np.random.default_rng(seed)
    J, y = rng.standard_normal((m, n)), 3 * rng.standard_normal(m)
    return J, y, lambda theta: (J @ theta - y, J)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), n_free=st.integers(0, 5))
def test_a_linear_problem_ends_where_bounded_least_squares_does(seed, n_free):
    J, y, residual = linear(seed)
    lower = np.where(np.arange(5) < n_free, -np.inf, 0.0)
    found = search(residual, np.ones(5), lower)
    exact = lsq_linear(J, y, (lower, np.full(5, np.inf)), method="bvls", tol=1e-15).x
    # The search ends when chi² would fall by less than 1e-8 of chi² a residual, here up to 10; at a curvature of at
    # least the smallest singular value's square, about 5, that leaves sqrt(1e-7 / 5).
    assert np.abs(found.theta - exact).max() < 2e-4
    assert (found.theta >= lower).all()
    assert ((found.theta == 0) == (np.abs(exact) < 1e-9))[n_free:].all(), "on the bound, not close to it"


def test_what_is_held_does_not_move():
    _, _, residual = linear(3)
    held = np.arange(5) == 2
    start = np.full(5, 0.37)
    found = search(residual, start, np.full(5, -np.inf), held)
    assert found.theta[2] == 0.37
    # And the others are the best for it: their gradient vanishes.
    assert np.abs(found.jacobian.T @ found.residual)[~held].max() < 1e-2
    assert np.abs(found.jacobian.T @ found.residual)[held].max() > 1


def test_a_nonlinear_minimum_is_found_from_afar():
    t = np.linspace(0, 5, 40)

    def residual(theta):
        e = np.exp(-theta[0] * t)
        return theta[1] * e - 3 * np.exp(-0.7 * t), np.stack([-theta[1] * t * e, e], 1)

    found = search(residual, np.array([8.0, 0.1]), np.array([0.0, 0.0]))
    assert found.theta == pytest.approx([0.7, 3.0], rel=1e-4)


def test_a_step_to_where_the_slope_is_no_number_is_taken_back():
    # The first step, of 4, would lead to a lower sum of squares without a slope.
    def residual(theta):
        slope = 1.0 if theta[0] < 3 else np.nan
        return np.array([theta[0] - 4.0]), np.array([[slope]])

    found = search(residual, np.array([0.0]), np.array([-np.inf]))
    assert 2 < found.theta[0] < 3
    assert np.isfinite(found.jacobian).all()


@given(seed=st.integers(0, 1000))
@settings(max_examples=15, deadline=None)
def test_the_reach_of_a_linear_problem_is_its_standard_error(seed):
    J, _, residual = linear(seed)
    free = np.full(5, -np.inf)
    found = search(residual, np.zeros(5), free)
    w = np.random.default_rng(seed + 1).standard_normal(5)
    furthest = reach(lambda theta: (float(w @ theta), w), residual, found, free, found.chi2 + 2.5)
    # chi² is a paraboloid: the largest w θ with chi² 2.5 above the minimum is sqrt(2.5) standard errors away.
    error = np.sqrt(w @ np.linalg.inv(J.T @ J) @ w)
    assert (furthest - w @ found.theta) / error == pytest.approx(np.sqrt(2.5), rel=1e-3)


def test_the_reach_respects_bounds():
    # Two parameters whose sum the data know: the first can only grow by what the second gives up, until that is 0.
    J = np.array([[1.0, 1.0], [1e-3, 0.0]])
    y = np.array([5.0, 0.0])
    lower = np.zeros(2)
    residual = lambda theta: (J @ theta - y, J)  # noqa: E731
    found = search(residual, np.array([1.0, 1.0]), lower)
    furthest = reach(lambda theta: (float(theta[0]), np.array([1.0, 0.0])), residual, found, lower, 4.0)
    # With the second at 0: (θ - 5)² + 1e-6 θ² = 4 at θ = 5 + sqrt(4 - 1e-6 * 49) to first order.
    assert furthest == pytest.approx(7.0, rel=1e-4)


def test_the_reach_turns_back_where_the_model_has_no_number():
    """|log θ| <= 1 holds down to 1 / e; a first step as long as an error ends at 0, and a longer one beyond."""

    def residual(theta):
        with np.errstate(all="ignore"):
            return np.log(theta), np.array([[1 / theta[0]]])

    found = search(residual, np.array([1.1]), np.array([-np.inf]))
    furthest = reach(
        lambda theta: (-float(theta[0]), np.array([-1.0])), residual, found, np.array([-np.inf]), 1.0
    )
    assert furthest == pytest.approx(-np.exp(-1), rel=1e-3)


def test_the_covariance_is_that_of_the_normal_equations():
    J, _, _ = linear(7)
    assert covariance_of(J) == pytest.approx(np.linalg.inv(J.T @ J), rel=1e-9)


def test_what_has_no_influence_has_no_error_bar():
    J, _, _ = linear(7)
    J = np.insert(J, 2, 0.0, axis=1)
    assert np.isinf(covariance_of(J)[2, 2])
    assert np.isfinite(np.delete(np.diag(covariance_of(J)), 2)).all()
    assert np.isinf(covariance_of(np.repeat(J, 2, axis=1))).all(), "two parameters that do the same"
