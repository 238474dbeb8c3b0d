"""Where the sample lies in a frame: found in the picture, never trusted to be at known pixels."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.raw import Preview

# The border of the sample is blurred by the lens and shaded by its own edge: this share of its radius is left out.
_RIM = 0.15
_SMALLEST_AREA_BINS = 50
_CLEAR_BINS = 4.0
# A glow that stands less than this many times the background's spread above it cannot be outlined.
_CONTRAST = 6.0


def find_sample(preview: Preview) -> NDArray[np.bool_]:
    """Return (h, w) the pixels of the glowing sample: the largest bright area, less its rim.

    Args:
        preview: the brightest frame of the series.

    Raises:
        PhoslabError: nothing in the frame stands out.
    """
    blob = _blob(preview)
    depth = cv2.distanceTransform(np.pad(blob, 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
    return preview.full_mask(depth > max(1.0, _RIM * float(depth.max())))


def surroundings(preview: Preview) -> NDArray[np.bool_] | None:
    """Return (h, w) the pixels well off the sample, where only scattered light is seen; None if there are too few.

    Raises:
        PhoslabError: as `find_sample`.
    """
    away = cv2.distanceTransform(1 - _blob(preview), cv2.DIST_L2, 5)
    # The lens's blur, some bins of it, is not what it scatters over all of the frame.
    outside = away > _CLEAR_BINS
    return preview.full_mask(outside) if outside.sum() >= _SMALLEST_AREA_BINS else None


def _blob(preview: Preview) -> NDArray[np.uint8]:
    """The largest bright area, in bins."""
    # Each channel by its own noise: a channel without light must not drown the others.
    level = preview.image - np.median(preview.image, axis=(0, 1))
    grey = cv2.GaussianBlur((level / (level.std(axis=(0, 1)) + 1e-12)).sum(axis=2), (0, 0), sigmaX=1.5)
    scaled = cv2.normalize(grey, np.empty_like(grey), 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    _, bright = cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    n, labels, stats, _ = cv2.connectedComponentsWithStats(bright, connectivity=4)
    areas = stats[1:n, cv2.CC_STAT_AREA]
    if not areas.size or areas.max() < _SMALLEST_AREA_BINS:
        raise _nothing(preview)
    blob = (labels == 1 + int(np.argmax(areas))).astype(np.uint8)
    outside = grey[bright == 0]
    if not outside.size or grey[blob > 0].mean() - outside.mean() < _CONTRAST * outside.std():
        raise _nothing(preview)
    return np.asarray(blob, dtype=np.uint8)


def _nothing(preview: Preview) -> PhoslabError:
    return PhoslabError(
        "shows no sample that stands out from the dark",
        file=preview.path,
        remedy="Check that the sample glows, fills part of the frame and is exposed long enough.",
    )
