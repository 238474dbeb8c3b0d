"""Relay boards on a serial port, as lamps: LCUS-1 and KMTronic kind.

They switch when told, and know no watchdog: whatever was said last holds until the power fails. So
they are used only if the rig file accepts that (`accept_no_failsafe`), and a guardian process switches the lamp off
when this one dies or hangs. Nothing switches it off when the computer itself does, or the cable is pulled. A KMTronic
board can be asked how its relay stands, and is, whenever the lamp is read; an LCUS-1 board says nothing at all.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import serial

import phoslab
from phoslab.instruments.devices import (
    Clock,
    DeviceError,
    DeviceGoneError,
    DeviceTimeoutError,
    Reading,
    Status,
)
from phoslab.instruments.link import open_port
from phoslab.instruments.system_clock import SystemClock

BEAT_S = 0.5
KEEP_S = 2.0
FIRST_PROMISE_S = 10.0
"""What switching the lamp on promises where `allow_until` has not been called before."""
WRITE_S = 1.0
"""How long a command may take to get on the wire (see open_port); 4 ms is usual."""
RELAY_S = 0.010
"""How long the armature of a small relay takes, at most."""
ANSWER_S = 0.5
"""How long a board may take to say how its relay stands; 6 ms is usual."""


@dataclass(frozen=True)
class Commands:
    """What a kind of board wants to hear; `ask` makes it answer with what would have switched it there, if it can."""

    baud: int
    on: bytes
    off: bytes
    ask: bytes = b""


KINDS = {
    # start byte, channel, state, sum of the three
    "lcus-1": Commands(9600, bytes.fromhex("A00101A2"), bytes.fromhex("A00100A1")),
    "kmtronic": Commands(9600, bytes.fromhex("FF0101"), bytes.fromhex("FF0100"), bytes.fromhex("FF0103")),
}


class RelayLamp:
    """A lamp behind a serial relay board.

    Args:
        port: see ports.resolve.
        kind: a name in KINDS.
        accept_no_failsafe: that the owner has been told that the board does not switch off by itself.
        name: for messages and readings.
        clock: the host's.

    Raises:
        DeviceError: the kind is unknown, or that it is not failsafe has not been accepted.
    """

    failsafe = False
    parent = None  # bluesky asks

    def __init__(
        self,
        port: str,
        kind: str,
        *,
        accept_no_failsafe: bool,
        name: str = "lamp",
        clock: Clock | None = None,
    ) -> None:
        if kind not in KINDS:
            raise DeviceError(
                f"has a relay board of an unknown kind {kind!r}",
                field=name,
                remedy=f"Known are: {', '.join(KINDS)}.",
            )
        if not accept_no_failsafe:
            raise DeviceError(
                f"would be switched by a relay board ({kind}) that does not switch off when this computer dies",
                field=name,
                remedy="Build the rig controller (docs/rig.md), or accept it: accept_no_failsafe = true in the rig "
                "file, a time switch in the lamp's mains lead, and somebody in the room.",
            )
        self.name = name
        self._port, self._kind, self._commands = port, kind, KINDS[kind]
        self._clock = clock if clock is not None else SystemClock()
        self._line: serial.Serial | None = None
        self._guardian: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None
        self._lock = threading.RLock()
        self._on, self._since_s, self._uncertainty_s = False, self._clock.mono_s(), RELAY_S
        self._until_s: float | None = None
        self._trouble: DeviceError | None = None
        self._subscribers: list[Callable[[DeviceError], None]] = []
        self._stopped = threading.Event()
        self._keeper: threading.Thread | None = None

    def subscribe(self, callback: Callable[[DeviceError], None]) -> None:
        """Call `callback` with whatever goes wrong, at once and in another thread."""
        self._subscribers.append(callback)

    # --- staging ------------------------------------------------------------------------------

    def stage(self) -> list[Any]:
        """Open the port, start the guardian, and switch the lamp off."""
        self._let_go()
        with self._lock:
            line = open_port(self._port, self._commands.baud, device=self.name)
            self._line, self._trouble = line, None
            try:
                self._switch(False)
                self._start_guardian(line.fileno())
            except BaseException:
                self._let_go()
                raise
        self._stopped = threading.Event()
        self._keeper = threading.Thread(
            target=self._keep, args=(self._stopped,), name=f"{self.name} heartbeat", daemon=True
        )
        self._keeper.start()
        return [self]

    def _start_guardian(self, port: int) -> None:
        ours, its = socket.socketpair()
        with its:
            # -P: a file in the current folder must not pass for a library.
            program = [sys.executable, "-P", "-m", "phoslab.instruments.guardian"]
            environment = {**os.environ, "PYTHONPATH": str(Path(phoslab.__file__).parent.parent)}
            self._guardian = subprocess.Popen(
                [*program, str(its.fileno()), str(port), self._commands.off.hex()],
                pass_fds=(its.fileno(), port),
                stdin=subprocess.DEVNULL,
                env=environment,
                start_new_session=True,
            )
        self._socket = ours
        ours.settimeout(10.0)
        try:
            ready = ours.recv(64)
        except OSError:
            ready = b""
        ours.settimeout(None)
        if not ready.startswith(b"READY"):
            raise DeviceError(
                "has no guardian: its process did not start within 10 s",
                field=self.name,
                remedy="Look at what it wrote above; without it the lamp is not switched on.",
            )

    def unstage(self) -> list[Any]:
        """Switch the lamp off and let the port go."""
        self.stop()
        self._let_go()
        return [self]

    def _let_go(self) -> None:
        """End heartbeat, guardian (which switches off once more) and line, as far as they are there."""
        self._stopped.set()
        if self._keeper is not None and self._keeper is not threading.current_thread():
            self._keeper.join(2.0)
        self._keeper = None
        with self._lock:
            if self._socket is not None:
                self._socket.close()
            if self._guardian is not None:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    self._guardian.wait(5.0)
            if self._line is not None:
                with contextlib.suppress(OSError):
                    self._line.close()
            self._socket = self._guardian = self._line = None

    # --- the verbs ----------------------------------------------------------------------------

    def allow_until(self, mono_s: float) -> None:
        """Promise to be back by then; without, switching on promises `FIRST_PROMISE_S`."""
        self._check()
        self._until_s = mono_s

    def set(self, value: Literal["on", "off"]) -> Status:
        """Set the lamp "on" or "off"; the status ends when the command is on its way through the line.

        It has ended when this returns: three or four bytes take 4 ms.
        """
        if value not in ("on", "off"):
            raise DeviceError(f"cannot be {value!r}", field=self.name, remedy='Set it "on" or "off".')
        status = Status(self.name, f"set {value}")
        with self._lock:
            if value == "on":
                self._check()
                if self._until_s is None or self._left_s() <= 0:
                    self._until_s = self._clock.mono_s() + FIRST_PROMISE_S
            try:
                self._switch(value == "on")
            except DeviceError as error:
                status.finish(error)
                return status
        status.finish()
        return status

    def stop(self, *, success: bool = False) -> None:
        """Switch the lamp off now."""
        with contextlib.suppress(DeviceError), self._lock:
            if self._line is not None:
                self._switch(False)

    def read(self) -> dict[str, Reading]:
        """Measure: how the board says that its relay stands, or what it was told last if it cannot say; since when,
        and how far off that may be, in s."""
        self._check()
        on = self._stands()
        clock = self._clock
        timestamp = clock.wall().timestamp() - (clock.mono_s() - self._since_s)

        def reading(value: Any, unit: str) -> Reading:
            return Reading(value=value, unit=unit, timestamp=timestamp, mono_s=self._since_s, device_s=None)

        return {
            self.name: reading("on" if on else "off", ""),
            f"{self.name}_uncertainty": reading(self._uncertainty_s, "s"),
        }

    def describe(self) -> dict[str, Any]:
        """bluesky's data keys."""
        source = f"{self._kind} at {self._port}"
        return {
            self.name: {"source": source, "dtype": "string", "shape": [], "units": ""},
            f"{self.name}_uncertainty": {"source": source, "dtype": "number", "shape": [], "units": "s"},
        }

    # --- inside -------------------------------------------------------------------------------

    def _check(self) -> None:
        if self._trouble is not None:
            raise self._trouble
        if self._line is None:
            raise DeviceError("is not staged", field=self.name, remedy="Call stage first.")

    def _left_s(self) -> float:
        assert self._until_s is not None
        return self._until_s - self._clock.mono_s()

    def _switch(self, on: bool) -> None:
        line = self._line
        if line is None:
            raise DeviceError("is not staged", field=self.name, remedy="Call stage first.")
        if on:
            self._tell_guardian(min(KEEP_S, self._left_s()))  # before the lamp is on
        begun_s = self._clock.mono_s()
        try:
            self._write(line, on)
        except serial.SerialTimeoutException as error:
            late = DeviceTimeoutError(self.name, f"set {'on' if on else 'off'}", WRITE_S)
            self._on_trouble(late)
            raise late from error
        except (OSError, TypeError) as error:
            raise self._gone(error) from error
        ended_s = self._clock.mono_s() + RELAY_S
        if on != self._on:
            self._since_s = (begun_s + ended_s) / 2
            self._uncertainty_s = (ended_s - begun_s) / 2
        self._on = on
        if not on:
            self._until_s = None
            if self._socket is not None:
                self._tell_guardian(0.0)

    def _write(self, line: serial.Serial, on: bool) -> None:
        """Write a command and wait until it is on the wire; `Serial.flush` would wait for ever."""
        until = time.monotonic() + WRITE_S
        line.write(self._commands.on if on else self._commands.off)
        while line.out_waiting:
            if time.monotonic() > until:
                raise serial.SerialTimeoutException("not on the wire")
            time.sleep(0.001)

    def _stands(self) -> bool:
        """Ask the board whether it is on; of one that cannot say, what it was told last."""
        with self._lock:
            line, asks = self._line, self._commands.ask
            if line is None or not asks:
                return self._on
            try:
                line.reset_input_buffer()
                line.write(asks)
                answer, until = b"", time.monotonic() + ANSWER_S
                while len(answer) < len(self._commands.on) and time.monotonic() < until:
                    answer += line.read(len(self._commands.on) - len(answer))
            except (OSError, TypeError, termios.error) as error:
                raise self._gone(error) from error
            if answer not in (self._commands.on, self._commands.off):
                if answer:
                    raise DeviceError(
                        f"is switched by a board that says {answer.hex()!r} when it is asked how its relay stands",
                        field=self.name,
                        remedy=f"Is it a {self._kind} board? Correct the rig file.",
                    )
                raise DeviceTimeoutError(self.name, "say how its relay stands", ANSWER_S)
            return answer == self._commands.on

    def _gone(self, error: BaseException) -> DeviceGoneError:
        """Keep, and tell, that the board is not there any more."""
        gone = DeviceGoneError(
            f"has gone from {self._port} ({error})",
            field=self.name,
            remedy="Look at the lamp: if it is on, pull its plug. Then plug the relay board in again.",
        )
        self._on_trouble(gone)
        return gone

    def _tell_guardian(self, keep_s: float) -> None:
        """Say how long the lamp may stay on; notice that the guardian has died, or has had to switch off."""
        assert self._socket is not None
        try:
            with contextlib.suppress(BlockingIOError):
                if b"OFF" in self._socket.recv(4096, socket.MSG_DONTWAIT):
                    self._on = False
                    raise DeviceError(
                        "was switched off by its guardian: this program was silent, or a promise was not renewed",
                        field=self.name,
                        remedy="End what keeps this computer so busy, then stage it again.",
                    )
            self._socket.sendall(f"KEEP {keep_s:.3f}\n".encode())
        except (OSError, DeviceError) as error:
            trouble = (
                error
                if isinstance(error, DeviceError)
                else DeviceError(
                    "has lost its guardian process",
                    field=self.name,
                    remedy="Stage it again, and see what ended it.",
                )
            )
            self._on_trouble(trouble)
            if keep_s > 0:
                raise trouble from error

    def _keep(self, stopped: threading.Event) -> None:
        pause_s = BEAT_S
        while not stopped.wait(pause_s):
            pause_s = BEAT_S
            try:
                with self._lock:
                    if not self._on or stopped.is_set():
                        continue
                    left_s = self._left_s()
                    if left_s > 0:
                        self._tell_guardian(min(KEEP_S, left_s))
                        pause_s = min(BEAT_S, max(left_s, 0.01))
                        continue
                    self._switch(False)
                self._on_trouble(
                    DeviceError(
                        "was switched off: a promise was not renewed",
                        field=self.name,
                        remedy="Call allow_until again before the time is over.",
                    )
                )
            except DeviceError:
                with contextlib.suppress(DeviceError), self._lock:
                    self._switch(False)

    def _on_trouble(self, error: DeviceError) -> None:
        if self._trouble is None:
            self._trouble = error
        for callback in self._subscribers:
            callback(error)
