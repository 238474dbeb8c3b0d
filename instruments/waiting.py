"""Waiting, while a lamp may be on.

In slices, between which a signal is heard, the lamp looked at and its promise renewed: who hangs lets it go out.
"""

from __future__ import annotations

import contextlib
import time

from phoslab.errors import PhoslabError
from phoslab.instruments.devices import AlarmError, DeviceError, DeviceTimeoutError, Status
from phoslab.instruments.laboratory import Laboratory
from phoslab.instruments.recorder import Recorder

GRACE_S = 10.0
"""By how much a step may overrun before the lamp goes out."""

SLICE_S = 0.25
"""How often a wait asks whether it shall end, in s of the real clock."""

LOOK_S = 5.0
"""How often a long wait looks at the lamp, in s of the real clock."""


class Waiting:
    """Waits for moments and for devices. Times are the session's.

    Args:
        lab: the devices.
        recorder: whose clock counts.
    """

    def __init__(self, lab: Laboratory, recorder: Recorder) -> None:
        self.lab, self.recorder = lab, recorder
        self.lamp_on = False
        """Whether the plan has switched it on: only then a promise is renewed."""
        self._looked = time.monotonic()

    def allow(self, at_least_s: float, *, switching: bool = False) -> None:
        """Keep the lamp on for so long, if it is on or about to be."""
        if self.lamp_on or switching:
            self.lab.lamp.allow_until(self.lab.clock.mono_s() + at_least_s + GRACE_S)

    def until(self, moment_s: float, why: str) -> None:
        """Wait for a moment, and say so; return at once if it has passed."""
        if moment_s > self.recorder.mono_s():
            self.lab.watcher.doing(why, moment_s - self.recorder.offset_s)
            self.sleep(moment_s)

    def sleep(self, until_s: float) -> None:
        """As `until`, without a word."""
        lab, slice_s = self.lab, SLICE_S
        while (left_s := until_s - self.recorder.mono_s()) > 0:
            lab.interrupts.check()
            if left_s > 2.0 and time.monotonic() - self._looked > LOOK_S:
                self.check_lamp()  # a relay that sticks hours before the next frame must not wait for it
            step_s = min(left_s, slice_s)
            self.allow(step_s)
            before_s = time.monotonic()
            lab.clock.sleep_until(lab.clock.mono_s() + step_s)
            if time.monotonic() - before_s < step_s / 4:
                slice_s *= 8  # a simulated clock jumps, and should not have to do so in small steps
        lab.interrupts.check()

    def for_status(self, status: Status, at_most_s: float) -> None:
        """Wait for a status; the time-out counts on the real clock, since something real has to answer."""
        end_s = time.monotonic() + at_most_s
        while not status.done and time.monotonic() < end_s:
            status.exception(timeout=SLICE_S)
            self.lab.interrupts.check()
        if not status.done:
            raise DeviceTimeoutError(status.device, status.command, at_most_s)
        status.wait(0)

    def check_lamp(self) -> None:
        """The lamp must be what the plan thinks it is; a lamp that is off may be out of reach for a while."""
        lamp = self.lab.lamp
        self._looked = time.monotonic()
        try:
            now = lamp.read()[lamp.name]["value"]
        except AlarmError:
            raise
        except DeviceError as error:
            if self.lamp_on:
                raise
            # A frame needs the camera only, and a fading light does not wait.
            self.lab.watcher.trouble(str(error))
            with contextlib.suppress(PhoslabError):
                lamp.stage()
            return
        if (now == "on") != self.lamp_on:
            kind = AlarmError if now == "on" else DeviceError
            raise kind(
                f"is {now} although the plan has switched it {'on' if self.lamp_on else 'off'}",
                field=lamp.name,
                remedy="Pull its plug, then look for a stuck relay."
                if now == "on"
                else "Something switched it off: its controller was reset, or a limit was reached.",
            )
