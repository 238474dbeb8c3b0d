"""Sessions to a material: rates from the decay, spectrum from the emission, excitation from the excitation series.

Each part is measured if its session and a calibration are there, else lent by a preset if one is named, else left out;
what was not measured is said first, with how to get it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import phoslab
from phoslab import presets, spectra
from phoslab.bands import Bands
from phoslab.errors import PhoslabError, printable
from phoslab.fitting import excitation_report
from phoslab.fitting.decay import MOST_STATES, DecayFit, fit_decay
from phoslab.fitting.emission import match_colour, re_radiation, smoothest
from phoslab.fitting.excitation import fit_excitation
from phoslab.fitting.excitation_series import charged_s, reduce_excitation
from phoslab.fitting.find_strip import outline_unseen
from phoslab.fitting.gather import Gathered, gather
from phoslab.fitting.holdout import hold_out
from phoslab.fitting.intervals import rate_intervals
from phoslab.fitting.lamp_light import NM as LAMP_NM
from phoslab.fitting.lamp_light import lamp_light
from phoslab.fitting.lvf import Calibration, calibrate
from phoslab.fitting.lvf_file import load
from phoslab.fitting.measured_camera import MeasuredCamera, measure_camera
from phoslab.fitting.reduction import ReducedDecay, reduce_decay
from phoslab.fitting.result import FitResult, MeasuredExcitation
from phoslab.fitting.screening import no_decay
from phoslab.fitting.selection import select
from phoslab.fitting.sensitivities import Sensitivities
from phoslab.fitting.spectrum import Spectrum, measure_spectrum
from phoslab.kinetics import excitation
from phoslab.material import Material
from phoslab.session import Session

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

# More than noise explains: camera responses and emission spectra agree better than this when they belong together.
_COLOUR_MISMATCH = 0.05
_FEW_DOF = 10
OWN_BANDS = 24
"""Of a material with a spectrum of its own: half as wide as what the strip passes. As many as the paper has, 8, would
miss the camera's colours of the bench's paints by 2 to 9 %, these by 1 to 3 %."""

_AUTOMATIC = (1, 2, 3)
"""What a session of some minutes is fitted with unless more is asked for."""


def fit_session(
    paths: Sequence[str | os.PathLike[str]],
    *,
    lvf: str | os.PathLike[str] | None = None,
    preset: str | None = None,
    states: int | str = "auto",
    name: str | None = None,
    progress: Progress | None = None,
) -> FitResult:
    """Fit a material to recorded sessions (Nalbach 2017, 8.4.3 to 8.4.6).

    Args:
        paths: folders of sessions in any order, and folders of such; one of a decay must be among them.
        lvf: a calibration of the linear variable filter; None: from the sessions of the plans `lvf` and `flats`.
        preset: the material that lends what was not measured: excitation rates (its first state's row, for every
            state) with the lamp they refer to, and the shape of the emission spectrum.
        states: 1 to 4, or "auto" for a choice of 1 to 3 by F-test.
        name: of the material; by default the sample's.
        progress: called with (frames done, frames in all) of each step.

    Raises:
        PhoslabError: there is no decay, or it or an argument is not usable. What else is wrong is said in the result.
    """
    if states != "auto" and states not in range(1, MOST_STATES + 1):
        raise PhoslabError(f"is {states!r}", field="states", remedy=f"Use auto, or 1 to {MOST_STATES}.")
    lender = None if preset is None else presets.preset(preset)
    told = gather(paths)
    session = told.get("decay")
    if session is None:
        raise PhoslabError(
            f"has sessions of the plans {', '.join(told.by_plan)} and none of a decay: without it there are no rates",
            field="the fit",
            remedy="Name one that `phoslab measure decay` recorded; `phoslab spectrum` needs none.",
        )
    job = _Job(told, session, lender, preset, progress)
    calibration, source = job.calibration(lvf)
    camera = job.camera(calibration)
    sensitivities = _sensitivities(session, calibration)
    reduced = reduce_decay(session, progress, camera)
    unseen = _no_decay(reduced, session)
    tried = _AUTOMATIC if states == "auto" else (int(states),)
    selection = select(reduced.data, states=tried, offsets=[False], rank_one=True)
    chosen = selection.chosen
    fit = fit_decay(reduced.data, chosen.n_states, near=[chosen.fit.theta[: chosen.n_states]])
    bands = Bands.uniform(OWN_BANDS) if lender is None else lender.bands
    measured = job.excitation(calibration, camera, reduced, fit, bands)
    spectrum = job.spectrum(calibration)

    shape, shape_error, seen = _shape(spectrum, lender, fit, sensitivities, bands)
    beta, mismatch = match_colour(fit.colour, seen)
    rates = _rates(measured, lender, session, fit, bands)
    if measured is None:
        kr, kr_error = fit.kr_per_s, fit.kr_standard_error
        emission, emission_error = re_radiation(fit, shape, beta, rates.initial)
    else:
        kr = measured.fit.kr_per_s
        # Where the sample does not follow the model the decay was held: its rates stay as they are, and their errors.
        kr_error = (
            fit.kr_standard_error
            if measured.fit.discrepancy
            else kr * np.sqrt(np.diag(measured.fit.covariance)[: kr.size])
        )
        gain = measured.fit.amplitude / (kr * measured.fit.initial)
        emission = beta * gain[:, None] * shape
        emission_error = emission * measured.fit.gain_error[:, None]
    # The spectrum's own error comes on top.
    per_state = emission.sum(axis=1) / shape.sum()
    emission_error = np.hypot(emission_error, per_state[:, None] * shape_error)

    # What spoils the material most stands first: wrong sessions, then a model that misses, then the frames.
    warnings = [
        *told.warnings,
        *unseen,
        *_doubts(fit, mismatch, "measured" if spectrum is not None else preset),
    ]
    if measured is not None:
        warnings += excitation_report.doubts(measured.fit)
    warnings += [*reduced.warnings, *job.warnings]
    assumed = _assumed(measured, spectrum, preset, session)
    known = {"kr_per_s": kr_error, "emission": emission_error, "ke_m2_per_J": rates.error}
    camera_name = sensitivities.name
    material = Material(
        name=name or printable(session.header.sample_name),
        bands=bands,
        kr_per_s=kr,
        ke_m2_per_J=rates.ke,
        ke_upper_limit=rates.upper,
        emission=emission,
        calibration="relative",
        reference_irradiance=rates.lamp,
        standard_error={k: v.tolist() for k, v in known.items() if v is not None and np.isfinite(v).all()}
        or None,
        covariance=_covariance(fit, reduced.data.channels),
        valid_s=(max(0.0, reduced.data.begin_s), reduced.data.end_s),
        provenance={
            "sessions": [
                {"name": s.path.resolve().name, "plan": s.header.plan, "sha256": s.digest} for s in job.used
            ],
            "calibration": source,
            "software": f"phoslab {phoslab.__version__}",
            "settings": {"states": states, "preset": preset, "camera": camera_name},
            "radiance_unit": f"DN per second at ISO 100 and f/1 of {camera_name}",
            "assumed": assumed,
            # Without excitation measured nothing tells how full the states were.
            "product_only": list(range(fit.n_states))
            if measured is None
            else np.flatnonzero(measured.fit.product_only).tolist(),
            "simulated": any(s.header.simulated is not None for s in job.used),
        },
    )
    return FitResult(
        material=material,
        fit=fit,
        selection=selection,
        interval95=rate_intervals(fit),
        reduced=reduced,
        held_out=tuple(hold_out(reduced.data, tried)),
        assumed=assumed,
        missing=tuple(job.missing),
        warnings=tuple(dict.fromkeys(warnings)),
        notes=job.notes(),
        spectrum=spectrum,
        excitation=measured,
    )


class _Job:
    """What is there to fit; collects on its way what is missing, and what to warn of."""

    def __init__(
        self,
        told: Gathered,
        decay: Session,
        lender: Material | None,
        preset: str | None,
        progress: Progress | None,
    ) -> None:
        self.told, self.decay, self.lender, self.progress = told, decay, lender, progress
        self.instead = "--preset NAME lends it" if preset is None else f"the preset {preset!r} lends it"
        self.used = [decay]
        self.missing: list[str] = []
        self.warnings: list[str] = []
        self._hidden: list[str] = []
        self._not_outlined: list[str] = []

    def notes(self) -> tuple[str, ...]:
        """What is as usual and yet good to know, one sentence each; never the same twice."""
        unseen = [outline_unseen(self._not_outlined)] if self._not_outlined else []
        return (*dict.fromkeys(self._hidden), *unseen)

    def calibration(
        self, lvf: str | os.PathLike[str] | None
    ) -> tuple[Calibration | None, dict[str, Any] | None]:
        """The filter's calibration and where it is from: the file named, else the sessions themselves.

        Raises:
            PhoslabError: the file cannot be read.
        """
        if lvf is not None:
            found, digest = load(Path(lvf))
            return found, {"name": Path(lvf).name, "sha256": digest}
        recorded, flats = self.told.get("lvf"), self.told.get("flats")
        if recorded is None:
            return None, None
        paths = [s.path for s in (recorded, flats) if s is not None]
        try:
            found = calibrate(paths, progress=self.progress)
        except PhoslabError as error:
            self.missing.append(f"the filter's calibration: {error}")
            return None, None
        self.warnings += found.warnings
        return found, {"sessions": [{"name": n, "sha256": h} for n, _, h in found.sessions]}

    def camera(self, calibration: Calibration | None) -> MeasuredCamera:
        """What flats have told of the camera, by the calibration or a session."""
        if calibration is not None and calibration.settings_misfit is not None:
            return calibration.body
        flats = self.told.get("flats")
        if flats is not None:
            try:
                found = measure_camera(flats, self.progress)
            except PhoslabError as error:
                self.missing.append(f"what the camera's settings really are: {error}")
            else:
                self.used.append(flats)
                self.warnings += found.warnings
                return found
        self.warnings.append(
            "No flats told what the camera's exposure times, ISO and apertures really are: they count as the powers of "
            "two that their numbers stand for, to some per cent. `phoslab measure flats` tells."
        )
        return MeasuredCamera()

    def spectrum(self, calibration: Calibration | None) -> Spectrum | None:
        """The spectrum of the glow, or None and why."""
        return self._spectrum(
            "emission", calibration, self.decay, "the spectrum of the glow", spectra_of="glow"
        )

    def _spectrum(
        self, plan: str, calibration: Calibration | None, flat: Session | None, what: str, spectra_of: str
    ) -> Spectrum | None:
        session = self.told.get(plan)
        if session is None:
            how = f"record it with `phoslab measure {plan}`"
            how += "" if calibration is not None else " and the filter with `phoslab measure lvf`"
            self._lack(what, f"no session of the plan {plan!r} is among those named; {how}.")
            return None
        if calibration is None:
            self._lack(what, _NO_CALIBRATION)
            return None
        try:
            found = measure_spectrum(
                session.path, calibration, flat=None if flat is None else flat.path, progress=self.progress
            )
        except PhoslabError as error:
            self._lack(what, str(error))
            return None
        self.used.append(session)
        self.warnings += [f"Spectrum of the {spectra_of}: {text}" for text in found.warnings]
        self._hidden += [found.hidden] if found.hidden else []
        self._not_outlined += [] if found.outlined else [found.session[0]]
        return found

    def excitation(
        self,
        calibration: Calibration | None,
        camera: MeasuredCamera,
        reduced: ReducedDecay,
        fit: DecayFit,
        bands: Bands,
    ) -> MeasuredExcitation | None:
        """The excitation rates, or None and why."""
        what = "excitation rates (ke)"
        session = self.told.get("excitation")
        if session is None:
            self._lack(
                what,
                "no session of the plan 'excitation' is among those named; record it with `phoslab measure "
                "excitation`, and the lamp's spectrum with `phoslab measure lamp`.",
            )
            return None
        if calibration is None:
            self._lack(what, _NO_CALIBRATION)
            return None
        flats = self.told.get("flats") if calibration.shading is None else None
        seen = self._spectrum("lamp", calibration, flats, "the lamp's spectrum, which ke refers to", "lamp")
        if seen is None:
            return None
        lamp = lamp_light(seen)
        means = spectra.band_means(lambda nm: np.interp(nm, LAMP_NM, lamp.irradiance), bands)
        lamp = replace(lamp, irradiance=lamp.irradiance / np.linalg.norm(means))
        try:
            series = reduce_excitation(
                session, self.decay, reduced, fit, calibration, lamp, camera, bands, self.progress
            )
            # A paint of one pigment: what fills its states is absorbed alike, as what empties them glows alike.
            found = fit_excitation(series.data, series.charge, common_shape=True)
        except PhoslabError as error:
            self._lack(what, str(error))
            return None
        self.used.append(session)
        self.warnings += series.warnings
        self._not_outlined += [] if series.outlined else [session.path.name]
        return MeasuredExcitation(found, series, lamp)

    def _lack(self, what: str, why: str) -> None:
        self.missing.append(f"{what}: {why.removesuffix('.')}; {self.instead}.")


_NO_CALIBRATION = (
    "there is no calibration of the filter; name one with --lvf (`phoslab calibrate` makes it), or add the session of "
    "`phoslab measure lvf`"
)


def _sensitivities(session: Session, calibration: Calibration | None) -> Sensitivities:
    """The camera's: as calibrated, else as the session names them."""
    if calibration is not None:
        return calibration.sensitivities
    camera = session.header.sensitivities
    if camera is None:
        raise PhoslabError(
            "does not name the camera's spectral sensitivities",
            file=session.path / "session.toml",
            field="camera.sensitivities",
            remedy="Name a camera of colour-science: signal cannot be turned into a spectrum without.",
        )
    return Sensitivities.of(camera, file=session.path / "session.toml")


def _shape(
    spectrum: Spectrum | None,
    lender: Material | None,
    fit: DecayFit,
    sensitivities: Sensitivities,
    bands: Bands,
) -> tuple[Array, Array, Array]:
    """Return the emission's shape (n_λ,), largest 1, its standard error, and what the camera makes of it (3,)."""
    response = spectra.band_means(lambda nm: sensitivities.at(nm).T, bands) * bands.widths_nm
    if spectrum is not None:
        means, errors = spectrum.band_means(bands)
        fine = np.interp(_FINE_NM, spectrum.nm, spectrum.value)
        seen = fine @ sensitivities.at(_FINE_NM)
        return means / means.max(), errors / means.max(), np.asarray(seen / means.max())
    if lender is not None:
        shape = lender.kr_per_s @ lender.emission
        shape = shape / shape.max()
    else:
        shape = smoothest(fit.colour, response)
    return shape, np.zeros(bands.n), response @ shape


_FINE_NM = np.arange(400.0, 701.0)


@dataclass(frozen=True, eq=False)
class _Rates:
    """Excitation rates as the material takes them.

    Args:
        ke: (n_c, n_λ); NaN: never measured.
        upper, error: the same shape, or None.
        lamp: (n_λ,) the light that they refer to, or None.
        initial: (n_c,) how full each state was when the lamp went off.
    """

    ke: Array
    upper: Array | None
    error: Array | None
    lamp: Array | None
    initial: Array


def _rates(
    measured: MeasuredExcitation | None,
    lender: Material | None,
    session: Session,
    fit: DecayFit,
    bands: Bands,
) -> _Rates:
    if measured is not None:
        found = measured.fit
        lamp = spectra.band_means(lambda nm: np.interp(nm, LAMP_NM, measured.lamp.irradiance), bands)
        upper = found.ke_upper_limit if np.isfinite(found.ke_upper_limit).any() else None
        return _Rates(found.ke_m2_per_J, upper, found.ke_standard_error, lamp, found.initial)
    full = np.ones(fit.n_states)
    if lender is None:
        return _Rates(np.full((fit.n_states, bands.n), np.nan), None, None, None, full)
    ke = np.repeat(lender.ke_m2_per_J[:1], fit.n_states, axis=0)
    if lender.reference_irradiance is None or np.isnan(ke).any():
        return _Rates(ke, None, None, lender.reference_irradiance, full)
    # So rendered after the same charge under that lamp, the glow starts where it was measured.
    a = np.repeat(excitation(lender, lender.reference_irradiance)[:1], fit.n_states)
    speed = a + fit.kr_per_s
    initial = a / speed * -np.expm1(-speed * charged_s(session))
    return _Rates(ke, None, None, lender.reference_irradiance, initial)


def _assumed(
    measured: MeasuredExcitation | None, spectrum: Spectrum | None, preset: str | None, session: Session
) -> str:
    """What was not measured, in a sentence or two."""
    lent = [
        text
        for text, missing in (
            ("excitation rates and lamp", measured is None),
            ("the shape of the emission spectrum", spectrum is None),
        )
        if missing
    ]
    if not lent:
        said = "rates, spectrum and excitation rates were all measured."
    elif preset is not None:
        said = f"{' and '.join(lent)} are those of the preset {preset!r}, not measured."
        if measured is None:
            said += " How full each state was when the lamp went off is computed from those rates."
    else:
        parts = []
        if measured is None:
            parts.append(
                "excitation rates were not measured and are left out, so that this material cannot be lit; every state "
                "is taken to have been full (r = 1) when the lamp went off"
            )
        if spectrum is None:
            parts.append(
                "the spectrum was not measured: it is the smoothest one of the colour that the camera saw, a guess"
            )
        said = "; ".join(parts) + "."
    return said + (" The session is simulated." if session.header.simulated is not None else "")


def _no_decay(reduced: ReducedDecay, session: Session) -> list[str]:
    """Say which channels hold no decay.

    Raises:
        PhoslabError: none does; the error says why.
    """
    data = reduced.data
    reasons = {
        name: reason
        for name, signal, sigma in zip(data.channels, data.signal.T, data.sigma.T, strict=True)
        if (reason := no_decay(data.t_s, signal, sigma)) is not None
    }
    text = "; ".join(f"{name} {reason}" for name, reason in reasons.items())
    if len(reasons) == len(data.channels):
        alike = set(reasons.values())
        text = f"every channel {alike.pop()}" if len(alike) == 1 else text
        raise PhoslabError(
            f"holds no decay: {text}",
            file=session.path,
            remedy="Check that its frames are in order, that the lamp was off and that no other light came in. Without "
            "a decay there is no material; `phoslab spectrum` measures the other sessions.",
        )
    return [f"{session.path}: channel {text}."] if text else []


def _doubts(fit: DecayFit, mismatch: float, spectrum_of: str | None) -> list[str]:
    """Say what about a fit should not be believed."""
    doubts = []
    if fit.degenerate and fit.n_states > 1:
        doubts.append(
            f"{fit.n_states} states were asked for, but the data do not tell them apart: "
            "one has no amplitude, or two have the same rate."
        )
    if fit.misses:
        t_s, share = fit.farthest_off()
        doubts.append(
            f"The fitted decay misses the measured one by up to {share:.1%}, after {t_s:.3g} s, which is more than "
            f"noise (chi-square / dof {fit.chi2 / fit.dof:.3g}; 1 is right): it is not a sum of so few exponentials. "
            "Rates and their errors, which are widened by the root of that, tell of the curve that comes nearest."
        )
        if fit.n_states < MOST_STATES:
            doubts[-1] += (
                f" `--states {fit.n_states + 1}` may come nearer, for renders of the decay; to render other charges "
                f"than the recorded one keep {fit.n_states}, unless {fit.n_states + 1} leave none of them empty."
            )
    if fit.dof < _FEW_DOF:
        doubts.append(
            f"{fit.dof + fit.n_parameters} values for {fit.n_parameters} parameters are few: the errors "
            "are themselves uncertain."
        )
    lost = fit.kr_standard_error > fit.kr_per_s
    if lost.any():
        doubts.append(
            f"The data do not determine the rate{'s' if lost.sum() > 1 else ''} "
            f"{', '.join(f'{kr:.2g}' for kr in fit.kr_per_s[lost])} 1/s: the error is as large as the value."
        )
    if mismatch > _COLOUR_MISMATCH and spectrum_of is not None:
        whose = "measured spectrum" if spectrum_of == "measured" else f"spectrum of {spectrum_of!r}"
        doubts.append(
            f"The camera saw a colour {mismatch:.0%} away from what the {whose} would give: the glow has another "
            "spectrum."
        )
    return doubts


def _covariance(fit: DecayFit, channels: Sequence[str]) -> dict[str, Any] | None:
    if not np.isfinite(fit.covariance).all():
        return None
    strongest = int(np.argmax(fit.colour))
    names = [f"log kr_per_s[{i}]" for i in range(fit.n_states)]
    names += [f"colour {c}" for k, c in enumerate(channels) if k != strongest]
    names += [f"amplitude[{i}]" for i in range(fit.n_states)]
    return {"parameters": names, "matrix": fit.covariance.tolist()}
