"""From a decay table to rates, amplitudes and offsets that can be believed, with everything that cannot be said so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.fitting import decay_problem, extrapolation, noise, table_doubts
from phoslab.fitting.decay import MOST_STATES, DecayFit, fit_decay
from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.extrapolation import Beyond
from phoslab.fitting.intervals import bootstrap_intervals, rate_intervals
from phoslab.fitting.missed import KnownNoise, Miss, Run, missed, valid_times, worst_miss
from phoslab.fitting.other_laws import OtherLaw, fit_other_laws
from phoslab.fitting.screening import Screened, clipped_start, screen
from phoslab.fitting.selection import Selection, select
from phoslab.fitting.table import read_table
from phoslab.fitting.table_noise import LEAST_NOISE, estimate_noise
from phoslab.fitting.written import for_json

Array = NDArray[np.float64]

# A pilot fit, for weights that all candidates share: enough states to follow any decay, few enough to leave scatter.
_PILOT_STATES = 3
# Values more than parameters that tell noise from what a pilot fit misses.
_SPARE = 3


@dataclass(frozen=True)
class TableFit:
    """A fitted table.

    Args:
        fit: the decay that was chosen; its channels are free.
        selection: what it was chosen from.
        interval95: (n_c, 2) of each rate in 1/s, by profile likelihood; open ends are 0 and infinity.
        bootstrap95: the same by parametric bootstrap, or None.
        sigma: "given", or "estimated" with the law that was found.
        scaled: whether σ were scaled to what this fit misses: chi2 / dof is then 1 by construction.
        scaled_to_law: whether σ were scaled to what Becquerel's law misses: that of its chi2 / dof is then 1.
        other_laws: stretched exponential and Becquerel.
        better_laws: those of them that fit better than the exponentials, the best first.
        valid_s: the times that the data support.
        worst_miss: the well-measured value within these that the fit misses by the largest share; None without any.
        missed: runs of values that the fit misses altogether.
        extrapolated: at the times asked for.
        flags: "code: sentence" each.
        lost: channels left out, with the reason.
    """

    fit: DecayFit
    selection: Selection
    interval95: Array
    bootstrap95: Array | None
    sigma: str
    scaled: bool
    scaled_to_law: bool
    other_laws: tuple[OtherLaw, ...]
    better_laws: tuple[OtherLaw, ...]
    valid_s: tuple[float, float]
    worst_miss: Miss | None
    missed: tuple[Run, ...]
    extrapolated: tuple[Beyond, ...]
    flags: tuple[str, ...]
    lost: dict[str, str]

    @property
    def misses(self) -> bool:
        """Whether the data are no sum of so few exponentials: then there is no true rate to bracket."""
        # With σ from the scatter about the fit itself χ² tells nothing, and another law has to.
        return bool(self.fit.misses or self.missed or (self.better_laws and self.sigma != "given"))

    @property
    def warnings(self) -> list[str]:
        """Those of the flags that spoil the fit."""
        return [flag for flag in self.flags if not table_doubts.usual(flag)]

    @property
    def notes(self) -> list[str]:
        """Those that are as usual, and good to know."""
        return [flag for flag in self.flags if table_doubts.usual(flag)]

    @property
    def amplitude_standard_error(self) -> Array:
        """(n_c, n_channels) in the signal's unit; not finite where an amplitude is not determined."""
        return self.fit.free_standard_error[: self.fit.n_states]

    @property
    def offset_standard_error(self) -> Array:
        """(n_channels,) in the signal's unit; 0 where no offset was fitted."""
        fit = self.fit
        return fit.free_standard_error[fit.n_states] if fit.has_offset else np.zeros_like(fit.offset)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as JSON takes it; what is not determined is null."""
        fit, s = self.fit, self.selection
        return {
            "states": fit.n_states,
            "channels": list(fit.data.channels),
            "kr_per_s": for_json(fit.kr_per_s),
            "amplitude": for_json(fit.amplitude),
            "offset": for_json(fit.offset),
            "offset_fitted": fit.has_offset,
            "amplitude_standard_error": for_json(self.amplitude_standard_error),
            "offset_standard_error": for_json(self.offset_standard_error),
            "kr_standard_error": for_json(fit.kr_standard_error),
            "interval95_per_s": for_json(self.interval95),
            "bootstrap95_per_s": None if self.bootstrap95 is None else for_json(self.bootstrap95),
            "chi2": fit.chi2,
            "dof": fit.dof,
            "sigma": self.sigma,
            "chi2_by_construction": self.scaled,
            "valid_s": list(self.valid_s),
            "worst_miss": None if self.worst_miss is None else vars(self.worst_miss),
            "selection": {
                "candidates": [
                    {
                        "states": c.n_states,
                        "offset": c.fit.has_offset,
                        "chi2": c.fit.chi2,
                        "dof": c.fit.dof,
                        "AICc": for_json(c.fit.aicc),
                        "BIC": c.fit.bic,
                        "F_test": c.f_test,
                        "cross_validation": c.cross_validation,
                        "degenerate": not c.sound,
                    }
                    for c in s.candidates
                ],
                "votes": {
                    name: {"states": vote.n_states, "offset": vote.fit.has_offset}
                    for name, vote in s.votes.items()
                },
                "choice": fit.n_states,
            },
            "other_laws": [
                {
                    "law": o.name,
                    **{k: None if k in o.undetermined else v for k, v in o.parameters.items()},
                    "chi2": o.chi2,
                    "AICc": o.aicc,
                }
                for o in self.other_laws
            ],
            "extrapolated": [b.to_dict() for b in self.extrapolated],
            "lost": self.lost,
            "flags": list(self.flags),
            "warnings": self.warnings,
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
    pilot_states = max([n for n in range(1, _PILOT_STATES + 1) if _carries(data, n, spare=_SPARE)], default=1)
    if known:
        data, said, estimated = replace(data, law=noise.law_of(data.signal, data.sigma)), "given", None
    else:
        data = estimate_noise(data, pilot_states, noise_law, skip=1).data
    data, clipped = clipped_start(data, n_states=pilot_states)
    flags += clipped
    if not known:
        estimated = estimate_noise(data, pilot_states, noise_law)
        data, said, known = estimated.data, estimated.said, estimated.own
        flags.append(table_doubts.of_noise(estimated))
    tested: dict[str, bool] = {"sigma_known": known, "approximate": estimated is not None and estimated.own}
    selection = select(data, states=numbers, offsets=offsets, **tested)
    chosen = selection.chosen.fit
    fit = _final(data, chosen, chosen.n_states, known)
    told_apart = screened.sigma_given or _carries(data, 1, spare=_SPARE)
    measured = KnownNoise(data.sigma if told_apart else np.zeros_like(data.sigma), screened.sigma_given)
    runs = missed(fit, measured)
    valid = valid_times(fit, runs)

    def worst(course: Array) -> Miss | None:
        return worst_miss(fit, course, valid, measured)

    told = worst(fit.predict(fit.data.t_s, fit.data.exposure_s))
    flags += table_doubts.of_fit(
        fit, selection, told, auto=states == "auto", sigma_known=known, sigma_given=screened.sigma_given
    )
    spare = None if states == "auto" else table_doubts.too_many_states(fit, offsets, **tested)
    flags += [spare] if spare else []
    interval = rate_intervals(fit, sigma_known=known)
    for rival in () if estimated is None else estimated.rivals:
        choice = select(rival.data, states=numbers, offsets=offsets, **tested).chosen.fit
        flags += table_doubts.of_other_noise(fit, rival.law, choice)
        again = _final(rival.data, fit, fit.n_states, known)
        interval = _hull(interval, rate_intervals(again, sigma_known=known))
    flags += table_doubts.of_rates(fit, interval, too_many=spare is not None)
    flags += [table_doubts.of_run(fit, run, estimated) for run in runs]
    other = fit_other_laws(fit.data)
    may_miss = fit.misses or not screened.sigma_given
    better = table_doubts.better_laws(fit, other, misses=may_miss)
    flags += table_doubts.of_laws(
        better,
        told,
        worst(better[0].course) if better else None,
        misses=may_miss,
    )
    beyonds = tuple(
        _believed(extrapolation.beyond(fit, t), valid if runs else None, interval, data)
        for t in extrapolate_s
    )
    flags += extrapolation.warnings(beyonds, data)
    return TableFit(
        fit=fit,
        selection=selection,
        interval95=interval,
        bootstrap95=bootstrap_intervals(fit, bootstrap, seed) if bootstrap else None,
        sigma=said,
        scaled=not known,
        scaled_to_law=estimated is not None and estimated.own,
        other_laws=tuple(other),
        better_laws=tuple(better),
        valid_s=valid,
        worst_miss=told,
        missed=tuple(runs),
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
    factor = np.sqrt(np.maximum((fit.residual**2).sum(axis=0) / spare, (LEAST_NOISE * peak / smallest) ** 2))
    law = None if data.law is None else data.law.scaled(factor)
    return fit_decay(
        replace(data, sigma=data.sigma * factor, law=law), n_states, near=[fit.theta[:n_states]], **options
    )


def _believed(b: Beyond, valid_s: tuple[float, float] | None, interval: Array, data: DecayData) -> Beyond:
    """Return a value at another time with the fit's own left out where that is not to be believed.

    Args:
        valid_s: where the fit misses nothing by much, if that is not everywhere.
        interval: (n_c, 2) of the rates.
    """
    if valid_s is not None and not valid_s[0] <= b.t_s <= valid_s[1]:
        return b.without_value(f"the fit is valid from {valid_s[0]:.4g} s to {valid_s[1]:.4g} s only")
    if b.t_s < data.begin_s and not np.isfinite(interval[:, 1]).all():
        # What faded before the first value is as large as one likes before it.
        return b.without_value(f"it counts on light that may have been over at {data.begin_s:.4g} s")
    return b


def _hull(one: Array, other: Array) -> Array:
    """Return (n_c, 2) intervals that hold both."""
    return np.stack([np.minimum(one[:, 0], other[:, 0]), np.maximum(one[:, 1], other[:, 1])], axis=1)
