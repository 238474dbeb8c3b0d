"""Which light comes to which place under a linear variable filter, band by band."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phoslab.bands import Bands

Array = NDArray[np.float64]


def band_light(nm: Array, irradiance: Array, bands: Bands, transmission: Array | None = None) -> Array:
    """Return (n_places, n_bands) the light that passes in each band, in W/m²; (n_bands,) without a filter.

    Args:
        nm: (n_nm,) ascending wavelengths, fine enough that the spectra are straight lines between them.
        irradiance: (n_nm,) the lamp before the filter, in W m⁻² nm⁻¹; 0 is taken beyond the ends of `nm`.
        bands: in which to sum up.
        transmission: (n_places, n_nm) of the filter at each place, 0..1.

    >>> band_light(np.array([400.0, 700.0]), np.array([1.0, 1.0]), Bands.uniform(2)).tolist()
    [150.0, 150.0]
    """
    passed = irradiance if transmission is None else transmission * irradiance
    inside = bands.edges_nm[(bands.edges_nm > nm[0]) & (bands.edges_nm < nm[-1])]
    knots = np.union1d(nm, inside)
    at = np.searchsorted(nm, knots, side="right").clip(1, nm.size - 1)
    share = (knots - nm[at - 1]) / (nm[at] - nm[at - 1])
    fine = passed[..., at - 1] * (1 - share) + passed[..., at] * share
    parts = (fine[..., :-1] + fine[..., 1:]) / 2 * np.diff(knots)
    total = np.concatenate([np.zeros((*passed.shape[:-1], 1)), np.cumsum(parts, axis=-1)], axis=-1)
    edges = np.searchsorted(knots, np.clip(bands.edges_nm, nm[0], nm[-1]))
    sums: Array = np.diff(total[..., edges], axis=-1)
    return sums


def outside(nm: Array, irradiance: Array, bands: Bands, transmission: Array) -> Array:
    """Return (n_places,) the share of each place's light that lies outside the bands: its rates are not among theirs."""
    everything = Bands(np.array([nm[0], nm[-1]]))
    whole = band_light(nm, irradiance, everything, transmission)[:, 0]
    inside = band_light(nm, irradiance, bands, transmission).sum(axis=1)
    share: Array = 1 - np.divide(inside, whole, out=np.ones_like(whole), where=whole > 0)
    return share
