"""The parameters of the measurement plans: what session.toml holds, what a plan takes, what the command line offers.

One frozen dataclass a plan; a field is a parameter, its name ends with its unit, and its option is the name without
the unit: `until_s` is `--until`. Nothing here imports more than Python, so that `--help` stays fast.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from phoslab.errors import PhoslabError


def _given(default: Any, text: str, low: float | None = None, *, choices: tuple[str, ...] = ()) -> Any:
    """A parameter: its default, what it says in `--help`, its smallest value or its choices."""
    return field(default=default, metadata={"help": text, "low": low, "choices": choices})


@dataclass(frozen=True)
class Flats:
    """Grey-card frames for the noise model, and overlapping frames at every change of a setting."""

    levels: int = _given(5, "exposures at each ISO, from bright to dark, each taken twice", 1)
    darks: int = _given(2, "dark frames for each setting", 1)


@dataclass(frozen=True)
class Lamp:
    """The spectrum of the exciting lamp: the grey card through the LVF."""

    frames: int = _given(3, "frames", 1)
    darks: int = _given(3, "dark frames", 1)
    lux_lx: float = _given(0.0, "illuminance at the sample as a luxmeter reads it; 0: the rig file's", 0)


@dataclass(frozen=True)
class Lvf:
    """Calibration of the LVF: a mercury lamp, a white LED, and the LED with each known filter."""

    filters: str = _given("", "names of the filters, separated by commas; empty: all of the rig file's")
    frames: int = _given(1, "frames of each", 1)
    darks: int = _given(2, "dark frames for each setting", 1)


@dataclass(frozen=True)
class Emission:
    """The spectrum of the glow: the charged sample through the LVF, long exposures."""

    charge_s: float = _given(5400.0, "how long the lamp shines before", 1)
    frames: int = _given(3, "frames", 1)
    longest_s: float = _given(30.0, "longest exposure", 0.01)
    darks: int = _given(3, "dark frames for each setting", 1)


@dataclass(frozen=True)
class Decay:
    """The decay after the lamp goes off (Nalbach 2017, 8.4.4)."""

    charge_s: float = _given(5400.0, "how long the lamp shines before", 1)
    until_s: float = _given(180.0, "time of the last frame after lamp-off", 1)
    spacing: str = _given("even", "of the frames in time", choices=("even", "log"))
    interval_s: float = _given(5.0, "from frame to frame, if even", 0.1)
    per_decade: int = _given(20, "frames in each tenfold of time, if log", 2)
    longest_s: float = _given(30.0, "longest exposure", 0.01)
    darks: int = _given(3, "dark frames for each setting", 1)


@dataclass(frozen=True)
class Excitation:
    """The glow after exposures of growing length through the LVF on the sample (Nalbach 2017, 8.4.6)."""

    dark_s: float = _given(10800.0, "how long a sample rests in the dark before each exposure", 0)
    first_s: float = _given(1.0, "shortest exposure to the lamp; then it doubles", 0.1)
    last_s: float = _given(4096.0, "longest exposure to the lamp, if the glow still grows", 0.1)
    change: float = _given(0.02, "growth of the glow, as a share, below which doubling ends", 0)
    between: int = _given(4, "exposure times measured afterwards between the doubled ones", 0)
    samples: int = _given(1, "physical samples alike, which take turns so that each can rest", 1)
    warm_up: str = _given(
        "none",
        "card: before each exposure the lamp warms up on the grey card, which a hand puts in the sample's place",
        choices=("none", "card"),
    )
    longest_s: float = _given(4.0, "longest exposure of the camera", 0.01)
    darks: int = _given(3, "dark frames for each setting", 1)


@dataclass(frozen=True)
class Check:
    """What the model assumes: one decay shape, one spectrum, no direction (Nalbach 2017, Fig. 8.9, 8.11 and 8.3)."""

    charges_s: str = _given("30,300,3000", "lengths of charge from which decays are compared, by commas")
    dark_s: float = _given(10800.0, "how long the sample rests in the dark before each of these", 0)
    interval_s: float = _given(5.0, "from frame to frame of a decay", 0.1)
    until_s: float = _given(90.0, "time of a decay's last frame", 1)
    spectra_at_s: str = _given("2,60,300", "times after lamp-off of the spectra that are compared, by commas")
    lamp_filters: str = _given("", "filters before the lamp under which the spectrum is measured again")
    angles_deg: str = _given("-60,-30,0,30,60", "directions from which the sample is seen, by commas")
    longest_s: float = _given(4.0, "longest exposure of the camera", 0.01)
    darks: int = _given(3, "dark frames for each setting", 1)


Parameters = Flats | Lamp | Lvf | Emission | Decay | Excitation | Check

PLANS: Mapping[str, type[Parameters]] = {
    "flats": Flats,
    "lamp": Lamp,
    "lvf": Lvf,
    "emission": Emission,
    "decay": Decay,
    "excitation": Excitation,
    "check": Check,
}
"""By name, in the order in which `measure all` needs the fewest hand movements."""

CAMPAIGN = ("flats", "lamp", "lvf", "emission", "decay", "excitation")
"""The plans of `measure all`: what a material needs."""


def option(name: str) -> str:
    """The command line's name of a parameter.

    >>> option("charge_s"), option("per_decade"), option("angles_deg")
    ('--charge', '--per-decade', '--angles')
    """
    for unit in ("_s", "_lx", "_deg"):
        name = name.removesuffix(unit)
    return "--" + name.replace("_", "-")


def parameters(plan: str, given: Mapping[str, Any], *, file: Any = None) -> Parameters:
    """Return a plan's parameters: the defaults, with what is given.

    >>> parameters("decay", {"until_s": 3600, "spacing": "log"}).until_s
    3600.0

    Args:
        plan: one of `PLANS`.
        given: by field name; texts are read as the field's type.
        file: where they stood, for the error.

    Raises:
        PhoslabError: a name is unknown, or a value is of another type or too small.
    """
    kind = PLANS[plan]
    known = {f.name: f for f in dataclasses.fields(kind)}
    unknown = sorted(set(given) - set(known))
    if unknown:
        raise PhoslabError(
            f"has no parameter {unknown[0]!r}",
            file=file,
            field=f"the plan {plan}",
            remedy=f"It has: {', '.join(known)}.",
        )
    values = {name: _value(plan, known[name], value, file) for name, value in given.items()}
    return kind(**values)


def numbers(text: str, *, field: str) -> tuple[float, ...]:
    """Read numbers that are separated by commas.

    >>> numbers("-60, 0,60", field="angles_deg")
    (-60.0, 0.0, 60.0)

    Raises:
        PhoslabError: something else stands there.
    """
    try:
        values = tuple(float(word) for word in text.split(",") if word.strip())
    except ValueError:
        values = (math.nan,)
    if not all(map(math.isfinite, values)):
        raise PhoslabError(f"is {text!r}", field=field, remedy="Give numbers separated by commas.")
    return values


def names(text: str) -> tuple[str, ...]:
    """Read names that are separated by commas.

    >>> names("R02, R27")
    ('R02', 'R27')
    """
    return tuple(word.strip() for word in text.split(",") if word.strip())


def _value(plan: str, about: dataclasses.Field[Any], value: Any, file: Any) -> Any:
    default: object = about.default
    kind: type[float] | type[int] | type[str] = (
        str if isinstance(default, str) else int if isinstance(default, int) else float
    )
    low, choices = about.metadata["low"], about.metadata["choices"]
    wanted = f"one of {', '.join(choices)}" if choices else "a text"
    if kind is not str:
        wanted = f"{'a whole number' if kind is int else 'a number'} of {low:g} or more"
    try:
        if isinstance(value, bool):
            raise ValueError
        # A list of one number is a number where it is typed.
        read = kind(f"{value:g}" if kind is str and isinstance(value, int | float) else value)
        if not isinstance(read, str) and (not math.isfinite(read) or read < low or read != float(value)):
            raise ValueError
        if choices and read not in choices:
            raise ValueError
    except (ValueError, TypeError, OverflowError):
        raise PhoslabError(
            f"is {value!r}", file=file, field=f"{plan}.{about.name}", remedy=f"Give {wanted}."
        ) from None
    return read
