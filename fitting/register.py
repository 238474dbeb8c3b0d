"""By how much a picture has moved between frames: phase correlation (Kuglin and Hines 1975) of what is coarse.

Only phases are compared, so neither how bright a picture is matters nor, much, that its parts fade at different rates.
Fine detail is left out: in a faint frame it is noise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft

Array = NDArray[np.float64]

_LEAST_RESPONSE = 0.4
"""The correlation's peak, as a share of that of two equal pictures, below which a picture is not recognised."""

_LEAST_SIDE, _LARGEST_SIDE = 32, 512
"""Of a picture in which a move can be told; and of what is worth looking at."""

_COARSE = 0.12
"""Standard deviation of the low pass, in cycles a value."""


class Register:
    """Compares pictures with a first one.

    Args:
        first: (h, w) brightness. What has fewer than 32 values a side is taken to be still.
    """

    def __init__(self, first: NDArray[np.generic]) -> None:
        self._bin = max(1, -(-max(first.shape) // _LARGEST_SIDE))
        h, w = self._shape = (first.shape[0] // self._bin, first.shape[1] // self._bin)
        self._tells = min(h, w) >= _LEAST_SIDE
        self._window = np.outer(np.hanning(h), np.hanning(w))
        frequency2 = fft.fftfreq(h)[:, None] ** 2 + fft.rfftfreq(w) ** 2
        self._weight = np.exp(-frequency2 / (2 * _COARSE**2))
        self._largest = float(fft.irfft2(self._weight, s=self._shape)[0, 0])
        self._first = self._spectrum(first)

    def shift(self, picture: NDArray[np.generic]) -> tuple[float, float] | None:
        """Return by how much (down, right) `picture` lies from the first; None where it is not recognised.

        >>> first = np.zeros((64, 80)); first[20:40, 30:50] = 1.0
        >>> tuple(round(d) for d in Register(first).shift(0.1 * np.roll(first, (3, -2), (0, 1))))
        (3, -2)
        """
        if not self._tells:
            return 0.0, 0.0
        cross = self._first.conj() * self._spectrum(picture)
        size = np.abs(cross)
        phases = np.divide(cross, size, out=np.zeros_like(cross), where=size > 0)
        correlation = fft.irfft2(phases * self._weight, s=self._shape)
        peak = np.unravel_index(int(correlation.argmax()), correlation.shape)
        if correlation[peak] < _LEAST_RESPONSE * self._largest:
            return None
        y, x = map(int, peak)
        down, right = self._between(correlation, y, x), self._between(correlation.T, x, y)
        return down * self._bin, right * self._bin

    def _spectrum(self, picture: NDArray[np.generic]) -> NDArray[np.complex128]:
        (h, w), b = self._shape, self._bin
        cells = np.asarray(picture[: h * b, : w * b], np.float64).reshape(h, b, w, b).mean(axis=(1, 3))
        return np.asarray(fft.rfft2((cells - cells.mean()) * self._window))

    @staticmethod
    def _between(along: Array, k: int, other: int) -> float:
        """The place of the peak at row `k` of a column, by a parabola; counted from 0 both ways."""
        n = along.shape[0]
        a, b, c = (float(along[(k + d) % n, other]) for d in (-1, 0, 1))
        bend = a - 2 * b + c
        place = k + (0.5 * (a - c) / bend if bend < 0 else 0.0)
        return place - n if place > n / 2 else place
