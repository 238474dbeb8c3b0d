"""Classes of photoluminescent safety signs, estimated from a decay of luminance.

The tables come from secondary sources (data sheets and guides that quote the standards), not from the standards. What
comes out is an estimate and no certification: a test house measures with the standard's own lamp, geometry and
temperature.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.fitting.decay_data import DecayData

Array = NDArray[np.float64]

SOURCE = "The class tables come from secondary sources. This is an estimate, not certification."


@dataclass(frozen=True)
class Standard:
    """A standard's excitation, and the least luminance in mcd/m² of each class at its times.

    Args:
        name: of the standard.
        excitation: what charges the sample, in words.
        illuminance_lx, duration_s: the same in numbers.
        minutes: after the light went off.
        classes: least luminance at those minutes, lowest class first.
        unchecked: what the numbers do not tell of the charging and a verdict therefore depends on.
    """

    name: str
    excitation: str
    illuminance_lx: float
    duration_s: float
    minutes: tuple[float, ...]
    classes: Mapping[str, tuple[float, ...]]
    unchecked: str


_XENON = ("xenon, 1000 lx for 5 min", 1000.0, 300.0)

STANDARDS = (
    Standard(
        "PSPA", *_XENON, (2, 10, 30, 60),
        {"A": (108, 23, 7, 3), "B": (210, 50, 15, 7), "C": (690, 140, 45, 20), "D": (1100, 260, 85, 35),
         "E": (1800, 400, 120, 55), "F": (2300, 520, 155, 70), "G": (3000, 650, 190, 80)},
        "if the lamp was a xenon lamp",
    ),
    Standard(
        "JIS Z 9107", "200 lx for 20 min", 200.0, 1200.0, (2, 10, 20, 30, 60),
        {"JA": (210, 50, 24, 15, 7), "JB": (440, 105, 50, 31, 15), "JC": (880, 210, 100, 62, 30),
         "JD": (1760, 420, 200, 124, 60)},
        "if the lamp was the standard's",
    ),
    # How long the 25 lx shine is not in the sources at hand.
    Standard(
        "IMO / ISO 15370", "25 lx", 25.0, float("nan"), (10, 60), {"pass": (15, 2)},
        "if lamp and length of light were the standard's, which the sources at hand do not tell",
    ),
)  # fmt: skip

MINUTES = tuple(sorted({minute for standard in STANDARDS for minute in standard.minutes}))
"""At which any of them reads."""

DIN = Standard("DIN 67510 style", *_XENON, (10, 60), {}, "if the lamp was a xenon lamp")
"""Has a label instead of classes."""

# Visible end of a DIN 67510 decay: a hundred times the threshold of the dark-adapted eye.
DIN_THRESHOLD_MCD = 0.3

DIN_LEGEND = (
    f"mcd/m² after 10 min / after 60 min - minutes until {DIN_THRESHOLD_MCD} mcd/m²; ?: outside the data"
)

_NONE = "below the lowest class"

# A value exactly at a limit reaches it, whatever float64 makes of exp(log(x)).
_AT = 1 - 1e-9


@dataclass(frozen=True)
class Verdict:
    """What a standard would say.

    Args:
        standard: its name.
        verdict: the class, "below the lowest class", "insufficient data", or "not comparable".
        reason: the limits that decide, with what was measured, in a sentence.
        luminance_mcd: by minute, where the data reach.
        condition: under which the verdict holds; "" for "not comparable".
    """

    standard: str
    verdict: str
    reason: str
    luminance_mcd: Mapping[float, float]
    condition: str = ""


@dataclass(frozen=True)
class Excitation:
    """How the sample was charged: illuminance in lx and duration in s; None where nobody says."""

    illuminance_lx: float | None = None
    duration_s: float | None = None


@dataclass(frozen=True, eq=False)
class Glow:
    """Luminance over time, between the first and the last time that data support.

    Args:
        luminance_mcd: in mcd/m² at (n,) times in s after the light went off.
        first_s, last_s: where it is known.
        share: its standard error as a share of it, at (n,) times; None where nobody says.
    """

    luminance_mcd: Callable[[Array], Array]
    first_s: float
    last_s: float
    share: Callable[[Array], Array] | None = None

    def at(self, minutes: Sequence[float]) -> dict[float, float]:
        """Return the luminance in mcd/m² by minute, of those that it reaches."""
        known = [m for m in minutes if self.first_s * _AT <= 60 * m <= self.last_s / _AT]
        return dict(zip(known, self.luminance_mcd(60 * np.array(known)).tolist(), strict=True))

    def shifted(self, errors: float) -> Glow:
        """Return it with so many standard errors added to every value."""
        if self.share is None:
            return self
        share = self.share
        return replace(self, luminance_mcd=lambda at: self.luminance_mcd(at) * (1 + errors * share(at)))

    @property
    def span(self) -> str:
        """From when to when, in words."""
        return f"from {self.first_s / 60:.3g} to {self.last_s / 60:.3g} min"


def measured(data: DecayData, channel: int, scale: float, *, sigma_given: bool) -> Glow:
    """Return what is read off measured values.

    Between values log L is a straight line over log t: a power law, which long decays are piecewise. No sum of
    exponentials is fitted: over an hour and five decades it would miss just the values that decide.

    Args:
        scale: mcd/m² for 1 of the table.
        sigma_given: whether its σ are known.

    Raises:
        PhoslabError: fewer than two positive values.
    """
    used = _read(data, channel)
    if used.sum() < 2:
        raise PhoslabError(
            "has fewer than two positive values",
            field=data.channels[channel],
            remedy="Measure more of the decay.",
        )
    t, values = data.t_s[used], scale * data.signal[used, channel]
    # The first value may be at t = 0, whose logarithm is none: count from the first interval on.
    origin = float(t[t > 0].min()) if (t > 0).any() else 1.0

    def read(at: Array, of: Array) -> Array:
        return np.asarray(np.interp(np.log(at + origin), np.log(t + origin), of))

    share = scale * data.sigma[used, channel] / values
    return Glow(
        lambda at: np.exp(read(at, np.log(values))),
        float(t[0]),
        float(t[-1]),
        (lambda at: read(at, share)) if sigma_given else None,
    )


def _read(data: DecayData, channel: int) -> NDArray[np.bool_]:
    """Return which values are read: none from the first on that is not positive, for there is more noise than glow."""
    used = data.used[:, channel]
    lost = used & (data.signal[:, channel] <= 0)
    return used & ~np.logical_or.accumulate(lost)


def in_the_noise(data: DecayData, channel: int) -> tuple[str, ...]:
    """Return a sentence on values that are not read because they are lost in the meter's noise."""
    left_out = data.used[:, channel] & ~_read(data, channel)
    if not left_out.any():
        return ()
    since = float(data.t_s[left_out].min())
    return (
        f"in-the-noise: from {since:.4g} s on {data.channels[channel]} is not always positive: the meter no longer "
        "tells the glow from nothing, and no value from there on is read.",
    )


def classify(glow: Glow, excitation: Excitation) -> list[Verdict]:
    """Return what each standard would say of a decay.

    Args:
        glow: the decay.
        excitation: how the sample was charged.
    """
    return [_judge(s, glow, excitation) for s in STANDARDS]


def _judge(standard: Standard, glow: Glow, excitation: Excitation) -> Verdict:
    seen = glow.at(standard.minutes)
    why = differs(standard, excitation)
    if why:
        return Verdict(standard.name, "not comparable", why, seen)
    kept = _kept(standard, seen)
    higher = list(standard.classes)[len(kept) :]
    short = _short_of(standard, higher[0], seen) if higher else ""
    least, most = (_highest(_kept(standard, glow.shifted(e).at(standard.minutes))) for e in (-2, 2))
    if least != most:
        short += (
            f"{'; ' * bool(short)}within two standard errors of the readings it is from {least} to {most}"
        )
    if not kept:
        return Verdict(standard.name, _NONE, short, seen, standard.unchecked)
    if len(seen) < len(standard.minutes):
        missing = [m for m in standard.minutes if m not in seen]
        reason = f"the data reach {glow.span}; {_and(missing)} min are needed"
        if seen:
            reason += f" (so far it could be {kept[-1]}{'; ' * bool(short)}{short})"
        return Verdict(standard.name, "insufficient data", reason, seen, standard.unchecked)
    limits = f"its limits are {_and(standard.classes[kept[-1]])} mcd/m2 at {_and(standard.minutes)} min"
    return Verdict(standard.name, kept[-1], f"{limits}{'; ' * bool(short)}{short}", seen, standard.unchecked)


def _kept(standard: Standard, seen: Mapping[float, float]) -> list[str]:
    """Return the classes that no value excludes: one is lost at the first time that falls short, whatever follows."""
    return [
        name
        for name, limits in standard.classes.items()
        if all(seen[m] >= least * _AT for m, least in zip(standard.minutes, limits, strict=True) if m in seen)
    ]


def _highest(kept: Sequence[str]) -> str:
    return kept[-1] if kept else _NONE


def _short_of(standard: Standard, name: str, seen: Mapping[float, float]) -> str:
    """Return by which value a class is missed: the one that falls shortest of its limit."""
    limits = dict(zip(standard.minutes, standard.classes[name], strict=True))
    minute = min(seen, key=lambda m: seen[m] / limits[m])
    return f"{name} needs {limits[minute]:g} mcd/m2 at {minute:g} min, measured {seen[minute]:.3g}"


def differs(standard: Standard, excitation: Excitation) -> str | None:
    """Return why an excitation is not the standard's, or None."""
    if excitation.illuminance_lx is None:
        return f"the standard charges with {standard.excitation}; how this sample was charged is not said"
    wrong = abs(excitation.illuminance_lx / standard.illuminance_lx - 1) > 0.05
    said = f"{excitation.illuminance_lx:g} lx"
    if np.isfinite(standard.duration_s):
        if excitation.duration_s is None:
            return (
                f"the standard charges with {standard.excitation}; for how long this sample was is not said"
            )
        wrong = wrong or abs(excitation.duration_s / standard.duration_s - 1) > 0.05
        said += f" for {excitation.duration_s / 60:g} min"
    return f"the standard charges with {standard.excitation}, this sample had {said}" if wrong else None


def din_label(glow: Glow) -> str | None:
    """Return a label in the style of DIN 67510: L at 10 min / L at 60 min - minutes until 0.3 mcd/m².

    A part that the data do not reach is "?"; None where they reach neither 10 nor 60 min.
    """
    seen = glow.at(DIN.minutes)
    if not seen:
        return None
    parts = "/".join(f"{seen[m]:.3g}" if m in seen else "?" for m in DIN.minutes)
    t = np.geomspace(max(60.0, glow.first_s), glow.last_s, 4000)
    below = np.flatnonzero(glow.luminance_mcd(t) < DIN_THRESHOLD_MCD)
    end = f"{t[below[0]] / 60:.0f}" if below.size and t[below[0]] > glow.first_s else "?"
    return f"{parts}-{end}"


def _and(values: Sequence[float]) -> str:
    return ", ".join(f"{x:g}" for x in values)
