"""What the simulated controller is wired to: the dark room's lamp and door, relays, photodiode and switches."""

from __future__ import annotations

import time

import numpy as np

from phoslab.instruments.bench.controller import Drive
from phoslab.instruments.bench.darkroom import Darkroom
from phoslab.instruments.bench.timekeeper import Timekeeper

LIGHT, DARK = 700, 20
"""Photodiode values of the warm lamp and of none."""


class Wiring:
    """The controller's `Hardware`. Its clock counts simulated time, a little too fast, and from before the bench.

    Args:
        room: whose lamp and door these are.
        keeper: simulated time.
        ppm: by how much the clock is too fast.
    """

    def __init__(self, room: Darkroom, keeper: Timekeeper, ppm: float = 20.0) -> None:
        self._room, self._keeper = room, keeper
        self._rate = 1 + ppm * 1e-6
        self._ahead_s = 12.5 - keeper.now_s()
        self._rng = np.random.default_rng([room.seed, 3])
        self._relay = self._main = self.alarm = False
        self._drive: Drive = None
        self._sticks = self._welded = self._jammed = False

    # --- Hardware -----------------------------------------------------------------------------

    def now_us(self) -> int:
        """Simulated microseconds since the controller got power."""
        return int((self._keeper.now_s() + self._ahead_s) * self._rate * 1e6)

    def silence_us(self) -> int:
        """Real microseconds: the host lives in real time, and its silence is measured by it."""
        return time.monotonic_ns() // 1000

    def set_lamp(self, on: bool) -> None:
        """Switch the lamp's relay."""
        self._relay = on
        self._supply()

    def set_main(self, on: bool) -> None:
        """Switch the relay before it."""
        self._main = on
        self._supply()

    def set_alarm(self, on: bool) -> None:
        """Switch the buzzer."""
        self.alarm = on

    def light(self) -> int:
        """The photodiode, which sees the rig's lamp only."""
        return round(DARK + (LIGHT - DARK) * self._room.lamp.level(self._keeper.now_s()))

    def drive_door(self, to: Drive) -> None:
        """Run the door's motor one way or the other, or stop it."""
        self._drive = to
        target = None if self._jammed else {"OPEN": 1.0, "CLOSE": 0.0, None: None}[to]
        hinge = self._room.door.hinge
        travel_s = hinge.travel_s + hinge.jitter_s * float(np.clip(self._rng.normal(), -3, 3))
        self._room.door.drive(self._keeper.now_s(), target, travel_s)

    def switches(self) -> tuple[bool, bool]:
        """Whether the end switches for open and for closed are pressed."""
        share = self._room.door.share(self._keeper.now_s())
        return share >= 1.0, share <= 0.0

    # --- what the bench asks and does ---------------------------------------------------------

    def at_s(self, us: int) -> float:
        """The simulated moment at which `now_us` gives `us`."""
        return us / 1e6 / self._rate - self._ahead_s

    def changes_s(self, after_s: float) -> list[float]:
        """Moments at which door or light will by themselves do something that the controller notices."""
        room = self._room
        # The controller takes a level of 300 for light, and with its hysteresis 263 for none.
        thresholds = [(n - DARK) / (LIGHT - DARK) for n in (300, 263)]
        lamp = [m for share in thresholds if (m := room.lamp.crosses(share * 1.001, after_s)) is not None]
        lamp += [m for share in thresholds if (m := room.lamp.crosses(share * 0.999, after_s)) is not None]
        arrival = room.door.arrives_s(after_s)
        return lamp + ([] if arrival is None else [arrival])

    def stick(self) -> None:
        """From now on the lamp's relay does not open once it is closed."""
        self._sticks = True
        self._welded = self._relay
        self._supply()

    def jam(self) -> None:
        """From now on the door does not move."""
        self._jammed = True
        self.drive_door(self._drive)

    def repair(self) -> None:
        """Mend both."""
        self._sticks = self._welded = self._jammed = False
        self._supply()
        self.drive_door(self._drive)

    def _supply(self) -> None:
        self._welded = self._welded or (self._sticks and self._relay)
        self._room.lamp.switch(self._keeper.now_s(), (self._relay or self._welded) and self._main)
