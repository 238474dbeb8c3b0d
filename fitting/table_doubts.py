"""What of a table's fit should not be believed, and why: a sentence each, "code: sentence"."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtr

from phoslab.fitting.decay import DecayFit, fit_decay
from phoslab.fitting.missed import Miss, Run
from phoslab.fitting.other_laws import OtherLaw
from phoslab.fitting.selection import Selection, chance, select
from phoslab.fitting.table_noise import WORDS, Noise

Array = NDArray[np.float64]

_FEW_DOF = 10
# A state less that so often looks as bad by chance is no worse.
_AS_GOOD = 0.05
# A law is said to fit better if AICc, and AIC without its correction for few values, are less by this.
_BETTER = 6.0  # e³ times as likely
# σ are called too large if chance would leave so little of them once in so many times.
_TOO_GOOD = 1e-3
# What is as usual, and good to know; everything else spoils something.
_USUAL = (
    "sigma-estimated",
    "criteria-disagree",
    "unsorted",
    "repeated-times",
    "extrapolated",
    "other-law-as-good",
)


def usual(flag: str) -> bool:
    """Whether a sentence tells what is as usual, not what spoils the fit."""
    return flag.partition(":")[0] in _USUAL


def of_noise(found: Noise) -> str:
    """Say where σ come from, and what χ² is worth then."""
    worth = (
        "χ² / dof of the exponentials tells how much worse than that law they do."
        if found.own
        else "χ² / dof is 1 by construction and does not tell whether the fit is good."
    )
    others = ""
    if found.rivals:
        named = " or ".join(WORDS[rival.law] for rival in found.rivals)
        others = f" Noise {named} is about as likely: the intervals of the rates hold what comes of it, too."
    return f"sigma-estimated: the table gives no σ; they were {found.said}. {worth}{others}"


def of_fit(
    fit: DecayFit,
    selection: Selection,
    worst: Miss | None,
    *,
    auto: bool,
    sigma_known: bool,
    sigma_given: bool,
) -> list[str]:
    """Say what about the choice and the fit as a whole should not be believed.

    Args:
        worst: what it misses most.
        auto: whether the number of states was chosen.
        sigma_known: whether σ do not come from what this fit misses.
        sigma_given: whether they stand in the table.
    """
    flags = []
    if fit.degenerate and fit.n_states > 1:
        flags.append(
            f"states-not-distinct: {fit.n_states} states were asked for, but the data do not tell them apart: one has "
            "no amplitude, two have the same rate, or one is as constant as the offset."
        )
    if auto and selection.dissent:
        others = [name for name in selection.votes if name != "F-test"]
        code = "outvoted" if selection.dissent == others else "criteria-disagree"
        other = selection.votes[selection.dissent[0]].n_states
        flags.append(
            f"{code}: the criteria disagree on the number of states ({votes(selection)}); the F-test decides. To take "
            f"another: --states {other}."
        )
    if fit.has_offset:
        flags.append(_constant(fit))
    if sigma_known and fit.misses:
        by = "" if worst is None else f", by up to {worst.share:.0%} at {worst.t_s:.4g} s"
        flags.append(
            f"misfit: the fit misses the values by more than noise{by} (χ² / dof is {fit.chi2 / fit.dof:.3g}; 1 is "
            "right): they are no sum of so few exponentials. Rates and their errors, widened by the root of that, tell "
            "of the curve that comes nearest."
        )
    if sigma_given and fit.dof > 0 and chdtr(fit.dof, fit.chi2) < _TOO_GOOD:
        flags.append(
            f"sigma-large: the values scatter {np.sqrt(fit.dof / max(fit.chi2, 1e-300)):.2g} times less than their σ "
            "say, and the errors are as much too large. Are σ those of these values, in their unit?"
        )
    if 0 < fit.dof < _FEW_DOF:
        flags.append(
            f"few-dof: {fit.dof + fit.n_parameters} values for {fit.n_parameters} parameters are few: the errors are "
            "themselves uncertain."
        )
    if fit.dof <= 0:
        flags.append("no-dof: as many parameters as values: nothing is left to tell how good the fit is.")
    return flags


def _constant(fit: DecayFit) -> str:
    """Say what a fitted constant may be, for the channel in which it is most of the last value."""
    last = [fit.data.signal[np.flatnonzero(used)[-1], c] for c, used in enumerate(fit.data.used.T)]
    share = np.abs(fit.offset) / np.maximum(np.abs(last), 1e-300)
    c = int(np.argmax(share))
    said = f"offset: a constant was fitted, in {fit.data.channels[c]} {fit.offset[c]:.3g}"
    if fit.offset[c] < 0:
        return f"{said}: too much was taken off as dark. Subtract what the meter reads without the sample."
    return (
        f"{said}, {share[c]:.0%} of its last value: stray light, a dark value that was not taken off, or glow too slow "
        "to be seen falling. The reading without the sample tells: subtract it, and fit with --offset none."
    )


def votes(selection: Selection) -> str:
    """Return what each criterion would choose."""
    return ", ".join(
        f"{name} {vote.n_states}{' and an offset' if vote.fit.has_offset else ''}"
        for name, vote in selection.votes.items()
    )


def too_many_states(fit: DecayFit, offsets: Sequence[bool], **tested: bool) -> str | None:
    """Say that a state less fits as well, and what would have been chosen; None if it does not.

    Args:
        offsets: from which the choice would be made.
        tested: what `chance` takes.
    """
    if fit.n_states == 1 or fit.dof <= 0:
        return None
    data = replace(fit.data, law=None)
    fewer = fit_decay(data, fit.n_states - 1, offset=fit.has_offset, rank_one=False, polish=False)
    p = chance(fewer, fit, **tested)
    if p <= _AS_GOOD:
        return None
    chosen = select(data, states=range(1, fit.n_states), offsets=offsets, **tested).chosen.fit
    rates = ", ".join(f"{kr:.4g}" for kr in chosen.kr_per_s)
    return (
        f"too-many-states: with one state less the data are met as well (F-test {p:.2g}), so single rates here mean "
        f"nothing. --states auto takes {chosen.n_states}: {rates} 1/s"
        f"{' and an offset' if chosen.has_offset else ''}."
    )


def of_rates(fit: DecayFit, interval: Array, *, too_many: bool) -> list[str]:
    """Name the rates that the data leave open.

    Args:
        interval: (n_c, 2) in 1/s.
        too_many: whether a state less fits as well.
    """
    flags = []
    # Two values a parameter, and two to judge by.
    needed = 2 * (2 * fit.n_states + int(fit.has_offset)) + 2
    for i, (low, high) in enumerate(interval):
        if low <= 0 and not np.isfinite(high):
            flags.append(
                f"rate-undetermined: no rate of state {i + 1} is excluded by {fit.data.n_values} values. Take "
                f"{needed} readings or more a channel, some of them in each tenfold of the light's fall."
            )
        elif not np.isfinite(high):
            flags.append(
                f"rate-open: the rate of state {i + 1} has no upper limit: what falls so fast is over before the "
                "second value, or it may be absent."
            )
        elif low <= 0 and too_many:
            flags.append(
                f"rate-open: the rate of state {i + 1} may be 0: it may be absent, others take its place."
            )
        elif low <= 0:
            why = "what the fit misses is as large" if fit.misses else "too little of its fall is seen"
            flags.append(
                f"rate-open: the rate of state {i + 1} may be 0: a constant in its place fits as well, since {why}."
            )
    for i in range(fit.n_states - 1):
        if interval[i, 0] < interval[i + 1, 1]:
            flags.append(
                f"rates-overlap: the intervals of the rates of states {i + 1} and {i + 2} overlap: the data hardly "
                "tell them apart."
            )
    return flags


def of_other_noise(fit: DecayFit, law: str, other: DecayFit) -> list[str]:
    """Say what another law of noise, which is about as likely, makes of the values, if that is another model.

    Args:
        other: the choice with that noise.
    """
    if (other.n_states, other.has_offset) == (fit.n_states, fit.has_offset):
        return []
    rates = ", ".join(f"{kr:.4g}" for kr in other.kr_per_s)
    constant = " and a constant" if other.has_offset else ", without a constant" if fit.has_offset else ""
    return [
        f"noise-law: noise {WORDS[law]} is about as likely, and of it come rates of {rates} 1/s{constant}. Give σ of "
        f"the values, or say --noise {law} if you know."
    ]


def of_run(fit: DecayFit, run: Run, estimated: Noise | None) -> str:
    """Say which values the fit misses, and what could mend it.

    Args:
        estimated: the noise, where σ are not given.
    """
    data, t, k = fit.data, fit.data.t_s, run.worst
    channel = data.channels[run.channel]
    told = float(fit.predict(t[k : k + 1], data.exposure_s[k : k + 1])[0, run.channel])
    where = f"at {t[run.first]:.4g} s" + (f" to {t[run.last]:.4g} s" if run.last > run.first else "")
    remedy = (
        "So few exponentials do not describe them."
        if estimated is None or estimated.law == "relative"
        else f"Try --noise relative, or give σ in a column {channel}_sigma."
    )
    return (
        f"missed: {channel} {where} is missed by more than half of itself (at {t[k]:.4g} s "
        f"{data.signal[k, run.channel]:.4g} was measured, the fit says {told:.2g}): the fit is not valid there. "
        f"{remedy}"
    )


def better_laws(fit: DecayFit, laws: Sequence[OtherLaw], *, misses: bool) -> list[OtherLaw]:
    """Return the laws that fit better than the exponentials, the best first; none where AICc tells nothing.

    Args:
        misses: whether the exponentials may miss more than noise; else laws count that are as good.
    """
    margin = _BETTER if misses else 0.0
    better = [
        law
        for law in laws
        if np.isfinite(fit.aicc) and law.aicc < fit.aicc - margin and law.aic < fit.aic - margin
    ]
    return sorted(better, key=lambda law: law.aicc)


def of_laws(
    laws: Sequence[OtherLaw], exponentials: Miss | None, best: Miss | None, *, misses: bool
) -> list[str]:
    """Say in one sentence that other laws fit better.

    Args:
        laws: that do, the best first.
        exponentials, best: what these and the best law miss most.
        misses: whether the exponentials may miss more than noise.
    """
    if not laws:
        return []
    if not misses:
        return [
            f"other-law-as-good: a {laws[0].name} law describes the values as well, with fewer parameters: they do not "
            "tell the one from the other. Beyond the times measured the two part."
        ]
    by = ""
    if exponentials is not None and best is not None and best.share < exponentials.share:
        most = f"{best.share:.0%} (the exponentials {exponentials.share:.0%})"
        by = f", which misses no well-measured value by more than {most}"
    return [
        f"other-law: a {laws[0].name} law describes the values better{by}. Within the times measured the exponentials "
        "stand in for it; beyond them they are not to be trusted."
    ]
