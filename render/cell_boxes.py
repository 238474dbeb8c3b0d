"""The boxes around cells as a ray's walk reads them: 16 bytes each, half of what float32 would take.

A software rasterizer reads memory a number and a ray at a time, and the boxes are most of what a walk reads: packed, a
ray takes a fifth to a third less time. What is rounded is rounded outwards, so a box holds all that it held.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError

Array = NDArray[np.float64]

# As in shaders/include/cell_boxes.glsl: corners are whole steps from -REACH, of the cells' coordinates.
REACH = 1.0001
STEP = 2 * REACH / 65535
FARTHEST = 4.0  # of all distances: beyond two scenes
NEXT_BITS = 24
ROW = 1024  # boxes in a row of the texture


def pack(low: Array, high: Array, after: NDArray[np.intp], apart: Array) -> NDArray[np.uint32]:
    """Return (rows, ROW, 4) numbers: for each axis low and high corner; then `after` and, above it, the distance.

    Args:
        low, high: (n, 3) corners.
        after: (n,) the cell after each one's last descendant.
        apart: (n,) distance from which on a cell may stand for its parts; negative: anywhere.

    Raises:
        PhoslabError: there are more cells than `after` can count.
    """
    n = len(after)
    if n >= 1 << NEXT_BITS:
        raise PhoslabError(
            f"are {n:,}, and at most {(1 << NEXT_BITS) - 1:,} can be told apart",
            field="the cells of the scene",
            remedy="Give a larger --cell, or another --gi.",
        )
    packed = np.zeros((-(-n // ROW) * ROW, 4), dtype=np.uint32)
    first = np.clip(np.floor((low + REACH) / STEP), 0, 65535).astype(np.uint32)
    last = np.clip(np.ceil((high + REACH) / STEP), 0, 65535).astype(np.uint32)
    packed[:n, :3] = first | last << 16
    packed[:n, 3] = (
        after.astype(np.uint32) | np.where(apart < 0, 0, _root(apart)).astype(np.uint32) << NEXT_BITS
    )
    return packed.reshape(-1, ROW, 4)


def box_middles(packed: NDArray[np.uint32]) -> Array:
    """Return (n, 3) the middles of packed boxes."""
    corners = packed.reshape(-1, 4)[:, :3]
    return ((corners & 0xFFFF) + (corners >> 16)) / 2 * STEP - REACH


def packed_distance(distance: Array) -> Array:
    """Return what a distance is after packing: no less, and at most `FARTHEST`."""
    packed: Array = FARTHEST * (_root(distance) / 255) ** 2
    return packed


def _root(distance: Array) -> Array:
    """Return what is packed: of the square root, so that near ones are told apart the better."""
    root: Array = np.ceil(255 * np.sqrt(np.clip(distance, 0.0, FARTHEST) / FARTHEST)).clip(1, 255)
    return root
