"""The camera's settings as a ladder, each rung one stop above the one before, and how to climb it.

What a frame holds is proportional to exposure time x ISO / f-number². Many settings give the same; the ladder takes
one for each stop, in the order in which light is scarce: with plenty of it the aperture is stopped down; then the
exposure grows longer at the widest aperture, which catches most photons; and only where it may not grow any longer
does the ISO rise, which amplifies photons but catches none.

Whole stops, so that few settings are used: each needs its dark frames, and each change one overlap in the flats.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from phoslab.errors import PhoslabError
from phoslab.instruments.devices import Exposure

LOWEST, HIGHEST = 0.05, 0.80
"""Share of saturation between which a frame is well exposed."""

TARGET = 0.55
"""Level that a new setting aims at: a stop of it may be missed and the light be 1.4 times as bright."""

SATURATED = 0.97
"""From here on a level says no more than that there is more light."""

KEEP = 0.22
"""A setting is kept while a frame reaches this: light that halves until the next still leaves twice `LOWEST`."""

NOMINAL: Mapping[str, Sequence[float]] = {
    "exposure_s": tuple(2.0**k for k in range(-12, 6)),
    "iso": tuple(100.0 * 2**k for k in range(7)),
    "f_number": (2.8, 4.0, 5.6, 8.0, 11.0, 16.0),
}
"""What cameras offer, for a rehearsal before there is one."""


def gain(exposure: Exposure) -> float:
    """Signal for a given light, relative to 1 s, ISO 100, f/1.

    >>> gain(Exposure(0.5, 200, 2.0))
    0.25
    """
    return exposure.exposure_s * exposure.iso / 100 / (exposure.f_number or 1.0) ** 2


@dataclass(frozen=True)
class Ladder:
    """Settings in ascending order of what they catch.

    >>> ladder = Ladder.of({"exposure_s": (0.5, 1, 2), "iso": (100, 200), "f_number": (2.8, 4)})
    >>> [(e.exposure_s, e.iso, e.f_number) for e in ladder.rungs]
    [(0.5, 100, 4), (0.5, 100, 2.8), (1, 100, 2.8), (2, 100, 2.8), (2, 200, 2.8)]
    >>> [e.iso for e in ladder.up_to(1).rungs]
    [100, 100, 100, 200]
    """

    exposures_s: tuple[float, ...]
    isos: tuple[float, ...]
    f_numbers: tuple[float | None, ...]

    @classmethod
    def of(cls, choices: Mapping[str, Sequence[float]], limits: Mapping[str, float] | None = None) -> Ladder:
        """Take whole stops of what a camera offers.

        Args:
            choices: of a `Camera`; what it cannot set has none.
            limits: `exposure_min_s`, `exposure_max_s`, `iso_min`, `iso_max`, `f_number_min`, `f_number_max`.

        Raises:
            PhoslabError: nothing is left.
        """
        limits = limits or {}

        def within(name: str, low: str, high: str, stop: float) -> tuple[float, ...]:
            values = sorted(
                v
                for v in choices.get(name, ())
                if limits.get(low, 0.0) * 0.999 <= v <= limits.get(high, math.inf) * 1.001
            )
            return _stops(values, stop)

        exposures = within("exposure_s", "exposure_min_s", "exposure_max_s", 2.0)
        isos = within("iso", "iso_min", "iso_max", 2.0)
        if not exposures or not isos:
            raise PhoslabError(
                "offers no exposure time or ISO within the limits",
                field="the camera",
                remedy="Widen [camera.limits] in the rig file, or say there what is set: exposures_s and isos.",
            )
        return cls(
            exposures, isos, within("f_number", "f_number_min", "f_number_max", math.sqrt(2)) or (None,)
        )

    @property
    def rungs(self) -> tuple[Exposure, ...]:
        """The settings, ascending."""
        shortest, longest, iso = self.exposures_s[0], self.exposures_s[-1], self.isos[0]
        widest, *narrower = self.f_numbers
        return (
            *(Exposure(shortest, iso, f) for f in reversed(narrower)),
            *(Exposure(t, iso, widest) for t in self.exposures_s),
            *(Exposure(longest, speed, widest) for speed in self.isos[1:]),
        )

    def up_to(self, longest_s: float) -> Ladder:
        """The same without longer exposures than this; the shortest one stays."""
        kept = tuple(t for t in self.exposures_s if t <= longest_s * 1.001)
        return Ladder(kept or self.exposures_s[:1], self.isos, self.f_numbers)

    @property
    def middle(self) -> Exposure:
        """Where to begin when nothing is known."""
        return self.rungs[len(self.rungs) // 2]

    def aim(self, exposure: Exposure, level: float, target: float = TARGET) -> Exposure:
        """The rung that brings a light, which gave `level` at `exposure`, nearest below `target`.

        A saturated frame only says "too much": three stops less.
        """
        if level >= SATURATED:
            return self.reaching(gain(exposure) / 8)
        return self.reaching(gain(exposure) * target / max(level, 1e-4))

    def reaching(self, wanted: float) -> Exposure:
        """The rung with the largest gain up to `wanted`, or the lowest."""
        below = [e for e in self.rungs if gain(e) <= wanted * 1.02]
        return below[-1] if below else self.rungs[0]

    def follow(self, exposure: Exposure, level: float) -> Exposure:
        """The setting for the next frame of a light that only fades: the same while it serves."""
        if math.isnan(level):
            return exposure
        if KEEP <= level <= HIGHEST and exposure.exposure_s <= self.exposures_s[-1] * 1.001:
            return exposure
        return self.aim(exposure, level)


def _stops(values: Sequence[float], stop: float) -> tuple[float, ...]:
    """Every value that is about one `stop` above the last one taken; all where they are further apart."""
    taken: list[float] = list(values[:1])
    for value in values[1:]:
        # Cameras round: 1/60 follows 1/30 and f/5.6 f/4. A third of a stop is 2^(1/3); a sixth of one is tolerance.
        if value >= taken[-1] * stop / 2 ** (1 / 6 if stop == 2.0 else 1 / 12):
            taken.append(value)
    return tuple(taken)
