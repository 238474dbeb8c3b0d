"""The exciting lamp's spectrum over all that it may excite with, also where a camera hardly sees.

A camera measures some 415 to 680 nm; phosphors are excited from the ultraviolet on. The light of a lamp that glows
because it is hot goes on as Planck's law says; where the seen part follows it, so does the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from phoslab.fitting.spectrum import Spectrum

Array = NDArray[np.float64]

NM = np.arange(360.0, 781.0)
"""Wavelengths at which the lamp's light is given."""

_SURE_NM = (430.0, 680.0)
"""Where a camera sees well enough for the spectrum to be its own word."""

_THERMAL = 0.03
"""A lamp that is off Planck's law by less than this, as a share, is taken to follow it."""

_COLDEST_K, _HOTTEST_K = 1500.0, 8000.0

_C2_NM_K = 1.438776877e7
"""The second radiation constant."""


@dataclass(frozen=True, eq=False)
class LampLight:
    """A lamp's light.

    Args:
        irradiance: (n_nm,) at `NM`, relative.
        temperature_K: of the thermal radiator that it follows; None: it follows none.
        misfit: how far it is off that, as a share.
    """

    irradiance: Array
    temperature_K: float | None
    misfit: float

    @property
    def said(self) -> str:
        """How the ends came about, and what rests on them."""
        rests = "ke there rests on that, with an error that its ± does not hold."
        if self.temperature_K is None:
            return (
                f"The lamp follows no thermal radiator (off by {self.misfit:.0%}); below {_SURE_NM[0]:g} and above "
                f"{_SURE_NM[1]:g} nm, where the camera hardly sees, it is taken to go on as at the ends; {rests}"
            )
        return (
            f"Below {_SURE_NM[0]:g} and above {_SURE_NM[1]:g} nm, where the camera hardly sees, the lamp goes on as a "
            f"thermal radiator of {self.temperature_K:.0f} K, which it follows between to {self.misfit:.1%}; {rests}"
        )


def lamp_light(measured: Spectrum) -> LampLight:
    """Continue a measured spectrum to `NM`."""
    sure = (measured.nm >= _SURE_NM[0]) & (measured.nm <= _SURE_NM[1])
    nm, value, error = measured.nm[sure], measured.value[sure], measured.standard_error[sure]

    def planck(kelvin: float, at: Array) -> Array:
        return np.asarray(
            (560.0 / at) ** 5 * np.expm1(_C2_NM_K / 560.0 / kelvin) / np.expm1(_C2_NM_K / at / kelvin)
        )

    def fitted(kelvin: float) -> tuple[Array, float]:
        shape = planck(kelvin, nm)
        weight = 1 / error**2
        scale = float((weight * shape * value).sum() / (weight * shape**2).sum())
        return scale * shape, scale

    def missed(log_kelvin: float) -> float:
        return float((((fitted(float(np.exp(log_kelvin)))[0] - value) / error) ** 2).sum())

    found = minimize_scalar(missed, bounds=(np.log(_COLDEST_K), np.log(_HOTTEST_K)), method="bounded")
    kelvin = float(np.exp(found.x))
    model, scale = fitted(kelvin)
    misfit = float(np.sqrt(np.mean((model - value) ** 2) / np.mean(value**2)))
    inside = (NM >= nm[0]) & (NM <= nm[-1])
    if misfit > _THERMAL:
        return LampLight(np.interp(NM, nm, value), None, misfit)
    irradiance = np.where(inside, np.interp(NM, nm, value), scale * planck(kelvin, NM))
    return LampLight(irradiance, kelvin, misfit)
