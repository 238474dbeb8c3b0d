"""What lies under the bench's camera, and where: a plane in mm, seen a little askew.

Origin in the middle of the frame, x to the right, y down. Camera and objects stand as hands have put them: turned by
a degree or two, not quite square. Nothing here knows colours; it says which point of what each pixel sees.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_FINE = 3
"""Rays a pixel, each way."""

WIDTH_MM = 66.0
"""Of the field that a frame sees."""


@dataclass(frozen=True)
class Panel:
    """A flat rectangle.

    Args:
        x_mm, y_mm: its middle.
        width_mm, height_mm: its size.
        turn_deg: counter-clockwise as seen in the picture.
        round_mm: radius of its corners.
    """

    x_mm: float
    y_mm: float
    width_mm: float
    height_mm: float
    turn_deg: float
    round_mm: float = 0.0

    def across(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Position on it of points in the plane: 0..1 from left to right and from top to bottom, where it is."""
        a = np.deg2rad(self.turn_deg)
        dx, dy = x - self.x_mm, y - self.y_mm
        right = (dx * np.cos(a) - dy * np.sin(a)) / self.width_mm + 0.5
        down = (dx * np.sin(a) + dy * np.cos(a)) / self.height_mm + 0.5
        return right, down

    def covers(self, x: Array, y: Array) -> Array:
        """1 where it is, 0 elsewhere."""
        right, down = self.across(x, y)
        dx = np.maximum(np.abs(right - 0.5) * self.width_mm - self.width_mm / 2 + self.round_mm, 0)
        dy = np.maximum(np.abs(down - 0.5) * self.height_mm - self.height_mm / 2 + self.round_mm, 0)
        return np.asarray(np.hypot(dx, dy) <= max(self.round_mm, 1e-9), dtype=float)


SAMPLE = Panel(0.9, -0.6, 61.0, 37.0, 2.1, round_mm=9.0)
CARD = Panel(-0.4, 0.3, 63.0, 44.0, -1.4)
STRIP = Panel(0.6, 0.9, 57.0, 11.0, -1.7)


@dataclass(frozen=True, eq=False)
class View:
    """Where the rays of one frame go.

    Args:
        x_mm, y_mm: (h, w, rays) points of the plane.
    """

    x_mm: Array
    y_mm: Array

    @classmethod
    def of(cls, shape: tuple[int, int], *, angle_deg: float = 0.0, shift_mm: float = 0.0) -> View:
        """The view of a frame.

        Args:
            shape: (h, w).
            angle_deg: by which the plane is turned about its vertical axis, away from the camera.
            shift_mm: by which it is moved down.
        """
        x, y = _rays(shape)
        # What is turned away looks narrower; how much farther away its far side is, the lens hardly shows.
        return cls(x / np.cos(np.deg2rad(angle_deg)), y - shift_mm)

    def mean(self, values: Array) -> Array:
        """(h, w) mean of a pixel's rays (h, w, rays)."""
        return np.asarray(values.mean(axis=-1))


@cache
def _rays(shape: tuple[int, int]) -> tuple[Array, Array]:
    h, w = shape
    row = (np.arange(h * _FINE) + 0.5) / _FINE
    column = (np.arange(w * _FINE) + 0.5) / _FINE
    down, right = np.meshgrid((row - h / 2) / w, (column - w / 2) / w, indexing="ij")
    # From picture to plane: turned, and seen a little from above and from the left.
    a = np.deg2rad(0.8)
    depth = 1 + 0.035 * right - 0.05 * down
    x = WIDTH_MM * (right * np.cos(a) + down * np.sin(a)) / depth
    y = WIDTH_MM * (down * np.cos(a) - right * np.sin(a)) / depth

    def grouped(values: Array) -> Array:
        return values.reshape(h, _FINE, w, _FINE).transpose(0, 2, 1, 3).reshape(h, w, -1)

    return grouped(x), grouped(y)


def corners_px(panel: Panel, shape: tuple[int, int]) -> list[tuple[float, float]]:
    """Pixel coordinates (x, y) of a panel's corners in a frame (h, w): top left, top right, bottom right, bottom left.

    The corner of the first pixel is (0, 0), its middle (0.5, 0.5).
    """
    view = View.of(shape)
    x, y = (view.mean(v) for v in panel.across(view.x_mm, view.y_mm))
    h, w = shape
    rows, columns = np.mgrid[0:h, 0:w] + 0.5
    # Plane and picture differ by a projective map; over the frame a quadratic follows it to a hundredth of a pixel.
    terms = np.stack([np.ones_like(x), x, y, x * y, x**2, y**2], axis=-1).reshape(-1, 6)
    found = np.linalg.lstsq(terms, np.stack([columns.ravel(), rows.ravel()], axis=-1), rcond=None)[0]
    ends = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
    corners = [np.array([1, a, b, a * b, a**2, b**2]) @ found for a, b in ends]
    return [(round(float(px), 3), round(float(py), 3)) for px, py in corners]


def coating(x: Array, y: Array) -> Array:
    """Brightness of the paint: laid on by hand, thicker here and there by some percent."""
    return np.asarray(
        1
        + 0.04 * np.sin(0.11 * x + 0.7) * np.cos(0.16 * y)
        + 0.02 * np.sin(0.41 * x - 0.3 * y)
        + 0.0012 * x
        - 0.002 * y
    )


def lighting(x: Array, y: Array, light: str) -> Array:
    """Irradiance over the plane relative to its middle: each light hangs elsewhere."""
    at = {"lamp": (6.0, -4.0), "led": (-9.0, 3.0), "mercury": (2.0, 8.0)}[light]
    height_mm = 260.0
    squared = ((x - at[0]) ** 2 + (y - at[1]) ** 2) / height_mm**2
    middle = (at[0] ** 2 + at[1] ** 2) / height_mm**2
    # The inverse square and two cosines.
    return np.asarray(((1 + middle) / (1 + squared)) ** 2)
