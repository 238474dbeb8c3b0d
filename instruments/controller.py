"""The rig controller's driver: a lamp and a door on one serial line (docs/rig-protocol.md).

    rig = RigController("usb:2341:0043")
    rig.lamp.stage()
    rig.lamp.allow_until(time.monotonic() + 60)
    rig.lamp.set("on").wait(3)
    ...
    rig.lamp.unstage()

What goes wrong between calls (a stuck relay, a reset, a pulled cable, a lamp that went out) is told to those who
subscribed, at once, and raised by every call from then on, until `stage`; only switching off, `stop` and `unstage`
are never refused.

Time-outs of the line are in real time. `clock` may be another: promises (`allow_until`) and readings are in its time.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable
from datetime import datetime
from typing import Any, Literal

from phoslab.instruments import wire
from phoslab.instruments.device_clock import DeviceClock
from phoslab.instruments.devices import (
    Clock,
    DeviceError,
    DeviceGoneError,
    DeviceTimeoutError,
    Reading,
    Status,
)
from phoslab.instruments.link import Answer, Link, greet
from phoslab.instruments.recorder import SystemClock

BEAT_S = 0.5
KEEP_S = 2.0
"""How long the lamp stays on without a heartbeat."""
FIRST_PROMISE_S = 10.0
"""What switching the lamp on promises where `allow_until` has not been called before."""
DOOR_S = 6.0
"""The controller gives up after 3; the rest is for the line."""

_WENT_OUT = {
    "WATCHDOG": (
        "went out: nothing was heard of this program for too long, or a promise was not renewed",
        "Call allow_until again before the time is over; end what keeps this computer so busy.",
    ),
    "MAXON": ("went out: its maximum on-time is over", "Allow more in the rig file, if the lamp may."),
}
_FAULTS = {
    "STUCK": (
        "SHINES ALTHOUGH IT IS SWITCHED OFF: a relay is stuck, or other light falls on the photodiode",
        "Pull the lamp's plug. Replace the relay before the lamp is used again.",
    ),
    "DEAD": (
        "gives no light although it is switched on",
        "Let it cool; check bulb, fuse, plug and photodiode.",
    ),
}


class RigController:
    """The connection to one controller board, its `lamp` and its `door`.

    Args:
        port: see ports.resolve; looked up anew at every `stage`, so that an adapter may move.
        name: of the lamp and door's prefix in messages.
        max_on_s: maximum on-time, which the board enforces.
        settle_s: how long lamp and photodiode may disagree after a change.
        threshold: photodiode value (1..1000) from which on the lamp shines; 0: there is no photodiode.
        clock: the host's.
    """

    def __init__(
        self,
        port: str,
        *,
        name: str = "rig",
        max_on_s: float = 7200.0,
        settle_s: float = 1.0,
        threshold: int = 300,
        clock: Clock | None = None,
    ) -> None:
        self.name = name
        self.host_clock = clock if clock is not None else SystemClock()
        self.device_clock = DeviceClock()
        self._limits = f"LIMITS {round(max_on_s * 1000)} {round(settle_s * 1000)} {threshold}"
        self._link = Link(name, port, self.host_clock.mono_s, self._on_event, self._on_trouble)
        self._state = threading.RLock()  # held while a request goes out and what it changes is noted
        self._moved = threading.Condition()  # the door has, or something has gone wrong
        self._subscribers: list[Callable[[DeviceError], None]] = []
        self._trouble: DeviceError | None = None
        self._staged: set[str] = set()
        self._ready = False
        self._boot = -1
        self.facts: dict[str, str] = {}
        self._lamp_on = False
        self._until_s: float | None = None
        self._keeper: threading.Thread | None = None
        self._wake = threading.Event()
        self.lamp = RigLamp(self)
        self.door = RigDoor(self)

    # --- for plans ----------------------------------------------------------------------------

    def subscribe(self, callback: Callable[[DeviceError], None]) -> None:
        """Call `callback` with whatever goes wrong, at once and in another thread."""
        self._subscribers.append(callback)

    @property
    def clock(self) -> ControllerClock:
        """The host's clock that also knows the controller's."""
        return ControllerClock(self)

    def mono_s(self, device_s: float) -> tuple[float, float]:
        """Return the host's time in s at a time of the controller, and how far off it may be."""
        found = self.device_clock.mono_s(device_s)
        assert found is not None, "no exchange yet"
        return found

    def status(self) -> dict[str, str]:
        """Ask for everything that the controller knows: the keys of STATUS in docs/rig-protocol.md."""
        return dict(self._ask("STATUS").reply.fields)

    # --- staging ------------------------------------------------------------------------------

    def _stage(self, device: str) -> None:
        with self._state:
            if not self._ready or self._trouble is not None or not self._link.is_open:
                self._connect()
            self._staged.add(device)

    def _connect(self) -> None:
        """Open the line and bring the board to a known state: lamp off, limits set, trouble forgotten."""
        self._stop_keeper()
        self._ready, self._lamp_on, self._until_s = False, False, None
        self._link.open()
        try:
            hello = greet(self._link, self.name)
            self.device_clock.forget()
            self._boot = int(hello.reply.fields.get("boot", "-1"))
            self.facts = dict(hello.reply.fields)
            self._trouble = None
            self._learn(hello)
            limits = self._link.request(self._limits)
            if not limits.reply.ok:
                longest = int(hello.reply.fields.get("max_on_ms", "0")) / 1000
                raise DeviceError(
                    f"refuses the limits of the rig file ({self._limits})",
                    field=self.name,
                    remedy=f"Its own maximum on-time is {longest:g} s; settling 0.05 to 60 s; threshold 0 to 1000.",
                )
        except BaseException:
            self._link.close()
            raise
        self._ready = True
        self._wake = threading.Event()
        self._keeper = threading.Thread(
            target=self._keep, args=(self._wake,), name=f"{self.name} heartbeat", daemon=True
        )
        self._keeper.start()

    def _unstage(self, device: str) -> None:
        """Let go of one of the two; with the last the line is closed."""
        self._staged.discard(device)
        if self._staged:
            return
        self._stop_keeper()
        self._ready = False
        self._link.close()

    def _stop_keeper(self) -> None:
        keeper, self._keeper = self._keeper, None
        self._wake.set()
        if keeper is not None and keeper is not threading.current_thread():
            # It may be waiting for the lock that is held here; it ends by itself once it sees the event.
            keeper.join(0 if self._state_is_mine() else 2.0)

    def _state_is_mine(self) -> bool:
        return bool(self._state._is_owned())  # type: ignore[attr-defined]  # as threading.Condition does

    # --- requests -----------------------------------------------------------------------------

    def check(self) -> None:
        """Raise what has gone wrong, if anything has."""
        if self._trouble is not None:
            raise self._trouble
        if not self._ready:
            raise DeviceError("is not staged", field=self.name, remedy="Call stage first.")

    def _ask(self, command: str) -> Answer:
        """Send a command, learn from the answer what it tells, and return it.

        Raises:
            DeviceError: it was refused, or could not be delivered.
        """
        with self._state:
            answer = self._link.request(command)
            reply = answer.reply
            if reply.code == "HELLO":
                self._on_trouble(self._reset_error())
                raise self._trouble or self._reset_error()
            self._learn(answer)
            if not reply.ok:
                raise DeviceError(
                    f"refuses {command!r} ({reply.code})",
                    field=self.name,
                    remedy="Stage it again; see docs/rig-protocol.md for what the code means.",
                )
            return answer

    def _learn(self, answer: Answer) -> None:
        self.device_clock.add(answer.sent_s, answer.reply.device_us * 1e-6, answer.heard_s)

    def _reset_error(self) -> DeviceError:
        return DeviceError(
            "has been reset: the lamp is off",
            field=self.name,
            remedy="Stage it again. If it happens by itself, check its supply and its USB cable.",
        )

    # --- the heartbeat ------------------------------------------------------------------------

    def _keep(self, wake: threading.Event) -> None:
        """Tell the controller every half second how long the lamp may stay on, until `wake` is set."""
        pause_s = 0.0
        while not wake.wait(pause_s):
            try:
                with self._state:
                    if wake.is_set():
                        return
                    pause_s = self._beat()
            except DeviceGoneError:
                return  # told by the reading thread
            except DeviceError as error:
                self._on_trouble(error)
                if not self._ready:
                    return

    def _beat(self) -> float:
        """Send one heartbeat; return how long to wait for the next."""
        left_s = KEEP_S
        if self._lamp_on:
            left_s = self._left_s()
            if left_s <= 0:
                self._lamp_on = False
                with contextlib.suppress(DeviceError):
                    self._ask("LAMP OFF")
                problem, remedy = _WENT_OUT["WATCHDOG"]
                raise DeviceError(problem, remedy=remedy, field=self.lamp.name)
        reply = self._ask(f"PING {self._keep_ms(left_s) if self._lamp_on else 0}").reply
        for alarm in reply.fields.get("alarms", "-").split(","):
            if alarm != "-":
                self._on_alarm(alarm, {})
        if self._lamp_on and reply.fields.get("lamp") == "OFF":
            self._went_out(reply.fields.get("why", "?"))
        return min(BEAT_S, max(left_s, 0.01))

    def _left_s(self) -> float:
        assert self._until_s is not None
        return self._until_s - self.host_clock.mono_s()

    @staticmethod
    def _keep_ms(left_s: float) -> int:
        return max(1, min(round(KEEP_S * 1000), int(left_s * 1000)))

    # --- what the controller says unasked -----------------------------------------------------

    def _on_event(self, event: wire.Event) -> None:
        """In the reading thread: no request may be sent from here."""
        if event.name == "BOOT":
            if self._ready and event.fields.get("boot") != str(self._boot):
                self._on_trouble(self._reset_error())
        elif event.name == "DOOR":
            with self._moved:
                self._moved.notify_all()
        elif event.name in ("WATCHDOG", "MAXON", "LAMPFAULT", "DOORSTUCK"):
            # Acknowledged from a thread of its own; a name is said again if that fails.
            threading.Thread(target=self._on_alarm, args=(event.name, event.fields), daemon=True).start()

    def _on_alarm(self, alarm: str, fields: Any) -> None:
        if not self._ready:
            return
        try:
            with self._state:
                status = self.status()
                if alarm == "LAMPFAULT":
                    self._lamp_on = False
                    problem, remedy = _FAULTS[fields.get("verdict", status.get("verdict", "STUCK"))]
                    self._on_trouble(DeviceError(problem, remedy=remedy, field=self.lamp.name))
                elif alarm in _WENT_OUT:
                    self._went_out(alarm)
                self._ask(f"ACK {alarm}")
        except (DeviceError, KeyError):
            return  # it is said again within a second; or the line is gone, which others tell
        with self._moved:
            self._moved.notify_all()

    def _went_out(self, why: str) -> None:
        """The lamp is off and nobody asked for it; said once, since the heartbeat and the alarm both notice."""
        if not self._lamp_on:
            return
        self._lamp_on = False
        problem, remedy = _WENT_OUT.get(why, (f"went out ({why})", "Look at it, then stage it again."))
        self._on_trouble(DeviceError(problem, remedy=remedy, field=self.lamp.name))

    def _on_trouble(self, error: DeviceError) -> None:
        """Keep the first trouble for all calls to come, and tell the subscribers of each."""
        lost = isinstance(error, DeviceGoneError) or str(error) == str(self._reset_error())
        if lost and not self._ready:
            return
        # A stuck relay is worse than what has gone wrong before, and must not hide behind it.
        if self._trouble is None or "SHINES" in str(error):
            self._trouble = error
        if lost:
            self._ready = self._lamp_on = False
        for callback in self._subscribers:
            callback(error)
        with self._moved:
            self._moved.notify_all()


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

    def __init__(self, rig: RigController, kind: str) -> None:
        self._rig, self._kind = rig, kind
        self.name = kind
        self._worker = _Worker(f"{rig.name} {kind}")

    def stage(self) -> list[Any]:
        """Connect if need be: the controller is greeted, its limits set, the lamp off."""
        self._rig._stage(self._kind)
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

    def __init__(self, rig: RigController) -> None:
        super().__init__(rig, "lamp")

    def stage(self) -> list[Any]:
        """Connect, and switch the lamp off."""
        super().stage()
        self._off()
        return [self]

    def unstage(self) -> list[Any]:
        """Switch the lamp off and let go."""
        with contextlib.suppress(DeviceError):
            if self._rig._ready:
                self._off()
        self._rig._unstage(self._kind)
        return [self]

    def stop(self, *, success: bool = False) -> None:
        """Switch the lamp off now."""
        with contextlib.suppress(DeviceError):
            self._off()

    def allow_until(self, mono_s: float) -> None:
        """Promise to be back by then; without, switching on promises `FIRST_PROMISE_S`."""
        self._rig.check()
        self._rig._until_s = mono_s

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
        answer = self._rig._ask("STATUS")
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
        with rig._state:
            rig.check()
            if rig._until_s is None or rig._left_s() <= 0:
                rig._until_s = rig.host_clock.mono_s() + FIRST_PROMISE_S
            rig._ask(f"LAMP ON {rig._keep_ms(rig._left_s())}")
            rig._lamp_on = True

    def _off(self) -> None:
        rig = self._rig
        with rig._state:
            rig._lamp_on, rig._until_s = False, None
            rig._ask("LAMP OFF")


class RigDoor(_Part):
    """The trapdoor on a rig controller."""

    def __init__(self, rig: RigController) -> None:
        super().__init__(rig, "door")

    def unstage(self) -> list[Any]:
        """Stop the motor and let go."""
        if self._rig._ready:
            self.stop()
        self._rig._unstage(self._kind)
        return [self]

    def stop(self, *, success: bool = False) -> None:
        """Stop the motor now; the door stays where it is."""
        with contextlib.suppress(DeviceError):
            self._rig._ask("DOOR STOP")

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
        rig._ask(f"DOOR {command}")
        waited_s = 0.0
        while waited_s < DOOR_S:
            with rig._moved:  # an event may be lost: what STATUS says counts
                rig._moved.wait(0.25)
            waited_s += 0.25
            rig.check()
            fields = rig.status()
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


class ControllerClock:
    """The host's clock, with the controller's beside it."""

    def __init__(self, rig: RigController) -> None:
        self._rig = rig

    def mono_s(self) -> float:
        """Seconds of the host's clock that never goes back."""
        return self._rig.host_clock.mono_s()

    def device_s(self) -> float | None:
        """Seconds of the controller's clock now, None before it has been heard."""
        return self._rig.device_clock.device_s(self.mono_s())

    def wall(self) -> datetime:
        """The moment in UTC."""
        return self._rig.host_clock.wall()

    def sleep_until(self, mono_s: float) -> None:
        """Wait for a moment of `mono_s`."""
        self._rig.host_clock.sleep_until(mono_s)
