"""The fit of an excitation series as a person reads it, and what about it should not be believed."""

from __future__ import annotations

import numpy as np

from phoslab.fitting.excitation import ExcitationFit

# A rise that is off by more than this is said to be (the fit's own measure of a sample that follows the model).
_RISE = 0.05
_LEVEL = 0.02


def doubts(fit: ExcitationFit) -> tuple[str, ...]:
    """Return one sentence for each thing that a user must know before using the rates."""
    found = []
    ratio = fit.rise_ratio
    if fit.discrepancy:
        text = (
            f"The sample does not follow the model: beyond noise, it is off by {fit.discrepancy:.0%} of the way that "
            "the glow still has to go. The decay's rates and amplitudes were kept, and the level after the longest "
            "exposure counts most."
        )
        found.append(text)
    if np.isfinite(ratio) and abs(ratio - 1) > _RISE:
        faster = "faster" if ratio < 1 else "slower"
        found.append(
            f"The modelled glow rises {faster} than the measured one: it is at half its end after {ratio:.2f} of the "
            "time (median of the bright places). What is rendered is off by that until the sample is charged."
        )
    off = np.abs(fit.level_error)
    if np.isfinite(off).any() and np.nanmedian(off) > _LEVEL:
        found.append(
            f"After the longest exposure the modelled glow is off by {np.nanmedian(off):.1%} (median of the bright "
            f"places, worst {np.nanmax(off):.1%})."
        )
    loose = fit.kr_per_s[fit.product_only]
    if loose.size:
        found.append(
            f"How full the states of {', '.join(f'{kr:.3g}' for kr in loose)} 1/s become is not known well enough to "
            "tell ke from Λ: only their product is determined. If ke is larger by a factor, Λ is smaller by it."
        )
    return tuple(found)


def report(fit: ExcitationFit) -> str:
    """Return the fit as text: parameters with errors, limits, what is correlated, warnings."""
    said = doubts(fit)
    warnings = ["[[warnings]]", *(f"  {text}" for text in said)] if said else []
    return "\n".join([*lines(fit), *warnings]) + "\n"


def lines(fit: ExcitationFit) -> list[str]:
    """Return the fit line by line, without its warnings."""
    shape = "one spectrum for all states" if fit.common_shape else "a spectrum of its own for each state"
    told = [
        f"[[excitation: {fit.n_states} state{'s' if fit.n_states > 1 else ''}, {shape}]]",
        f"  chi-square / dof        {fit.chi2:.4g} / {fit.dof} = {fit.chi2 / max(fit.dof, 1):.3g}",
    ]
    if np.isfinite(fit.level_error).any():
        off = np.abs(fit.level_error)
        told.append(
            f"  level reached           missed by {np.nanmedian(off):.1%} (median), {np.nanmax(off):.1%} (worst)"
        )
    if np.isfinite(fit.rise_ratio):
        measured = float(np.nanmedian(fit.rise_s[:, 0]))
        told.append(
            f"  time to half of it      {measured:.3g} s measured, {fit.rise_ratio:.2f} of that modelled"
        )
    for i in range(fit.n_states):
        loose = fit.product_only[i]
        only, known = (
            (", only Λ ke is determined", "not determined") if loose else ("", _share(fit.scale_error[i]))
        )
        told += [
            f"[[state {i}{only}]]",
            f"  a under the lamp [1/s]  {fit.a_per_s[i]:.4g} ({known})",
            f"  r when the lamp went off  {fit.initial[i]:.3f}",
            f"  correlation of log a    {fit.correlation[i, 0]:+.2f} with log Λ, "
            f"{fit.correlation[i, 1]:+.2f} with log r(0)",
        ]
        if not fit.common_shape:
            told += [_rate(fit, i, j) for j in range(fit.bands.n)]
    if fit.common_shape:
        told.append("[[ke of every state: its a, times]]")
        told += [_shape(fit, j) for j in range(fit.bands.n)]
    return told


def _rate(fit: ExcitationFit, i: int, j: int) -> str:
    """A state's rate in a band, or what it stays below."""
    name = f"  ke {fit.bands.label(j)}".ljust(26)
    ke = fit.ke_m2_per_J[i, j]
    if ke > 0:
        error = fit.product_standard_error[i, j] / fit.product[i, j]
        return f"{name}{ke:.4g} m²/J ({_share(fit.ke_standard_error[i, j] / ke)}; Λ ke {_share(error)})"
    return name + _below(fit.ke_upper_limit[i, j], "m²/J")


def _shape(fit: ExcitationFit, j: int) -> str:
    """What all states have in common in a band: ke as a share of the excitation a under the lamp."""
    name = f"  {fit.bands.label(j)}".ljust(26)
    share = fit.ke_m2_per_J[0, j] / fit.a_per_s[0]
    if share > 0:
        return f"{name}{share:.4g} s m²/J ({_share(fit.shape_error[0, j])})"
    return name + _below(fit.ke_upper_limit[0, j] / fit.a_per_s[0], "s m²/J")


def _below(limit: float, unit: str) -> str:
    return (
        f"below {limit:.2g} {unit} (95 %)"
        if np.isfinite(limit)
        else "below the limit of detection, which could not be found"
    )


def _share(error: float) -> str:
    return f"± {error:.1%}" if error < 1 else "not determined"
