"""Luminance as the eye by day and by night would have it."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phoslab.bands import Bands
from phoslab.colorimetry import EFFICACY_LM_PER_W
from phoslab.spectra import band_means

Array = NDArray[np.float64]

# Efficacy at the maximum of V'(λ), which makes both observers agree at 555 nm (CIE 18:2019): 683.002 / V'(555).
SCOTOPIC_EFFICACY_LM_PER_W = 1700.05

_FUNCTIONS = {
    "photopic": ("CIE 1924 Photopic Standard Observer", EFFICACY_LM_PER_W, "SDS_LEFS_PHOTOPIC"),
    "scotopic": ("CIE 1951 Scotopic Standard Observer", SCOTOPIC_EFFICACY_LM_PER_W, "SDS_LEFS_SCOTOPIC"),
}


def luminance(radiance: ArrayLike, bands: Bands, observer: str = "photopic") -> Array:
    """Return (...,) luminance in cd/m² of (..., n_λ) radiance in W m⁻² sr⁻¹ nm⁻¹.

    Args:
        observer: "photopic", the eye adapted to light, or "scotopic", adapted to the dark.

    A relative material's radiance is in units of its own, and so is what comes out here.
    """
    return np.asarray(np.asarray(radiance, dtype=np.float64) @ _weights(bands, observer))


@cache
def _weights(bands: Bands, observer: str) -> Array:
    import colour

    name, efficacy, table = _FUNCTIONS[observer]
    function = getattr(colour.colorimetry, table)[name]
    nm, values = np.asarray(function.wavelengths, float), np.asarray(function.values, float)
    means = band_means(lambda at: np.interp(at, nm, values, left=0.0, right=0.0), bands)
    weights: Array = efficacy * means * bands.widths_nm
    return weights
