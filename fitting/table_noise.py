"""The noise of a table that gives no σ, from the scatter of its values about a smooth course.

The course is that of a few exponentials, or Becquerel's law where that is likelier: a decay as 1/t over three
decades is no sum of three exponentials, and what these miss is no noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting import noise
from phoslab.fitting.decay import fit_decay
from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.other_laws import enough_values, fit_law

Array = NDArray[np.float64]

# Noise that digits of a file hide altogether.
LEAST_NOISE = 1e-10
# What is less simple must be likelier by a factor of e².
_LIKELIER = 2.0
# What is less likely by a factor of e³ is not; of few values that are nearly followed, likelihoods tell less.
_UNLIKELY = 3.0
_OTHER = "Becquerel"
# Weights of another law follow its own course: relative ones settle to a per cent.
_ITERATIONS = 4

WORDS = {
    "constant": "the same for all values of a channel",
    "photon": "growing with the root of the signal",
    "relative": "in proportion to the signal",
}


@dataclass(frozen=True)
class Noise:
    """The noise that was found.

    Args:
        data: the values with their σ.
        law: "constant", "photon" or "relative".
        said: how σ was found, in words.
        own: whether σ is from another law than the exponentials: then χ² tells how well these do.
        rivals: what other laws say that are not much less likely; none if it is `own`.
    """

    data: DecayData
    law: str
    said: str
    own: bool
    rivals: tuple[Noise, ...] = ()


@dataclass(frozen=True)
class _Course:
    """A smooth course through the values: σ but for a factor (n, n_channels), residuals in these, and its price.

    Args:
        about: "the fit", or the law.
        unit: (n, n_channels) σ but for a factor a channel; infinite where a value is left out.
        squares: (n_channels,) sum of squares of residuals in `unit`.
        n_parameters: of one channel, its share of common ones included.
    """

    about: str
    unit: Array
    squares: Array
    n_parameters: float


def estimate_noise(data: DecayData, n_states: int, law: str = "auto", *, skip: int = 0) -> Noise:
    """Return the data with σ from their own scatter.

    Args:
        data: with any σ.
        n_states: of the exponentials.
        law: "constant", "photon" (σ² as the signal), "relative" (σ as the signal), or "auto" for the likeliest.
        skip: leave so many first frames out of it.
    """
    rest = data.take(slice(skip, None)) if data.t_s.size > 2 * n_states + 4 + skip else data
    found_by: dict[str, tuple[float, _Course]] = {}
    for name in noise.LAWS if law == "auto" else (law,):
        for course in _courses(rest, name, n_states):
            # Fewer parameters are no merit of another law: every decay is judged by the price of the exponentials.
            price = max(course.n_parameters, n_states + n_states / rest.signal.shape[1])
            simpler = (name == "constant") + (course.about == "the fit")
            likelihood = _likelihood(rest, course, price) + _LIKELIER * simpler
            if name not in found_by or likelihood > found_by[name][0]:
                found_by[name] = likelihood, course
    name = max(found_by, key=lambda law: found_by[law][0])
    likeliest, course = found_by[name]
    worth = max(rest.n_values - course.n_parameters * rest.signal.shape[1], 1.0) / rest.n_values
    found = _noise_about(data, rest, n_states, name, course)
    if found.own:
        return found
    rivals = (
        _noise_about(data, rest, n_states, other, about)
        for other, (x, about) in found_by.items()
        if other != name and worth * (likeliest - x) < _UNLIKELY
    )
    return replace(found, rivals=tuple(rivals))


def _noise_about(data: DecayData, rest: DecayData, n_states: int, name: str, course: _Course) -> Noise:
    """Return the noise of a law, from the scatter of `rest` of the data about a course."""
    factor = np.sqrt(_scale2(rest, course, course.n_parameters))
    found = noise.unscaled(noise.LAWS[name], data.signal.shape[1]).scaled(factor)
    said = f"estimated from the scatter about {course.about}, {WORDS[name]}"
    if course.about == "the fit":
        first = np.where(data.used, found.sigma(np.maximum(data.signal, 0.0)), np.inf)
        fit = fit_decay(replace(data, sigma=first, law=found), n_states, rank_one=False, polish=False)
        law_kept = None if name == "constant" else found
        return Noise(replace(fit.data, law=law_kept, expected=None), name, said, own=False)
    (whole,) = [c for c in _courses(data, name, n_states) if c.about == course.about]
    return Noise(replace(data, sigma=whole.unit * factor, law=None, expected=None), name, said, own=True)


def _courses(data: DecayData, name: str, n_states: int) -> list[_Course]:
    """Fit exponentials and Becquerel's law with the weights of one noise law."""
    n_channels = data.signal.shape[1]
    law = noise.unscaled(noise.LAWS[name], n_channels)
    first = np.where(data.used, law.sigma(np.maximum(data.signal, 0.0)), np.inf)
    start = replace(data, sigma=first, law=None if name == "constant" else law)
    fit = fit_decay(start, n_states, rank_one=False, polish=False)
    courses = [
        _Course("the fit", fit.data.sigma, (fit.residual**2).sum(axis=0), n_states + n_states / n_channels)
    ]
    if not enough_values(start):
        return courses
    about, other = start, fit_law(start, _OTHER)
    for _ in range(0 if name == "constant" else _ITERATIONS):
        about = about.weighted_by(other.course)
        other = fit_law(about, _OTHER, near=other)
    miss = np.where(data.used, (data.signal - other.course) / about.sigma, 0.0)
    courses.append(_Course(f"a {_OTHER} law", about.sigma, (miss**2).sum(axis=0), 1 + 2 / n_channels))
    return courses


def _scale2(data: DecayData, course: _Course, n_parameters: float) -> Array:
    """Return (n_channels,) the variance in units of `course.unit`, squared."""
    spare = np.maximum(data.used.sum(axis=0) - n_parameters, 0.5)
    smallest = np.where(data.used, course.unit, np.inf).min(axis=0)
    least = (LEAST_NOISE * np.abs(data.signal).max(axis=0) / smallest) ** 2
    scale2: Array = np.maximum(course.squares / spare, least)
    return scale2


def _likelihood(data: DecayData, course: _Course, n_parameters: float) -> float:
    """Return the logarithm of the likelihood of the values, with the variance that they show."""
    units = np.log(np.where(data.used, course.unit, 1.0)).sum()
    scales = (data.used.sum(axis=0) * np.log(_scale2(data, course, n_parameters)) / 2).sum()
    return -float(units + scales)
