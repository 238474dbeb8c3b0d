"""When lights are on, and how times are written.

A schedule is a list of [on_s, off_s) stretches; light is constant between changes, which is what lets the
phosphor state jump to any time at the cost of the light changes alone.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from phoslab.errors import PhoslabError

_TIME = re.compile(r"^(off)?([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)?s?$")


@dataclass(frozen=True)
class Schedule:
    """When each light is on.

    Args:
        stretches_s: by the light's name, its ascending [on_s, off_s) stretches; None: always on.
    """

    stretches_s: Mapping[str, tuple[tuple[float, float], ...] | None]

    def lit(self, t_s: float) -> frozenset[str]:
        """Return the names of the lights that are on at `t_s`; a light is off at the moment of its off_s."""
        return frozenset(
            name
            for name, stretches in self.stretches_s.items()
            if stretches is None or any(on <= t_s < off for on, off in stretches)
        )

    def segments(self, start_s: float, end_s: float) -> Iterator[tuple[float, float, frozenset[str]]]:
        """Yield (from_s, to_s, lights that are on) from `start_s` to `end_s`, light being constant in each."""
        edges = {t for stretches in self.stretches_s.values() for pair in stretches or () for t in pair}
        times = [start_s, *sorted(t for t in edges if start_s < t < end_s), end_s]
        for low, high in itertools.pairwise(times):
            if high > low:
                yield low, high, self.lit(low)

    @property
    def off_s(self) -> float | None:
        """When the last light goes off; None where one never does, or there is none."""
        ends = [math.inf if s is None else s[-1][1] for s in self.stretches_s.values() if s is None or s]
        return max(ends) if ends and math.isfinite(max(ends)) else None

    def dark_for_s(self, t_s: float) -> float | None:
        """Return how long no light has been on at `t_s`; None while one is."""
        if self.lit(t_s):
            return None
        return t_s - max((b for s in self.stretches_s.values() for _, b in s or () if b <= t_s), default=0.0)

    def parse_time(self, text: str, *, field: str = "the time") -> float:
        """Return the seconds that `text` means: `12`, `12.5s`, `off`, `off+80s`, `off-1s`.

        >>> Schedule({"lamp": ((0.0, 60.0),)}).parse_time("off+80s")
        140.0
        """
        match = _TIME.match(text.strip().replace(" ", ""))
        if match is None or not (match[1] or match[2]):
            raise PhoslabError(
                f"{text!r} is not understood", field=field, remedy="Write seconds (`12.5`) or `off+80s`."
            )
        seconds = float(match[2] or 0.0)
        if match[1]:
            if self.off_s is None:
                raise PhoslabError(
                    f"{text!r} counts from when the last light goes off, but that never happens in this scene",
                    field=field,
                    remedy="Give the lights a schedule that ends, or write the time in seconds.",
                )
            seconds += self.off_s
        if not 0 <= seconds < math.inf:
            raise PhoslabError(
                f"{text!r} is before the scene begins at 0", field=field, remedy="Use 0 or later."
            )
        return seconds


def parse_stretches(
    pairs: list[list[float]] | None, *, file: str, field: str
) -> tuple[tuple[float, float], ...] | None:
    """Check a schedule as a scene file has it; None stays None (always on).

    Raises:
        PhoslabError: the stretches overlap, run backwards or start before 0.
    """
    if pairs is None:
        return None
    last = 0.0
    for k, (on, off) in enumerate(pairs):
        if not last <= on < off:
            raise PhoslabError(
                f"is [{on:g}, {off:g}], which is out of order",
                file=file,
                field=f"{field}[{k}]",
                remedy="Each pair is [on_s, off_s] with on before off, none before 0, and pairs ascend.",
            )
        last = off
    return tuple((float(on), float(off)) for on, off in pairs)
