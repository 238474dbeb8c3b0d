"""A door that a hand opens and closes, for a rig without a motor."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Literal

from phoslab.instruments.devices import Clock, Reading, Status
from phoslab.instruments.operator import Operator


class HandDoor:
    """A `Door` that asks for a hand. What it reads is what was last asked for and confirmed.

    Unlike other devices it blocks in `set`, until the hand says that it is done: the moment of the door's edge is that
    of the answer, so frames right after it are as late as the hand was.

    Args:
        operator: the hand.
        clock: stamps the readings.
        check: called while waiting; it raises when the plan shall stop.
    """

    name = "door"

    def __init__(self, operator: Operator, clock: Clock, check: Callable[[], None] = lambda: None) -> None:
        self._operator, self._clock, self._check = operator, clock, check
        self._reading = self._now("between")

    def stage(self) -> list[Any]:
        """Nothing to prepare: a plan says first where it wants the door."""
        return [self]

    def unstage(self) -> list[Any]:
        """Nothing to let go."""
        return [self]

    def stop(self, *, success: bool = False) -> None:
        """Nothing moves by itself."""

    def set(self, value: Literal["open", "closed"]) -> Status:
        """Have the door opened or closed, unless it is."""
        status = Status(self.name, f"set {value}")
        if self._reading["value"] != value:
            verb = "Open" if value == "open" else "Close"
            self._operator.do([f"{verb} the door."], None, self._check)
            self._reading = self._now(value)
        status.finish()
        return status

    def read(self) -> dict[str, Reading]:
        """Where it is, since the hand said so."""
        return {self.name: self._reading}

    def describe(self) -> dict[str, Any]:
        """See `Device`."""
        return {self.name: {"source": "hand", "dtype": "string", "shape": []}}

    def _now(self, value: str) -> Reading:
        return Reading(
            value=value,
            unit="",
            timestamp=time.time(),
            mono_s=self._clock.mono_s(),
            device_s=self._clock.device_s(),
        )
