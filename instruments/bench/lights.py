"""What shines on the bench: halogen lamp, white LED, mercury lamp; and the colour filters before them.

Spectra are relative, by the nm, and on one scale: a light of 1 over the visible range has 1 at every wavelength.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.spectra import spectrum

Array = NDArray[np.float64]

LED = "illuminant:LED-B3"
"""The white LED's spectrum, as phoslab.spectra names it; a rig may state it as known."""

MERCURY_NM = {
    # Relative intensities of a low-pressure lamp in its glass; the weak ones are there, too.
    404.66: 0.42,
    407.78: 0.04,
    433.92: 0.03,
    435.83: 1.00,
    491.61: 0.012,
    546.07: 1.10,
    576.96: 0.24,
    579.07: 0.26,
    623.44: 0.012,
    671.64: 0.006,
    690.75: 0.012,
}
"""Lines of mercury and their share of light."""

GLASS_NM, GLASS_WIDTH_NM = 396.0, 3.0
"""The lamp's front glass holds ultraviolet light back."""


def halogen(temperature_K: float) -> Callable[[Array], Array]:
    """The lamp's light at wavelengths in nm: a thermal radiator behind glass, mean 1 over 400..700 nm."""
    planck = spectrum(f"blackbody:{temperature_K:g}", file=Path(__file__), field="temperature_K")
    mean = planck(np.arange(400.0, 700.5)).mean()
    return lambda nm: np.asarray(planck(nm) / mean / (1 + np.exp(-(nm - GLASS_NM) / GLASS_WIDTH_NM)))


def led() -> Callable[[Array], Array]:
    """The white LED's light, mean 1 over 400..700 nm."""
    known = spectrum(LED, file=Path(__file__), field="LED")
    mean = known(np.arange(400.0, 700.5)).mean()
    return lambda nm: np.asarray(known(nm) / mean)


def mercury(width_nm: float = 1.2, continuum: float = 0.004) -> Callable[[Array], Array]:
    """The mercury lamp's light: lines, as broad as pressure makes them, over a weak continuum."""

    def lines(nm: Array) -> Array:
        total = np.full(nm.shape, continuum)
        for centre, strength in MERCURY_NM.items():
            total += 60 * strength * np.exp(-0.5 * ((nm - centre) / width_nm) ** 2) / width_nm
        return total

    return lines


READY = (
    *("L002", "L035", "L101", "L122", "L147", "L179", "L201", "L225", "L279", "L366"),
    *("L603", "L714", "L736", "L775"),
)
"""Colour filters that lie ready: of all that are known every nineteenth."""


@cache
def filter_names() -> tuple[str, ...]:
    """Names of the colour filters whose spectra are known: those of the package lighting-filters."""
    return tuple(sorted(name for name, item in _filters().items() if item["sd"]))


def colour_filter(name: str) -> Callable[[Array], Array]:
    """Transmission of a colour filter; beyond its measured range it stays what it was at the range's end.

    Raises:
        PhoslabError: there is none of that name.
    """
    if name not in filter_names():
        raise PhoslabError(
            f"{name!r} is none of the {len(filter_names())} that are there",
            field="filter",
            remedy=f"Take {', '.join(filter_names()[:5])} ... or {filter_names()[-1]}.",
        )
    table = _filters()[name]["sd"]
    nm = np.array([float(x) for x in table])
    share = np.array([float(x) for x in table.values()])
    return lambda at: np.interp(at, nm, share)


@cache
def _filters() -> dict[str, dict[str, dict[str, str]]]:
    # The file itself: the package's own reader checks all of it with pydantic, which takes longer than to use it.
    found: dict[str, dict[str, dict[str, str]]] = json.loads(
        (files("dataset") / "filters.json").read_text("utf-8")
    )["filters"]
    return found
