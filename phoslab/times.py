"""How the moments of a scene are written: in seconds, or counted from when its last light goes off."""

from __future__ import annotations

import re

# 30 thousand years, and float64 still tells their parts of a millisecond apart.
LATEST_S = 1e12

REMEDY = "Write seconds (`12.5`) or `off+80s`."

_TIME = re.compile(r"(off)?([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)?s?", re.ASCII)


def parse_time(text: str) -> tuple[bool, float]:
    """Return whether `text` counts from lamp-off, and its seconds: `12`, `12.5s`, `off`, `off+80s`, `off-1s`.

    Raises:
        ValueError: the text is none of these, or no scene lasts that long.

    >>> parse_time("off+80s")
    (True, 80.0)
    """
    match = _TIME.fullmatch(text.strip().replace(" ", ""))
    if match is None or not (match[1] or match[2]):
        raise ValueError(f"{text!r} is not understood")
    from_off, seconds = match[1] is not None, float(match[2] or 0.0)
    if not from_off:
        check_time(seconds, repr(text))
    return from_off, seconds


def check_time(seconds: float, text: str) -> float:
    """Return the seconds of a moment that a scene can have; `text` is how it was written.

    Raises:
        ValueError: it is before 0, after `LATEST_S` or not a number.
    """
    if seconds > LATEST_S:
        raise ValueError(f"{text} is later than {LATEST_S:g} s")
    if not seconds >= 0:
        raise ValueError(f"{text} is before the scene begins at 0")
    return seconds
