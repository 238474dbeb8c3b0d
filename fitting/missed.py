"""What a fit misses by so much that it is not valid there, whatever its σ say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting.decay import DecayFit

Array = NDArray[np.float64]

# A value that the model gives to more than half of itself is not described by it.
_SHARE = 0.5
_SIGMAS = 3.0
# Without given σ a value counts only if it and its neighbours lie on a course that is smooth to this; whatever σ was
# found for it, if they do to this: noise of that size would show.
_SMOOTH, _VERY_SMOOTH = 0.3, 0.1
_NEIGHBOURS = 2


@dataclass(frozen=True)
class Run:
    """Neighbouring values of a channel that are missed, and the worst of them.

    Args:
        channel: its index.
        first, last: indices of frames.
        worst: index of the frame that is missed by the largest factor.
    """

    channel: int
    first: int
    last: int
    worst: int


@dataclass(frozen=True)
class Miss:
    """How far a value is missed, as a share of it.

    Args:
        channel: its name.
        t_s: when.
        share: of the value.
    """

    channel: str
    t_s: float
    share: float


@dataclass(frozen=True, eq=False)
class KnownNoise:
    """What tells which values are well measured.

    Args:
        sigma: (n, n_channels) of the values, not scaled to what the fit misses; 0 where nothing tells it.
        given: whether the table gives σ; else a value must lie on a smooth course with its neighbours, too.
    """

    sigma: Array
    given: bool


def worst_miss(fit: DecayFit, course: Array, valid_s: tuple[float, float], noise: KnownNoise) -> Miss | None:
    """Return the well-measured value within `valid_s` that is missed by the largest share of it, if there is any.

    Args:
        course: (n, n_channels) what a model says.
    """
    data = fit.data
    worst = None
    for c, channel in enumerate(data.channels):
        for k in np.flatnonzero(data.used[:, c])[_well_measured(fit, c, noise)]:
            share = abs(float(course[k, c] / data.signal[k, c] - 1))
            if valid_s[0] <= data.t_s[k] <= valid_s[1] and (worst is None or share > worst.share):
                worst = Miss(channel, float(data.t_s[k]), share)
    return worst


def _well_measured(fit: DecayFit, channel: int, noise: KnownNoise) -> NDArray[np.bool_]:
    """Return which used values of a channel stand out of the noise."""
    data = fit.data
    frames = np.flatnonzero(data.used[:, channel])
    values = data.signal[frames, channel]
    clear = np.asarray(values > _SIGMAS * noise.sigma[frames, channel])
    if noise.given:
        return clear
    scatter = _scatter(data.t_s[frames], values)
    return np.asarray((clear & (scatter < _SMOOTH)) | (scatter < _VERY_SMOOTH))


def missed(fit: DecayFit, noise: KnownNoise) -> list[Run]:
    """Return the runs of values that the fit misses by more than half of themselves though they are well measured.

    A single value inside may be an outlier; two in a row, the first or the last are the model's fault.
    """
    data = fit.data
    model = fit.predict(data.t_s, data.exposure_s)
    runs = []
    for c in range(len(data.channels)):
        frames = np.flatnonzero(data.used[:, c])
        values, told = data.signal[frames, c], model[frames, c]
        off = np.abs(values - told)
        bad = _well_measured(fit, c, noise) & (off > _SHARE * np.abs(values))
        if noise.given:
            bad &= off > _SIGMAS * noise.sigma[frames, c]
        edges = np.flatnonzero(np.diff(np.concatenate([[0], bad.astype(int), [0]])))
        for first, end in edges.reshape(-1, 2):
            if end - first > 1 or first == 0 or end == frames.size:
                factor = off[first:end] / np.maximum(
                    np.minimum(np.abs(told), np.abs(values))[first:end], 1e-300
                )
                worst = first + int(np.argmax(factor))
                runs.append(Run(c, int(frames[first]), int(frames[end - 1]), int(frames[worst])))
    return runs


def valid_times(fit: DecayFit, runs: list[Run]) -> tuple[float, float]:
    """Return from when to when the fit is valid, in s: the stretch without a run that holds most values."""
    data = fit.data
    if not runs:
        return data.begin_s, data.end_s
    bad = np.unique(np.concatenate([np.arange(run.first, run.last + 1) for run in runs]))
    edges = np.concatenate([[-1], bad, [data.t_s.size]])
    longest = int(np.argmax(np.diff(edges)))
    stretch = slice(edges[longest] + 1, max(edges[longest + 1], edges[longest] + 2))
    return float(data.t_s[stretch].min()), float((data.t_s + data.exposure_s)[stretch].max())


def _scatter(t_s: Array, values: Array) -> Array:
    """Return how far values lie off power laws between their neighbours, as a share; infinite where one is below 0."""
    n = values.size
    positive = values > 0
    if n < 3:
        return np.where(positive, 0.0, np.inf)
    x, y = np.log(t_s - t_s[0] + _first_step(t_s)), np.log(np.where(positive, values, 1.0))
    width = np.maximum(x[2:] - x[:-2], 1e-12)
    right = (x[1:-1] - x[:-2]) / width
    off = y[1:-1] - (1 - right) * y[:-2] - right * y[2:]
    # Of three values with equal scatter each: what the middle one is off has that of all.
    scatter = np.abs(off) / np.sqrt(1 + right**2 + (1 - right) ** 2)
    scatter = np.concatenate([scatter[:1], scatter, scatter[-1:]])
    found = np.full(n, np.inf)
    for k in range(n):
        near = slice(max(0, k - _NEIGHBOURS), k + _NEIGHBOURS + 1)
        if positive[near].all():
            found[k] = np.sqrt(np.mean(scatter[near] ** 2))
    return found


def _first_step(t_s: Array) -> float:
    """Return a time to count logarithms from: the first value may be at t = 0, which has none."""
    steps = np.diff(t_s)
    return float(t_s[0]) if t_s[0] > 0 else float(steps[steps > 0].min())
