"""From a decay table to rates, amplitudes and offsets that can be believed, with everything that cannot be said so."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.fitting import decay, decay_problem, extrapolation, noise
from phoslab.fitting.decay import MOST_STATES, DecayFit, fit_decay
from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.extrapolation import Beyond
from phoslab.fitting.intervals import bootstrap_intervals, rate_intervals
from phoslab.fitting.other_laws import OtherLaw, fit_other_laws
from phoslab.fitting.screening import Screened, clipped_start, screen
from phoslab.fitting.selection import Selection, chance, select
from phoslab.fitting.table import read_table

Array = NDArray[np.float64]

# A pilot fit, for weights that all candidates share: enough states to follow any decay, few enough to leave scatter.
_PILOT_STATES = 3
# Noise that digits of a file hide altogether.
_LEAST_NOISE = 1e-10
_FEW_DOF = 10
# A state less that so often looks as bad by chance is no worse.
_AS_GOOD = 0.05


@dataclass(frozen=True)
class TableFit:
    """A fitted table.

    Args:
        fit: the decay that was chosen; its channels are free.
        selection: what it was chosen from.
        interval95: (n_c, 2) of each rate in 1/s, by profile likelihood; open ends are 0 and infinity.
        bootstrap95: the same by parametric bootstrap, or None.
        sigma: "given", or "estimated" with the law that was found.
        other_laws: stretched exponential and Becquerel.
        valid_s: the times that the data support.
        extrapolated: at the times asked for.
        flags: "code: sentence" each.
        lost: channels left out, with the reason.
    """

    fit: DecayFit
    selection: Selection
    interval95: Array
    bootstrap95: Array | None
    sigma: str
    other_laws: tuple[OtherLaw, ...]
    valid_s: tuple[float, float]
    extrapolated: tuple[Beyond, ...]
    flags: tuple[str, ...]
    lost: dict[str, str]

    def to_dict(self) -> dict[str, Any]:
        """Return everything as JSON takes it; what is not determined is null."""
        fit, s = self.fit, self.selection
        return {
            "states": fit.n_states,
            "channels": list(fit.data.channels),
            "kr_per_s": _plain(fit.kr_per_s),
            "amplitude": _plain(fit.amplitude),
            "offset": _plain(fit.offset),
            "offset_fitted": fit.has_offset,
            "kr_standard_error": _plain(fit.kr_standard_error),
            "interval95_per_s": _plain(self.interval95),
            "bootstrap95_per_s": None if self.bootstrap95 is None else _plain(self.bootstrap95),
            "chi2": fit.chi2,
            "dof": fit.dof,
            "sigma": self.sigma,
            "valid_s": list(self.valid_s),
            "selection": {
                "candidates": [
                    {
                        "states": c.n_states,
                        "offset": c.fit.has_offset,
                        "chi2": c.fit.chi2,
                        "dof": c.fit.dof,
                        "AICc": _finite(c.fit.aicc),
                        "BIC": c.fit.bic,
                        "F_test": c.f_test,
                        "cross_validation": c.cross_validation,
                        "degenerate": not c.sound,
                    }
                    for c in s.candidates
                ],
                "votes": {name: vote.n_states for name, vote in s.votes.items()},
                "choice": fit.n_states,
            },
            "other_laws": [
                {"law": o.name, **o.parameters, "chi2": o.chi2, "AICc": o.aicc} for o in self.other_laws
            ],
            "extrapolated": [b.to_dict() for b in self.extrapolated],
            "lost": self.lost,
            "flags": list(self.flags),
        }


def fit_table(
    path: str | PathLike[str],
    *,
    states: int | str = "auto",
    offset: str = "auto",
    noise_law: str = "auto",
    bootstrap: int = 0,
    extrapolate_s: Sequence[float] = (),
    seed: int = 0,
) -> TableFit:
    """Fit the decay in a CSV table.

    Args:
        states: 1 to 4, or "auto".
        offset: "auto", "none", or "fit" for a constant in every channel.
        noise_law: how σ goes with the signal where the table gives none: "auto", "constant", "photon", "relative".
        bootstrap: how many draws of a parametric bootstrap to add.
        extrapolate_s: times after lamp-off at which to continue the fit, with the band that the data allow.
        seed: of the bootstrap.

    Raises:
        PhoslabError: the table cannot be read, or holds no decay.
    """
    return fit_screened(
        screen(read_table(path)),
        states=states,
        offset=offset,
        noise_law=noise_law,
        bootstrap=bootstrap,
        extrapolate_s=extrapolate_s,
        seed=seed,
        file=path,
    )


def fit_screened(
    screened: Screened,
    *,
    states: int | str = "auto",
    offset: str = "auto",
    noise_law: str = "auto",
    bootstrap: int = 0,
    extrapolate_s: Sequence[float] = (),
    seed: int = 0,
    file: str | PathLike[str] | None = None,
) -> TableFit:
    """Fit what a table holds; arguments and errors are those of `fit_table`."""
    if states != "auto" and states not in range(1, MOST_STATES + 1):
        raise PhoslabError(f"is {states!r}", field="states", remedy=f"Use auto, or 1 to {MOST_STATES}.")
    flags = list(screened.flags)
    data, known = screened.data, screened.sigma_given
    numbers = list(range(1, MOST_STATES + 1)) if states == "auto" else [int(states)]
    offsets = {"auto": [False, True], "none": [False], "fit": [True]}[offset]
    if not _carries(data, numbers[0], offset=offsets[0]):
        numbers, offsets = _reduced(data, numbers, offsets, flags, file)
    pilot_states = max([n for n in range(1, _PILOT_STATES + 1) if _carries(data, n, spare=3)], default=1)
    if known:
        data = replace(data, law=noise.law_of(data.signal, data.sigma))
        said = "given"
    else:
        data, _ = estimate_noise(data, pilot_states, noise_law, skip=1)
    data, clipped = clipped_start(data, n_states=pilot_states)
    flags += clipped
    if not known:
        data, said = estimate_noise(data, pilot_states, noise_law)
        flags.append(f"sigma-estimated: the table gives no σ; they were {said}.")
    selection = select(data, states=numbers, offsets=offsets, sigma_known=known)
    chosen = selection.chosen.fit
    fit = _final(data, chosen, chosen.n_states, known)
    flags += _doubts(fit, selection, states, known)
    if states != "auto" and fit.n_states > 1 and fit.dof > 0:
        fewer = fit_decay(
            replace(fit.data, law=None), fit.n_states - 1, offset=fit.has_offset, rank_one=False, polish=False
        )
        p = chance(fewer, fit, sigma_known=known)
        if p > _AS_GOOD:
            flags.append(
                f"too-many-states: {fewer.n_states} would do (F-test {p:.2g}): "
                f"{', '.join(f'{kr:.4g}' for kr in fewer.kr_per_s)} 1/s fits as well, and a rate here means nothing."
            )
    interval = rate_intervals(fit, sigma_known=known)
    flags += _undetermined(fit, interval)
    other = fit_other_laws(fit.data)
    flags += [
        f"other-law: a {o.name} law fits better (AICc {o.aicc:.4g} against {fit.aicc:.4g}): do not extrapolate."
        for o in other
        if o.aicc < fit.aicc - 2
    ]
    valid = (float(data.t_s.min()), data.end_s)
    beyonds = tuple(extrapolation.beyond(fit, t) for t in extrapolate_s)
    flags += extrapolation.warnings(beyonds, valid[1])
    return TableFit(
        fit=fit,
        selection=selection,
        interval95=interval,
        bootstrap95=bootstrap_intervals(fit, bootstrap, seed) if bootstrap else None,
        sigma=said,
        other_laws=tuple(other),
        valid_s=valid,
        extrapolated=beyonds,
        flags=tuple(flags),
        lost=screened.lost,
    )


def _carries(data: DecayData, n_states: int, *, offset: bool = False, spare: int = 0) -> bool:
    """Whether the data have values enough, in every channel and in all."""
    own = data.used.sum(axis=0)
    needed = decay_problem.n_parameters(data, n_states, offset=offset, rank_one=False)
    return bool((own >= n_states + int(offset)).all() and data.n_values >= needed + spare)


def _reduced(
    data: DecayData,
    numbers: list[int],
    offsets: list[bool],
    flags: list[str],
    file: str | PathLike[str] | None,
) -> tuple[list[int], list[bool]]:
    """Return what can still be fitted to so few values, and say so."""
    smaller = [n for n in range(1, numbers[0] + 1) if _carries(data, n)]
    if not smaller:
        raise PhoslabError(
            f"has {data.n_values} usable values for {data.signal.shape[1]} channels: too few for a single rate",
            file=file,
            remedy="A rate needs two values at different times in each channel.",
        )
    asked = f"{numbers[0]} states" + (" and an offset" if offsets[0] else "")
    flags.append(
        f"few-values: {data.n_values} usable values do not determine {asked}; {smaller[-1]} without offset is what "
        "they carry."
    )
    return [smaller[-1]], [False]


def estimate_noise(
    data: DecayData, n_states: int, law: str = "auto", *, skip: int = 0
) -> tuple[DecayData, str]:
    """Return the data with σ from the scatter about a fit, and how they were found in words.

    Args:
        data: with any σ.
        n_states: of the fit.
        law: "constant", "photon" (σ² as the signal), "relative" (σ as the signal), or "auto" for the likeliest.
        skip: leave so many first frames out of it.
    """
    rest = data.take(slice(skip, None)) if data.t_s.size > 2 * n_states + 4 + skip else data
    ones = np.where(rest.used, 1.0, np.inf)
    best: tuple[float, str, noise.NoiseLaw] | None = None
    for name in noise.LAWS if law == "auto" else (law,):
        unscaled = noise.unscaled(noise.LAWS[name], data.signal.shape[1])
        first = np.where(rest.used, unscaled.sigma(np.maximum(rest.signal, 0.0)), np.inf)
        start = replace(
            rest, sigma=first if name != "constant" else ones, law=None if name == "constant" else unscaled
        )
        fit = fit_decay(start, n_states, rank_one=False, polish=False)
        n = rest.used.sum(axis=0)
        shared = n_states / rest.signal.shape[1]
        spare = np.maximum(n - n_states - shared, 0.5)
        scale2 = (fit.residual**2).sum(axis=0) / spare
        peak = np.abs(rest.signal).max(axis=0)
        unit = fit.data.sigma
        smallest = np.where(rest.used, unit, np.inf).min(axis=0)
        scale2 = np.maximum(scale2, (_LEAST_NOISE * peak / smallest) ** 2)
        scaled = unscaled.scaled(np.sqrt(scale2))
        logs = (
            np.where(rest.used, np.log(np.where(rest.used, unit, 1.0)), 0.0).sum()
            + (n * np.log(scale2) / 2).sum()
        )
        # A constant is the simplest: others must be likelier by a factor of e².
        likelihood = -float(logs) + (2.0 if name == "constant" else 0.0)
        if best is None or likelihood > best[0]:
            best = likelihood, name, scaled
    assert best is not None
    _, name, found = best
    model = fit_decay(
        replace(
            data, sigma=np.where(data.used, found.sigma(np.maximum(data.signal, 0.0)), np.inf), law=found
        ),
        n_states,
        rank_one=False,
        polish=False,
    )
    iterated = None if name == "constant" else found
    words = {
        "constant": "the same for all values of a channel",
        "photon": "growing with the root of the signal",
        "relative": "in proportion to the signal",
    }[name]
    return replace(
        model.data, law=iterated, expected=None
    ), f"estimated from the scatter about the fit, {words}"


def _final(data: DecayData, chosen: DecayFit, n_states: int, known: bool) -> DecayFit:
    """Refit to the last digit with weights from the fit's own model, and with σ from its own scatter if unknown."""
    options: dict[str, Any] = {"offset": chosen.has_offset, "rank_one": False}
    fit = fit_decay(data, n_states, near=[chosen.theta[:n_states]], **options)
    if known:
        return fit
    if fit.dof <= 0:
        return replace(fit, covariance=np.full_like(fit.covariance, np.inf))
    channels = data.signal.shape[1]
    spare = np.maximum(data.used.sum(axis=0) - n_states - int(chosen.has_offset) - n_states / channels, 0.5)
    peak = np.abs(data.signal).max(axis=0)
    smallest = np.where(data.used, fit.data.sigma, np.inf).min(axis=0)
    factor = np.sqrt(np.maximum((fit.residual**2).sum(axis=0) / spare, (_LEAST_NOISE * peak / smallest) ** 2))
    law = None if data.law is None else data.law.scaled(factor)
    return fit_decay(
        replace(data, sigma=data.sigma * factor, law=law), n_states, near=[fit.theta[:n_states]], **options
    )


def _doubts(fit: DecayFit, selection: Selection, states: int | str, known: bool) -> list[str]:
    """Say what about the choice and the fit as a whole should not be believed."""
    flags = []
    if fit.degenerate and fit.n_states > 1:
        flags.append(
            f"states-not-distinct: {fit.n_states} states were asked for, but the data do not tell them apart: one has "
            "no amplitude, or two have the same rate."
        )
    if states == "auto" and selection.dissent:
        votes = ", ".join(f"{name} {vote.n_states}" for name, vote in selection.votes.items())
        flags.append(f"criteria-disagree: on the number of states ({votes}); the F-test decides.")
    if fit.has_offset:
        worst = float(np.max(np.abs(fit.offset) / np.abs(fit.data.signal).max(axis=0)))
        flags.append(
            f"offset: a constant of up to {worst:.2g} of the peak was fitted: stray light, a dark value that was not "
            "taken off, or a state too slow to be seen falling."
        )
    if known and decay.misfit(fit.chi2, fit.dof) > 1:
        flags.append(
            f"misfit: chi-square / dof is {fit.chi2 / fit.dof:.3g}: the model misses the data by more than their σ. "
            "Standard errors and intervals are widened by its root."
        )
    if 0 < fit.dof < _FEW_DOF:
        flags.append(
            f"few-dof: {fit.dof + fit.n_parameters} values for {fit.n_parameters} parameters are few: the errors are "
            "themselves uncertain."
        )
    if fit.dof <= 0:
        flags.append("no-dof: as many parameters as values: nothing is left to tell how good the fit is.")
    return flags


def _undetermined(fit: DecayFit, interval: Array) -> list[str]:
    """Name the rates that the data leave open."""
    flags = []
    for i, (low, high) in enumerate(interval):
        if low <= 0 and not np.isfinite(high):
            flags.append(f"rate-undetermined: any value of kr[{i}] fits as well.")
        elif not np.isfinite(high):
            flags.append(
                f"rate-open: kr[{i}] has no upper limit: what falls so fast is over before the second value, or its "
                "state may be absent."
            )
        elif low <= 0:
            flags.append(f"rate-open: kr[{i}] may be 0: over so short a time nothing is seen to fall.")
    for i in range(fit.n_states - 1):
        if interval[i, 0] < interval[i + 1, 1]:
            flags.append(
                f"rates-overlap: the intervals of kr[{i}] and kr[{i + 1}] overlap: the data hardly tell them apart."
            )
    return flags


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _plain(values: Array) -> Any:
    """Return an array as lists, with null for what is not finite."""
    if values.ndim > 1:
        return [_plain(row) for row in values]
    return [_finite(v) for v in values.tolist()]
