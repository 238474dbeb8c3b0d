"""Sums of exponentials with one colour."""

from dataclasses import replace

import numpy as np
import pytest

from phoslab.errors import PhoslabError
from phoslab.fitting.decay import fit_decay
from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.holdout import hold_out
from phoslab.fitting.selection import select

T = np.arange(37) * 5.0
COLOUR = np.array([1.0, 0.6, 0.25])


def decay(kr, amplitude, sigma=0.002, seed=0, exposure_s=0.0) -> DecayData:
    """A noisy decay, its exposure averaged by a fine sum that knows nothing of the fit's formula."""
    rng = np.random.default_rng(seed)
    inside = np.linspace(0, exposure_s, 2001)
    inside = (inside[1:] + inside[:-1]) / 2 if exposure_s else np.zeros(1)
    light = sum(
        a * np.exp(-k * (T[:, None] + inside)).mean(axis=1) for k, a in zip(kr, amplitude, strict=True)
    )
    signal = light[:, None] * COLOUR
    noise = rng.normal(0, sigma, signal.shape) if sigma else 0.0
    return DecayData(T, np.full(37, exposure_s), signal + noise, np.full(signal.shape, sigma or 1e-6))


def test_noise_free_rates_come_back_to_the_last_digits_without_a_guess():
    fit = fit_decay(decay([0.3, 0.1, 0.03], [0.4, 0.3, 0.3], sigma=0), 3)
    # Float64 rounding of the data (1e-16) times the problem's condition: |d log kr / d data| is about 1e4 here.
    assert fit.kr_per_s == pytest.approx([0.3, 0.1, 0.03], rel=1e-11)
    assert fit.strength == pytest.approx([0.4, 0.3, 0.3], rel=1e-11)
    assert fit.colour == pytest.approx(COLOUR, rel=1e-12)


@pytest.mark.parametrize("seed", range(20))
def test_two_rates_are_found_within_their_errors_and_two_states_suffice(seed):
    data = decay([0.132, 0.009], [0.7, 0.3], seed=seed)
    fit = fit_decay(data, 2)
    z = (fit.kr_per_s - [0.132, 0.009]) / fit.kr_standard_error
    assert np.abs(z).max() < 5  # 40 draws of a normal: beyond 5 sigma once in 40,000 runs of this test
    one = fit_decay(data, 1)
    assert fit.aicc < one.aicc


def test_standard_errors_are_the_scatter_of_repeated_measurements():
    fits = [fit_decay(decay([0.132, 0.009], [0.7, 0.3], seed=100 + s), 2) for s in range(60)]
    z = np.array([(f.kr_per_s - [0.132, 0.009]) / f.kr_standard_error for f in fits])
    # The standard deviation of 60 draws scatters by 1/sqrt(2*59) = 9 %; chi2/dof > 1 widens the error in half of them.
    assert z.std(axis=0) == pytest.approx([1, 1], abs=0.3)


def test_exposure_time_is_integrated():
    data = decay([0.5, 0.01], [0.7, 0.3], sigma=0, exposure_s=4.0)
    # The sum over 2000 midpoints errs by (k h)²/24 = 4e-8, times the condition of two well separated rates.
    assert fit_decay(data, 2).kr_per_s == pytest.approx([0.5, 0.01], rel=1e-6)
    ignored = fit_decay(replace(data, exposure_s=np.zeros(37)), 2)
    assert fit_decay(data, 2).strength[0] > 1.5 * ignored.strength[0]


def test_states_come_fast_to_slow_with_their_own_amplitudes_and_errors():
    fit = fit_decay(decay([0.009, 0.132], [0.3, 0.7]), 2)
    assert fit.kr_per_s[0] > fit.kr_per_s[1]
    assert fit.strength[0] > fit.strength[1]
    assert fit.kr_standard_error[0] > fit.kr_standard_error[1]


def test_a_value_left_out_does_not_matter():
    data = decay([0.132, 0.009], [0.7, 0.3])
    spoilt, sigma = data.signal.copy(), data.sigma.copy()
    spoilt[3, 1], sigma[3, 1] = np.nan, np.inf
    fit = fit_decay(replace(data, signal=spoilt, sigma=sigma), 2)
    spoilt[3, 1] = 1e9
    assert fit_decay(replace(data, signal=spoilt, sigma=sigma), 2).kr_per_s.tolist() == fit.kr_per_s.tolist()
    assert fit.dof == fit_decay(data, 2).dof - 1
    assert fit.residual[3, 1] == 0


def test_whitening_is_the_inverse_root_of_a_frame_s_covariance():
    data = replace(decay([0.1], [1.0], sigma=0.01), repeatability=0.05)
    W = data.whitening()
    for frame in (0, 20):
        s = data.signal[frame]
        covariance = np.diag(data.sigma[frame] ** 2) + 0.05**2 * np.outer(s, s)
        assert W[frame] @ covariance @ W[frame].T == pytest.approx(np.eye(3), abs=1e-12)


def test_errors_that_channels_share_do_not_average_out():
    alone = replace(decay([0.03], [1.0], sigma=1e-6), repeatability=0.01)
    three = fit_decay(alone, 1)
    one = fit_decay(replace(alone, signal=alone.signal[:, :1], sigma=alone.sigma[:, :1]), 1)
    assert three.kr_standard_error == pytest.approx(one.kr_standard_error, rel=1e-3)


def test_a_channel_without_light_is_no_obstacle():
    data = decay([0.1], [1.0])
    dark = data.signal.copy()
    dark[:, 2] = np.random.default_rng(1).normal(0, 0.002, 37)
    fit = fit_decay(replace(data, signal=dark), 1)
    assert fit.kr_per_s == pytest.approx([0.1], rel=0.02)
    assert abs(fit.colour[2]) < 0.01


def test_more_states_than_there_are_are_seen_to_be_degenerate_or_dearer():
    data = decay([0.03], [1.0])
    assert select(data, rank_one=True).chosen.n_states == 1


def test_too_few_values_are_refused():
    data = decay([0.1], [1.0]).take(slice(0, 1))
    with pytest.raises(PhoslabError, match="too few"):
        fit_decay(data, 1)


def test_hold_out_reports_the_true_misfit_of_too_few_states():
    data = decay([0.132, 0.009], [0.7, 0.3], sigma=1e-6)
    one, two, *_ = hold_out(data)
    assert not one.automatic
    assert two.worst < 1e-4
    fit = fit_decay(data.take(slice(0, None, 2)), 1)
    odd = slice(1, None, 2)
    miss = np.abs(fit.predict(T[odd], np.zeros(18)) / data.signal[odd] - 1).max()
    assert one.worst == pytest.approx(miss, rel=1e-3)
