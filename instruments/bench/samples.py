"""The samples that lie ready on the bench, by name."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from phoslab.errors import PhoslabError
from phoslab.instruments.bench.film import Film
from phoslab.instruments.bench.paints import known, paint
from phoslab.instruments.bench.sample import Sample
from phoslab.instruments.bench.states import StateFilm, StatePaint, state_paint

_OTHERS: dict[str, Callable[[], Sample]] = {
    "broad": partial(Sample, name="broad"),
    "two-states": partial(state_paint, "two-states", "green", 1.5),
}
"""Beside the paints: one wide distribution of traps; and two states as the model has them, not at all as paint does."""


def names() -> tuple[str, ...]:
    """All of them."""
    return (*known(), *_OTHERS)


def sample(name: str) -> Sample:
    """Return the sample of that name.

    Raises:
        PhoslabError: there is none.
    """
    if name not in names():
        raise PhoslabError(
            f"is {name!r}, which is no sample of the bench",
            field="--simulate",
            remedy=f"Use one of: {', '.join(names())}.",
        )
    return _OTHERS[name]() if name in _OTHERS else paint(name)


def rested(sample: Sample) -> Film:
    """Return a piece of a sample that was kept dark for long, with the physics that it has."""
    return StateFilm.rested(sample) if isinstance(sample, StatePaint) else Film.dark(sample)
