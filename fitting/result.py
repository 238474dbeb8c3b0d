"""Fitting a session to a material, and the report a person reads."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import phoslab
from phoslab import presets, spectra
from phoslab.errors import PhoslabError, printable
from phoslab.fitting.decay import MOST_STATES, DecayFit, fit_decay
from phoslab.fitting.emission import match_colour, re_radiation
from phoslab.fitting.holdout import NOISE_ALLOWANCE, HoldOut, hold_out
from phoslab.fitting.intervals import rate_intervals
from phoslab.fitting.reduction import ReducedDecay, reduce_decay
from phoslab.fitting.selection import Selection, select
from phoslab.kinetics import equilibrium
from phoslab.material import Material
from phoslab.session import Session

Array = NDArray[np.float64]

# More than noise explains: camera responses and emission spectra agree better than this when they belong together.
_COLOUR_MISMATCH = 0.05
_MISFIT = 2.0
_FEW_DOF = 10
# What a session of some minutes is fitted with unless more is asked for.
_AUTOMATIC = (1, 2, 3)


@dataclass(frozen=True)
class FitResult:
    """A fitted material and how it came about.

    Args:
        material: what was fitted, with standard errors.
        fit: the decay that was chosen.
        selection: what it was chosen from.
        interval95: (n_c, 2) of each rate in 1/s, by profile likelihood; open ends are 0 and infinity.
        reduced: the measured decay, and where in the frames it was measured.
        held_out: how each number of states predicts frames that it has not seen.
        assumed: what was not measured but taken from elsewhere, in one sentence.
        warnings: one sentence each.
    """

    material: Material
    fit: DecayFit
    selection: Selection
    interval95: Array
    reduced: ReducedDecay
    held_out: tuple[HoldOut, ...]
    assumed: str
    warnings: tuple[str, ...]

    @property
    def uncertainty(self) -> Mapping[str, Any]:
        """Standard errors by field of the material."""
        return self.material.standard_error or {}

    def report(self) -> str:
        """Return the fit as text: what was assumed, parameters with errors, candidates, warnings."""
        fit, data = self.fit, self.reduced.data
        lines = [
            f"Note: {self.assumed}",
            "",
            f"[[{self.material.name}: decay, {fit.n_states} exponential{'s' if fit.n_states > 1 else ''}]]",
            f"  frames                  {data.t_s.size}, {data.t_s[0]:.3g} s to {data.t_s[-1]:.4g} s after lamp-off",
            f"  values used             {data.n_values} of {data.sigma.size}",
            f"  chi-square / dof        {fit.chi2:.4g} / {fit.dof} = {fit.chi2 / fit.dof:.3g}",
            "[[parameters]]",
        ]
        for i in range(fit.n_states):
            lines.append(
                f"  kr[{i}] [1/s]           {_with_error(fit.kr_per_s[i], fit.kr_standard_error[i])}"
                f", 95 % in {self.interval95[i, 0]:.4g} .. {self.interval95[i, 1]:.4g}"
                f"   (lifetime {1 / fit.kr_per_s[i]:.4g} s)"
            )
        for i in range(fit.n_states):
            lines.append(
                f"  A[{i}] [signal]         {_with_error(fit.strength[i], fit.strength_standard_error[i])}"
            )
        lines.append(
            "  colour                  "
            + ", ".join(f"{c} {v:.4f}" for c, v in zip(data.channels, fit.colour, strict=True))
        )
        lines.append("[[number of states]]")
        held = {h.n_states: h for h in self.held_out}
        for c in self.selection.candidates:
            chosen = "  <- chosen" if c is self.selection.chosen else ""
            unseen = (
                f", frames held out missed by at most {held[c.n_states].worst:.1%}"
                if c.n_states in held
                else ""
            )
            lines.append(
                f"  {c.n_states}: chi-square {c.fit.chi2:.4g}, AICc {c.fit.aicc:.4g}, BIC {c.fit.bic:.4g}"
                f"{unseen}{chosen}"
            )
        if self.held_out:
            lines.append(
                f"  (fitted to every second frame; {NOISE_ALLOWANCE:g} standard deviations of noise are taken off)"
            )
        if self.warnings:
            lines.append("[[warnings]]")
            lines += [f"  {w}" for w in self.warnings]
        return "\n".join(lines) + "\n"


def fit_session(
    paths: Sequence[str | os.PathLike[str]],
    *,
    preset: str,
    states: int | str = "auto",
    name: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> FitResult:
    """Fit a material to a recorded decay session (Nalbach 2017, 8.4.4 and 8.4.5).

    Args:
        paths: the session's folder; one decay session.
        preset: the material that lends what a decay does not tell: excitation rates (its first state's row, for
            every state), the lamp they refer to, and the shape of the emission spectrum.
        states: 1 to 3, or "auto" for the number of smallest AICc.
        name: of the material; by default the sample's.
        progress: called with (frames done, frames in all).

    Raises:
        PhoslabError: the session or an argument is not usable.
    """
    if len(paths) != 1:
        raise PhoslabError(
            f"names {len(paths)} sessions", field="the fit", remedy="Name one session, that of the decay."
        )
    if states != "auto" and states not in range(1, MOST_STATES + 1):
        raise PhoslabError(f"is {states!r}", field="states", remedy=f"Use auto, or 1 to {MOST_STATES}.")
    lender = presets.preset(preset)
    session = Session.open(paths[0])
    camera = session.header.sensitivities
    if camera is None:
        raise PhoslabError(
            "does not name the camera's spectral sensitivities",
            file=session.path / "session.toml",
            field="camera.sensitivities",
            remedy="Name a camera of colour-science: signal cannot be turned into a spectrum without.",
        )
    spectra.camera_sensitivities(camera, file=session.path / "session.toml")  # before the work, not after it
    reduced = reduce_decay(session, progress)
    selection = select(
        reduced.data,
        states=_AUTOMATIC if states == "auto" else [int(states)],
        offsets=[False],
        rank_one=True,
    )
    chosen = selection.chosen
    fit = fit_decay(reduced.data, chosen.n_states, near=[chosen.fit.theta[: chosen.n_states]])

    spectrum = lender.kr_per_s @ lender.emission
    spectrum = spectrum / spectrum.max()
    beta, mismatch = match_colour(fit.colour, spectra.camera_response(spectrum, lender.bands, camera))
    emission, emission_error = re_radiation(fit, spectrum, beta)
    warnings = [*reduced.warnings, *_doubts(fit, states, mismatch, preset)]
    data = reduced.data
    assumed = (
        f"excitation rates, lamp and the shape of the emission spectrum are those of the preset {preset!r}, not "
        "measured; every state was full (r = 1) when the lamp went off."
    )
    if session.header.simulated is not None:
        assumed += " The session is simulated."
    known = {"kr_per_s": fit.kr_standard_error, "emission": emission_error}
    material = Material(
        name=name or printable(session.header.sample_name),
        bands=lender.bands,
        kr_per_s=fit.kr_per_s,
        ke_m2_per_J=np.repeat(lender.ke_m2_per_J[:1], fit.n_states, axis=0),
        emission=emission,
        calibration="relative",
        reference_irradiance=lender.reference_irradiance,
        standard_error={k: v.tolist() for k, v in known.items() if np.isfinite(v).all()} or None,
        covariance=_covariance(fit, data.channels),
        valid_s=(0.0, float(data.t_s[-1] + data.exposure_s[-1])),
        provenance={
            "sessions": [{"name": Path(session.path).resolve().name, "sha256": session.digest}],
            "software": f"phoslab {phoslab.__version__}",
            "settings": {"states": states, "preset": preset, "camera": camera},
            "radiance_unit": f"DN per second at ISO 100 and f/1 of {camera}",
            "assumed": assumed,
            "simulated": session.header.simulated is not None,
        },
    )
    if material.reference_irradiance is not None and not np.isnan(material.ke_m2_per_J).any():
        charged = equilibrium(material, material.reference_irradiance)
        start = float((charged * fit.strength).sum() / fit.strength.sum())
        warnings.append(
            f"Under the lamp of {preset!r} the states would charge to r = "
            f"{', '.join(f'{r:.2f}' for r in charged)} and not to 1: rendered after that lamp, the glow starts at "
            f"{start:.0%} of what was measured."
        )
    return FitResult(
        material=material,
        fit=fit,
        selection=selection,
        interval95=rate_intervals(fit),
        reduced=reduced,
        held_out=tuple(hold_out(data)),
        assumed=assumed,
        warnings=tuple(warnings),
    )


def _doubts(fit: DecayFit, states: int | str, mismatch: float, preset: str) -> list[str]:
    """Say what about a fit should not be believed."""
    doubts = []
    if fit.degenerate and fit.n_states > 1:
        doubts.append(
            f"{fit.n_states} states were asked for, but the data do not tell them apart: "
            "one has no amplitude, or two have the same rate."
        )
    if fit.chi2 > _MISFIT * fit.dof:
        doubts.append(
            f"The model misses the data by more than their noise (chi-square / dof {fit.chi2 / fit.dof:.1f}): this "
            f"decay is not a sum of so few exponentials. The standard errors are widened by the root of that."
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
    if mismatch > _COLOUR_MISMATCH:
        doubts.append(
            f"The camera saw a colour {mismatch:.0%} away from what the spectrum of {preset!r} would give: "
            "the glow has another spectrum."
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


def _with_error(value: float, error: float) -> str:
    """Write `0.1320 ± 0.0011 (0.8 %)`, to two digits of the error."""
    if not np.isfinite(error) or error <= 0 or value <= 0:
        return f"{value:.6g} (not determined)"
    digits = max(2, int(np.ceil(np.log10(value / error))) + 2)
    return f"{value:.{digits}g} ± {error:.2g} ({error / value:.2g} relative)"
