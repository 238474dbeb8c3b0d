"""Spectral bands: the wavelength intervals over which every spectrum is averaged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phoslab.errors import PhoslabError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Bands:
    """Adjoining wavelength intervals.

    A spectrum over bands is the mean of the spectral quantity in each band (per nm), so its integral is
    `sum(values * widths_nm)`.

    Args:
        edges_nm: (n_λ + 1,) ascending wavelengths in nm.

    >>> Bands.uniform().widths_nm.tolist()
    [37.5, 37.5, 37.5, 37.5, 37.5, 37.5, 37.5, 37.5]
    """

    edges_nm: Array

    def __post_init__(self) -> None:
        edges = np.array(self.edges_nm, dtype=np.float64)
        if edges.ndim != 1 or edges.size < 2 or not np.isfinite(edges).all() or (np.diff(edges) <= 0).any():
            raise PhoslabError(
                "must be at least two finite, ascending wavelengths",
                field="band_edges_nm",
                remedy="Give n + 1 edges in nm for n bands.",
            )
        edges.setflags(write=False)
        object.__setattr__(self, "edges_nm", edges)

    @classmethod
    def uniform(cls, n: int = 8, low_nm: float = 400.0, high_nm: float = 700.0) -> Bands:
        """Return `n` equal bands; the default is that of Nalbach 2017, 8.4.7: 8 of 37.5 nm."""
        return cls(np.linspace(low_nm, high_nm, n + 1))

    @property
    def n(self) -> int:
        """Number of bands, n_λ."""
        return self.edges_nm.size - 1

    @property
    def widths_nm(self) -> Array:
        """(n_λ,) width of each band in nm."""
        return np.diff(self.edges_nm)

    @property
    def centres_nm(self) -> Array:
        """(n_λ,) middle of each band in nm."""
        return (self.edges_nm[:-1] + self.edges_nm[1:]) / 2

    def label(self, j: int) -> str:
        """Name band `j` for a message: `400-437.5 nm`."""
        return f"{self.edges_nm[j]:g}-{self.edges_nm[j + 1]:g} nm"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Bands) and np.array_equal(self.edges_nm, other.edges_nm)

    def __hash__(self) -> int:
        return hash(self.edges_nm.tobytes())


def merge(*bands: Bands) -> Bands:
    """Return the bands whose edges are all the edges of `bands`.

    Re-binning into them is exact: a merged band lies wholly inside one band of each operand, or outside it.
    """
    return Bands(np.unique(np.concatenate([b.edges_nm for b in bands])))


def overlap_nm(source: Bands, target: Bands) -> Array:
    """Return (target.n, source.n): the width in nm that each pair of bands has in common."""
    low = np.maximum(target.edges_nm[:-1, None], source.edges_nm[None, :-1])
    high = np.minimum(target.edges_nm[1:, None], source.edges_nm[None, 1:])
    shared: Array = np.clip(high - low, 0.0, None)
    return shared


def rebin(values: ArrayLike, source: Bands, target: Bands) -> Array:
    """Re-bin band means so that the integral over every stretch of common bands is kept.

    Args:
        values: (..., source.n) band means per nm; NaN marks a band that was never measured.

    Returns:
        (..., target.n) band means; 0 where the target lies outside the source, NaN where a target band
        takes any part of a NaN band.
    """
    v = np.asarray(values, dtype=np.float64)
    weight = overlap_nm(source, target) / target.widths_nm[:, None]
    # NaN * 0 is NaN: bands without overlap must not spread what was never measured.
    unknown = np.isnan(v) @ (weight.T > 0)
    means: Array = np.where(unknown, np.nan, np.where(np.isnan(v), 0.0, v) @ weight.T)
    return means


def integral_outside(values: ArrayLike, source: Bands, target: Bands) -> Array:
    """Return (...,) the integral of a spectrum over the wavelengths that `target` does not cover."""
    v = np.asarray(values, dtype=np.float64)
    outside: Array = v @ (source.widths_nm - overlap_nm(source, target).sum(axis=0))
    return outside
