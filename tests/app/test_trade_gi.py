"""How the trade of glow transport measures error."""

from __future__ import annotations

import numpy as np
import pytest

from phoslab.app.trades.gi import relative_error


def test_the_noise_of_the_truth_is_no_error():
    """Two truths, each off by σ = 3 % from pixel to pixel. The product has mean 0, and of 2e5 values a deviation of
    σ² / sqrt(2e5) = 2e-6, of which five are allowed; the noise in what it is divided by leaves as little (3/2 σ⁴), and
    2 % of an error of 0.01. Each truth alone would say σ²."""
    rng = np.random.default_rng(1)
    r = np.ones((256, 256, 3))
    one, two = (r + 0.03 * rng.normal(size=r.shape) for _ in range(2))
    assert relative_error(r, one, two) == pytest.approx(0.0, abs=1e-5)
    assert relative_error(1.1 * r, one, two) == pytest.approx(0.01, rel=0.04)
    assert relative_error(r, one, one) == pytest.approx(9e-4, rel=0.04)
