"""What the simulated controller is wired to: relays, lamp, photodiode, door and end switches, and their faults."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from phoslab.instruments.bench.controller import Drive


def _real_us() -> int:
    return time.monotonic_ns() // 1000


@dataclass
class Board:
    """A lamp behind two relays, a photodiode that sees it, and a door between two end switches.

    Args:
        clock_us: the time of everything that happens here.
        silence_clock_us: the time that the host lives in.
        travel_us: of the door, from end to end.
        light_on, light_off: photodiode values.
        light_after_us: from relay to light, both ways.
        stuck_relay: the lamp's relay stays closed, whatever it is told.
        stuck_main: so does the main relay.
        dead_lamp: there is never light.
        stuck_door: the door does not move.
    """

    clock_us: Callable[[], int] = _real_us
    silence_clock_us: Callable[[], int] = _real_us
    travel_us: int = 280_000
    light_on: int = 700
    light_off: int = 20
    light_after_us: int = 40_000
    stuck_relay: bool = False
    stuck_main: bool = False
    dead_lamp: bool = False
    stuck_door: bool = False

    def __post_init__(self) -> None:
        self.lamp = self.main = self.alarm = False
        self._powered, self._powered_us = False, -self.light_after_us
        self.door = 0.0  # 0: closed, 1: open
        self._drive: Drive = None
        self._moved_us = self.clock_us()

    @property
    def powered(self) -> bool:
        """Whether the lamp has current."""
        return (self.lamp or self.stuck_relay) and (self.main or self.stuck_main) and not self.dead_lamp

    def now_us(self) -> int:
        """See Hardware, as the others below."""
        return self.clock_us()

    def silence_us(self) -> int:
        return self.silence_clock_us()

    def set_lamp(self, on: bool) -> None:
        self.lamp = on
        self.light()

    def set_main(self, on: bool) -> None:
        self.main = on
        self.light()

    def set_alarm(self, on: bool) -> None:
        self.alarm = on

    def light(self) -> int:
        now = self.clock_us()
        if self.powered != self._powered:
            self._powered, self._powered_us = self.powered, now
        shines = self._powered == (now - self._powered_us >= self.light_after_us)
        return self.light_on if shines else self.light_off

    def drive_door(self, to: Drive) -> None:
        self._move()
        self._drive = to

    def switches(self) -> tuple[bool, bool]:
        self._move()
        return self.door >= 1.0, self.door <= 0.0

    def _move(self) -> None:
        now = self.clock_us()
        way = (now - self._moved_us) / self.travel_us
        self._moved_us = now
        if self._drive is not None and not self.stuck_door:
            self.door = min(1.0, max(0.0, self.door + (way if self._drive == "OPEN" else -way)))
