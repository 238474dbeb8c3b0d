"""The controller's clock against the host's: what every exchange of lines proves about both.

The controller stamps a reply between the moment at which the request began to go out and the moment at which the reply
had come in. Such intervals, and a bound on how wrong a quartz or resonator can run, leave room for only some straight
lines; two of those give the earliest and the latest host time that a device time can stand for. This is Cristian's
interval (Distributed Computing 3, 1989, doi 10.1007/BF01784024) carried over many exchanges; nothing is averaged, so a
slow way out and a fast way back (a USB adapter) make the answer wider, never wrong.
"""

from __future__ import annotations

import threading

import numpy as np
from numpy.typing import NDArray

_BUCKET_S = 10.0
_BUCKETS = 32
_ROUNDING_S = 1e-7  # of a device time in us, and of floats of this size


class DeviceClock:
    """Host time from device time and back; thread-safe.

    Args:
        largest_drift: how far the rate of the two may differ. 0.6 %: a ceramic resonator (0.5 %) with temperature.
    """

    def __init__(self, largest_drift: float = 6e-3) -> None:
        self._drift = largest_drift
        self._lock = threading.Lock()
        self._kept: dict[int, tuple[float, float, float]] = {}  # device_s, earliest, latest by bucket

    def forget(self) -> None:
        """Begin anew: the controller has been reset, and so has its clock."""
        with self._lock:
            self._kept.clear()

    def add(self, sent_s: float, device_s: float, heard_s: float) -> None:
        """Learn from one exchange: the device's time lies between two of the host's, all in s.

        The narrowest exchange of every 10 s is kept, 32 of them. If no clock of one constant rate fits all of them,
        the rate has changed (with the room's temperature), and the oldest are given up.
        """
        earliest, latest = sent_s - _ROUNDING_S, heard_s + _ROUNDING_S
        with self._lock:
            while self._kept:
                low, high = self._bounds(device_s)
                if low <= latest and high >= earliest:
                    break
                del self._kept[next(iter(self._kept))]
            bucket = int(device_s // _BUCKET_S)
            old = self._kept.get(bucket)
            if old is None or latest - earliest < old[2] - old[1]:
                self._kept.pop(bucket, None)
                self._kept[bucket] = (device_s, earliest, latest)
            if len(self._kept) > _BUCKETS:
                del self._kept[next(iter(self._kept))]

    def mono_s(self, device_s: float) -> tuple[float, float] | None:
        """Return the host's time in s at a device time, and how far off it may be; None before the first exchange."""
        with self._lock:
            if not self._kept:
                return None
            low, high = self._bounds(device_s)
        return (low + high) / 2, max(0.0, high - low) / 2

    def device_s(self, mono_s: float) -> float | None:
        """Return the device's time in s at a moment of the host's clock; None before the first exchange."""
        with self._lock:
            if not self._kept:
                return None
            anchor = next(reversed(self._kept.values()))
            device_s = anchor[0] + mono_s - (anchor[1] + anchor[2]) / 2
            for _ in range(3):  # each step leaves a drift's share (0.006) of the error before it
                low, high = self._bounds(device_s)
                device_s += mono_s - (low + high) / 2
        return device_s

    def _bounds(self, device_s: float) -> tuple[float, float]:
        """Return the earliest and latest host time of `device_s`.

        The dual of a linear programme in two unknowns: one exchange and the bound on drift, or two exchanges, settle
        each end. Between two exchanges a line lies below the chord of their upper ends; beyond both, below the line
        through the far one's lower and the near one's upper end. Likewise from below.
        """
        at, low, high = np.array(list(self._kept.values())).T
        step = device_s - at
        slow, fast = step * (1 - self._drift), step * (1 + self._drift)
        lowest = float(np.max(low + np.minimum(slow, fast)))
        highest = float(np.min(high + np.maximum(slow, fast)))
        near, far = np.meshgrid(np.arange(len(at)), np.arange(len(at)), indexing="ij")
        near, far = near[near != far], far[near != far]
        if near.size:
            # Of the stretch between them: beyond the near one if it is positive.
            share = step[near] / (at[near] - at[far])
            beyond = share >= 0
            between = (share < 0) & (share > -1)
            lowest = max(lowest, _largest(low, low, high, near, far, share, between, beyond))
            highest = min(highest, -_largest(-high, -high, -low, near, far, share, between, beyond))
        return lowest, highest


def _largest(
    here: NDArray[np.float64],
    same: NDArray[np.float64],
    other: NDArray[np.float64],
    near: NDArray[np.intp],
    far: NDArray[np.intp],
    share: NDArray[np.float64],
    between: NDArray[np.bool_],
    beyond: NDArray[np.bool_],
) -> float:
    """The tightest lower bound that pairs of exchanges give: chords of `same` ends, lines on from `other` ends."""
    chord = here[near] + share * (here[near] - same[far])
    line = here[near] + share * (here[near] - other[far])
    found = np.concatenate([chord[between], line[beyond]])
    return float(found.max(initial=-np.inf))
