"""Where the linear variable filter lies in a frame: its direction and long edges, found by OpenCV, never trusted.

Its short edges cannot be found: no light that a camera sees passes there. Places along the strip are therefore counted
from the frame's middle, and what a hand has moved between two sessions is found from the colours (`spectrum.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.raw import Preview
from phoslab.strip import Strip

Array = NDArray[np.float64]

_CONTRAST = 8.0
"""Standard deviations of the dark that a column must stand above it for its edges to count."""

_LIT = 0.01
"""Share of the brightest column from which on a column counts as lit."""

_SLIM = 2.0
"""What is not at least this many times as long as wide is no strip."""

_COLUMNS = 12


def find_strip(preview: Preview) -> Strip:
    """Find the strip in a frame whose light passes along most of it, as a white LED's does.

    Raises:
        PhoslabError: nothing long and straight stands out.
    """
    level = preview.image - np.median(preview.image, axis=(0, 1))
    grey = np.maximum(level, 0.0).sum(axis=2).astype(np.float32)
    scaled = cv2.normalize(np.sqrt(grey), np.empty_like(grey), 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    smooth = cv2.GaussianBlur(scaled, (0, 0), sigmaX=1.0)
    _, bright = cv2.threshold(smooth, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    # A line spectrum leaves gaps along the strip: what is bright anywhere belongs to one strip.
    points = cv2.findNonZero(_large(bright))
    if points is None or len(points) < 2 * _COLUMNS:
        raise _nothing(preview)
    (_, _), (w, h), angle = cv2.minAreaRect(points)
    if w < h:
        angle -= 90.0
    if max(w, h) < _SLIM * min(w, h):
        raise _nothing(preview)
    angle = (angle + 90.0) % 180.0 - 90.0
    x, top, bottom, lit = _edges(grey, angle)
    if x.size < _COLUMNS:
        raise _nothing(preview)
    upper, lower = _line(x, top), _line(x, bottom)
    # Once more along the edges themselves: the rectangle around a strip of few pixels is a degree off.
    turn = float(np.rad2deg(np.arctan((upper[1] + lower[1]) / 2)))
    x, top, bottom, lit = _edges(grey, angle + turn)
    if x.size < _COLUMNS:
        raise _nothing(preview)
    side = preview.bin
    # The preview may lack a rim of pixels that fill no bin: its middle is not the frame's.
    a = np.deg2rad(angle + turn)
    dx = (grey.shape[1] * side - preview.shape[1]) / 2
    dy = (grey.shape[0] * side - preview.shape[0]) / 2
    along, across = dx * np.cos(a) + dy * np.sin(a), dy * np.cos(a) - dx * np.sin(a)

    def in_pixels(line: tuple[float, float]) -> tuple[float, float]:
        return line[0] * side - line[1] * along + across, line[1]

    return Strip(
        shape=preview.shape,
        angle_deg=float(angle + turn),
        top=in_pixels(_line(x, top)),
        bottom=in_pixels(_line(x, bottom)),
        slant=0.0,
        ends_px=(float(lit[0] * side + along), float(lit[1] * side + along)),
    )


def follow_strip(preview: Preview, known: Strip) -> tuple[Strip, bool]:
    """Find a strip again that was calibrated, in a frame in which only part of it may be lit.

    Returns:
        The strip with the known nodes and slant, and whether its edges were found; if not, the known ones are taken.

    Raises:
        PhoslabError: the frame has another size, or the strip lies elsewhere: by more than a tenth of its width or
            2 degrees.
    """
    if preview.shape != known.shape:
        raise PhoslabError(
            f"has {preview.shape[0]} x {preview.shape[1]} pixels where the calibration has "
            f"{known.shape[0]} x {known.shape[1]}",
            file=preview.path,
            remedy="Measure and calibrate with the same camera at the same picture size.",
        )
    try:
        found = find_strip(preview)
    except PhoslabError:
        return known, False
    turned = (found.angle_deg - known.angle_deg + 90) % 180 - 90
    middle = sum(found.ends_px) / 2
    moved = [
        abs(a[0] + a[1] * middle - b[0] - b[1] * middle)
        for a, b in ((found.top, known.top), (found.bottom, known.bottom))
    ]
    if abs(turned) > 2.0 or max(moved) > 0.1 * known.width_px:
        raise PhoslabError(
            f"shows the strip turned by {turned:.1f} degrees and moved by {max(moved):.0f} pixels "
            "against the calibration",
            file=preview.path,
            remedy="Calibrate anew: wavelengths belong to places in the frame, so camera and filter must stay.",
        )
    return replace(found, slant=known.slant, ends_px=known.ends_px), True


def outline_unseen(sessions: Sequence[str]) -> str:
    """Say that the strip's outline was not found in these sessions' frames, as `follow_strip` tells."""
    return (
        f"Too little of the linear variable filter (the strip of glass before the camera) is bright in "
        f"{' and '.join(sessions)} to find its outline: it is taken to lie where it was calibrated, which holds as "
        "long as neither it nor the camera has been moved."
    )


def _large(bright: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Without specks: bright areas that are small against the largest."""
    n, labels, stats, _ = cv2.connectedComponentsWithStats(bright, connectivity=8)
    areas = stats[1:n, cv2.CC_STAT_AREA]
    if not areas.size:
        return bright
    keep = 1 + np.flatnonzero(areas >= max(6.0, 0.1 * areas.max()))
    return np.isin(labels, keep).astype(np.uint8)


def _edges(grey: NDArray[np.float32], angle_deg: float) -> tuple[Array, Array, Array, tuple[float, float]]:
    """Where the signal falls to half of its plateau, above and below, in columns along a direction.

    Returns:
        x (n,), and y of upper and lower edge (n,), in bins from the middle; and the ends in x of what is lit.
    """
    h, w = grey.shape
    half = int(np.ceil(np.hypot(h, w) / 2))
    a = np.deg2rad(angle_deg)
    # From rotated to picture coordinates, as warpAffine wants it with WARP_INVERSE_MAP.
    cos, sin = np.cos(a), np.sin(a)
    matrix = np.array(
        [
            [cos, -sin, (w - 1) / 2 - cos * half + sin * half],
            [sin, cos, (h - 1) / 2 - sin * half - cos * half],
        ]
    )
    turned = cv2.warpAffine(
        grey, matrix, (2 * half + 1, 2 * half + 1), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    ).astype(float)
    level = turned.max(axis=0)
    noise = float(np.median(np.abs(grey))) * 1.4826 + 1e-12
    row = int(np.argmax(turned.sum(axis=1)))
    lit = np.flatnonzero(turned[row] > max(_LIT * float(turned[row].max()), 3 * noise))
    xs, tops, bottoms = [], [], []
    for x in np.flatnonzero(level > max(_CONTRAST * noise, _LIT * level.max())):
        column = turned[:, x]
        middle = float(np.median(column[max(0, row - 2) : row + 3]))
        above = np.flatnonzero(column[:row] < middle / 2)
        below = np.flatnonzero(column[row:] < middle / 2)
        if middle < _CONTRAST * noise or not above.size or not below.size:
            continue
        i, j = above[-1], row + below[0]
        xs.append(x - half)
        tops.append(i + (middle / 2 - column[i]) / (column[i + 1] - column[i]) - half)
        bottoms.append(j - (middle / 2 - column[j]) / (column[j - 1] - column[j]) - half)
    ends = (float(lit[0] - half), float(lit[-1] - half)) if lit.size else (0.0, 0.0)
    return np.array(xs, float), np.array(tops), np.array(bottoms), ends


def _line(x: Array, y: Array) -> tuple[float, float]:
    """Offset and slope of a line that does not heed outliers (Theil-Sen)."""
    i, j = np.triu_indices(x.size, 1)
    slope = float(np.median((y[j] - y[i]) / (x[j] - x[i])))
    return float(np.median(y - slope * x)), slope


def _nothing(preview: Preview) -> PhoslabError:
    return PhoslabError(
        "shows no long, straight strip that stands out from the dark",
        file=preview.path,
        remedy="Check that the filter lies before the camera, in focus, with a light behind it that is exposed well.",
    )
