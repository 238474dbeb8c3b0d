"""What the lights of a scene do over time, and how times are written.

Between the jumps of its lights, where every light is constant, a phosphor's state can jump to any time at the cost of
the light changes alone.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from phoslab import times
from phoslab.errors import PhoslabError
from phoslab.render.light_course import NEVER, Course, Segment


@dataclass(frozen=True)
class Schedule:
    """What each light does.

    Args:
        courses: by the light's name.
    """

    courses: Mapping[str, Course]

    @property
    def alike(self) -> dict[Course, frozenset[str]]:
        """The lights that share a course, by it: their light adds up to one. Without any: one that is never on."""
        shared: dict[Course, set[str]] = {}
        for name, course in self.courses.items():
            shared.setdefault(course, set()).add(name)
        return {course: frozenset(names) for course, names in shared.items()} or {NEVER: frozenset()}

    @property
    def piecewise_constant(self) -> bool:
        """Whether every light is constant between its jumps."""
        return all(course.programme.piecewise_constant for course in self.courses.values())

    def factors(self, t_s: float) -> dict[str, float]:
        """Return the factor of every light at `t_s`; a light is off at the moment of its off_s."""
        return {name: course.at(t_s) for name, course in self.courses.items()}

    def segments(self, start_s: float, end_s: float) -> Iterator[Segment]:
        """Yield the stretches between jumps of the lights from `start_s` to `end_s`."""
        courses = tuple(self.alike)
        edges = {t for course in courses for t in course.changes(start_s, end_s)}
        for low, high in itertools.pairwise([start_s, *sorted(edges), end_s]):
            if high > low:
                yield Segment(low, high, courses)

    @property
    def off_s(self) -> float | None:
        """When the last light goes off; None where one never does, or there is none."""
        last = max(self._offs(), default=math.inf)
        return last if math.isfinite(last) else None

    def dark_since_s(self, t_s: float) -> float | None:
        """Return since when no light has been on at `t_s`, whatever its programme; None while one is."""
        if any(course.on.at(t_s) for course in self.courses.values()):
            return None
        return max((off for off in self._offs() if off <= t_s), default=0.0)

    def dark_for_s(self, t_s: float) -> float | None:
        """Return how long that has been; None while a light is on."""
        since = self.dark_since_s(t_s)
        return None if since is None else t_s - since

    def _offs(self) -> list[float]:
        return [off for course in self.courses.values() for _, off in course.on.intervals]

    def parse_time(self, text: str, *, field: str = "the time") -> float:
        """Return the seconds that `text` means: `12`, `12.5s`, `off`, `off+80s`, `off-1s`.

        >>> from phoslab.programmes import Switched
        >>> Schedule({"lamp": Course(Switched(((0.0, 60.0),)))}).parse_time("off+80s")
        140.0
        """
        try:
            from_off, seconds = times.parse_time(text)
        except ValueError as error:
            raise PhoslabError(str(error), field=field, remedy=times.REMEDY) from None
        if from_off:
            if self.off_s is None:
                raise PhoslabError(
                    f"{text!r} counts from when the last light goes off, but that never happens in this scene",
                    field=field,
                    remedy="Give the lights a schedule that ends, or write the time in seconds.",
                )
            seconds += self.off_s
        return check_time(seconds, repr(text), field=field)


def check_time(seconds: float, text: str, *, field: str = "the time") -> float:
    """Return the seconds of a moment that a scene can have; `text` is how it was written.

    Raises:
        PhoslabError: see `phoslab.times.check_time`.
    """
    try:
        return times.check_time(seconds, text)
    except ValueError as error:
        raise PhoslabError(str(error), field=field, remedy=f"Use 0 to {times.LATEST_S:g} s.") from None
