"""What lamp and door have done, and from that what they are at any moment: closed forms, never a step.

A course only grows at its end. So a frame of a minute ago can be computed now, while the lamp is switched again.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Bulb:
    """How a halogen lamp behaves.

    Args:
        rise_s: time constant of its light after it is switched on.
        fade_s: from switching off to no light (Nalbach 2017, 8.4.6: 320 ms); a square, as in lamp.py.
        cold: share of light that it lacks before it is warm.
        warm_s: time constant of getting warm, and cold again.
        heat_C: by how much it warms what lies under it.
        heat_s: time constant of that.
    """

    rise_s: float = 0.08
    fade_s: float = 0.32
    cold: float = 0.03
    warm_s: float = 300.0
    heat_C: float = 3.0
    heat_s: float = 1200.0


@dataclass(frozen=True)
class _Switch:
    at_s: float
    on: bool
    level: float
    warmth: float
    heat: float


@dataclass
class LampCourse:
    """Lamp light over time; it is off and cold at first."""

    bulb: Bulb = field(default_factory=Bulb)

    def __post_init__(self) -> None:
        self._switches = [_Switch(-math.inf, False, 0.0, 0.0, 0.0)]

    def switch(self, at_s: float, on: bool) -> None:
        """Give it current, or none, from `at_s` on: not before the last switch."""
        last = self._switches[-1]
        if on != last.on:
            now = _Switch(at_s, on, self._relative(at_s), self.warmth(at_s), self._heat(at_s))
            self._switches.append(now)

    @property
    def on(self) -> bool:
        """Whether it has current."""
        return self._switches[-1].on

    def level(self, t_s: float) -> float:
        """Light as a share of the warm lamp's."""
        return self._relative(t_s) * (1 - self.bulb.cold * (1 - self.warmth(t_s)))

    def warmth(self, t_s: float) -> float:
        """0 cold, 1 warm."""
        return self._towards(t_s, "warmth", self.bulb.warm_s)

    def warming(self, t_s: float) -> float:
        """By how much what lies under it is warmer than the room."""
        return self.bulb.heat_C * self._heat(t_s)

    def changes(self, begin_s: float, end_s: float) -> list[float]:
        """Moments inside an interval at which its light has a kink."""
        moments = [m for s in self._switches for m in (s.at_s, s.at_s + (0.0 if s.on else self.bulb.fade_s))]
        return [m for m in moments if begin_s < m < end_s]

    def dark(self, begin_s: float, end_s: float) -> bool:
        """Whether there is no light in an interval without kinks."""
        return self._relative((begin_s + end_s) / 2) == 0.0

    def crosses(self, share: float, after_s: float) -> float | None:
        """When, after a moment, its light passes a share of full light, if no switch comes; None for never."""
        last = self._switches[-1]
        if last.at_s == -math.inf:
            return None
        if last.on and last.level < share:
            at_s = last.at_s - self.bulb.rise_s * math.log((1 - share) / (1 - last.level))
        elif not last.on and last.level > share:
            at_s = last.at_s + self.bulb.fade_s * (1 - math.sqrt(share / last.level))
        else:
            return None
        return at_s if at_s > after_s else None

    def _at(self, t_s: float) -> _Switch:
        return self._switches[bisect.bisect_right(self._switches, t_s, key=lambda s: s.at_s) - 1]

    def _relative(self, t_s: float) -> float:
        since = self._at(t_s)
        if since.at_s == -math.inf:
            return 0.0
        if since.on:
            return 1 - (1 - since.level) * math.exp(-(t_s - since.at_s) / self.bulb.rise_s)
        return since.level * max(0.0, 1 - (t_s - since.at_s) / self.bulb.fade_s) ** 2

    def _heat(self, t_s: float) -> float:
        return self._towards(t_s, "heat", self.bulb.heat_s)

    def _towards(self, t_s: float, name: str, time_constant_s: float) -> float:
        since = self._at(t_s)
        begin: float = getattr(since, name)
        if since.at_s == -math.inf:
            return begin
        return since.on + (begin - since.on) * math.exp(-(t_s - since.at_s) / time_constant_s)


@dataclass(frozen=True)
class Hinge:
    """How the trapdoor moves.

    Args:
        travel_s: from closed to open (Nalbach 2017, 8.4.6: 280 ms).
        jitter_s: standard deviation of that.
        swing_mm, swing_hz, swing_s: amplitude, frequency and time constant of what it shakes when it stops.
    """

    travel_s: float = 0.28
    jitter_s: float = 0.006
    swing_mm: float = 0.25
    swing_hz: float = 11.0
    swing_s: float = 0.12


@dataclass(frozen=True)
class _Move:
    at_s: float
    share: float
    to: float | None
    travel_s: float


@dataclass
class DoorCourse:
    """How far the door is open over time, 0..1; it is closed at first."""

    hinge: Hinge = field(default_factory=Hinge)

    def __post_init__(self) -> None:
        self._moves = [_Move(-math.inf, 0.0, None, self.hinge.travel_s)]

    def drive(self, at_s: float, to: float | None, travel_s: float) -> None:
        """Run the motor to 1 (open) or 0 (closed), or stop it (None), from `at_s` on: not before the last."""
        if to != self._moves[-1].to:
            self._moves.append(_Move(at_s, self.share(at_s), to, travel_s))

    def share(self, t_s: float) -> float:
        """How far it is open, 0..1."""
        move = self._at(t_s)
        if move.to is None:
            return move.share
        way = (t_s - move.at_s) / move.travel_s
        return min(move.to, move.share + way) if move.to > move.share else max(move.to, move.share - way)

    def arrives_s(self, after_s: float) -> float | None:
        """When it reaches the end that it is under way to, if that is later than a moment."""
        at_s = self._arrival(self._moves[-1])
        return at_s if at_s > after_s else None

    def changes(self, begin_s: float, end_s: float) -> list[float]:
        """Moments inside an interval at which it starts or stops."""
        moments = [m for move in self._moves for m in (move.at_s, self._arrival(move))]
        return [m for m in moments if begin_s < m < end_s]

    def shake_mm(self, t_s: float) -> float:
        """By how much what hangs on it is out of place."""
        arrived = self._arrival(self._at(t_s))
        since = t_s - arrived
        if not 0 <= since < 10 * self.hinge.swing_s:
            return 0.0
        swing = math.exp(-since / self.hinge.swing_s) * math.cos(2 * math.pi * self.hinge.swing_hz * since)
        return self.hinge.swing_mm * swing

    def _at(self, t_s: float) -> _Move:
        return self._moves[bisect.bisect_right(self._moves, t_s, key=lambda m: m.at_s) - 1]

    def _arrival(self, move: _Move) -> float:
        if move.to is None or move.to == move.share:
            return -math.inf
        return move.at_s + abs(move.to - move.share) * move.travel_s
