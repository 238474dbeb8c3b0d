"""What one light does over time: a programme (`phoslab.programmes`), cut to the stretches in which it is on.

Times are in s of the scene's schedule, and so is a programme's phase: a sine begins to rise at 0, a strobe flashes at
0. Every programme has the mean 1, so that a light's irradiance is its mean while it is on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.programmes import ALWAYS_ON, Programme, Sine, Strobe, Switched, mains_flicker, mean
from phoslab.solvers import Drive

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Course:
    """One light's factor over time.

    Args:
        on: when it is on.
        programme: its factor while it is on.
    """

    on: Switched = ALWAYS_ON
    programme: Programme = ALWAYS_ON

    def at(self, t_s: float) -> float:
        """Return the factor at a time; at a jump, the value after it."""
        return float(self.on.at(t_s) * self.programme.at(t_s))

    @property
    def largest(self) -> float:
        """What the factor never exceeds."""
        match self.programme:
            case Strobe(duty=duty):
                return 1 / duty
            case Sine(depth=depth):
                return 1 + depth
        return 1.0

    def most_changes(self, end_s: float) -> float:
        """Return what the number of jumps from 0 to `end_s` does not exceed."""
        switched = 2.0 * len(self.on.intervals)
        if isinstance(self.programme, Strobe):
            return 2 * switched + 2 * float(self.on.integral(end_s)) / self.programme.period_s
        return switched

    def changes(self, start_s: float, end_s: float) -> list[float]:
        """Return the times in (start_s, end_s) at which the factor may jump."""
        edges = [self.on.changes(start_s, end_s)]
        for on, off in self.on.intervals:
            edges.append(self.programme.changes(max(on, start_s), min(off, end_s)))
        return [float(t) for t in np.concatenate(edges)]


NEVER = Course(on=Switched(()))


@dataclass(frozen=True)
class Segment:
    """A stretch of time in which no light jumps.

    Args:
        start_s, end_s: from when to when.
        courses: of the lights.
    """

    start_s: float
    end_s: float
    courses: tuple[Course, ...]

    @property
    def constant(self) -> bool:
        """Whether every light is constant."""
        return not any(self._varies(course) for course in self.courses)

    @property
    def dark(self) -> bool:
        """Whether no light is on."""
        return not any(self._varies(course) or course.at(self._middle_s) for course in self.courses)

    def drives(self, begin_s: float, end_s: float) -> list[Drive]:
        """Return the factor of each course over a step within the segment."""
        return [self._drive(course, begin_s, end_s) for course in self.courses]

    @property
    def _middle_s(self) -> float:
        """Where what is constant is looked up: a jump at the segment's end belongs to the next one."""
        return (self.start_s + self.end_s) / 2

    def _varies(self, course: Course) -> bool:
        return not course.programme.piecewise_constant and bool(course.on.at(self._middle_s))

    def _drive(self, course: Course, begin_s: float, end_s: float) -> Drive:
        if not self._varies(course):
            return Drive.constant(np.asarray(course.at(self._middle_s)))
        programme = course.programme
        return Drive(
            lambda s: programme.at(begin_s + s * (end_s - begin_s)), lambda: mean(programme, begin_s, end_s)
        )


def parse_course(entry: dict[str, Any], *, file: str, field: str) -> Course:
    """Read `schedule` and `programme` of a light's table in a scene file that fits the schema.

    Raises:
        PhoslabError: the stretches of the schedule overlap, run backwards or start before 0.
    """
    on = ALWAYS_ON
    if "schedule" in entry:
        on = _parse_schedule(entry["schedule"], file=file, field=f"{field}.schedule")
    return Course(on, _parse_programme(entry["programme"]) if "programme" in entry else ALWAYS_ON)


def _parse_schedule(pairs: Sequence[Sequence[float]], *, file: str, field: str) -> Switched:
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
    return Switched(tuple((float(on), float(off)) for on, off in pairs))


def _parse_programme(entry: dict[str, Any]) -> Programme:
    if entry["kind"] == "strobe":
        return Strobe(entry["period_s"], entry["duty"])
    depth = entry.get("depth", 1.0)
    if entry["kind"] == "flicker":
        return mains_flicker(entry["mains_hz"], depth)
    return Sine(entry["period_s"], depth)
