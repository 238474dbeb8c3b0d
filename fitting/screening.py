"""What of a table can be used, and a sentence on everything that cannot."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.fitting import decay, decay_problem
from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.falling import not_falling
from phoslab.fitting.table import DecayTable

Array = NDArray[np.float64]

# A first value is taken for clipped if it costs the fit this much chi², and lies below the others' course.
_CLIPPED = 25.0
_MOST_CLIPPED = 3
# Squares of values, over squares of their errors, must stay within what float64 holds.
_LEAST, _MOST = 1e-60, 1e60


@dataclass(frozen=True)
class Screened:
    """The usable part of a table.

    Args:
        data: sorted by time, without the channels that hold no decay; σ is 1 in channels that give none.
        sigma_given: whether every channel gives its σ.
        flags: "code: sentence", one for everything left out or doubtful.
        lost: by channel left out, the reason.
    """

    data: DecayData
    sigma_given: bool
    flags: tuple[str, ...]
    lost: dict[str, str]


def screen(table: DecayTable) -> Screened:
    """Sort out rows and columns that hold no decay.

    Raises:
        PhoslabError: nothing is left; the error says why.
    """
    flags: list[str] = []
    known = np.isfinite(table.t_s)
    if not known.all():
        flags.append(f"time-missing: {np.sum(~known)} rows without a time are left out.")
    early = known & (table.t_s < 0)
    if early.any():
        flags.append(f"before-lamp-off: {early.sum()} rows with t_s < 0 are left out: the lamp was still on.")
    rows = np.flatnonzero(known & ~early)
    if (np.diff(table.t_s[rows]) < 0).any():
        flags.append("unsorted: the rows were not in order of time; they have been sorted.")
    rows = rows[np.argsort(table.t_s[rows], kind="stable")]
    t = table.t_s[rows]
    if (np.diff(t) == 0).any():
        flags.append(
            f"repeated-times: {np.sum(np.diff(t) == 0)} times occur more than once; each value counts as a "
            "measurement of its own."
        )
    given = np.asarray(~np.isnan(table.sigma).all(axis=0))
    sigma = np.where(given, table.sigma[rows], 1.0)
    signal = table.signal[rows]
    lost: dict[str, str] = {}
    for c, name in enumerate(table.channels):
        bad_sigma = ~(sigma[:, c] > 0) | ~np.isfinite(sigma[:, c])
        missing = ~np.isfinite(signal[:, c])
        if (bad_sigma & ~missing).any():
            flags.append(
                f"sigma-unusable: {np.sum(bad_sigma & ~missing)} values of {name} have no positive σ and are left out."
            )
        if missing.any():
            flags.append(f"not-a-number: {missing.sum()} values of {name} are missing and left out.")
        sigma[missing | bad_sigma, c] = np.inf
        signal[missing, c] = 0.0
        clipped = _plateau(t, signal[:, c], np.isfinite(sigma[:, c]))
        if clipped:
            flags.append(
                f"saturated: the first {clipped} values of {name} are all at its largest, "
                f"{signal[0, c]:.6g}: the meter was at its limit; they are left out."
            )
            sigma[:clipped, c] = np.inf
        reason = no_decay(t, signal[:, c], sigma[:, c])
        if given[c] and not missing.all() and (bad_sigma | missing).all():
            reason = f"has no usable value: no σ in {name}_sigma is positive"
        if reason:
            lost[name] = reason
    every = DecayData(t, table.exposure_s[rows], signal, sigma, channels=table.channels)
    for c, name in enumerate(table.channels):
        if name not in lost and (reason := not_falling(every, c, sigma_known=bool(given[c]))):
            lost[name] = reason
    flags += [f"channel-lost: {name} {reason}." for name, reason in lost.items()]
    kept = [c for c, name in enumerate(table.channels) if name not in lost]
    if not kept:
        raise PhoslabError(
            "holds no decay: " + "; ".join(f"{name} {reason}" for name, reason in lost.items()),
            file=table.file,
            remedy="Without a decay there are no rates: check the columns, and that the lamp was off.",
        )
    data = replace(
        every,
        signal=signal[:, kept],
        sigma=sigma[:, kept],
        channels=tuple(table.channels[c] for c in kept),
    )
    if given[kept].any() and not given[kept].all():
        flags.append("sigma-partial: some channels give no σ: the σ of all are estimated from the data.")
    return Screened(data, bool(given[kept].all()), tuple(flags), lost)


def _plateau(t: Array, values: Array, used: NDArray[np.bool_]) -> int:
    """Return how many values at the start equal the largest, if they are of several times and the rest falls."""
    seen = values[used]
    if seen.size < 4 or seen.min() == seen.max():
        return 0
    at_limit = values == seen.max()
    run = int(np.argmin(at_limit)) if not at_limit.all() else values.size
    return run if run > 1 and t[run - 1] > t[0] else 0


def no_decay(t: Array, values: Array, sigma: Array) -> str | None:
    """Return why values are no decay, or None.

    Args:
        t, values, sigma: (n,); an infinite sigma is of a value that cannot be used.
    """
    used = np.isfinite(sigma)
    v, at = values[used], t[used]
    if v.size == 0:
        return "holds no usable value"
    if (v == 0).all():
        return "is zero throughout: nothing glows"
    if not _LEAST <= np.abs(v).max() <= _MOST:
        return f"has a largest value of {np.abs(v).max():.3g}, whose square no computer holds: give it in another unit"
    if (v <= 0).all():
        return "is negative throughout: no light has that; check its sign and the dark value"
    if np.median(v) < 0 and v.max() < 3 * -v.min():
        return "is mostly negative: no light has that; check its sign and the dark value"
    if v.size < 2 or at[0] == at[-1]:
        return "has values at one time only: a rate needs two"
    if (v == v[0]).all():
        return "does not change"
    if v.size >= 4:
        # Mann and Kendall's test for a trend: of something that falls, so many pairs rise once in 30,000 times.
        pairs = np.sign(np.subtract.outer(v, v)) * np.sign(np.subtract.outer(at, at))
        n = v.size
        if pairs.sum() / 2 > 4 * np.sqrt(n * (n - 1) * (2 * n + 5) / 18) or pairs.sum() == n * (n - 1):
            return "rises instead of falling"
    elif v[-1] > v[0]:
        return "rises instead of falling"
    return None


def clipped_start(data: DecayData, *, n_states: int) -> tuple[DecayData, tuple[str, ...]]:
    """Leave out first values that lie below what the others say: clipped, or taken while the lamp was fading.

    A sum of falling exponentials seen backwards only steepens, so a first value may lie above the course of the
    others (a faster state) but not below.
    """
    flags: list[str] = []
    for frame in range(min(_MOST_CLIPPED, data.t_s.size - 6)):
        sigma = data.sigma.copy()
        sigma[frame] = np.inf
        without = replace(data, sigma=sigma)
        if without.n_values <= decay_problem.n_parameters(data, n_states, offset=False, rank_one=False):
            break
        with_it = decay.fit_decay(data, n_states, rank_one=False, polish=False)
        free = decay.fit_decay(without, n_states, rank_one=False, polish=False)
        predicted = free.predict(data.t_s[frame : frame + 1], data.exposure_s[frame : frame + 1])[0]
        low = data.used[frame] & (predicted - data.signal[frame] > 3 * data.sigma[frame])
        # Where the fit is bad everywhere, one value more proves nothing.
        scale = max(1.0, free.chi2 / max(1, free.dof))
        if not low.any() or (with_it.chi2 - free.chi2) / scale < _CLIPPED:
            break
        lower = float(np.mean(1 - data.signal[frame, low] / predicted[low]))
        flags.append(
            f"clipped-start: the value at {data.t_s[frame]:.4g} s lies {lower:.0%} below what all others say "
            f"({', '.join(np.array(data.channels)[low])}): clipped, or taken while the lamp was fading; left out."
        )
        sigma = data.sigma.copy()
        sigma[frame, low] = np.inf
        data = replace(data, sigma=sigma)
    return data, tuple(flags)
