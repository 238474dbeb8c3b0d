"""How bright a picture's directions take each cell to be: at what sends much, more of them are aimed.

Whatever is taken, the mean of what they meet is right; the better it fits, the less noise. What is bright when it goes
dark may not be what is bright later: phosphors fade at different rates. So half of the directions follow what cells
send then, a quarter follow it within each material, with all materials alike, and a quarter follow area alone: no
picture ever has less than that of what it would have without knowing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from phoslab.render.cells import Cells
from phoslab.render.gpu_scene import GpuDrawable

Array = NDArray[np.float64]

SENT, OF_MATERIAL = 1 / 2, 1 / 4


def brightness(cells: Cells, emitted: Array, drawables: Sequence[GpuDrawable]) -> Array:
    """Return (n,) what each cell is taken to send, of mean 1 over all that glows; 1 each where nothing does now.

    Args:
        emitted: (m, K) the radiance of the smallest cells.
        drawables: in the order in which the cells have them.
    """
    sent, expected = emitted.sum(axis=1), np.ones(len(emitted))
    material = _materials(cells, drawables)
    glows, area = material >= 0, cells.leaf_areas
    of, light = material[glows], (sent * area)[glows]
    total = float(light.sum())
    if total > 0.0:
        each = np.bincount(of, weights=light)
        alike = np.divide(each.sum() / np.count_nonzero(each), each, out=np.zeros_like(each), where=each > 0)
        shares = SENT + OF_MATERIAL * alike[of]
        expected[glows] = sent[glows] * shares * (area[glows].sum() / total) + (1.0 - SENT - OF_MATERIAL)
    return cells.averages(expected[:, None])[:, 0]


def _materials(cells: Cells, drawables: Sequence[GpuDrawable]) -> NDArray[np.intp]:
    """Return (m,) which material each of the smallest cells glows with; -1: none."""
    numbers: dict[int, int] = {}
    each = np.full(len(cells.leaf_areas), -1)
    for k, drawable in enumerate(drawables):
        phosphor = drawable.drawable.phosphor
        if phosphor is not None:
            number = numbers.setdefault(id(phosphor.material), len(numbers))
            each[cells.owners[k] : cells.owners[k + 1]] = number
    return each


def aim_rows(cells: Cells, expected: Array) -> NDArray[np.float32]:
    """Return (n, 3, 4) each cell's corners; beside the first what it is taken to send in all, beside the second of
    each of its areas."""
    rows = np.zeros((len(cells.skip), 3, 4), dtype=np.float32)
    rows[..., :3] = cells.corners
    a, b, c = cells.corners.transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    rows[:, 0, 3] = np.where(cells.is_triangle, area / 2, area) * expected
    rows[:, 1, 3] = expected
    return rows
