"""A serial line to one board: opened for us alone, lines with checksums, requests that are repeated until answered."""

from __future__ import annotations

import contextlib
import fcntl
import random
import termios
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import serial

from phoslab.instruments import ports, wire
from phoslab.instruments.devices import DeviceError, DeviceGoneError, DeviceTimeoutError

TRY_S = 0.4
"""How long to wait before a request is repeated: a reply takes 20 ms, a USB adapter 16 more, a busy computer longer."""
TRIES = 5
RELEASE_S = 1.5
"""How long to wait for a port in use: the guardian of a host that was killed holds it while it switches off."""


@dataclass(frozen=True)
class Answer:
    """A reply, and the host's clock when the request began to go out and when the reply had come in, in s."""

    reply: wire.Reply
    sent_s: float
    heard_s: float


def open_port(port: str, baud: int, *, device: str) -> serial.Serial:
    """Open a port so that no other program can have it at the same time.

    Args:
        port: see ports.resolve.
        baud: bits a second.
        device: its name, for messages.

    Raises:
        DeviceGoneError: it is not there, or cannot be opened; the message names the process that holds it, if that
            can be found out.
    """
    path = ports.resolve(port, field=device)
    until = time.monotonic() + RELEASE_S
    while True:
        try:
            opened = serial.Serial(path, baud, timeout=0.1, write_timeout=1.0, exclusive=True)
            # The lock stops those who ask; this stops everybody (but root).
            fcntl.ioctl(opened.fileno(), termios.TIOCEXCL)
            return opened
        except (OSError, termios.error) as error:
            taken = "exclusively lock" in str(error) or "busy" in str(error)
            if taken and time.monotonic() < until:
                time.sleep(0.05)
                continue
            if taken:
                raise DeviceGoneError(
                    f"at {path} is in use by {ports.holder(path) or 'another process'}",
                    field=device,
                    remedy="End that, or wait until it is done.",
                ) from error
            raise DeviceGoneError(
                f"at {path} cannot be opened ({error})", field=device, remedy="Check its power and cable."
            ) from error


class Link:
    """The line to a rig controller. Requests of all threads queue up; replies and events come from its own thread.

    Args:
        device: its name, for messages.
        port: see ports.resolve; looked up anew by every `open`.
        mono_s: the clock that answers are stamped with.
        on_event: called with each event, in the reading thread.
        on_gone: called once when the line breaks, in that thread.
    """

    def __init__(
        self,
        device: str,
        port: str,
        mono_s: Callable[[], float],
        on_event: Callable[[wire.Event], None],
        on_gone: Callable[[DeviceError], None],
    ) -> None:
        self._device, self._port, self._mono_s = device, port, mono_s
        self._on_event, self._on_gone = on_event, on_gone
        self._turn = threading.Lock()
        self._heard = threading.Condition()
        self._answer: tuple[wire.Reply, float] | None = None
        self._gone: DeviceGoneError | None = None
        self._line: serial.Serial | None = None
        self._reader: threading.Thread | None = None
        self._next_id = random.randrange(1, 65536)
        self.strange = False

    @property
    def is_open(self) -> bool:
        """Whether there is a line, as far as is known."""
        return self._line is not None and self._gone is None

    def open(self) -> None:
        """Open the port; see `open_port` for what may go wrong."""
        self.close()
        line = open_port(self._port, wire.BAUD, device=self._device)
        self._gone, self._answer, self.strange = None, None, False
        self._line = line
        self._reader = threading.Thread(
            target=self._read, args=(line,), name=f"{self._device} reader", daemon=True
        )
        self._reader.start()

    def close(self) -> None:
        """Close it; harmless if it is not open."""
        line, self._line = self._line, None
        if line is None:
            return
        with contextlib.suppress(OSError):
            line.cancel_read()
        if self._reader is not None and self._reader is not threading.current_thread():
            self._reader.join(2.0)
        with contextlib.suppress(OSError):
            line.close()

    def request(self, command: str, *, tries: int = TRIES, try_s: float = TRY_S) -> Answer:
        """Send a command, repeat it until it is answered, and return the answer.

        Raises:
            DeviceTimeoutError: no answer to any of `tries` tries of `try_s` each.
            DeviceGoneError: the line is broken.
        """
        with self._turn:
            number = self._next_id
            self._next_id = number % 65535 + 1
            text = wire.encode(f"{number} {command}")
            begun = time.monotonic()
            sent_s = self._mono_s()
            for _ in range(tries):
                with self._heard:
                    self._answer = None
                self._write(text)
                answer = self._wait(number, time.monotonic() + try_s)
                if answer is not None:
                    return Answer(answer[0], sent_s, answer[1])
            raise DeviceTimeoutError(self._device, command, round(time.monotonic() - begun, 1))

    def _write(self, text: bytes) -> None:
        line = self._line
        if line is None or self._gone is not None:
            raise self._gone or DeviceGoneError(
                "is not connected", field=self._device, remedy="Stage it first."
            )
        try:
            line.write(text)
        except (OSError, TypeError) as error:  # a TypeError: pyserial's, when it is closed meanwhile
            if isinstance(error, serial.SerialTimeoutException):
                return  # not taken: as good as lost, and repeated
            self._break(error)
            assert self._gone is not None
            raise self._gone from error

    def _wait(self, number: int, until: float) -> tuple[wire.Reply, float] | None:
        """Wait for the reply to request `number`; None if it does not come, or the request came garbled."""
        with self._heard:
            while True:
                if self._gone is not None:
                    raise self._gone
                if self._answer is not None:
                    if self._answer[0].id == number:
                        return self._answer
                    garbled = self._answer[0].code == "GARBLED"
                    self._answer = None
                    if garbled:
                        return None
                left = until - time.monotonic()
                if left <= 0 or not self._heard.wait(left):
                    return None

    def _read(self, line: serial.Serial) -> None:
        lines = wire.Lines()
        while self._line is line:
            try:
                data = line.read(max(1, line.in_waiting))
            except (OSError, TypeError) as error:
                if self._line is line:
                    self._break(error)
                return
            heard_s = self._mono_s()
            for raw in lines.feed(data):
                text = wire.decode(raw)
                said = wire.parse(text) if text is not None else None
                if isinstance(said, wire.Reply):
                    with self._heard:
                        self._answer = said, heard_s
                        self._heard.notify_all()
                elif isinstance(said, wire.Event):
                    self._on_event(said)
                elif text is None:
                    self.strange = True

    def _break(self, error: Exception) -> None:
        with self._heard:
            if self._gone is not None:
                return
            self._gone = DeviceGoneError(
                f"has gone from {self._port} ({error})",
                field=self._device,
                remedy="Plug it in again; the lamp has gone out by itself. Then resume.",
            )
            self._heard.notify_all()
        self._on_gone(self._gone)


def greet(link: Link, device: str, *, timeout_s: float = 5.0) -> Answer:
    """Say HELLO until the board answers: opening the port may have reset it, and a boot loader swallows lines.

    Raises:
        DeviceError: what is there is no rig controller, or speaks another version of the protocol.
    """
    try:
        answer = link.request(f"HELLO {wire.PROTOCOL}", tries=round(timeout_s / 0.5), try_s=0.5)
    except DeviceTimeoutError as error:
        what = "says things that a rig controller does not say" if link.strange else "says nothing"
        raise DeviceError(
            f"does not answer HELLO within {timeout_s:g} s ({what})",
            field=device,
            remedy="Check that the port is the rig controller's and its firmware flashed (docs/rig.md).",
        ) from error
    if not answer.reply.ok:
        raise DeviceError(
            f"speaks another protocol than version {wire.PROTOCOL} (it answered {answer.reply.code})",
            field=device,
            remedy="Flash the firmware that comes with this phoslab (docs/rig.md).",
        )
    return answer
