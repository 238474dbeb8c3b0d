"""The grey card in a frame: where it lies, and how unevenly it shows.

A frame is darker towards its corners (vignetting), and a lamp does not light all of a card alike. What a card shows is
the product of both, and smooth: a polynomial of the fourth degree over the frame follows it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.raw import Preview

Array = NDArray[np.float64]

_RIM = 0.08
"""Share of the card, from its edges to its middle, that is left out: the lens blurs the edges."""

_SMALLEST = 0.02
"""Share of the frame below which a bright area is no card."""

_DEGREE = 4


@dataclass(frozen=True, eq=False)
class Card:
    """A card in a frame.

    Args:
        corners_px: (4, 2) columns and rows of its corners, in order around it.
        shape: (h, w) of the frame.
    """

    corners_px: Array
    shape: tuple[int, int]

    def mask(self, rim: float = _RIM) -> NDArray[np.bool_]:
        """(h, w) the pixels of the card, less a rim."""
        middle = self.corners_px.mean(axis=0)
        inner = middle + (1 - rim) * (self.corners_px - middle)
        drawn = np.zeros(self.shape, np.uint8)
        cv2.fillConvexPoly(drawn, np.round(inner).astype(np.int32), 1)
        return drawn.astype(bool)


def find_card(preview: Preview) -> Card:
    """Find the card: the largest bright area, as a quadrilateral, however it is turned and seen.

    Raises:
        PhoslabError: nothing stands out.
    """
    level = preview.image.sum(axis=2)
    scaled = cv2.normalize(level, np.empty_like(level), 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    smooth = cv2.GaussianBlur(scaled, (0, 0), sigmaX=1.0)
    _, bright = cv2.threshold(smooth, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    contours, _ = cv2.findContours(bright, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    largest = max(contours, key=cv2.contourArea, default=None)
    if largest is None or cv2.contourArea(largest) < _SMALLEST * bright.size:
        raise PhoslabError(
            "shows no grey card that stands out from what surrounds it",
            file=preview.path,
            remedy="Put the card under the lamp, large in the frame, and expose it well.",
        )
    hull = cv2.convexHull(largest)
    corners = _four_corners(np.asarray(hull, dtype=np.int32))
    # From bins, whose middles are counted, to pixels.
    return Card((corners + 0.5) * preview.bin, preview.shape)


def _four_corners(hull: NDArray[np.int32]) -> Array:
    """(4, 2) a quadrilateral around a hull: its own corners if it has four, else the smallest rectangle."""
    length = cv2.arcLength(hull, True)
    for share in (0.02, 0.03, 0.05, 0.08):
        found = cv2.approxPolyDP(hull, share * length, True)
        if len(found) == 4:
            return np.asarray(found[:, 0, :], dtype=np.float64)
    return np.asarray(cv2.boxPoints(cv2.minAreaRect(hull)), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Shading:
    """How bright an even surface shows at each place of a frame, 1 in its middle.

    Args:
        shape: (h, w) of the frame.
        coefficients: of x^i y^j with i + j <= 4, in the order of `_powers`; x and y are -1..1 from edge to edge of the
            frame's longer side. The first is 1.
        misfit: root mean square of what the polynomial misses, as a share.
    """

    shape: tuple[int, int]
    coefficients: Array
    misfit: float

    def at(self, row: Array, column: Array) -> Array:
        """Values at pixels; 0.1 at least, where a polynomial has gone astray beyond the card."""
        x, y = _normalised(np.asarray(row, float), np.asarray(column, float), self.shape)
        total = sum(c * x**i * y**j for c, (i, j) in zip(self.coefficients, _powers(), strict=True))
        return np.maximum(np.asarray(total, dtype=np.float64), 0.1)

    def mean(self, region: NDArray[np.bool_]) -> float:
        """Mean over the pixels of a region (h, w)."""
        row, column = np.nonzero(region)
        return float(self.at(row.astype(float), column.astype(float)).mean())


def _powers() -> list[tuple[int, int]]:
    return [(i, n - i) for n in range(_DEGREE + 1) for i in range(n + 1)]


def _normalised(row: Array, column: Array, shape: tuple[int, int]) -> tuple[Array, Array]:
    half = max(shape) / 2
    return (column + 0.5 - shape[1] / 2) / half, (row + 0.5 - shape[0] / 2) / half


def fit_shading(image: Array, preview: Preview, card: Card) -> Shading:
    """Fit the polynomial to what a card shows.

    Args:
        image: (h', w', 3) linear signal of the preview's bins, dark frames taken off.
        preview: which bins those are.
        card: where it lies.
    """
    side = preview.bin
    rows, columns = (np.arange(n) * side + (side - 1) / 2 for n in image.shape[:2])
    r, c = np.meshgrid(rows, columns, indexing="ij")
    inside = card.mask()[r.astype(int), c.astype(int)] & ~preview.saturated
    # Each colour by its own mean: shading has no colour, and all three tell of it.
    level = (image / image[inside].mean(axis=0)).mean(axis=2)[inside]
    x, y = _normalised(r[inside], c[inside], preview.shape)
    A = np.stack([x**i * y**j for i, j in _powers()], axis=1)
    solved = np.linalg.lstsq(A, level, rcond=None)[0]
    misfit = float(np.sqrt(np.mean((A @ solved - level) ** 2)) / solved[0])
    return Shading(preview.shape, solved / solved[0], misfit)
