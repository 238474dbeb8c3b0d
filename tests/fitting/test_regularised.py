"""Non-negative regularised least squares: the constraint, the choice of smoothness, the band."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import nnls

from phoslab.fitting.regularised import Normal, non_negative, second_differences, solve

D = second_differences(40)
PENALTY = D.T @ D


@given(st.integers(0, 2**32 - 1), st.integers(1, 60))
def test_block_pivoting_finds_the_non_negative_minimum(seed, n):
    rng = np.random.default_rng(seed)
    A, y = rng.normal(size=(n + 5, n)), rng.normal(size=n + 5)
    x, free = non_negative(A.T @ A, A.T @ y)
    known, _ = nnls(A, y)
    # The minimum is unique. Both solve the same normal equations; those lose the square of A's condition.
    condition = np.linalg.cond(A[:, known > 0]) if (known > 0).any() else 1.0
    assert np.abs(x - known).max() <= 1e-10 * condition**2 * max(1.0, np.abs(known).max())
    assert (x >= 0).all()
    assert (x[~free] == 0).all()


@given(st.integers(0, 2**32 - 1))
def test_a_narrow_band_of_the_matrix_changes_nothing(seed):
    """A banded matrix takes another factorisation; the answer is that of the full one."""
    rng = np.random.default_rng(seed)
    M = PENALTY + np.eye(40)
    right = rng.normal(size=40)
    x, _ = non_negative(M, right)
    known, _ = nnls(np.linalg.cholesky(M).T, np.linalg.solve(np.linalg.cholesky(M), right))
    assert np.abs(x - known).max() < 1e-10


def blurred(seed, noise=0.01):
    """A peak on nothing, seen through bands as broad as itself: what an LED's blue is to the filter."""
    rng = np.random.default_rng(seed)
    at = np.arange(40.0)
    truth = np.exp(-0.5 * ((at - 20) / 2) ** 2)
    A = np.exp(-0.5 * ((np.linspace(0, 39, 80)[:, None] - at) / 2) ** 2)
    sigma = np.full(80, noise)
    return A, A @ truth + rng.normal(0, noise, 80), sigma, truth


@pytest.mark.parametrize("noise", [0.01, 0.1])
def test_the_chosen_smoothness_is_near_the_best_one(noise):
    worse = []
    for seed in range(8):
        A, y, sigma, truth = blurred(seed, noise)
        normal = Normal.of(A, y, sigma)
        chosen = solve(normal, PENALTY)
        errors = []
        for mu in chosen.strength * np.geomspace(1e-4, 1e4, 17):
            x, _ = non_negative(normal.matrix + mu * PENALTY, normal.right)
            errors.append(np.sqrt(np.mean((x - truth) ** 2)))
        worse.append(np.sqrt(np.mean((chosen.x - truth) ** 2)) / min(errors))
        assert not chosen.at_end
    # Knowing the truth, nobody could choose better than 1; too rough or too smooth by 10^4 costs a factor of 5 or more.
    assert np.median(worse) < 1.5
    assert max(worse) < 3


@pytest.mark.parametrize("noise", [0.01, 0.1])
def test_the_band_covers_the_truth_as_often_as_it_says_and_where_it_bends(noise):
    """On average over a curve it does (Wahba 1983); what is held at 0 is exact here and adds to it."""
    inside = []
    for seed in range(20):
        A, y, sigma, truth = blurred(seed, noise)
        solution = solve(Normal.of(A, y, sigma), PENALTY)
        inside.append(np.abs(solution.x - truth) < 2 * solution.standard_error)
    assert np.mean(inside) > 0.95
    assert np.mean(np.array(inside)[:, 15:26]) > 0.95


def test_noise_that_is_understated_widens_the_band_and_does_not_roughen():
    A, y, sigma, _ = blurred(3, 0.05)
    honest, sure = (solve(Normal.of(A, y, s), PENALTY) for s in (sigma, sigma / 10))
    assert sure.strength / 100 == pytest.approx(honest.strength, rel=0.5)  # μ is in units of 1 / σ²
    # Both know the noise from the same 78 values, the second from them alone: to 1 / sqrt(2 * 78), of which 3.
    assert np.allclose(sure.standard_error, honest.standard_error, rtol=3 / np.sqrt(2 * 78))


@given(st.integers(0, 2**32 - 1))
def test_errors_that_go_together_count_as_generalised_least_squares_says(seed):
    rng = np.random.default_rng(seed)
    A, y = rng.normal(size=(5, 3, 4)), rng.normal(size=(5, 3))
    root = rng.normal(size=(5, 3, 3)) + 3 * np.eye(3)
    covariance = root @ root.swapaxes(1, 2)
    covariance[1, 2, 2] = np.inf
    normal = Normal.correlated(A, y, covariance)
    used = np.arange(15) != 5
    whole = np.zeros((15, 15))
    for k in range(5):
        whole[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = covariance[k]
    inverse = np.linalg.inv(whole[np.ix_(used, used)])
    rows, values = A.reshape(15, 4)[used], y.ravel()[used]
    assert normal.n_data == 14
    assert np.allclose(normal.matrix, rows.T @ inverse @ rows, rtol=1e-9, atol=1e-12)
    assert np.allclose(normal.right, rows.T @ inverse @ values, rtol=1e-9, atol=1e-12)
    assert np.isclose(normal.squares, values @ inverse @ values, rtol=1e-9)


def test_rows_of_unknown_noise_say_nothing():
    A, y, sigma, _ = blurred(1)
    normal = Normal.of(A, y, sigma)
    more = Normal.of(np.vstack([A, A]), np.append(y, 1e6 + y), np.append(sigma, np.full(80, np.inf)))
    assert np.array_equal(more.matrix, normal.matrix)
    assert more.n_data == normal.n_data
