"""A fitted material with all that it rests on, and the report a person reads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting import excitation_report
from phoslab.fitting.decay import MOST_STATES, DecayFit
from phoslab.fitting.excitation import ExcitationFit
from phoslab.fitting.excitation_series import ExcitationSeries
from phoslab.fitting.holdout import NOISE_ALLOWANCE, HoldOut
from phoslab.fitting.lamp_light import LampLight
from phoslab.fitting.reduction import ReducedDecay
from phoslab.fitting.selection import Selection
from phoslab.fitting.spectrum import Spectrum
from phoslab.fitting.written import with_error
from phoslab.material import Material

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MeasuredExcitation:
    """Where the excitation rates come from.

    Args:
        fit: the rates.
        series: what they were fitted to.
        lamp: the lamp's light that they refer to.
    """

    fit: ExcitationFit
    series: ExcitationSeries
    lamp: LampLight


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
        missing: what would have to be measured for a whole material, and how; one sentence each.
        warnings: what spoils the material, the worst first; one sentence each.
        notes: what is as usual and yet good to know, likewise.
        spectrum: of the glow, if it was measured.
        excitation: the excitation rates, if they were measured.
    """

    material: Material
    fit: DecayFit
    selection: Selection
    interval95: Array
    reduced: ReducedDecay
    held_out: tuple[HoldOut, ...]
    assumed: str
    missing: tuple[str, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...] = ()
    spectrum: Spectrum | None = None
    excitation: MeasuredExcitation | None = None

    @property
    def uncertainty(self) -> Mapping[str, Any]:
        """Standard errors by field of the material."""
        return self.material.standard_error or {}

    @property
    def why_states(self) -> str:
        """Why the decay has so many states, in a sentence."""
        n, tried = self.fit.n_states, [c.n_states for c in self.selection.candidates]
        if self.material.provenance["settings"]["states"] != "auto":
            return f"{n}, as was asked for (--states {n}); no other number was tried."
        chance = "chance would, 1 time in 200 (F-test)"
        if n < max(tried):
            return f"Of 1 to {max(tried)} the smallest number that no larger one beats by more than {chance}."
        more = f" More are tried only if asked for (--states {n + 1})." if n < MOST_STATES else ""
        return f"Of 1 to {n} the largest number: it beats the smaller ones by more than {chance}.{more}"

    def report(self) -> str:
        """Return the fit as text: what was assumed, parameters with errors, candidates, warnings."""
        fit, data = self.fit, self.reduced.data
        lines = [
            f"Note: {self.assumed}",
            *(f"Missing: {text}" for text in self.missing),
            "",
            f"[[{self.material.name}: decay, {fit.n_states} exponential{'s' if fit.n_states > 1 else ''}]]",
            f"  frames                  {data.t_s.size}, from {data.t_s[0]:.3g} s to {data.end_s:.4g} s after lamp-off",
            f"  values used             {data.n_values} of {data.sigma.size}",
            f"  χ² / dof                {fit.chi2:.4g} / {fit.dof} = {fit.chi2 / fit.dof:.3g}",
            "[[parameters]]",
        ]
        for i in range(fit.n_states):
            lines.append(
                f"  kr[{i + 1}] [1/s]           {with_error(fit.kr_per_s[i], fit.kr_standard_error[i], share=True)}"
                f", 95 % in {self.interval95[i, 0]:.4g} .. {self.interval95[i, 1]:.4g}"
                f"   (lifetime {1 / fit.kr_per_s[i]:.4g} s)"
            )
        for i in range(fit.n_states):
            strength = with_error(fit.strength[i], fit.strength_standard_error[i], share=True)
            lines.append(f"  A[{i + 1}] [DN/s]           {strength}")
        lines.append(
            "  colour                  "
            + ", ".join(f"{c} {v:.4f}" for c, v in zip(data.channels, fit.colour, strict=True))
        )
        if self.fit.misses:
            lines.append(
                "  (no bounds of true rates, since the model misses the data: of the nearest curve's)"
            )
        lines.append("[[number of states]]")
        lines.append(f"  {self.why_states}")
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
                "  (held out: fitted to every second frame, compared with the others; "
                f"{NOISE_ALLOWANCE:g} standard deviations of noise are taken off)"
            )
        if self.spectrum is not None:
            lines += self._spectrum_lines()
        if self.excitation is not None:
            lines += excitation_report.lines(self.excitation.fit)
            lines.append(f"  lamp                    {self.excitation.lamp.said}")
        if self.warnings:
            lines.append("[[warnings]]")
            lines += [f"  {w}" for w in self.warnings]
        if self.notes:
            lines.append("[[notes]]")
            lines += [f"  {n}" for n in self.notes]
        return "\n".join(lines) + "\n"

    def _spectrum_lines(self) -> list[str]:
        """The spectrum of the glow by band."""
        assert self.spectrum is not None
        means, errors = self.spectrum.band_means(self.material.bands)
        lines = [
            "[[emission spectrum]]",
            f"  peak                    {self.spectrum.peak_nm:.1f} nm",
            f"  misfit                  {self.spectrum.scaled_misfit:.2f} of noise and calibration; 1 is right",
        ]
        for j, (mean, error) in enumerate(zip(means / means.max(), errors / means.max(), strict=True)):
            lines.append(f"  {self.material.bands.label(j)}".ljust(26) + f"{mean:.4f} ± {error:.4f}")
        return lines
