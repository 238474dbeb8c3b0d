"""Decays of single pixels."""

from dataclasses import replace

import numpy as np
import pytest

from phoslab.fitting.decay import fit_decay
from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.pixel_decay import Flag, PixelNoise, PixelProblem, fit_pixels

T = np.arange(37) * 5.0
COLOUR = np.array([1.0, 0.6, 0.25])
SIGMA = 0.002


def curve(kr, amplitude, exposure_s=0.0):
    """(n, 3) noise-free, its exposure averaged by a fine sum that knows nothing of the fit's formula."""
    inside = (np.arange(2000) + 0.5) / 2000 * exposure_s
    light = sum(
        a * np.exp(-k * (T[:, None] + inside)).mean(axis=1) for k, a in zip(kr, amplitude, strict=True)
    )
    return light[:, None] * COLOUR


def problem(typical, sigma=SIGMA, n_states=2, exposure_s=0.0, **noise):
    floor = np.full(typical.shape, sigma**2)
    law = PixelNoise(**{"floor": floor, "gain": np.zeros_like(floor), **noise})
    return PixelProblem(T, np.full(T.size, exposure_s), law, typical, n_states, (0.1 / 180, 0.6))


def drawn(clean, n, sigma=SIGMA, seed=0):
    """(n, frames, 3) float32, as they come from a camera."""
    return (clean + np.random.default_rng(seed).normal(0, sigma, (n, *clean.shape))).astype(np.float32)


TRUTH = curve([0.132, 0.009], [0.7, 0.3])


@pytest.fixture(scope="module")
def thousand():
    return fit_pixels(problem(TRUTH), drawn(TRUTH, 2000))


def test_both_rates_are_within_10_percent_in_every_pixel_without_a_guess(thousand):
    assert (np.abs(thousand.kr_per_s / [0.132, 0.009] - 1) < 0.1).all()
    # Chance alone widens the errors of 1 pixel in 1,000.
    assert (thousand.flags & ~np.uint8(Flag.MISFIT) == 0).all()
    assert np.count_nonzero(thousand.flags) < 12


def test_scatter_is_that_of_the_cramer_rao_bound(thousand):
    kr, amplitude = np.array([0.132, 0.009]), np.array([0.7, 0.3])
    g = np.exp(-T[:, None] * kr)
    J = np.zeros((3, T.size, 6))
    J[:, :, :2] = COLOUR[:, None, None] * amplitude * -T[:, None] * kr * g
    J[:, :, 2:4] = COLOUR[:, None, None] * g
    J[1, :, 4] = J[2, :, 5] = g @ amplitude  # a colour of its own
    J = J.reshape(-1, 6) / SIGMA
    bound = np.sqrt(np.diag(np.linalg.inv(J.T @ J))[:2])
    # The standard deviation of 2,000 draws scatters by 1/sqrt(4,000) = 1.6 %.
    assert np.log(thousand.kr_per_s.astype(float)).std(axis=0) / bound == pytest.approx([1, 1], abs=0.05)


def test_standard_errors_are_the_scatter_also_of_amplitudes(thousand):
    z = (thousand.kr_per_s - [0.132, 0.009]) / thousand.kr_error
    assert z.std(axis=0) == pytest.approx([1, 1], abs=0.05)
    z = (thousand.amplitude - [0.7, 0.3]) / thousand.amplitude_error
    assert z.std(axis=0) == pytest.approx([1, 1], abs=0.05)


def test_amplitudes_know_their_height_from_the_reference_channel_alone():
    """With one state the height is half of the error; the other channels, whose colour is free, say nothing of it."""
    clean = curve([0.05], [1.0])
    fits = fit_pixels(problem(clean, n_states=1), drawn(clean, 4000))
    z = (fits.amplitude[:, 0].astype(float) - 1.0) / fits.amplitude_error[:, 0]
    # If all channels told it, z would scatter by 1.10; 4,000 draws tell a standard deviation to 1.1 %.
    assert z.std() == pytest.approx(1, abs=0.045)


@pytest.mark.parametrize("n_states", [1, 2, 3])
def test_a_pixel_is_fitted_as_a_sample_is(n_states):
    """The same minimum as the fit of a whole session finds, which searches all parameters at once."""
    clean = curve([0.3, 0.1, 0.03][:n_states], [0.4, 0.3, 0.3][:n_states])
    y = drawn(clean, 5, sigma=0.0005)
    fits = fit_pixels(problem(clean, 0.0005, n_states), y)
    for values, kr, error in zip(y.astype(float), fits.kr_per_s, fits.kr_error, strict=True):
        whole = fit_decay(DecayData(T, np.zeros(37), values, np.full(values.shape, 0.0005)), n_states)
        # The colour is not refined here; it is off by 1e-4, and what that does to weights is of second order.
        assert (np.abs(kr - whole.kr_per_s) < 0.02 * error).all()


def test_exposure_time_is_integrated():
    clean = curve([0.5, 0.01], [0.7, 0.3], exposure_s=4.0)
    fits = fit_pixels(problem(clean, 1e-6, exposure_s=4.0), clean[None].astype(np.float32))
    # float32 data are off by 6e-8, times the condition of two well separated rates, some tens.
    assert fits.kr_per_s[0] == pytest.approx([0.5, 0.01], rel=1e-5)
    ignored = fit_pixels(problem(clean, 1e-6), clean[None].astype(np.float32))
    assert fits.amplitude[0, 0] > 1.5 * ignored.amplitude[0, 0]


def test_weights_come_from_the_model_and_not_from_what_fell_low():
    """400 electrons at the peak of the strongest channel: no bias beyond what 4,000 pixels can show."""
    peak = 400.0
    rng = np.random.default_rng(1)
    clean = TRUTH * peak
    y = rng.poisson(np.broadcast_to(clean, (4000, *clean.shape))).astype(np.float32)
    read = 1.0
    y += rng.normal(0, read, y.shape).astype(np.float32)
    one = fit_pixels(problem(clean, read, 1, gain=np.ones_like(clean)), y)
    of_mean = fit_pixels(problem(clean, read, 1, gain=np.ones_like(clean)), clean[None].astype(np.float32))
    off = one.kr_per_s[:, 0].astype(float) / of_mean.kr_per_s[0, 0] - 1
    # Standard error of the mean, three times, and the curvature of a rate in its data: half its variance.
    assert abs(off.mean()) < 3 * off.std() / np.sqrt(off.size) + off.var()


def test_a_value_left_out_does_not_matter_and_is_said():
    y = drawn(TRUTH, 3)
    y[0, 3, 1] = y[1, :2] = np.nan
    fits = fit_pixels(problem(TRUTH), y)
    assert (fits.flags & Flag.CLIPPED > 0).tolist() == [True, True, False]
    alone = fit_decay(
        DecayData(
            T, np.zeros(37), np.nan_to_num(y[1].astype(float)), np.where(np.isnan(y[1]), np.inf, SIGMA)
        ),
        2,
    )
    assert (np.abs(fits.kr_per_s[1] - alone.kr_per_s) < 0.02 * fits.kr_error[1]).all()


def test_a_frame_s_own_error_is_shared_by_channels():
    """Repeatability adds to the common series: three channels know the rate no better than one."""
    clean = curve([0.03], [1.0])
    known = problem(clean, 1e-5, 1, repeatability=0.01)
    three = fit_pixels(known, clean[None].astype(np.float32))
    law = PixelNoise(known.noise.floor[:, :1], known.noise.gain[:, :1], 0.01)
    one = fit_pixels(replace(known, noise=law, typical=clean[:, :1]), clean[None, :, :1].astype(np.float32))
    assert three.kr_error[0] == pytest.approx(one.kr_error[0], rel=1e-2)


def test_a_dark_pixel_is_said_to_be_dark_and_has_no_numbers():
    y = drawn(TRUTH * 0.002, 50)
    y[0] = np.nan
    fits = fit_pixels(problem(TRUTH), y)
    assert (fits.flags & Flag.DARK > 0).all()
    assert (fits.kr_per_s == 0).all()


def test_a_pixel_with_one_rate_gets_fewer_states_or_two_with_light():
    fits = fit_pixels(problem(TRUTH), drawn(curve([0.03], [1.0]), 300, seed=3))
    fewer = fits.flags & Flag.FEWER > 0
    assert 0.2 < fewer.mean() < 1  # half of all noise asks for a second state of negative light
    assert (fits.amplitude[fewer, 1] == 0).all()
    assert fits.kr_per_s[fewer, 0] == pytest.approx(0.03, rel=0.02)
    assert (fits.amplitude[~fewer] > 0).all()


def test_a_start_from_the_whole_image_changes_no_result(thousand):
    near = replace(problem(TRUTH), near_per_s=np.array([0.132, 0.009]))
    again = fit_pixels(near, drawn(TRUTH, 2000), threads=1)
    assert (np.abs(again.kr_per_s - thousand.kr_per_s) < 0.01 * thousand.kr_error).all()
