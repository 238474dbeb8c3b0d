"""What follows linearly from the light that is sent, found anew only where that is no sum of what was sent before.

In the dark what surfaces send is a sum of parts, of which each fades at a rate of its own. So what they reflect of it
is such a sum, too, at all later times and wherever the camera goes (`fade_basis.py` has the same of whole pictures):
it is found for as many parts as there are rates, and each later time is these, weighted.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Parts that are remembered, and their bytes at most.
MOST, MOST_BYTES = 16, 1 << 28
# Of what is sent, what may be left that no part explains: what float32 rounds off.
ROUNDING = 1e-6


class Superposition:
    """A linear map that remembers what it was asked: parts that are orthogonal, of length 1, and what follows of each.

    Args:
        follow: the map, which is costly: from (...) to (...) of the same shape, of any sign.
    """

    def __init__(self, follow: Callable[[Array], Array]) -> None:
        self._follow = follow
        self._parts: list[tuple[Array, Array]] = []

    def of(self, sent: Array) -> Array:
        """Return what follows of `sent`, to a millionth of its length."""
        total, rest = np.zeros_like(sent), sent.copy()
        for part, follows in self._parts:
            weight = float(np.vdot(part, rest))
            rest -= weight * part
            total += weight * follows
        left = float(np.linalg.norm(rest))
        if left <= ROUNDING * float(np.linalg.norm(sent)):
            return total
        if len(self._parts) >= min(MOST, MOST_BYTES // (2 * sent.nbytes)):
            # While light changes what is sent, it is no sum of a few parts.
            self._parts.clear()
            return self._follow(sent)
        self._parts.append((rest / left, self._follow(rest / left)))
        return total + left * self._parts[-1][1]
