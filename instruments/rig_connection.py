"""The connection to a rig controller: greeting, heartbeat, alarms, and the two clocks (docs/rig-protocol.md)."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from datetime import datetime

from phoslab.instruments import wire
from phoslab.instruments.device_clock import DeviceClock
from phoslab.instruments.devices import AlarmError, Clock, DeviceError
from phoslab.instruments.link import Answer, Link, greet
from phoslab.instruments.system_clock import SystemClock

BEAT_S = 0.5
KEEP_S = 2.0
"""How long the lamp stays on without a heartbeat."""

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


class RigConnection:
    """One controller board; `RigController` adds its lamp and its door, which share what is public here.

    Args: as of RigController.
    """

    def __init__(
        self, port: str, *, name: str, max_on_s: float, settle_s: float, threshold: int, clock: Clock | None
    ) -> None:
        self.name = name
        self.host_clock = clock if clock is not None else SystemClock()
        self.device_clock = DeviceClock()
        self.facts: dict[str, str] = {}
        """What the board said of itself: protocol, firmware, boot, reset, max_on_ms."""
        self.state = threading.RLock()
        """Held while a request goes out and what it changes is noted."""
        self.moved = threading.Condition()
        """Notified when the door has moved, or something has gone wrong."""
        self.ready = False
        self.lamp_on = False
        """Whether somebody wants the lamp on: it is kept on as long as this is true and the promise holds."""
        self.until_s: float | None = None
        self._limits = f"LIMITS {round(max_on_s * 1000)} {round(settle_s * 1000)} {threshold}"
        self._link = Link(name, port, self.host_clock.mono_s, self._on_event, self._on_lost)
        self._subscribers: list[Callable[[DeviceError], None]] = []
        self._trouble: DeviceError | None = None
        self._staged: set[str] = set()
        self._keeper: threading.Thread | None = None
        self._wake = threading.Event()

    def subscribe(self, callback: Callable[[DeviceError], None]) -> None:
        """Call `callback` with whatever goes wrong, at once and in another thread."""
        self._subscribers.append(callback)

    @property
    def clock(self) -> ControllerClock:
        """The host's clock that also knows the controller's."""
        return ControllerClock(self)

    def mono_s(self, device_s: float) -> tuple[float, float]:
        """Return the host's time in s at a time of the controller, and how far off it may be.

        Raises:
            DeviceError: the controller has not been heard yet.
        """
        found = self.device_clock.mono_s(device_s)
        if found is None:
            raise DeviceError("is not staged", field=self.name, remedy="Call stage first.")
        return found

    def status(self) -> dict[str, str]:
        """Ask for everything that the controller knows: the keys of STATUS in docs/rig-protocol.md."""
        return dict(self.ask("STATUS").reply.fields)

    # --- staging ------------------------------------------------------------------------------

    def stage(self, device: str) -> None:
        """Connect, unless it is connected and all is well."""
        with self.state:
            if not self.ready or self._trouble is not None or not self._link.is_open:
                self._connect()
            self._staged.add(device)

    def unstage(self, device: str) -> None:
        """Let go of one of the two; with the last the line is closed."""
        self._staged.discard(device)
        if self._staged:
            return
        self.ready = False
        self._wake.set()
        if self._keeper is not None:
            self._keeper.join(2.0)
        self._link.close()

    def _connect(self) -> None:
        """Open the line and bring the board to a known state: lamp off, limits set, trouble forgotten."""
        self._wake.set()  # an old heartbeat ends as soon as it gets hold of `state`
        self.ready, self.lamp_on, self.until_s = False, False, None
        self._link.open()
        try:
            hello = greet(self._link, self.name)
            self.facts = dict(hello.reply.fields)
            self.device_clock.forget()
            self._learn(hello)
            limits = self._link.request(self._limits).reply
            if limits.code == "HELLO":
                raise self._reset_error()
            if not limits.ok:
                longest_s = int(self.facts.get("max_on_ms", "0")) / 1000
                raise DeviceError(
                    f"refuses the limits of the rig file ({self._limits})",
                    field=self.name,
                    remedy=f"Its own maximum on-time is {longest_s:g} s; settling 0.05 to 60 s; threshold 0 to 1000.",
                )
        except BaseException:
            self._link.close()
            raise
        self._trouble, self.ready = None, True
        self._wake = threading.Event()
        self._keeper = threading.Thread(
            target=self._keep, args=(self._wake,), name=f"{self.name} heartbeat", daemon=True
        )
        self._keeper.start()

    # --- requests -----------------------------------------------------------------------------

    def check(self) -> None:
        """Raise what has gone wrong, if anything has."""
        if self._trouble is not None:
            raise self._trouble
        if not self.ready:
            raise DeviceError("is not staged", field=self.name, remedy="Call stage first.")

    def ask(self, command: str) -> Answer:
        """Send a command and return its answer.

        Raises:
            DeviceError: it was refused, or could not be delivered.
        """
        with self.state:
            answer = self._link.request(command)
            if answer.reply.code == "HELLO":
                self._on_lost(self._reset_error())
                raise self._reset_error()
            self._learn(answer)
            if not answer.reply.ok:
                raise DeviceError(
                    f"refuses {command!r} ({answer.reply.code})",
                    field=self.name,
                    remedy="Stage it again; docs/rig-protocol.md says what the code means.",
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
            pause_s = BEAT_S
            try:
                with self.state:
                    if wake.is_set() or not self.ready:
                        return
                    pause_s = self._beat()
            except DeviceError as error:
                if self.ready:  # else it is lost, and that has been told
                    self._tell(error)

    def _beat(self) -> float:
        """Send one heartbeat; return how long to wait for the next."""
        left_s = self.left_s() if self.lamp_on else KEEP_S
        if left_s <= 0:
            with contextlib.suppress(DeviceError):
                self.ask("LAMP OFF")
            self._went_out("WATCHDOG")
            return BEAT_S
        fields = self.ask(f"PING {self.keep_ms(left_s) if self.lamp_on else 0}").reply.fields
        for alarm in fields.get("alarms", "-").split(","):
            if alarm != "-":
                self._on_alarm(alarm)
        if self.lamp_on and fields.get("lamp") == "OFF":
            self._went_out(fields.get("why", "?"))
        return min(BEAT_S, max(left_s, 0.01))

    def left_s(self) -> float:
        """How long the promise still holds."""
        assert self.until_s is not None
        return self.until_s - self.host_clock.mono_s()

    @staticmethod
    def keep_ms(left_s: float) -> int:
        """What to tell the controller."""
        return max(1, min(round(KEEP_S * 1000), int(left_s * 1000)))

    # --- what goes wrong ----------------------------------------------------------------------

    def _on_event(self, event: wire.Event) -> None:
        """In the reading thread: no request may be sent from here."""
        if event.name == "BOOT":
            if self.ready and event.fields.get("boot") != self.facts.get("boot"):
                self._on_lost(self._reset_error())
        elif event.name == "DOOR":
            with self.moved:
                self.moved.notify_all()
        elif event.name in ("WATCHDOG", "MAXON", "LAMPFAULT", "DOORSTUCK"):
            threading.Thread(target=self._on_alarm, args=(event.name,), daemon=True).start()

    def _on_alarm(self, alarm: str) -> None:
        """Tell and acknowledge it, unless another thread has; if that fails, it is said again within a second."""
        with self.state, contextlib.suppress(DeviceError):
            status = self.status() if self.ready else {}
            if alarm not in status.get("alarms", "").split(","):
                return
            if alarm == "LAMPFAULT":
                dead = status.get("verdict") == "DEAD"
                problem, remedy = _FAULTS["DEAD" if dead else "STUCK"]
                kind = DeviceError if dead else AlarmError
                self._tell(kind(problem, remedy=remedy, field="lamp"), grave=True)
            elif alarm != "DOORSTUCK":  # which the door's status tells
                self._went_out(alarm)
            self.ask(f"ACK {alarm}")
        with self.moved:
            self.moved.notify_all()

    def _went_out(self, why: str) -> None:
        """The lamp is off and nobody asked for it; told once: the heartbeat and the alarm both notice."""
        if not self.lamp_on:
            return
        problem, remedy = _WENT_OUT.get(why, (f"went out ({why})", "Look at it, then stage it again."))
        self._tell(DeviceError(problem, remedy=remedy, field="lamp"))

    def _on_lost(self, error: DeviceError) -> None:
        """The line is broken, or the controller has forgotten everything."""
        if self.ready:
            self.ready = False
            self._tell(error)

    def _tell(self, error: DeviceError, *, grave: bool = False) -> None:
        """Keep the first trouble for all calls to come (a grave one goes first), and tell the subscribers.

        The lamp is not kept on any longer: it goes out within `KEEP_S`.
        """
        if self._trouble is None or grave:
            self._trouble = error
        self.lamp_on = False
        for callback in self._subscribers:
            callback(error)
        with self.moved:
            self.moved.notify_all()


class ControllerClock:
    """The host's clock, with the controller's beside it."""

    def __init__(self, rig: RigConnection) -> None:
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
