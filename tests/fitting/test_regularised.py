"""Non-negative regularised least squares: the constraint, the choice of smoothness, the band."""

import numpy as np
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
    """A smooth peak on nothing, seen through broad bands."""
    rng = np.random.default_rng(seed)
    at = np.arange(40.0)
    truth = np.exp(-0.5 * ((at - 20) / 4) ** 2)
    A = np.exp(-0.5 * ((np.linspace(0, 39, 80)[:, None] - at) / 2) ** 2)
    sigma = np.full(80, noise)
    return A, A @ truth + rng.normal(0, noise, 80), sigma, truth


def test_the_chosen_smoothness_is_near_the_best_one():
    worse = []
    for seed in range(8):
        A, y, sigma, truth = blurred(seed)
        normal = Normal.of(A, y, sigma)
        chosen = solve(normal, PENALTY)
        errors = []
        for mu in chosen.strength * np.geomspace(1e-4, 1e4, 17):
            x, _ = non_negative(normal.matrix + mu * PENALTY, normal.right)
            errors.append(np.sqrt(np.mean((x - truth) ** 2)))
        worse.append(np.sqrt(np.mean((chosen.x - truth) ** 2)) / min(errors))
        assert not chosen.at_end
    # Knowing the truth, nobody could choose better than 1; too rough or too smooth by 10^4 costs a factor of 5 or more.
    assert np.median(worse) < 2.0


def test_the_band_covers_the_truth_as_often_as_it_says():
    inside = []
    for seed in range(20):
        A, y, sigma, truth = blurred(seed)
        solution = solve(Normal.of(A, y, sigma), PENALTY)
        inside.append(np.mean(np.abs(solution.x - truth) < 2 * solution.standard_error))
    # 95 % on average over a curve (Wahba 1983); what is held at 0 is exact here and adds to it.
    assert np.mean(inside) > 0.9


def test_rows_of_unknown_noise_say_nothing():
    A, y, sigma, _ = blurred(1)
    normal = Normal.of(A, y, sigma)
    more = Normal.of(np.vstack([A, A]), np.append(y, 1e6 + y), np.append(sigma, np.full(80, np.inf)))
    assert np.array_equal(more.matrix, normal.matrix)
    assert more.n_data == normal.n_data
