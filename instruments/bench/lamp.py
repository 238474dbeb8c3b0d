"""The bench's lamp: a halogen bulb that takes a moment to go dark."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phoslab import spectra
from phoslab.bands import Bands

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lamp:
    """A halogen lamp (Nalbach 2017, 8.4.6: 400 W, dark 320 ms after it is switched off).

    Args:
        temperature_K: of the filament, while on; its slight reddening while it cools is left out.
        fade_s: from switching off to no light.
    """

    temperature_K: float = 3000.0
    fade_s: float = 0.32

    def level(self, since_off_s: float) -> float:
        """Light as a share of full light, `since_off_s` seconds after switching off (negative: on)."""
        # A cooling filament loses most of its light at first; the square ends without a kink.
        return float(np.clip(1 - since_off_s / self.fade_s, 0.0, 1.0) ** 2)

    def irradiance(self, bands: Bands) -> Array:
        """(n_λ,) relative spectral irradiance at the sample, mean 1 over the bands."""
        values = spectra.shape(
            f"blackbody:{self.temperature_K:g}", bands, file=Path(__file__), field="temperature_K"
        )
        return np.asarray(values / np.average(values, weights=bands.widths_nm))
