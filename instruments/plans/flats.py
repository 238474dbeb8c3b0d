"""Flats: what the camera makes of a given light, from frames of an evenly lit grey card.

Two things are measured. *Noise*: at every ISO, pairs of frames at levels from bright to dark; the variance of a pair's
difference against its mean is the photon-transfer curve (gain, read noise). *Steps*: exposure times, ISO and apertures
are only nominal; wherever another plan may change one of them, two frames that differ in nothing else say by how much
the signal really changes. Nalbach 2017, 8.4.1, calibrates changes of ISO and aperture out in the same way.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

from phoslab.instruments.devices import Exposure
from phoslab.instruments.plans.darks import dark_frames
from phoslab.instruments.plans.ladder import Ladder, gain
from phoslab.instruments.plans.metering import meter
from phoslab.instruments.plans.steps import Door, Lamp, Part, Plan, Setup, Shoot, Shot, Stage, Step
from phoslab.instruments.plans.warm_up import warm_up
from phoslab.plan_parameters import Flats

CARD = Stage("card")

_LOW, _HIGH = 0.10, 0.75
"""Levels between which both frames of an overlap must lie: a stop apart and away from noise and saturation."""


def flats(p: Flats, setup: Setup) -> Plan:
    """Pairs at `p.levels` levels for every ISO, an overlap for every change of a setting, dark frames for all."""
    used: set[Exposure] = set()
    exposure: Exposure | None = None
    for iso in setup.ladder.isos:
        yield Part(f"noise at ISO {iso:g}")
        yield from _light(setup)
        # The aperture is stopped down rather than leave no shorter times for the darker levels.
        times_s = setup.ladder.exposures_s
        ladder = Ladder(times_s[min(p.levels, len(times_s)) - 1 :], (iso,), setup.ladder.f_numbers)
        brightest = yield from meter(ladder, exposure and replace(exposure, iso=iso))
        for exposure_s in _shorter(setup.ladder, brightest, p.levels):
            exposure = replace(brightest, exposure_s=exposure_s)
            used.add(exposure)
            for _ in range(2):
                yield Shoot("flat", exposure)
        exposure = brightest
    yield Part("overlaps of settings")
    yield from _light(setup)
    reference = yield from meter(setup.ladder, exposure)
    shot: Shot = yield Shoot("meter", reference)
    for a, b in _overlaps(setup.ladder, reference, shot.level):
        used |= {a, b}
        yield Shoot("flat", a)
        yield Shoot("flat", b)
    yield Lamp("off")
    yield from dark_frames(used, p.darks)


def _light(setup: Setup) -> Generator[Step, Any, None]:
    yield CARD
    yield from warm_up("lamp", setup)
    yield Lamp("on")
    yield Door("open")


def _shorter(ladder: Ladder, brightest: Exposure, n: int) -> tuple[float, ...]:
    """`n` exposure times from the brightest down."""
    below = [t for t in ladder.exposures_s if t <= brightest.exposure_s * 1.001]
    return tuple(reversed(below[-n:]))


def _overlaps(ladder: Ladder, reference: Exposure, level: float) -> Iterator[tuple[Exposure, Exposure]]:
    """Pairs that differ in one setting by one rung, at others that expose both well; a pair without any is left out.

    Args:
        reference, level: a frame of the same light.
    """
    everything = [
        Exposure(t, iso, f) for f in ladder.f_numbers for iso in ladder.isos for t in ladder.exposures_s
    ]

    def serves(exposure: Exposure) -> bool:
        return _LOW <= level * gain(exposure) / gain(reference) <= _HIGH

    changes: tuple[tuple[str, tuple[float | None, ...]], ...] = (
        ("exposure_s", ladder.exposures_s),
        ("iso", ladder.isos),
        ("f_number", ladder.f_numbers),
    )
    for name, values in changes:
        for low, high in pairwise(values):
            for base in everything:
                if getattr(base, name) != low:
                    continue
                changed: dict[str, Any] = {name: high}
                other = replace(base, **changed)
                if serves(base) and serves(other):
                    yield base, other
                    break
