"""The lamp and the door on a rig controller, with the verbs of devices.py."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable
from typing import Any, Literal

from phoslab.instruments.devices import DeviceError, DeviceTimeoutError, Reading, Status
from phoslab.instruments.rig_connection import RigConnection

FIRST_PROMISE_S = 10.0
"""What switching the lamp on promises where `allow_until` has not been called before."""
DOOR_S = 6.0
"""By the controller's clock, whose own limit is 3: so that one acts first, however fast the clock is."""


class _Worker:
    """Does one thing after the other in a thread of its own, so that `set` need not wait."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._tasks: queue.SimpleQueue[tuple[Status, Callable[[], None]]] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None

    def do(self, status: Status, act: Callable[[], None]) -> Status:
        self._tasks.put((status, act))
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
            self._thread.start()
        return status

    def _run(self) -> None:
        while True:
            status, act = self._tasks.get()
            try:
                act()
            except Exception as error:  # whatever it is, somebody waits for this status
                status.finish(error)
            else:
                status.finish()


class _Part:
    """What lamp and door have in common."""

    parent = None  # bluesky asks

    def __init__(self, rig: RigConnection, kind: str) -> None:
        self._rig, self._kind = rig, kind
        self.name = kind
        self._worker = _Worker(f"{rig.name} {kind}")

    def stage(self) -> list[Any]:
        """Connect if need be: the controller is greeted, its limits set, the lamp off."""
        self._rig.stage(self._kind)
        return [self]

    def _reading(self, value: Any, unit: str, device_s: float) -> Reading:
        clock = self._rig.host_clock
        mono_s, _ = self._rig.mono_s(device_s)
        timestamp = clock.wall().timestamp() - (clock.mono_s() - mono_s)
        return Reading(value=value, unit=unit, timestamp=timestamp, mono_s=mono_s, device_s=device_s)

    def _key(self, dtype: str, units: str) -> dict[str, Any]:
        return {"source": f"{self._rig.name}:{self._kind}", "dtype": dtype, "shape": [], "units": units}


class RigLamp(_Part):
    """The lamp on a rig controller."""

    failsafe = True

    def __init__(self, rig: RigConnection) -> None:
        super().__init__(rig, "lamp")

    def stage(self) -> list[Any]:
        """Connect, and switch the lamp off."""
        super().stage()
        self._off()
        return [self]

    def unstage(self) -> list[Any]:
        """Switch the lamp off and let go."""
        with contextlib.suppress(DeviceError):
            if self._rig.ready:
                self._off()
        self._rig.unstage(self._kind)
        return [self]

    def stop(self, *, success: bool = False) -> None:
        """Switch the lamp off now."""
        with contextlib.suppress(DeviceError):
            self._off()

    def allow_until(self, mono_s: float) -> None:
        """Promise to be back by then; without, switching on promises `FIRST_PROMISE_S`."""
        self._rig.check()
        self._rig.until_s = mono_s

    def set(self, value: Literal["on", "off"]) -> Status:
        """Set the lamp "on" or "off"; the status ends when the controller has switched its relay."""
        if value not in ("on", "off"):
            raise DeviceError(f"cannot be {value!r}", field=self.name, remedy='Set it "on" or "off".')
        if value == "on":
            self._rig.check()
        return self._worker.do(Status(self.name, f"set {value}"), self._on if value == "on" else self._off)

    def read(self) -> dict[str, Reading]:
        """Measure: "on" or "off" since its edge; that edge's uncertainty in s; photodiode 0..1023; its verdict."""
        self._rig.check()
        answer = self._rig.ask("STATUS")
        fields, now_s = answer.reply.fields, answer.reply.device_us * 1e-6
        since_s = int(fields["since"]) * 1e-6
        return {
            self.name: self._reading(fields["lamp"].lower(), "", since_s),
            f"{self.name}_uncertainty": self._reading(self._rig.mono_s(since_s)[1], "s", since_s),
            f"{self.name}_light": self._reading(int(fields["light"]), "", now_s),
            f"{self.name}_verdict": self._reading(fields["verdict"], "", now_s),
        }

    def describe(self) -> dict[str, Any]:
        """bluesky's data keys."""
        return {
            self.name: self._key("string", ""),
            f"{self.name}_uncertainty": self._key("number", "s"),
            f"{self.name}_light": self._key("integer", ""),
            f"{self.name}_verdict": self._key("string", ""),
        }

    def _on(self) -> None:
        rig = self._rig
        with rig.state:
            rig.check()
            if rig.until_s is None or rig.left_s() <= 0:
                rig.until_s = rig.host_clock.mono_s() + FIRST_PROMISE_S
            rig.ask(f"LAMP ON {rig.keep_ms(rig.left_s())}")
            rig.lamp_on = True

    def _off(self) -> None:
        rig = self._rig
        with rig.state:
            rig.lamp_on, rig.until_s = False, None
            rig.ask("LAMP OFF")


class RigDoor(_Part):
    """The trapdoor on a rig controller."""

    def __init__(self, rig: RigConnection) -> None:
        super().__init__(rig, "door")

    def unstage(self) -> list[Any]:
        """Stop the motor and let go."""
        if self._rig.ready:
            self.stop()
        self._rig.unstage(self._kind)
        return [self]

    def stop(self, *, success: bool = False) -> None:
        """Stop the motor now; the door stays where it is."""
        with contextlib.suppress(DeviceError):
            self._rig.ask("DOOR STOP")

    def set(self, value: Literal["open", "closed"]) -> Status:
        """Set the door "open" or "closed"; the status ends when its end switch says so."""
        if value not in ("open", "closed"):
            raise DeviceError(f"cannot be {value!r}", field=self.name, remedy='Set it "open" or "closed".')
        self._rig.check()
        command, arrived = ("OPEN", "OPEN") if value == "open" else ("CLOSE", "CLOSED")
        return self._worker.do(Status(self.name, f"set {value}"), lambda: self._drive(command, arrived))

    def _drive(self, command: str, arrived: str) -> None:
        rig = self._rig
        rig.check()
        told = rig.ask(f"DOOR {command}").reply
        if told.fields["door"] == arrived:
            return
        waited_us = 0
        while waited_us < DOOR_S * 1e6:
            with rig.moved:  # an event may be lost: what STATUS says counts
                rig.moved.wait(0.25)
            rig.check()
            status = rig.ask("STATUS").reply
            fields, waited_us = status.fields, status.device_us - told.device_us
            if fields["drive"] == "STUCK":
                raise DeviceError(
                    f"did not become {arrived.lower()}: its end switch says {fields['door'].lower()}",
                    field=self.name,
                    remedy="Look whether something holds it, and whether motor and end switch are connected.",
                )
            if fields["door"] == arrived:
                return
            if fields["drive"] == "IDLE":
                raise DeviceError(
                    f"was stopped before it became {arrived.lower()}",
                    field=self.name,
                    remedy="Set it again.",
                )
        raise DeviceTimeoutError(self.name, f"DOOR {command}", DOOR_S)

    def read(self) -> dict[str, Reading]:
        """Measure: "open", "closed" or "between", since its end switch changed."""
        self._rig.check()
        fields = self._rig.status()
        place = {"OPEN": "open", "CLOSED": "closed"}.get(fields["door"], "between")
        since_s = int(fields["door_us"]) * 1e-6
        return {
            self.name: self._reading(place, "", since_s),
            f"{self.name}_uncertainty": self._reading(self._rig.mono_s(since_s)[1], "s", since_s),
        }

    def describe(self) -> dict[str, Any]:
        """bluesky's data keys."""
        return {self.name: self._key("string", ""), f"{self.name}_uncertainty": self._key("number", "s")}
