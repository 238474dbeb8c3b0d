"""The fit of an excitation series as a person reads it, and what about it should not be believed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting.excitation import ExcitationFit

Array = NDArray[np.float64]

# A rise that is off by more than this is said to be (the fit's own measure of a sample that follows the model).
_RISE = 0.05
_LEVEL = 0.02
# Off by less than this, a render of a recorded length of light counts as good.
_NEAR = 0.1
# A state that fills no further than this shows nothing of its saturation.
_HARDLY_FULL = 0.01


def doubts(fit: ExcitationFit) -> tuple[str, ...]:
    """Return one sentence for each thing that a user must know before using the rates."""
    found = [*_unseen(fit), *_charging(fit)]
    off = np.abs(fit.level_error)
    if np.isfinite(off).any() and np.nanmedian(off) > _LEVEL:
        found.append(
            f"After the longest exposure the modelled glow is off by {np.nanmedian(off):.1%} (median of the bright "
            f"places, worst {np.nanmax(off):.1%})."
        )
    empty = fit.kr_per_s[fit.product_only & (fit.initial < _HARDLY_FULL)]
    if empty.size:
        found.append(
            f"The fit leaves {_states(empty)} next to empty however long the lamp shone, and makes up for it by a Λ "
            "as much too large: under more light than was recorded a render is far too bright. "
            + (
                f"For other light than was recorded use `--states {fit.n_states - 1}`; this fit serves for the decay "
                "after the recorded light."
                if fit.n_states > 1
                else "A series with longer exposures may tell how full it becomes."
            )
        )
    loose = fit.kr_per_s[fit.product_only]
    if loose.size:
        found.append(
            f"How full {_states(loose)} become{'s' if loose.size == 1 else ''} is not known well enough to tell ke "
            "(how fast light fills a state) from Λ (the light that a full state gives): only their product is known. "
            "If ke is larger by a factor, Λ is smaller by it. Renders of light as strong and as long as was recorded "
            "are as good as the fit; of much stronger light they are a guess. "
            + (
                "No other recording of this kind tells more, since saturation is hidden by what the model misses."
                if fit.discrepancy
                else "A stronger lamp would tell, or longer exposures (`phoslab measure excitation --change 0`)."
            )
        )
    return tuple(found)


def _states(kr_per_s: Array) -> str:
    plural = "s" if kr_per_s.size > 1 else ""
    return f"the state{plural} of {', '.join(f'{kr:.3g}' for kr in kr_per_s)} 1/s"


def _unseen(fit: ExcitationFit) -> list[str]:
    """Say that the series began too late to see the glow rise."""
    if not fit.rise_unseen:
        return []
    return [
        f"All exposures to the lamp ({fit.data.steps.lit_s.min():.3g} s and longer) were past half of the final glow: "
        "how fast the sample charges was not recorded, and what the material says of it is a guess. Record the "
        "excitation again from shorter exposures on (`phoslab measure excitation --first 1`)."
    ]


def _charging(fit: ExcitationFit) -> list[str]:
    """Say how far the modelled glow is off while the sample is being charged."""
    ratio = fit.rise_ratio
    off = np.isfinite(ratio) and abs(ratio - 1) > _RISE
    if not off and not fit.discrepancy:
        return []
    said = ["The sample does not follow the model"] if fit.discrepancy else []
    if off:
        faster = "faster" if ratio < 1 else "slower"
        said.append(f"the modelled glow rises {faster} than the measured one")
    text = ": ".join(said)
    text = text[0].upper() + text[1:] + ("." if off else ", by more than noise.")
    if off:
        measured = float(np.nanmedian(fit.rise_s[:, 0]))
        text += (
            f" The material reaches half of its final glow after {measured * ratio:.2g} s of light, the sample after "
            f"{measured:.2g} s."
        )
    lit_s, factor = fit.farthest_off()
    if abs(factor - 1) > _RISE:
        text += (
            f" It is farthest off after {lit_s:.2g} s of light, where it is {factor:.2g} times as bright as the sample "
            "(medians of the bright places): renders of as much light are off by as much."
        )
        near = fit.near_from(_NEAR)
        if np.isfinite(near):
            text += (
                f" From {near:.3g} s of light on it is within {_NEAR:.0%}: use the material for charges of that length "
                "and more, under light about as strong as the lamp's."
            )
    if fit.discrepancy:
        text += (
            " The decay was kept as measured, and the level after the longest exposure was to be met first. Another "
            "recording does not mend this: the sample does what the model has no part for."
        )
    return [text]


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
        f"  χ² / dof                {fit.chi2:.4g} / {fit.dof} = {fit.chi2 / max(fit.dof, 1):.3g}"
        + (
            " (where the sample does not follow the model, that counts as noise already)"
            if fit.discrepancy
            else ""
        ),
    ]
    if np.isfinite(fit.level_error).any():
        off = np.abs(fit.level_error)
        told.append(
            f"  level reached           missed by {np.nanmedian(off):.1%} (median), {np.nanmax(off):.1%} (worst)"
        )
    if np.isfinite(fit.rise_ratio):
        measured = float(np.nanmedian(fit.rise_s[:, 0]))
        told.append(
            f"  time to half of it      {measured:.3g} s measured, {measured * fit.rise_ratio:.3g} s modelled"
        )
    for i in range(fit.n_states):
        loose = fit.product_only[i]
        told += [
            f"[[state {i + 1}{', only Λ ke is determined' if loose else ''}]]",
            f"  a under the lamp [1/s]  {excitation_of(fit, i)}",
            f"  r when the lamp went off  {initial_of(fit, i)}",
            f"  correlation of log a    {fit.correlation[i, 0]:+.2f} with log Λ, "
            f"{fit.correlation[i, 1]:+.2f} with log r(0) (near ±1: one is known only with the other)",
        ]
        if not fit.common_shape:
            told += [_rate(fit, i, j) for j in range(fit.bands.n)]
    if fit.common_shape:
        told.append(
            "[[ke of every state by band: a share of its a under the lamp, in s m²/J; a times it is ke in m²/J]]"
        )
        told += [_shape(fit, j) for j in range(fit.bands.n)]
    return told


def excitation_of(fit: ExcitationFit, i: int) -> str:
    """How fast the whole lamp excites a state, in 1/s: as many digits as are known."""
    if fit.product_only[i]:
        return f"about {fit.a_per_s[i]:.2g} (not determined)"
    return f"{fit.a_per_s[i]:.3g} ({_share(fit.scale_error[i])})"


def initial_of(fit: ExcitationFit, i: int) -> str:
    """How full a state was when the lamp went off, which is known as its excitation is."""
    if fit.product_only[i]:
        return f"about {fit.initial[i]:.2g} (not determined)"
    return f"{fit.initial[i]:.3f} ± {fit.initial[i] * fit.initial_error[i]:.1g}"


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
