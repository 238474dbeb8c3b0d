"""Samples of the bench from RAW frames to a material, and that beside what the bench knows.

Pictures: ΔE00 between the material and photographs that no fit has seen (Nalbach 2017, Fig. 8.13). A sample that was at
rest is charged anew and photographed without noise 0, 0.01 and 20 s after the lamp has faded, at moments that the
decay's frames do not have. The material is charged by the same lamp, its radiance goes through the camera's
sensitivities band by band, and both become colours by one matrix; white is the photograph's brightness. The camera's
unit stands between camera and material, as an aperture that is a little off what is written on it makes it: one factor
for the three pictures of a sample, the only thing that is adjusted. How brightness changes and every colour are the
fit's.

Excitation: how far the level after the longest exposure is missed, how the modelled rise compares with the measured
one, and which light excites, as shares: a distribution of traps has no ke, but light in a band sets electrons free.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from phoslab import kinetics, spectra
from phoslab.app.trades.fit_bench import CHARGE_S, SEED, Recorded
from phoslab.bands import Bands
from phoslab.fitting import fit_session
from phoslab.fitting.lvf_file import load
from phoslab.fitting.result import FitResult
from phoslab.fitting.sensitivities import Sensitivities
from phoslab.instruments.bench.darkroom import NM, Darkroom, Stage
from phoslab.instruments.bench.sample import Sample
from phoslab.instruments.bench.samples import sample
from phoslab.instruments.bench.states import StatePaint
from phoslab.material import Material

Array = NDArray[np.float64]
States: TypeAlias = int | str

AT_S = (0.0, 0.01, 20.0)
"""After the lamp has faded."""

_FADE_S = 0.32
_PAPER = Bands.uniform()
"""The bands of the paper, in which shares of excitation are told."""


@dataclass(frozen=True, eq=False)
class Seen:
    """A material beside photographs: its number of states, (3,) ΔE00 and the unit's factor."""

    n_states: int
    delta_e: Array
    factor: float


@dataclass(frozen=True, eq=False)
class Excited:
    """What the excitation fit of a sample says, and the truth.

    Args:
        level, level_worst: by how much the level is missed, of the bright places; median and worst.
        rise_s, rise_ratio: light to half of the level, measured, and modelled as a share of it; medians.
        share, true_share: (8,) part of each band in what the whole lamp excites.
        discrepancy: 0 where the sample follows the model; see `ExcitationFit`.
        rate_error: (n_c,) relative error of kr, of a sample that has states; None: of one that has not as many.
    """

    level: float
    level_worst: float
    rise_s: float
    rise_ratio: float
    share: Array
    true_share: Array
    discrepancy: float
    rate_error: Array | None


@dataclass(frozen=True, eq=False)
class Judged:
    """A sample's materials by the number of states that was asked for, and the excitation of the automatic one."""

    name: str
    seen: dict[str, Seen]
    excited: Excited


def judge(recorded: Recorded, states: tuple[States, ...], k: int) -> Judged:
    """Record the `k`th sample, fit it with each number of states, "auto" last, and compare."""
    name = recorded.samples[k]
    folder = recorded.record(name)
    sensitivities = load(recorded.lvf)[0].sensitivities
    room = Darkroom(SEED, sample(name))
    photographs = _photographs(room, CHARGE_S)
    seen = {}
    for wanted in states:
        result = fit_session([recorded.rig / "lamp", folder], lvf=recorded.lvf, states=wanted)
        shown = _pictures(result.material, sensitivities, CHARGE_S)
        factor = float(np.exp(np.mean(np.log(photographs[:, 1] / shown[:, 1]))))
        matrix = _to_xyz(sensitivities)
        seen[f"{wanted}"] = Seen(result.fit.n_states, _delta_e(photographs, factor * shown, matrix), factor)
    return Judged(name, seen, _excited(result, room))


def _photographs(room: Darkroom, charge_s: float) -> Array:
    """(n_times, 3) what a perfect camera sees of a rested sample, charged for `charge_s` and left in the dark.

    In DN of 1 s at ISO 100 and f/1, of the sample's mean.
    """
    room.place(0.0, Stage("sample"))
    room.lamp.switch(10.0, True)
    off_s = 10.0 + charge_s
    room.lamp.switch(off_s, False)
    light = np.array(room.afterglow(1, [off_s + _FADE_S + t for t in AT_S]))
    camera = room.camera
    unit = camera.exposure_e / camera.full_scale_e * camera.full_scale_dn
    return np.asarray(unit * light[:, None] * (room.sample.emission(NM) @ room.sensitivity))


def _pictures(material: Material, sensitivities: Sensitivities, charge_s: float) -> Array:
    """(n_times, 3) what the material shows to the same camera, charged by its own lamp."""
    assert material.reference_irradiance is not None
    r = kinetics.advance(material, np.zeros(material.n_states), material.reference_irradiance, charge_s)
    means = spectra.band_means(lambda nm: sensitivities.at(nm).T, material.bands)
    response = means * material.bands.widths_nm
    faded = [r * np.exp(-material.kr_per_s * (_FADE_S + t)) for t in AT_S]
    return np.array([response @ kinetics.emitted_radiance(material, left) for left in faded])


def _delta_e(measured: Array, rendered: Array, matrix: Array) -> Array:
    """(n_times,) ΔE00 of camera RGB (n_times, 3); white is each photograph's own brightness."""
    import colour

    def lab(rgb: Array, white: float) -> Array:
        return np.asarray(colour.XYZ_to_Lab(rgb @ matrix.T / white, illuminant=np.array([1 / 3, 1 / 3])))

    # Each picture is exposed as its photograph asks for: a glow at 20 s would be black beside that at 0 s.
    found = []
    for photo, picture in zip(measured, rendered, strict=True):
        white = float((photo @ matrix.T)[1])
        found.append(float(colour.delta_E(lab(photo, white), lab(picture, white), method="CIE 2000")))
    return np.array(found)


def _to_xyz(sensitivities: Sensitivities) -> Array:
    """(3, 3) the matrix that takes camera RGB nearest to XYZ for smooth spectra."""
    import colour

    nm = np.arange(400.0, 701.0, 2.0)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    cmfs = np.stack([np.interp(nm, observer.wavelengths, observer.values[:, k]) for k in range(3)], axis=1)
    return np.asarray(np.linalg.lstsq(sensitivities.at(nm), cmfs, rcond=None)[0].T)


def _excited(result: FitResult, room: Darkroom) -> Excited:
    measured = result.excitation
    assert measured is not None, result.missing
    fit, lamp = measured.fit, result.material.reference_irradiance
    stored = _in_paper_bands(fit.product.sum(axis=0) * lamp, fit.bands)
    freed = room.light(Stage()) * room.sample.excitation(NM)
    inside = (NM[:, None] >= _PAPER.edges_nm[:-1]) & (NM[:, None] < _PAPER.edges_nm[1:])
    truth = freed @ inside
    off = np.abs(fit.level_error[np.isfinite(fit.level_error)])
    return Excited(
        level=float(np.median(off)),
        level_worst=float(off.max()),
        rise_s=float(np.nanmedian(fit.rise_s[:, 0])),
        rise_ratio=fit.rise_ratio,
        share=stored / stored.sum(),
        true_share=truth / truth.sum(),
        discrepancy=fit.discrepancy,
        rate_error=_rate_error(fit.kr_per_s, room.sample),
    )


def _rate_error(kr_per_s: Array, truth: Sample) -> Array | None:
    if not isinstance(truth, StatePaint) or len(truth.kr_per_s) != kr_per_s.size:
        return None
    return np.asarray(kr_per_s / np.array(truth.kr_per_s) - 1)


def _in_paper_bands(values: Array, bands: Bands) -> Array:
    """Sums (8,) over bands that cut each of the paper's into equal parts."""
    return np.asarray((values * bands.widths_nm).reshape(_PAPER.n, -1).sum(axis=1))
