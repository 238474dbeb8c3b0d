"""The spectrum of what a calibrated linear variable filter shows: of the lamp, or of a glowing sample.

Each of the positions k is seen in three channels c, y_kc = ∫ T_k(λ) S_c(λ) L(λ) dλ, with T_k and S_c
known: some 93 equations
for L at 61 wavelengths, solved without negative values and as smooth as the data say (Nalbach 2017, 8.4.2).
A hand that has put the strip down anew has moved it along itself by some tenth of a millimetre, that is by some tenths
of a nanometre. The three channels see one spectrum only if it is read at the right places, which tells by how much.
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
from phoslab.fitting.find_strip import follow_strip
from phoslab.fitting.lvf import POSITIONS_NM, Calibration, positions, shading
from phoslab.fitting.lvf_curves import GRID_NM
from phoslab.fitting.regularised import Normal, Solution, second_differences, solve
from phoslab.fitting.strip_light import StripLight, read_light
from phoslab.raw import preview
from phoslab.session import Frame, Session
from phoslab.strip import Strip

Array = NDArray[np.float64]

NM = np.arange(400.0, 701.0, 5.0)
"""Wavelengths of a spectrum."""

BELIEF = 0.004
"""How well a calibration describes another measurement, as a share of the signal: repeated settings, moved lights."""

UNEVEN, EVEN = 0.03, 0.01
"""How far a spectrum may be wrong over long stretches, as a share of it: lights hang elsewhere than the one of the
calibration did. The second where a frame without the strip has told how evenly the scene is lit."""

_STRETCH_NM = 50.0

BENDS_NM, STRAIGHT = 12.0, 0.1
"""Over so much bends are alike, half the width of what the strip passes; and how much of the strongest is expected
where nothing bends."""

_ADAPTED = 2
"""How often bends and the curves' share of the noise are taken from the spectrum before."""

_SHIFT_PX = 1.0
"""Standard deviation of a strip's place along itself, before the colours are looked at."""

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
        warnings: one sentence each.
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
    warnings: tuple[str, ...] = ()

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
    strip, found = follow_strip(preview(frames[0].path), calibration.strip)
    if not found:
        warnings.append(
            f"{frames[0].path}: too little of the strip is lit to find its edges; they are taken to be "
            f"where they were calibrated."
        )
    lights, said = read_light(session, frames, strip, calibration.settings, progress=progress)
    warnings += said
    if not lights:
        raise PhoslabError(
            f"has no {plan} frame that can be used: {said[0] if said else 'none shows the strip'}",
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
            f"noise explains): "
            "the strip, the camera or the scattered light is not what it was at the calibration."
        )
    if abs(result.shift_px) > 2 * _SHIFT_PX:
        warnings.append(
            f"The strip seems to have moved by {result.shift_px:.1f} pixels along itself since the calibration."
        )
    if result.at_end:
        warnings.append("The data do not say how smooth the spectrum is; the smoothest is taken.")
    hidden = _hidden(calibration)
    if hidden:
        warnings.append(f"The camera hardly sees {hidden}: values there are little more than a continuation.")
    return Spectrum(
        **{
            **vars(result),
            "plan": plan,
            "session": (session.path.resolve().name, session.digest),
            "simulated": (session.header.simulated or {}).get("statement"),
            "warnings": tuple(dict.fromkeys(warnings)),
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
    equations = _Equations(calibration, light.signal / even[:, None], light.sigma / even[:, None])
    solution = equations.solve(0.0)
    shift, shift_error = equations.shift(solution)
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


class _Equations:
    """The equations of light along a strip that may have moved along itself; what is known of the light sharpens them.

    Args:
        signal, sigma: (n, 3) at the strip's nodes, as if the scene were lit evenly.
    """

    def __init__(self, calibration: Calibration, signal: Array, sigma: Array) -> None:
        assert calibration.curves is not None
        self.calibration, self.curves = calibration, calibration.curves
        self.signal, self.sigma = signal, sigma
        self.hats = np.maximum(0.0, 1 - np.abs(GRID_NM[:, None] - NM) / (NM[1] - NM[0]))
        self.hats[:, 0] = np.where(GRID_NM < NM[0], 1.0, self.hats[:, 0])  # beyond the ends it is as at them
        self.hats[:, -1] = np.where(GRID_NM > NM[-1], 1.0, self.hats[:, -1])
        self.seen = calibration.sensitivities.at(GRID_NM)
        curve = np.nan_to_num(self.curves.curve)
        step = GRID_NM[1] - GRID_NM[0]
        self.response = np.einsum("kn,nc,nj->kcj", curve, self.seen, self.hats) * step
        self.bends = second_differences(NM.size)
        self.penalty = self.bends.T @ self.bends
        self.from_curves: Array | None = None

    def read(self, shift_px: float) -> tuple[Array, Array]:
        """(n_k, 3) the signals at the positions, and their noise, infinite where nothing is seen.

        Raises:
            PhoslabError: fewer than three positions are seen.
        """
        weights = self.calibration.reading(shift_px)
        there = np.isfinite(weights).all(axis=1) & np.isfinite(self.curves.curve).all(axis=1)
        y, noise = (
            np.asarray(v)[:, 0] for v in positions([self.signal], [self.sigma], np.nan_to_num(weights))
        )
        noise = np.where(there[:, None], noise, np.inf)
        if np.isfinite(noise).any(axis=1).sum() < 3:
            raise PhoslabError(
                "shows fewer than three positions that are calibrated and not saturated",
                file="the session",
                field="the strip",
                remedy="Expose it shorter, and calibrate with the strip where it is now.",
            )
        return y, noise

    def measured(self, shift_px: float) -> Array:
        """(n_k, 3) the signals at the positions; NaN where nothing is seen."""
        y, noise = self.read(shift_px)
        return np.where(np.isfinite(noise), y, np.nan)

    def normal(self, shift_px: float) -> Normal:
        """The equations, weighted."""
        y, noise = self.read(shift_px)
        variance = noise**2 + (BELIEF * y) ** 2
        between = self.from_curves
        if between is None:  # no spectrum is known yet to see the curves' errors by
            variance = variance + (self.curves.misfit * y.max(axis=1, keepdims=True)) ** 2
            between = np.zeros((*y.shape, 3))
        return Normal.correlated(self.response, y, between + variance[:, :, None] * np.eye(3))

    def solve(self, shift_px: float) -> Solution:
        return solve(self.normal(shift_px), self.penalty)

    def adapt(self, solution: Solution) -> None:
        """Expect the spectrum to bend where it was found to, and the errors that the curves make of it.

        As penalties that vary over a curve are found from a first fit (Ruppert and Carroll 2000,
        doi 10.1111/1467-842X.00119).
        """
        at = NM[1:-1]
        near = np.exp(-0.5 * ((at[:, None] - at) / BENDS_NM) ** 2)
        bend = near @ (self.bends @ solution.x) ** 2 / near.sum(axis=1)
        weight = 1 / (bend / max(float(bend.max()), 1e-300) + STRAIGHT**2)
        self.penalty = self.bends.T @ (weight[:, None] * self.bends)
        light = self.seen * (self.hats @ solution.x)[:, None]
        self.from_curves = self.curves.signal_covariance(POSITIONS_NM, light)

    def shift(self, first: Solution) -> tuple[float, float]:
        """The shift at which the three colours agree best, as far as they say anything: a parabola through three.

        Returns:
            It and its standard error, in pixels.
        """
        tried = np.linspace(-2.0, 2.0, 9)

        def badness(shift: float) -> float:
            normal = self.normal(shift)
            x = np.linalg.solve(normal.matrix + first.strength * self.penalty, normal.right)
            total = normal.misfit(x) + first.strength * float(x @ self.penalty @ x)
            return total / max(1.0, first.scale) + (shift / _SHIFT_PX) ** 2

        scores = np.array([badness(s) for s in tried])
        k = int(np.clip(np.argmin(scores), 1, tried.size - 2))
        a, b, c = scores[k - 1 : k + 2]
        step = tried[1] - tried[0]
        bend = max((a - 2 * b + c) / step**2, 2 / _SHIFT_PX**2)
        return float(np.clip(tried[k] + 0.5 * (a - c) / step / bend, -2.5, 2.5)), float(np.sqrt(2 / bend))


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


__all__ = ["NM", "POSITIONS_NM", "Spectrum", "measure_spectrum", "reconstruct"]
