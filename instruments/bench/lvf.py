"""The bench's linear variable filter: a strip on which the wavelength that passes changes from one end to the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lvf:
    """A strip of glass with a wedge of interference layers (Nalbach 2017, 8.4.2: bands of about 25 nm).

    Positions along it are u, 0 at the blue end and 1 at the red one.

    Args:
        ends_nm: wavelength that passes at u = 0 and u = 1.
        bend_nm: by how much the middle lies above a straight line between them: no real wedge is straight.
        ripple_nm: amplitude of two waves of thickness on top of that.
        width_nm: full width at half maximum of a band at 550 nm; it is in proportion to the wavelength.
        peak: transmission at the middle of a band, at 550 nm; it falls to both ends.
        leak: transmission far from the band.
        tilt: how much u changes over the strip's width, as a share of its length: lines of one wavelength are
            not quite at right angles to the strip.
    """

    ends_nm: tuple[float, float] = (388.0, 715.0)
    bend_nm: float = -6.0
    ripple_nm: float = 0.4
    width_nm: float = 25.0
    peak: float = 0.62
    leak: float = 6e-4
    tilt: float = 0.006

    def centre_nm(self, u: Array) -> Array:
        """(n,) middle of the band that passes at positions `u` (n,)."""
        low, high = self.ends_nm
        straight = low + (high - low) * u
        return straight + self.bend_nm * 4 * u * (1 - u) + self.ripple_nm * np.sin(4 * np.pi * u)

    def transmission(self, u: Array, nm: Array) -> Array:
        """(n, m) transmission at positions `u` (n,) for wavelengths `nm` (m,)."""
        centre = self.centre_nm(u)[:, None]
        offset = (nm[None, :] - centre) / (self.width_nm * centre / 550)
        # Two coupled cavities: flatter on top and steeper than one (which would be a Lorentzian).
        band = 1 / (1 + (2 * offset) ** 4)
        peak = self.peak * (1 - ((centre - 560) / 420) ** 2)
        return np.asarray(self.leak + peak * band)
