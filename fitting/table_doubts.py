"""What of a table's fit should not be believed, and why: a sentence each, "code: sentence"."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting.decay import DecayFit, fit_decay
from phoslab.fitting.missed import Miss, Run
from phoslab.fitting.other_laws import OtherLaw
from phoslab.fitting.selection import Selection, chance, select
from phoslab.fitting.table_noise import Noise

Array = NDArray[np.float64]

_FEW_DOF = 10
# A state less that so often looks as bad by chance is no worse.
_AS_GOOD = 0.05
# A law is said to fit better if AICc, and AIC without its correction for few values, are less by this.
_BETTER = 2.0
# What is as usual, and good to know; everything else spoils something.
_USUAL = ("sigma-estimated", "criteria-disagree", "unsorted", "repeated-times", "extrapolated")


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
    return f"sigma-estimated: the table gives no σ; they were {found.said}. {worth}"


def of_fit(
    fit: DecayFit, selection: Selection, worst: Miss | None, *, auto: bool, sigma_known: bool
) -> list[str]:
    """Say what about the choice and the fit as a whole should not be believed."""
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
        c, share = _largest_constant(fit)
        flags.append(
            f"offset: a constant was fitted, in {fit.data.channels[c]} {fit.offset[c]:.3g}, {share:.0%} of its last "
            "value: stray light, a dark value that was not taken off, or glow too slow to be seen falling. The reading "
            "without the sample tells: subtract it, and fit with --offset none."
        )
    if sigma_known and fit.misses:
        by = "" if worst is None else f", by up to {worst.share:.0%} at {worst.t_s:.4g} s"
        flags.append(
            f"misfit: the fit misses the values by more than noise{by} (χ² / dof is {fit.chi2 / fit.dof:.3g}; 1 is "
            "right): they are no sum of so few exponentials. Rates and their errors, widened by the root of that, tell "
            "of the curve that comes nearest."
        )
    if 0 < fit.dof < _FEW_DOF:
        flags.append(
            f"few-dof: {fit.dof + fit.n_parameters} values for {fit.n_parameters} parameters are few: the errors are "
            "themselves uncertain."
        )
    if fit.dof <= 0:
        flags.append("no-dof: as many parameters as values: nothing is left to tell how good the fit is.")
    return flags


def _largest_constant(fit: DecayFit) -> tuple[int, float]:
    """Return the channel in which a fitted constant is most of the last value, and how much."""
    last = [fit.data.signal[np.flatnonzero(used)[-1], c] for c, used in enumerate(fit.data.used.T)]
    share = np.abs(fit.offset) / np.maximum(np.abs(last), 1e-300)
    c = int(np.argmax(share))
    return c, float(share[c])


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
            flags.append(
                f"rate-open: the rate of state {i + 1} may be 0: a constant in its place fits as well, since too "
                "little of its fall is seen."
            )
    for i in range(fit.n_states - 1):
        if interval[i, 0] < interval[i + 1, 1]:
            flags.append(
                f"rates-overlap: the intervals of the rates of states {i + 1} and {i + 2} overlap: the data hardly "
                "tell them apart."
            )
    return flags


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


def better_laws(fit: DecayFit, laws: Sequence[OtherLaw]) -> list[OtherLaw]:
    """Return the laws that fit better than the exponentials, the best first; none where AICc tells nothing."""
    better = [
        law
        for law in laws
        if np.isfinite(fit.aicc) and law.aicc < fit.aicc - _BETTER and law.aic < fit.aic - _BETTER
    ]
    return sorted(better, key=lambda law: law.aicc)


def of_laws(laws: Sequence[OtherLaw], exponentials: Miss | None, best: Miss | None) -> list[str]:
    """Say in one sentence that other laws fit better.

    Args:
        laws: that do, the best first.
        exponentials, best: what these and the best law miss most.
    """
    if not laws:
        return []
    by = ""
    if exponentials is not None and best is not None and best.share < exponentials.share:
        most = f"{best.share:.0%} (the exponentials {exponentials.share:.0%})"
        by = f", which misses no well-measured value by more than {most}"
    return [
        f"other-law: a {laws[0].name} law describes the values better{by}. Within the times measured the exponentials "
        "stand in for it; beyond them they are not to be trusted."
    ]
