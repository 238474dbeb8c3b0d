"""Write the preset files from the published tables: `python -m phoslab.presets.make_presets FOLDER`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from phoslab import spectra
from phoslab.bands import Bands
from phoslab.material import Material

# Nalbach 2017, Table 8.1: kr [1/s]; ke in bands 1 to 3; Λ in 8 bands (relative units).
TABLE_8_1 = """
blue     0.032 | 0.0170 0.0500 0.0040 | 0.34 4.37 3.65 0.55 0 0.01 0 0
green    0.227 | 0.1000 0.0350 0.0060 | 0 0 0.07 0.64 0.05 0 0 0
orange   0.015 | 0.0150 0.0060 0.0003 | 0.04 1.85 0.47 0 0.45 7.70 4.88 2.49
pink     0.027 | 0.0060 0.0150 0.0033 | 0.59 4.07 0.49 0 0 1.22 1.77 0.09
purple   0.028 | 0.0120 0.0180 0.0008 | 0.46 3.08 0.36 0 0 0.19 0.08 0
red      0.016 | 0.0120 0.0038 0.0000 | 0.13 3.03 0.44 0 0.02 5.49 6.21 0.63
white    0.047 | 0.0180 0.0400 0.0058 | 0.26 2.55 2.49 0.61 0 0.01 0 0.10
yellow   0.251 | 0.1450 0.0380 0.0070 | 0 0 0.08 0.80 0.15 0.12 0.02 0
bottle   0.185 | | 0 0.04 0.41 0.58 0.25 0.06 0.01 0
gloves   0.067 | | 0.10 0.88 5.29 5.28 2.01 0.66 0.12 0.01
stickers 0.039 | | 0.01 6.02 40.75 40.66 14.86 5.08 1.11 0.14
"""

# Nalbach 2017, Table A.1: the one material of which both rates are known; its ke was not measured.
TABLE_A_1_STICKERS = """
0.132 | | 0 1.70 11.5 11.5 4.19 1.43 0.31 0.04
0.009 | | 0 7.62 51.6 51.5 18.8 6.43 1.41 0.18
"""

CITATION = "O. Nalbach, Data Acquisition, Reproduction and Manipulation in Screen Space, dissertation, 2017, "
UNIT_OF_KE = (
    "The unit of ke is not settled by the publication. It is read here as a = sum(ke_j E_j dlambda_j) with E the "
    "band means of the lamp, scaled to Euclidean length 1 over the 8 bands (a 3000 K radiator stands for the "
    "halogen lamp): then that lamp charges the eight paints to 0.69..0.91 of saturation; without dlambda it would "
    "be 0.06..0.21, which contradicts the saturation that was observed."
)
WEAK_BANDS = "Excitation in the bands from 512.5 nm up was too weak to measure: 0."
NO_KE = "Excitation was not measured: null."


def presets() -> Iterator[tuple[str, Material]]:
    """Yield (name, material) for every preset."""
    for line in TABLE_8_1.strip().splitlines():
        name, _, row = line.partition(" ")
        yield name, _material(name, [row], "Table 8.1")
    yield "stickers-2", _material("stickers-2", TABLE_A_1_STICKERS.strip().splitlines(), "Table A.1")


def _material(name: str, rows: list[str], table: str) -> Material:
    bands = Bands.uniform()
    kr, ke, emission = zip(*([part.split() for part in row.split("|")] for row in rows), strict=True)
    measured = any(ke)
    lamp = spectra.shape("blackbody:3000", bands, file=Path(__file__), field="lamp")
    return Material(
        name=name,
        bands=bands,
        kr_per_s=np.array(kr, float)[:, 0],
        ke_m2_per_J=np.array([row + ["0"] * 5 if row else ["nan"] * 8 for row in ke], float),
        emission=np.array(emission, float),
        calibration="relative",
        reference_irradiance=spectra.unit_length(lamp),
        valid_s=(0.0, 180.0),
        provenance={
            "citation": CITATION + table,
            "note": f"{UNIT_OF_KE} {WEAK_BANDS}" if measured else NO_KE,
        },
    )


if __name__ == "__main__":
    for name, material in presets():
        material.save(Path(sys.argv[1]) / f"{name}.json")
