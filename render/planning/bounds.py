"""How wrong a picture may be, and how wrong one is: three ways to say it.

2%        mean |a - b| / mean b over all pixels and the three channels of XYZ
1dE       mean CIEDE2000 over the pixels, at the scene's exposure
0.05flip  mean LDR-FLIP over the pixels, at the scene's exposure (Andersson et al. 2020)
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phoslab.colorimetry import display_srgb
from phoslab.errors import PhoslabError

Array = NDArray[np.float64]

# Whiter than display white is clipped, as there: Lab has no top.
_WHITE = 1.0


def radiance_error(a: Array, b: Array, exposure: float) -> float:
    """Return mean |a - b| / mean b of (..., 3) XYZ; 0 where both are dark."""
    scale = float(np.mean(b))
    difference = float(np.abs(a - b).mean())
    return difference / scale if scale > 0 else (0.0 if difference == 0 else np.inf)


def colour_error(a: Array, b: Array, exposure: float) -> float:
    """Return the mean CIEDE2000 of (..., 3) XYZ, as a display of white D65 shows them."""
    import colour

    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]

    def lab(xyz: Array) -> Array:
        return np.asarray(colour.XYZ_to_Lab(np.minimum(xyz * exposure, _WHITE), white))

    return float(np.mean(colour.difference.delta_E_CIE2000(lab(b), lab(a))))


def flip_error(a: Array, b: Array, exposure: float) -> float:
    """Return the mean LDR-FLIP of (h, w, 3) XYZ.

    Raises:
        PhoslabError: flip-evaluator is not installed.
    """
    flip_evaluator = _flip_evaluator()
    shown = [display_srgb(xyz, exposure).astype(np.float32) for xyz in (b, a)]
    return float(flip_evaluator.evaluate(*shown, "LDR", applyMagma=False)[1])


@cache
def _flip_evaluator() -> Any:
    # Its threads wait for each other by spinning: small pictures take a hundred times as long with more than one. They
    # are counted once, when it is loaded.
    threads = os.environ.get("OMP_NUM_THREADS")
    os.environ["OMP_NUM_THREADS"] = "1"
    try:
        import flip_evaluator
    except ImportError as error:
        raise PhoslabError(
            "needs flip-evaluator, which is not installed",
            field="a bound in flip",
            remedy="pip install 'phoslab[reference]', or give the bound in % or dE.",
        ) from error
    finally:
        if threads is None:
            del os.environ["OMP_NUM_THREADS"]
        else:
            os.environ["OMP_NUM_THREADS"] = threads
    return flip_evaluator


Measure = Callable[[Array, Array, float], float]

# By unit: how it is measured, how many make 1 of the measure, and the largest that means anything.
UNITS: dict[str, tuple[Measure, float, float]] = {
    "%": (radiance_error, 0.01, 100.0),
    "dE": (colour_error, 1.0, 100.0),
    "flip": (flip_error, 1.0, 1.0),
}

REMEDY = "Write it as 2%, 1dE or 0.05flip."


@dataclass(frozen=True)
class Bound:
    """How wrong a picture may be: `value` of `unit`, a key of `UNITS`."""

    value: float
    unit: str

    def error(self, a: ArrayLike, b: ArrayLike, exposure: float = 1.0) -> float:
        """Return how wrong (h, w, 3) XYZ `a` is against `b`, in this bound's unit.

        Args:
            exposure: what brings Y to display white.
        """
        measure, unit, _ = UNITS[self.unit]
        return measure(np.asarray(a, np.float64), np.asarray(b, np.float64), exposure) / unit

    @property
    def of_the_whole(self) -> bool:
        """Whether an error counts by its share of all light; else what is dark counts as much as what is bright."""
        return self.unit == "%"

    def say(self, value: float) -> str:
        """Return a value in this unit as text."""
        space = "" if self.unit == "%" else " "
        return f"{value:.2g}{space}{self.unit}"

    def __str__(self) -> str:
        return f"{self.value:g}{self.unit}"


def parse_bound(text: str) -> Bound:
    """Return the bound that `text` means.

    Raises:
        PhoslabError: it is none, or absurd.

    >>> parse_bound("2%")
    Bound(value=2.0, unit='%')
    """
    number = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?"
    match = re.fullmatch(rf"\s*({number})\s*(%|dE|flip|)\s*", text, re.ASCII | re.IGNORECASE)
    if match is None:
        raise PhoslabError(f"{text!r} is not understood", field="the bound", remedy=REMEDY)
    if not match[2]:
        raise PhoslabError(f"{text!r} has no unit", field="the bound", remedy=REMEDY)
    unit = next(u for u in UNITS if u.lower() == match[2].lower())
    bound, largest = Bound(float(match[1]), unit), UNITS[unit][2]
    if not 0 < bound.value < largest:
        problem = "a black picture would hold it" if bound.value > 0 else "no picture is less than right"
        raise PhoslabError(
            f"{text!r} is absurd: {problem}",
            field="the bound",
            remedy=f"Give more than 0 and less than {largest:g}{unit}.",
        )
    return bound
