"""Profile intervals: what the statistics of them cannot show (those are in test_table_fit)."""

from dataclasses import replace

import numpy as np
import pytest

from phoslab.fitting import decay_problem
from phoslab.fitting.decay import fit_decay
from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.intervals import _Profile, bootstrap_intervals


def test_the_search_for_an_end_that_is_not_there_comes_to_an_end():
    """Wherever the fit lies: best + (edge - best) need not be the edge, as it rounds."""
    t_s = np.arange(12.0)
    signal = np.exp(-0.3 * t_s)[:, None]
    data = DecayData(t_s, np.zeros(12), signal, np.full((12, 1), 1e-3), channels=("G",))
    fit = fit_decay(data, 1)
    stated = decay_problem.problem(data, 1, offset=False, rank_one=fit.rank_one)
    for best in np.random.default_rng(0).uniform(-2.0, 0.0, 200):
        theta = fit.theta.copy()
        theta[0] = best
        profile, asked = _Profile(replace(fit, theta=theta), stated, 0, 1.96), []

        def flat(value: float, asked: list[float] = asked) -> float:
            asked.append(value)
            assert len(asked) < 200
            return 0.0

        profile.rise = flat
        assert profile.end(-1) == -np.inf
        assert profile.end(1) == np.inf


def test_a_bootstrap_lets_the_channels_of_a_frame_err_together():
    """A camera that repeats its settings to 2 % errs in three channels as it does in one."""
    t_s = np.linspace(0.0, 60.0, 30)
    light = np.exp(-0.05 * t_s)[:, None] * np.array([1.0, 0.9, 0.8])
    data = DecayData(t_s, np.zeros(30), light, np.full(light.shape, 1e-5), repeatability=0.02)
    fit = fit_decay(data, 1)
    low, high = bootstrap_intervals(fit, 300, seed=0)[0]
    # Normal, so ± 1.96 standard errors; 300 draws know a quantile's distance to some 8 %. Errors of each channel's own
    # would make it 1.7 times too narrow.
    assert (high - low) / (2 * 1.96 * fit.kr_standard_error[0]) == pytest.approx(1.0, abs=0.2)
