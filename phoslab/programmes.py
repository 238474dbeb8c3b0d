"""Light programmes: how the strength of a light runs over time, with its exact mean over any interval.

A programme is a factor on a light's irradiance. Where it is piecewise constant the rate equations have a closed
form between its changes; where it is not, its mean over a step is what a second-order step needs.

Times are in s and may be arrays; factors are dimensionless.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class Programme(Protocol):
    """A light's strength over time.

    Attributes:
        piecewise_constant: whether the factor is constant between its changes.
    """

    @property
    def piecewise_constant(self) -> bool: ...

    def at(self, t: ArrayLike) -> Array:
        """Return the factor at time t; at a jump, the value after it."""
        ...

    def integral(self, t: ArrayLike) -> Array:
        """Return the integral of the factor from 0 to t, in s."""
        ...

    def changes(self, start: float, stop: float) -> Array:
        """Return (n,) the times in (start, stop) at which the factor jumps, ascending."""
        ...


def mean(programme: Programme, start: ArrayLike, stop: ArrayLike) -> Array:
    """Return the mean factor over [start, stop], stop > start."""
    begin, end = np.asarray(start, dtype=np.float64), np.asarray(stop, dtype=np.float64)
    average: Array = (programme.integral(end) - programme.integral(begin)) / (end - begin)
    return average


@dataclass(frozen=True)
class Switched:
    """On (factor 1) in each interval, off between them.

    Args:
        intervals: (on, off) times in s, ascending and apart.
    """

    intervals: tuple[tuple[float, float], ...]

    piecewise_constant = True

    def at(self, t: ArrayLike) -> Array:
        """Return 1 while on, 0 while off."""
        t = np.asarray(t, dtype=np.float64)
        on = np.zeros(t.shape)
        for start, stop in self.intervals:
            on = np.where((start <= t) & (t < stop), 1.0, on)
        return on

    def integral(self, t: ArrayLike) -> Array:
        """Return the time spent on between 0 and t."""
        t = np.asarray(t, dtype=np.float64)
        spent = np.zeros(t.shape)
        for start, stop in self.intervals:
            spent = spent + np.clip(t, start, stop) - np.clip(0.0, start, stop)
        return spent

    def changes(self, start: float, stop: float) -> Array:
        """Return the switching times inside (start, stop)."""
        edges = np.array([edge for interval in self.intervals for edge in interval])
        return edges[(start < edges) & (edges < stop)]


ALWAYS_ON = Switched(((-np.inf, np.inf),))


@dataclass(frozen=True)
class Sine:
    """1 + depth sin(2π t / period): a light that swells and fades, never negative for depth <= 1."""

    period_s: float
    depth: float = 1.0

    piecewise_constant = False

    def at(self, t: ArrayLike) -> Array:
        """Return the factor at t."""
        return 1 + self.depth * np.sin(2 * np.pi * np.asarray(t, dtype=np.float64) / self.period_s)

    def integral(self, t: ArrayLike) -> Array:
        """Return the integral from 0 to t."""
        t = np.asarray(t, dtype=np.float64)
        omega = 2 * np.pi / self.period_s
        return t + self.depth * 2 * np.sin(omega * t / 2) ** 2 / omega

    def changes(self, start: float, stop: float) -> Array:
        """Return nothing: it never jumps."""
        return np.empty(0)


def mains_flicker(frequency_hz: float = 50.0, depth: float = 1.0) -> Sine:
    """Return the flicker of a lamp without smoothing: its power follows sin², at twice the mains frequency."""
    return Sine(period_s=1 / (2 * frequency_hz), depth=depth)


@dataclass(frozen=True)
class Strobe:
    """A flash of factor 1 / duty for the first `duty` of each period: mean factor 1."""

    period_s: float
    duty: float

    piecewise_constant = True

    def at(self, t: ArrayLike) -> Array:
        """Return 1 / duty in a flash, 0 between."""
        phase = np.mod(np.asarray(t, dtype=np.float64) / self.period_s, 1.0)
        return np.where(phase < self.duty, 1 / self.duty, 0.0)

    def integral(self, t: ArrayLike) -> Array:
        """Return the integral from 0 to t."""
        cycles = np.asarray(t, dtype=np.float64) / self.period_s
        whole = np.floor(cycles)
        return self.period_s * (whole + np.minimum((cycles - whole) / self.duty, 1.0))

    def changes(self, start: float, stop: float) -> Array:
        """Return the starts and ends of flashes inside (start, stop)."""
        whole = np.arange(np.floor(start / self.period_s) - 1, np.ceil(stop / self.period_s) + 1)
        edges = np.sort(np.concatenate([whole, whole + self.duty])) * self.period_s
        return edges[(start < edges) & (edges < stop)]


@dataclass(frozen=True, eq=False)
class Sweep:
    """A laser sheet that passes by: a Gaussian pulse in time, at another moment for each place.

    Args:
        passes_s: (...) when the sheet's middle passes each place.
        width_s: standard deviation of the pulse: the sheet's thickness over its speed.
    """

    passes_s: Array
    width_s: float

    piecewise_constant = False

    def at(self, t: ArrayLike) -> Array:
        """Return (...) the factor at time t, 1 at the sheet's middle."""
        return np.exp(-0.5 * ((np.asarray(t, dtype=np.float64) - self.passes_s) / self.width_s) ** 2)

    def integral(self, t: ArrayLike) -> Array:
        """Return (...) the integral from 0 to t."""
        from scipy.special import ndtr

        scale = self.width_s * np.sqrt(2 * np.pi)
        t = np.asarray(t, dtype=np.float64)
        return np.asarray(
            scale * (ndtr((t - self.passes_s) / self.width_s) - ndtr(-self.passes_s / self.width_s))
        )

    def changes(self, start: float, stop: float) -> Array:
        """Return nothing: it never jumps."""
        return np.empty(0)
