"""What a change of each pixel's light by some share of it is in the unit of a bound: tried on the pilot's own picture.

A share says by how much XYZ changes and not in which direction. For mean |a - b| / mean b all directions are alike; to
CIEDE2000 and FLIP some hues matter more. The worst of a few is taken, as it is found for a small change everywhere.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phoslab.render.planning.bounds import Bound
from phoslab.render.planning.pilot import Pilot

Array = NDArray[np.float64]

# All three of XYZ change by the same share of themselves, or one by that share of all three.
TOGETHER = ((1.0, 1.0, 1.0), (-1.0, -1.0, -1.0), (1.0, 0.0, -1.0), (-1.0, 1.0, -1.0))
ALONE = (*np.eye(3), *-np.eye(3))

SMALL = 0.01


class Sensitivity:
    """A pilot's picture, and the direction of change that a bound is most sensitive to at each moment."""

    def __init__(self, pilot: Pilot, bound: Bound) -> None:
        self._pilot, self._bound = pilot, bound
        self._direction: Array = np.stack([self._worst(t) for t in range(len(pilot.moments))])

    def of(self, share: Array) -> float:
        """Return the error at the worst moment where (T, P) shares of the light change."""
        if not share.any():
            return 0.0
        change = share.reshape(self._direction.shape[:-1])[..., None] * self._direction
        return self.between(self._pilot.pictures + change)

    def between(self, changed: Array) -> float:
        """Return the error of (T, h, w, 3) XYZ in place of the pilot's, at the worst moment."""
        return max(self._error(t, changed[t]) for t in range(len(changed)))

    def _error(self, t: int, changed: Array) -> float:
        return self._bound.error(np.maximum(changed, 0.0), self._pilot.pictures[t], self._pilot.exposures[t])

    def _worst(self, t: int) -> Array:
        """Return the (h, w, 3) change that a share of 1 stands for."""
        picture = self._pilot.pictures[t]
        total = picture.sum(axis=-1, keepdims=True)
        changes = [*(picture * np.array(x) for x in TOGETHER), *(total * x for x in ALONE)]
        return max(changes, key=lambda change: self._error(t, picture + SMALL * change))
