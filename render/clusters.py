"""Groups of a mesh's parts, all treated at once: sums and extremes over each, and their halves."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Clusters:
    """Some clusters, none of them empty.

    Args:
        of: (k,) the parts, cluster after cluster.
        sizes: (c,) how many parts each has.
    """

    of: Indices
    sizes: Indices

    @cached_property
    def first(self) -> Indices:
        """(c,) where each begins in `of`."""
        return np.asarray(np.cumsum(self.sizes) - self.sizes, dtype=np.intp)

    @cached_property
    def which(self) -> Indices:
        """(k,) the cluster of each part."""
        return np.repeat(np.arange(len(self.sizes)), self.sizes)

    def select(self, chosen: NDArray[np.bool_]) -> Clusters:
        """Return the clusters where (c,) `chosen` is true."""
        return Clusters(self.of[chosen[self.which]], self.sizes[chosen])

    def thinned(self, most: int) -> NDArray[np.bool_]:
        """Return (k,) which parts to look at where `most` to twice as many of a cluster are enough."""
        within = np.arange(len(self.of)) - self.first[self.which]
        return np.asarray(within % np.maximum(self.sizes // most, 1)[self.which] == 0)

    def total(self, values: NDArray[Any]) -> Array:
        """Return (c, ...) sums of (k, ...) values."""
        return np.asarray(np.add.reduceat(values, self.first, axis=0), dtype=np.float64)

    def least(self, values: Array) -> Array:
        """Return (c, ...) the least of (k, ...) values."""
        return np.asarray(np.minimum.reduceat(values, self.first, axis=0))

    def most(self, values: Array) -> Array:
        """Return (c, ...) the largest of (k, ...) values."""
        return np.asarray(np.maximum.reduceat(values, self.first, axis=0))

    def halves(self, features: Array) -> Clusters:
        """Return the clusters, of two parts or more, cut in two at the median of the feature that varies most.

        Args:
            features: (k, f) of each part.
        """
        away = features - (self.total(features) / self.sizes[:, None])[self.which]
        widest = np.argmax(self.total(away**2) / self.sizes[:, None], axis=1)
        order = np.lexsort((features[np.arange(len(self.of)), widest[self.which]], self.which))
        half = self.sizes // 2
        return Clusters(self.of[order], np.stack([half, self.sizes - half], axis=1).ravel())
