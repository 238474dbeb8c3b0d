"""The spectrum of what a calibrated linear variable filter shows: of the lamp, or of a glowing sample.

`strip_equations.py` tells how it follows from the signals along the strip; here sessions are read for it, and what they
lack is said (Nalbach 2017, 8.4.2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phoslab.bands import Bands
from phoslab.errors import PhoslabError
from phoslab.fitting.card import Shading
from phoslab.fitting.find_strip import follow_strip, outline_unseen
from phoslab.fitting.lvf import POSITIONS_NM, Calibration, shading
from phoslab.fitting.strip_equations import NM, SHIFT_PX, StripEquations
from phoslab.fitting.strip_light import StripLight, read_light
from phoslab.raw import preview
from phoslab.session import Frame, Session
from phoslab.strip import Strip

Array = NDArray[np.float64]

UNEVEN, EVEN = 0.03, 0.01
"""How far a spectrum may be wrong over long stretches, as a share of it: lights hang elsewhere than the one of the
calibration did. The second where a frame without the strip has told how evenly the scene is lit."""

_STRETCH_NM = 50.0

_ADAPTED = 2
"""How often bends and the curves' share of the noise are taken from the spectrum before."""

MISSES = 1.5
"""Misfit per degree of freedom that is no chance any more, of the strip's 31 positions in three colours."""

_SEEN = 0.02
"""Share of the best-seen wavelength's weight below which a wavelength is hardly seen."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """A measured spectrum.

    Args:
        nm: (n,) wavelengths.
        value: (n,) relative spectral radiance, 1 at its highest.
        standard_error: (n,) of it.
        scale: what 1 is in the camera's unit.
        covariance: (n, n) of `value`.
        shift_px: by how much the strip was found to have moved along itself.
        scaled_misfit: of the equations, per degree of freedom, in units of their noise.
        at_end: the data do not say how smooth it is.
        measured: (n_k, 3) the signals at the positions, and what the spectrum predicts (n_k, 3).
        plan, session: what it was measured from; and the session's SHA-256.
        simulated: the statement of a simulated session, or None.
        outlined: whether the strip's outline was found in a frame; if not, it is taken to lie where it was calibrated.
        warnings: what spoils the spectrum, one sentence each.
        hidden: the ends of the spectrum at which the camera hardly sees, in a sentence; "" if it sees all.
    """

    nm: Array
    value: Array
    standard_error: Array
    scale: float
    covariance: Array
    shift_px: float
    scaled_misfit: float
    at_end: bool
    measured: Array
    predicted: Array
    plan: str = ""
    session: tuple[str, str] = ("", "")
    simulated: str | None = None
    outlined: bool = True
    warnings: tuple[str, ...] = ()
    hidden: str = ""

    @property
    def farthest_off(self) -> tuple[float, float]:
        """What is missed most, as a share of the largest signal, and the position in nm where."""
        missed = np.nan_to_num(np.abs(self.measured - self.predicted)).max(axis=1)
        k = int(np.argmax(missed))
        return float(missed[k] / np.nanmax(self.measured)), float(POSITIONS_NM[k])

    @property
    def notes(self) -> tuple[str, ...]:
        """What is as usual and yet good to know, one sentence each."""
        unseen = () if self.outlined else (outline_unseen([self.session[0]]),)
        return (*unseen, *([self.hidden] if self.hidden else []))

    def band_means(self, bands: Bands) -> tuple[Array, Array]:
        """(n_λ,) means over bands, and their standard errors."""
        weights = np.stack(
            [
                _overlap(self.nm, low, high)
                for low, high in zip(bands.edges_nm[:-1], bands.edges_nm[1:], strict=True)
            ]
        )
        return weights @ self.value, np.sqrt(
            np.maximum(np.einsum("ij,jk,ik->i", weights, self.covariance, weights), 0)
        )

    @property
    def end_nm(self) -> float | None:
        """The end of what was measured that is within two standard errors of the highest value, in nm, or None.

        Beyond such an end the spectrum may go on rising.
        """
        k = int(np.argmax(self.value))
        for end in (0, self.nm.size - 1):
            spread = self.covariance[k, k] + self.covariance[end, end] - 2 * self.covariance[k, end]
            if self.value[k] - self.value[end] <= 2 * np.sqrt(max(spread, 0.0)):
                return float(self.nm[end])
        return None

    @property
    def peak_nm(self) -> float:
        """Wavelength of the highest value, between the wavelengths by a parabola."""
        k = int(np.argmax(self.value))
        if not 0 < k < self.nm.size - 1:
            return float(self.nm[k])
        a, b, c = self.value[k - 1 : k + 2]
        return float(self.nm[k] + (self.nm[1] - self.nm[0]) * 0.5 * (a - c) / (a - 2 * b + c))


def measure_spectrum(
    path: Path,
    calibration: Calibration,
    *,
    flat: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Spectrum:
    """Measure the spectrum of a session of the plan `lamp` or `emission`.

    Args:
        flat: a session of the same scene without the strip: `flats` for a lamp (if the calibration has not seen it),
            `decay` for a sample.
        progress: called with (frames done, frames in all).

    Raises:
        PhoslabError: the session is of another plan, has no frames or no dark frames; or the calibration has no curves
            or is of another camera or place.
    """
    session = Session.open(path)
    plan = session.header.plan
    if plan not in ("lamp", "emission"):
        raise PhoslabError(
            f"is of the plan {plan!r}",
            file=path,
            remedy="Name a session of the plan 'lamp' or 'emission'.",
        )
    if calibration.curves is None:
        raise PhoslabError(
            "holds wavelengths but no transmission curves, without which no spectrum can be told",
            file="the calibration",
            remedy="Calibrate from a session that has LED frames, and name the LED's spectrum.",
        )
    warnings = list(session.warnings)
    frames = session.frames_of(plan)
    if plan == "emission" and session.lamp_off_s is not None:
        off_s = session.lamp_off_s
        lit = [f for f in frames if f.start_s < off_s]
        frames = tuple(f for f in frames if f.start_s >= off_s)
        if lit:
            warnings.append(f"{len(lit)} frames from before the lamp went off are left out.")
    if not frames:
        raise PhoslabError(
            f"has no {plan} frames",
            file=path,
            remedy="Record the session anew; this one holds nothing to measure.",
        )
    strip, outlined = follow_strip(preview(frames[0].path), calibration.strip)
    lights, said = read_light(session, frames, strip, calibration.settings, progress=progress)
    warnings += said
    if not lights:
        raise PhoslabError(
            f"has no {plan} frame that can be used: {said[0].removesuffix('.') if said else 'none shows the strip'}",
            file=path,
            remedy="Record the session anew, with dark frames at the same settings and without saturation.",
        )
    evenness = None
    if flat is None and plan == "lamp" and calibration.shading is not None:
        evenness = _shaded(calibration.shading, calibration.strip)
    elif flat is None:
        other = "flats" if plan == "lamp" else "decay"
        warnings.append(
            f"How unevenly the {'card is lit' if plan == 'lamp' else 'sample glows'} is taken for a "
            f"part of the spectrum, a few "
            f"per cent from end to end: name a session of the same scene without the strip with --flat "
            f"(of the plan {other!r})."
        )
    else:
        evenness, said = _evenness(flat, calibration)
        warnings += said
    result = reconstruct(lights[0], calibration, evenness)
    if result.scaled_misfit > 4:
        warnings.append(
            f"The three colours do not agree on one spectrum (misfit {result.scaled_misfit:.1f} of what "
            f"noise explains; {_missed(result)}): "
            "the strip, the camera or the scattered light is not what it was at the calibration. Calibrate anew, and "
            "record this again with neither touched in between."
        )
    elif result.scaled_misfit > MISSES:
        warnings.append(
            f"The spectrum misses what the camera saw by more than noise and calibration explain "
            f"({result.scaled_misfit:.1f} times in the mean square; 1 is right): {_missed(result)}. Its errors are "
            "widened by the root of that; what it comes from is not known, so they are a guide and no bounds. If so "
            "much matters, calibrate the filter anew and record this again, strip and camera untouched in between."
        )
    if abs(result.shift_px) > 2 * SHIFT_PX:
        warnings.append(
            f"The strip seems to have moved by {result.shift_px:.1f} pixels along itself since the calibration."
        )
    if result.at_end:
        warnings.append("The data do not say how smooth the spectrum is; the smoothest is taken.")
    hidden = _hidden(calibration)
    return Spectrum(
        **{
            **vars(result),
            "plan": plan,
            "session": (session.path.resolve().name, session.digest),
            "simulated": (session.header.simulated or {}).get("statement"),
            "outlined": outlined,
            "warnings": tuple(dict.fromkeys(warnings)),
            "hidden": hidden
            and f"The camera hardly sees {hidden}: a spectrum is little more than a continuation there.",
        }
    )


def reconstruct(light: StripLight, calibration: Calibration, evenness: Array | None = None) -> Spectrum:
    """Solve for the spectrum of light along the strip.

    Args:
        evenness: (n,) how evenly the scene is lit without the strip, mean 1; None: evenly.

    Raises:
        PhoslabError: fewer than three positions are seen.
    """
    assert calibration.curves is not None
    even = np.ones(light.signal.shape[0]) if evenness is None else evenness
    equations = StripEquations(calibration, light.signal / even[:, None], light.sigma / even[:, None])
    solution = equations.solve(0.0)
    shift = equations.shift(solution)
    for _ in range(_ADAPTED):
        equations.adapt(solution)
        solution = equations.solve(shift)
    top = float(solution.x.max())
    if not (solution.x > 3 * solution.standard_error).any():
        raise PhoslabError(
            "shows no light along the strip that stands out from its noise",
            file="the session",
            remedy="Expose longer, and check that the strip lies before the camera.",
        )
    value = solution.x / top
    together = np.exp(-0.5 * ((NM[:, None] - NM) / _STRETCH_NM) ** 2)
    long = (UNEVEN if evenness is None else EVEN) ** 2 * np.outer(value, value) * together
    covariance = solution.covariance / top**2 + long
    return Spectrum(
        nm=NM,
        value=value,
        standard_error=np.sqrt(np.diag(covariance)),
        scale=top,
        covariance=covariance,
        shift_px=shift,
        scaled_misfit=solution.scale,
        at_end=solution.at_end,
        measured=equations.measured(shift),
        predicted=equations.response @ solution.x,
    )


def _evenness(path: Path, calibration: Calibration) -> tuple[Array | None, list[str]]:
    """How evenly the scene is lit without the strip, from the first frames of another session."""
    session = Session.open(path)
    role = {"flats": "flat", "decay": "decay", "lvf": "flat"}.get(session.header.plan)
    if role is None:
        raise PhoslabError(
            f"is of the plan {session.header.plan!r}",
            file=path,
            remedy="Name one of the scene without the strip: of the plan 'flats' for a lamp, 'decay' for a sample.",
        )
    frames: tuple[Frame, ...] = session.frames_of(role)
    if role == "decay" and session.lamp_off_s is not None:
        frames = tuple(f for f in frames if f.start_s >= session.lamp_off_s)
    same = [f for f in frames if frames and (f.exposure_s, f.iso) == (frames[0].exposure_s, frames[0].iso)][
        :4
    ]
    lights, said = read_light(session, same, calibration.strip, calibration.settings, scattered=False)
    if not lights:
        return None, [*said, f"{path}: has no frame that says how evenly the scene is lit."]
    return shading(lights[0], 4 if role == "flat" else 12), said


def _shaded(shading: Shading, strip: Strip) -> Array:
    """(n,) how evenly the card shows along the strip, mean 1, as flats have told."""
    value = shading.at(*strip.middle())
    return np.asarray(value / value.mean())


def _missed(result: Spectrum) -> str:
    """What the spectrum misses most, for a message."""
    share, nm = result.farthest_off
    return f"by at most {share:.2%} of the largest signal, at {nm:g} nm"


def _hidden(calibration: Calibration) -> str:
    """The ends at which the camera hardly sees anything, for a message."""
    weight = calibration.sensitivities.at(NM).max(axis=1)
    seen = np.flatnonzero(weight > _SEEN * weight.max())
    ends = []
    if seen[0] > 0:
        ends.append(f"below {NM[seen[0]]:g} nm")
    if seen[-1] < NM.size - 1:
        ends.append(f"above {NM[seen[-1]]:g} nm")
    return " and ".join(ends)


def _overlap(nm: Array, low: float, high: float) -> Array:
    """(n,) weights of values at `nm`, joined by straight lines, in their mean from `low` to `high`."""
    fine = low + (np.arange(200) + 0.5) * (high - low) / 200
    return np.asarray(np.maximum(0.0, 1 - np.abs(fine[:, None] - nm) / (nm[1] - nm[0])).mean(axis=0))
