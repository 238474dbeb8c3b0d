"""Least squares with the linear parameters eliminated, on the reference problems of the NIST."""

import numpy as np
import pytest

from phoslab.app.trades import strd
from phoslab.app.trades.strd import digits
from phoslab.fitting import varpro


def solved(problem, start, **options):
    """Rates, linear parameters and standard deviations in the order of the certificate; every sign is free."""
    n_x, n = problem.linear.size, len(start)
    found = varpro.solve(problem.basis, problem.y[None], np.log(start), signed=np.ones(n_x, bool), **options)
    covariance = varpro.covariance(problem.basis, found) * found.chi2 / (problem.y.size - n - n_x)
    sd = np.sqrt(np.diag(covariance))
    order = np.argsort(found.theta)[np.argsort(np.argsort(problem.rates))]
    columns = np.concatenate([np.arange(int(problem.constant)), order + int(problem.constant)])
    rates = np.exp(found.theta[order])
    return found, rates, found.linear[0][columns], sd[:n][order] * rates, sd[n:][columns]


@pytest.mark.parametrize("name", strd.PROBLEMS)
def test_the_data_are_those_that_were_certified(name):
    p = strd.PROBLEMS[name]
    phi, _ = p.basis(np.log(p.rates))
    # Certified parameters have 11 digits: on Lanczos1, whose residuals are 1e-13, that alone is 1e-10 a value.
    ss = np.sum((p.y - phi[0] @ p.linear) ** 2)
    assert ss == pytest.approx(p.sum_of_squares, rel=1e-9, abs=24 * 1e-20)


@pytest.mark.parametrize("start", [0, 1])
@pytest.mark.parametrize("name", ["Lanczos1", "Lanczos2", "Lanczos3"])
def test_lanczos_is_solved_to_every_digit_of_its_certificate_from_both_starts(name, start):
    p = strd.PROBLEMS[name]
    found, rates, linear, rate_sd, linear_sd = solved(p, p.starts[start])
    # A rate just above 1 is certified to half of 1e-10: 10.3 digits. That of Lanczos2 ends in ...28486, certified
    # ...2849, which is 10.40; float64 data move it by 3e-13 (their rounding times sd / residual sd = 3000).
    assert digits(rates, p.rates) >= 10.39
    assert digits(linear, p.linear) >= 10.4
    # Lanczos1's residuals are the 14th digit of the data: float64 holds their sum of squares to 3 digits.
    assert found.chi2 == pytest.approx(p.sum_of_squares, rel=1e-2 if name == "Lanczos1" else 1e-9)
    if name != "Lanczos1":
        assert min(digits(rate_sd, p.rate_sd), digits(linear_sd, p.linear_sd)) >= 10


@pytest.mark.parametrize("name", ["Lanczos1", "Lanczos2"])
def test_the_last_digits_do_not_depend_on_the_start(name):
    p = strd.PROBLEMS[name]
    first, second = (solved(p, start)[1] for start in p.starts)
    # Float64 leaves 2e-13: its rounding of 1e-16 times sd / residual sd = 3000. Long double residuals leave 2e-15.
    assert first == pytest.approx(second, rel=2e-14, abs=0)


@pytest.mark.parametrize("start", [0, 1])
@pytest.mark.parametrize("name", ["BoxBOD", "MGH17", "DanWood"])
def test_problems_with_large_residuals_or_far_starts_are_solved_to_ten_digits(name, start):
    p = strd.PROBLEMS[name]
    found, rates, linear, rate_sd, linear_sd = solved(p, p.starts[start], find_scale=name != "DanWood")
    # Certified to 11 digits, of which rounding may cost the last.
    assert min(digits(rates, p.rates), digits(linear, p.linear)) >= 10
    assert min(digits(rate_sd, p.rate_sd), digits(linear_sd, p.linear_sd)) >= 10
    assert digits(np.array([found.chi2]), np.array([p.sum_of_squares])) >= 10


def test_the_jacobian_is_that_of_finite_differences():
    p = strd.LANCZOS3
    y = (p.y + 0.01 * np.sin(p.x * 40))[None]  # far from a minimum the second term of the projection matters
    theta, h = np.log([0.8, 2.0, 6.0]), 1e-6

    def residual(theta):
        return varpro._project(p.basis, y, theta, None).residual.ravel()

    numeric = np.stack(
        [(residual(theta + h * e) - residual(theta - h * e)) / (2 * h) for e in np.eye(3)], axis=1
    )
    # Central differences: h² times the third derivative, and rounding eps/h, here about 1e-9.
    assert np.abs(varpro._project(p.basis, y, theta, None).jacobian - numeric).max() < 1e-7


def test_a_blocks_amplitudes_are_its_own_and_its_rates_are_shared():
    p = strd.LANCZOS3
    both = np.stack([p.y, 0.3 * p.y[::-1][::-1]])

    def basis(theta):
        phi, dphi = p.basis(theta)
        return np.repeat(phi, 2, axis=0), np.repeat(dphi, 2, axis=1)

    alone = varpro.solve(p.basis, p.y[None], np.log([0.7, 4.2, 6.3]))
    found = varpro.solve(basis, both, np.log([0.7, 4.2, 6.3]))
    assert np.sort(found.theta) == pytest.approx(np.sort(alone.theta), rel=1e-9)
    assert found.linear[1] == pytest.approx(0.3 * found.linear[0], rel=1e-9)


def test_what_is_held_does_not_move_and_the_rest_is_best_for_it():
    p = strd.LANCZOS3
    start = np.log([0.9, 3.0, 5.0])
    found = varpro.solve(p.basis, p.y[None], start, held=np.array([True, False, False]))
    assert found.theta[0] == start[0]
    for shift in (1e-3, -1e-3):
        moved = found.theta + np.array([0, shift, 0])
        assert varpro._project(p.basis, p.y[None], moved, None).chi2 > found.chi2


def test_amplitudes_are_never_negative_unless_their_sign_is_free():
    x = strd.LANCZOS3.x
    y = np.exp(-x) - 0.5 * np.exp(-3 * x)
    phi, _ = strd.LANCZOS3.basis(np.log([1.0, 3.0]))
    assert (varpro.linear_part(phi[0], y) >= 0).all()
    assert varpro.linear_part(phi[0], y)[1] == 0
    free = varpro.linear_part(phi[0], y, np.array([False, True]))
    assert free == pytest.approx([1.0, -0.5], rel=1e-12)


def test_an_undetermined_parameter_has_infinite_variance_and_spoils_no_other():
    solution = varpro.Solution(np.log([1.0, 3.0]), np.array([[2.0, 0.0]]), np.zeros((1, 24)))
    cov = varpro.covariance(strd.LANCZOS3.basis, solution)
    assert np.isinf(cov[3, 3])
    assert np.isinf(cov[1, 1])
    assert np.isfinite(cov[np.ix_([0, 2], [0, 2])]).all()
