"""A plan taken through without a device: its time line, how long it lasts, what it asks of lamp, disk and hands.

This is what `--dry-run` prints, and what is checked before the lamp is switched on for the first time. Where a plan
depends on what the camera will see, a rehearsal takes the longer way.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from phoslab.instruments.operator import instructions
from phoslab.instruments.plans.steps import (
    Cold,
    Dark,
    Door,
    Lamp,
    Part,
    Plan,
    Setup,
    Shoot,
    Shot,
    Stage,
    Step,
    Wait,
)

HAND_S = 30.0
"""What a hand movement is taken to last."""


@dataclass(frozen=True)
class Entry:
    """A line of the time line: when (s from the start), what, and whether a hand is needed."""

    at_s: float
    text: str
    by_hand: bool = False


@dataclass
class TimeLine:
    """What a plan will do.

    Args:
        entries: in order.
        duration_s: in all.
        frames: number of frames by role.
        longest_on_s: longest time for which the lamp shines without a break.
        hands: number of hand movements.
    """

    entries: list[Entry] = field(default_factory=list)
    duration_s: float = 0.0
    frames: Counter[str] = field(default_factory=Counter)
    longest_on_s: float = 0.0
    hands: int = 0

    @property
    def n_frames(self) -> int:
        """All frames."""
        return self.frames.total()


class Rehearsal:
    """Takes steps by adding up their time; one may go through several plans in a row.

    Args:
        setup: what the plans will know.
    """

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._stage: Stage | None = None
        self._warm: set[str] = set()
        self._on_since_s: float | None = None
        self._dark_since_s = 0.0
        self._shooting: tuple[str, int, float, float] | None = None
        self._waiting: tuple[str, int] | None = None  # what the last line waits for, and that line's number
        self.line = TimeLine()

    def title(self, text: str) -> None:
        """Put a heading into the time line."""
        self._say(text)

    def run(self, plan: Plan) -> TimeLine:
        """Go through a plan; the time line goes on from the one before."""
        answer: Any = None
        while True:
            try:
                step = plan.send(answer)
            except StopIteration:
                self._say_frames()
                return self.line
            answer = self._take(step)

    def _take(self, step: Step) -> Any:
        line = self.line
        match step:
            case Part(name):
                self._say(name + ":")
            case Stage():
                todo = instructions(self._stage, step)
                for text in todo:
                    self._say(text, by_hand=True)
                    line.duration_s += HAND_S
                    line.hands += 1
                if todo and self._stage is not None and step.light != self._stage.light:
                    self._warm.discard(step.light)
                self._stage = step
            case Cold(light):
                cold = light not in self._warm
                self._warm.add(light)
                return cold
            case Lamp(to):
                self._switch(to)
                return line.duration_s
            case Door(to):
                line.duration_s += self._setup.door_s
                return line.duration_s
            case Wait(duration_s, why, since_s):
                self._wait(line.duration_s + duration_s if since_s is None else since_s + duration_s, why)
            case Dark(duration_s):
                self._wait(self._dark_since_s + duration_s, "resting in the dark")
            case Shoot():
                return self._shoot(step)
        return None

    def _switch(self, to: str) -> None:
        line = self.line
        if to == "on" and self._on_since_s is None:
            self._say("lamp on")
            self._on_since_s = line.duration_s
        elif to == "off" and self._on_since_s is not None:
            self._say("lamp off")
            line.longest_on_s = max(line.longest_on_s, line.duration_s - self._on_since_s)
            self._on_since_s, self._dark_since_s = None, line.duration_s

    def _wait(self, until_s: float, why: str) -> None:
        line = self.line
        if until_s - line.duration_s > 1.0:
            if self._waiting == (why, len(line.entries) - 1):
                # A series of waits with frames between (a warm-up) is one line, with its whole length.
                begun_s = line.entries[-1].at_s
                line.entries[-1] = Entry(begun_s, f"{why}, {duration(until_s - begun_s)}")
            else:
                self._say(f"{why}, {duration(until_s - line.duration_s)}")
                self._waiting = (why, len(line.entries) - 1)
        line.duration_s = max(line.duration_s, until_s)

    def _shoot(self, step: Shoot) -> Shot:
        line = self.line
        if step.at_s is not None:
            line.duration_s = max(line.duration_s, step.at_s)
        start_s = line.duration_s
        if self._shooting is None or self._shooting[0] != step.role:
            self._say_frames()
            self._shooting = (step.role, 0, start_s, start_s)
        role, n, first_s, _ = self._shooting
        self._shooting = (role, n + 1, first_s, start_s)
        line.frames[step.role] += 1
        line.duration_s += step.exposure.exposure_s + self._setup.cycle_s
        return Shot(f"{line.n_frames:04d}", step.exposure, start_s, step.rehearsed, 0.0)

    def _say_frames(self) -> None:
        if self._shooting is not None:
            role, n, first_s, last_s = self._shooting
            self._shooting = None
            span = f" in {duration(last_s - first_s)}" if n > 1 else ""
            self.line.entries.append(Entry(first_s, f"{n} x {role}{span}"))

    def _say(self, text: str, *, by_hand: bool = False) -> None:
        self._say_frames()
        self.line.entries.append(Entry(self.line.duration_s, text, by_hand))


def duration(seconds: float) -> str:
    """Write a length of time for people.

    >>> duration(5), duration(90.4), duration(5400), duration(11000)
    ('5 s', '90 s', '1 h 30 min', '3 h 3 min')
    """
    if seconds < 100:
        return f"{seconds:.0f} s" if seconds >= 1 else f"{seconds:.1f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
