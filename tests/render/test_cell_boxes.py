"""Boxes that are packed hold what they held, and let a cell stand for its parts no nearer than it may."""

from __future__ import annotations

import numpy as np
import pytest

from phoslab.render.cell_boxes import FARTHEST, NEXT_BITS, REACH, ROW, STEP, pack


@pytest.fixture
def cells():
    rng = np.random.default_rng(1)
    n = 3 * ROW // 2
    ends = np.sort(rng.uniform(-1, 1, (2, n, 3)), axis=0)
    ends[:, 0] = [[-1, -1, 0.5], [1, 1, 0.5]]
    return *ends, rng.integers(0, 1 << NEXT_BITS, n), rng.uniform(0, 5, n) ** 4


def unpack(packed):
    """Undo it, as the shader does."""
    words = packed.reshape(-1, 4)
    low, high = ((words[:, :3] >> shift & 0xFFFF) * STEP - REACH for shift in (0, 16))
    return low, high, words[:, 3] & (1 << NEXT_BITS) - 1, FARTHEST * ((words[:, 3] >> NEXT_BITS) / 255) ** 2


def test_boxes_hold_what_they_held_and_a_step_to_each_side_at_most(cells):
    packed = pack(*cells)
    assert packed.shape == (2, ROW, 4)
    low, high, after, _ = (a[: len(cells[0])] for a in unpack(packed))
    assert (low <= cells[0]).all()
    assert (high >= cells[1]).all()
    assert (cells[0] - low < STEP * (1 + 1e-9)).all()
    assert (high - cells[1] < STEP * (1 + 1e-9)).all()
    np.testing.assert_array_equal(after, cells[2])


def test_distances_are_never_shorter_and_those_of_none_stay_none(cells):
    """To a step of the square root; what lies beyond all distances in a scene is as far as that."""
    far = cells[3]
    got = unpack(pack(*cells))[3][: len(far)]
    wanted = np.minimum(far, FARTHEST)
    assert (got >= wanted - 1e-12).all()
    assert (np.sqrt(got) - np.sqrt(wanted) <= np.sqrt(FARTHEST) / 255 + 1e-12).all()
    assert (unpack(pack(*cells[:3], np.full_like(far, -1.0)))[3] == 0).all()
    assert (unpack(pack(*cells[:3], np.full_like(far, 1e-12)))[3][: len(far)] > 0).all()


def test_more_cells_than_can_be_counted_are_refused(refuses):
    n = 1 << NEXT_BITS
    none = np.broadcast_to(0.0, (n, 3))
    assert "16,777,215" in refuses(pack, none, none, np.broadcast_to(0, n), none[:, 0])
