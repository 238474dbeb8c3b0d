"""Which light comes to which place under a linear variable filter, and how rates over wavelength are written.

An excitation rate over wavelength is a sum of shapes with coefficients of 0 or more: constant in each band, or straight
lines between nodes, which follow a spectrum that changes within a band (by 25 nm, a place sees no more than a band's
two thirds). What a place is excited by is linear in the coefficients, and so is the mean rate of a band.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from phoslab.bands import Bands
from phoslab.errors import PhoslabError

Array = NDArray[np.float64]

_CELL_NM = 0.25
"""Integrals are sums over the middles of cells of at most this width, none of which holds a band's edge."""


@dataclass(frozen=True, eq=False)
class Shapes:
    """Shapes that a rate over wavelength is made of.

    Args:
        bands: whose mean rates are asked for.
        nodes_nm: (n_shapes,) where a shape of straight lines is 1, its neighbours being 0; None: one constant a band.
    """

    bands: Bands
    nodes_nm: Array | None = None

    @classmethod
    def lines(cls, bands: Bands, cuts: int = 2) -> Shapes:
        """Straight lines between the edges of bands cut into `cuts`, and on over a band more at either end.

        Light outside the bands excites as well; what it does must not be laid to theirs.
        """
        edges = bands.edges_nm
        whole = np.concatenate([[2 * edges[0] - edges[1]], edges, [2 * edges[-1] - edges[-2]]])
        parts = np.linspace(whole[:-1], whole[1:], cuts, endpoint=False)
        return cls(bands, np.append(parts.T.ravel(), whole[-1]))

    @property
    def n(self) -> int:
        """Number of shapes."""
        return self.bands.n if self.nodes_nm is None else self.nodes_nm.size

    @cached_property
    def _cells(self) -> tuple[Array, Array]:
        """Middles and widths of cells from the first to the last wavelength."""
        edges = self.bands.edges_nm
        knots = edges if self.nodes_nm is None else np.union1d(edges, self.nodes_nm)
        fine = [
            np.linspace(low, high, max(2, int(np.ceil((high - low) / _CELL_NM)) + 1))
            for low, high in pairwise(knots)
        ]
        at = np.unique(np.concatenate(fine))
        return (at[:-1] + at[1:]) / 2, np.diff(at)

    @cached_property
    def _values(self) -> Array:
        """(n_shapes, n_cells)."""
        middles, _ = self._cells
        if self.nodes_nm is not None:
            return np.asarray([np.interp(middles, self.nodes_nm, row) for row in np.eye(self.n)])
        return np.asarray(self._band_of(middles) == np.arange(self.n)[:, None], dtype=np.float64)

    def _band_of(self, nm: Array) -> NDArray[np.intp]:
        return np.asarray(np.searchsorted(self.bands.edges_nm, nm) - 1)

    def light(self, nm: Array, irradiance: Array, transmission: Array | None = None) -> Array:
        """Return (n_places, n_shapes) the light that each shape weighs, in W/m²; (n_shapes,) without a filter.

        Args:
            nm: (n_nm,) ascending; spectra are straight lines between them, and 0 beyond.
            irradiance: (n_nm,) the lamp before the filter, in W m⁻² nm⁻¹.
            transmission: (n_places, n_nm) of the filter at each place, 0..1.

        >>> Shapes(Bands.uniform(2)).light(np.array([400.0, 700.0]), np.array([1.0, 1.0])).round(9).tolist()
        [150.0, 150.0]
        """
        middles, widths = self._cells
        lamp = np.interp(middles, nm, irradiance, left=0.0, right=0.0)
        weighed = self._values * lamp * widths
        if transmission is None:
            return np.asarray(weighed.sum(axis=1))
        passed = np.stack([np.interp(middles, nm, row, left=0.0, right=0.0) for row in transmission])
        return np.asarray(passed @ weighed.T)

    def band_means(self, nm: Array, irradiance: Array) -> Array:
        """Return (n_bands, n_shapes): from coefficients to mean rates, weighted with the lamp's light in the band.

        Raises:
            PhoslabError: a band without light has no such mean.
        """
        middles, widths = self._cells
        light = np.interp(middles, nm, irradiance, left=0.0, right=0.0) * widths
        inside = self._band_of(middles) == np.arange(self.bands.n)[:, None]
        whole = (inside * light).sum(axis=1)
        if not (whole > 0).all():
            dark = self.bands.label(int(np.argmin(whole)))
            raise PhoslabError(
                f"holds no light at {dark}",
                field="the lamp's spectrum",
                remedy="Measure it (phoslab measure lamp), or choose bands that it reaches.",
            )
        return np.asarray((inside * light) @ self._values.T / whole[:, None])


def outside(nm: Array, irradiance: Array, bands: Bands, transmission: Array) -> Array:
    """Return (n_places,) the share of each place's light that lies outside the bands."""
    everything = Shapes(Bands(np.array([nm[0], nm[-1]])))
    whole = everything.light(nm, irradiance, transmission)[:, 0]
    inside = Shapes(bands).light(nm, irradiance, transmission).sum(axis=1)
    share: Array = 1 - np.divide(inside, whole, out=np.ones_like(whole), where=whole > 0)
    return share
