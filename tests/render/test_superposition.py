"""Light that is a sum of what was followed before is not followed again."""

from __future__ import annotations

import numpy as np
import pytest

from phoslab.render.superposition import MOST, Superposition


@pytest.fixture
def counted():
    """A map, its matrix, and what it was asked."""
    rng = np.random.default_rng(0)
    matrix, asked = rng.random((60, 60)), []

    def follow(sent):
        asked.append(sent)
        return (matrix @ sent.ravel()).reshape(sent.shape)

    return Superposition(follow), matrix, asked


def test_what_fades_at_three_rates_is_followed_as_often(counted):
    """Over six decades, at times as close as pictures of a film, in values that float32 rounds: that is 6e-8 of each,
    and 1e-6 of the length of all may be left over, which the map multiplies by no more than its norm."""
    sums, matrix, asked = counted
    parts = np.random.default_rng(1).random((3, 30, 2))
    for t in np.concatenate([np.arange(20) / 30, np.linspace(1, 40, 60)]):
        weights = np.exp(-np.array([0.3, 0.05, 0.35]) * t)
        sent = np.tensordot(weights, parts, 1).astype(np.float32).astype(np.float64)
        want = (matrix @ sent.ravel()).reshape(sent.shape)
        allowed = 1.01e-6 * np.linalg.norm(matrix, 2) * np.linalg.norm(sent)
        assert np.linalg.norm(sums.of(sent) - want) <= allowed
    # What rounding leaves of two that are nearly alike at first is a part, too.
    assert 3 <= len(asked) <= 6


def test_what_changes_each_time_is_followed_each_time_and_forgotten(counted):
    sums, matrix, asked = counted
    rng = np.random.default_rng(2)
    for n in range(1, 2 * MOST):
        sent = rng.random((30, 2))
        np.testing.assert_allclose(sums.of(sent).ravel(), matrix @ sent.ravel(), rtol=1e-9)
        assert len(asked) == n


def test_nothing_is_sent_where_nothing_is(counted):
    sums, _, asked = counted
    assert not sums.of(np.zeros((30, 2))).any()
    assert not asked
