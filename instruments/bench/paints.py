"""Samples with a preset's colours and time scale, but the bench's physics.

Band means of a preset become smooth spectra with the same means; its rate becomes depths of traps. Nothing of its
model is left: what comes out decays as traps do, not as exp(-kr t), and a fit has to find out how well one describes
the other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from phoslab.errors import PhoslabError
from phoslab.instruments.bench.lights import halogen
from phoslab.instruments.bench.sample import BOLTZMANN_EV_PER_K, Sample
from phoslab.presets import names, preset

Array = NDArray[np.float64]

HASTE = 1.3
"""Release rate of the main traps as a multiple of the preset's kr: so the light falls to 1/e in about 1/kr.

Retrapping slows the decay. All times of a sample scale with its kr, so one number serves all presets.
"""

DIMNESS = 40.0
"""A preset's emission by this: then a fresh glow takes a camera some tenths of a second, as paints do."""

_NM = np.arange(360.0, 761.0)


@dataclass(frozen=True)
class Paint(Sample):
    """A sample whose spectra are tables.

    Args:
        edges_nm: of the bands.
        emission_means, excitation_means: in them, of relative emission and excitation.
    """

    edges_nm: tuple[float, ...] = ()
    emission_means: tuple[float, ...] = ()
    excitation_means: tuple[float, ...] = ()

    def emission(self, nm: Array) -> Array:
        """Relative spectral radiance at wavelengths `nm`, with the band means of the preset."""
        return smooth(self.edges_nm, self.emission_means)(nm)

    def excitation(self, nm: Array) -> Array:
        """Relative excitation at wavelengths `nm`, 1 at the best; it does not stop at the first band's edge."""
        first = self.edges_nm[0]
        return smooth(self.edges_nm, self.excitation_means)(np.maximum(nm, first + 0.5)) * (nm > first - 20)


def smooth(edges_nm: tuple[float, ...], means: tuple[float, ...]) -> Callable[[Array], Array]:
    """Return a continuous spectrum >= 0 that has these band means, and is 0 outside the bands.

    It is the slope of a monotone cubic through the integral up to each edge (Fritsch and Carlson 1980), which rises
    wherever the means are positive and meets each edge.
    """
    edges = np.array(edges_nm)
    integral = np.concatenate([[0.0], np.cumsum(np.array(means) * np.diff(edges))])
    slope = PchipInterpolator(edges, integral, extrapolate=False).derivative()
    return lambda nm: np.nan_to_num(np.maximum(slope(nm), 0.0))


def known() -> tuple[str, ...]:
    """Return the presets of which a sample can be made: those whose excitation was measured."""
    return tuple(n for n in names() if not np.isnan(preset(n).ke_m2_per_J).any())


def paint(name: str) -> Paint:
    """Return the sample that looks and lasts like the preset `name`.

    Raises:
        PhoslabError: there is none, or its excitation was never measured.
    """
    if name not in known():
        raise PhoslabError(
            f"{name!r} is no sample that the bench can make",
            field="--simulate",
            remedy=f"Take one of those whose excitation is known: {', '.join(known())}.",
        )
    material = preset(name)
    bands = material.bands
    ke, kr = material.ke_m2_per_J[0], float(material.kr_per_s[0])
    assert material.reference_irradiance is not None  # every preset with ke has one
    full_per_s = float((ke * material.reference_irradiance * bands.widths_nm).sum())
    shape = tuple(float(k) for k in ke / ke.max())
    edges = tuple(float(e) for e in bands.edges_nm)
    plain = Paint(edges_nm=edges, excitation_means=shape)
    lamp = halogen(3000.0)(_NM)
    excited = float((plain.excitation(_NM) * lamp).sum() / _NM.size)
    kT_eV = BOLTZMANN_EV_PER_K * (plain.temperature_C + 273.15)
    depth = kT_eV * float(np.log(plain.attempts_per_s / (HASTE * kr)))
    return Paint(
        name=name,
        depth_eV=depth,
        width_eV=0.02,
        # A quarter as many, each twenty times as slow.
        more_traps=((0.25, depth + 0.075, 0.03),),
        retrapping=1.5,
        excitation_per_s=full_per_s / excited,
        edges_nm=edges,
        emission_means=tuple(float(e) / DIMNESS for e in material.emission[0]),
        excitation_means=shape,
    )
