"""The host's end of the simulated bench: a connection, its clock, and the hands that place things.

    link = Link(Path("/tmp/bench/socket"))
    clock = BenchClock(Path("/tmp/bench"), link)
    hands = Hands(Link(Path("/tmp/bench/socket")))
    hands.place(target="card", lvf="camera", light="led")
    clock.sleep_until(clock.mono_s() + 5400)            # takes milliseconds

The bench itself is another process (docs/simulation.md); a plan knows nothing of it but its clock, its serial port and
its camera. On the socket go lines of JSON, one request and one answer at a time, each of at most `LONGEST` bytes;
an answer may announce bytes that follow it. Nothing is pickled.
"""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import socket
import struct
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from phoslab.errors import PhoslabError
from phoslab.instruments.devices import DeviceError, DeviceGoneError, DeviceTimeoutError

LONGEST = 1 << 16
"""Bytes of a line."""

LARGEST = 1 << 28
"""Bytes that an answer may announce."""

PATIENCE_S = 60.0
"""For an answer: a frame after hours of simulated time takes a second to compute, on a busy machine more."""

TIME_FILE = "time"
TIME = struct.Struct("<Qdddd")
"""The time file: a counter that is odd while the rest changes, and then in s: `zero`, `ahead`, `start`, `step`.

mono_s is time.monotonic() - zero + ahead; the wall clock shows start + mono_s + step, from 1970 on.
"""

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


class Link:
    """A connection to the bench; thread-safe, one question at a time.

    Args:
        path: of the bench's socket.
        device: whose it is, for messages.

    Raises:
        DeviceGoneError: no bench listens there; from `ask` too, if it is there no more.
    """

    def __init__(self, path: Path, device: str = "the simulated bench") -> None:
        self.path, self.device = path, device
        self._lock = threading.Lock()
        self._socket: socket.socket | None = None
        self._open()

    def _open(self) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(PATIENCE_S)
        try:
            self._socket.connect(str(self.path))
        except OSError as error:
            self.close()
            raise self._gone() from error
        self._stream = self._socket.makefile("rb")

    def close(self) -> None:
        """Let go of it; harmless when it is closed."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.close()
            self._socket = None

    def ask(self, do: str, **arguments: Any) -> dict[str, Any]:
        """Send a request and return its answer; bytes that follow it stand under "body".

        Raises:
            RefusedError: the bench refuses, in its own words.
            DeviceGoneError: it is gone.
            DeviceTimeoutError: it does not answer within `PATIENCE_S`.
        """
        with self._lock:
            if self._socket is None:
                raise self._gone()
            try:
                self._socket.sendall(json.dumps({"do": do, **arguments}).encode() + b"\n")
                line = self._stream.readline(LONGEST)
                if not line.endswith(b"\n"):
                    raise ConnectionError
                answer = dict(json.loads(line))
                if "bytes" in answer:
                    size = int(answer["bytes"])
                    body = self._stream.read(size) if 0 <= size <= LARGEST else b""
                    if len(body) != size:
                        raise ConnectionError
                    answer["body"] = body
            except TimeoutError:
                self.close()
                raise DeviceTimeoutError(self.device, do, PATIENCE_S) from None
            except (OSError, ValueError) as error:
                self.close()
                raise self._gone() from error
        if not answer.get("ok"):
            raise RefusedError(
                str(answer.get("problem")),
                device=self.device,
                field=answer.get("field"),
                remedy=str(answer.get("remedy")),
                code=str(answer.get("code", "")),
            )
        return answer

    def _gone(self) -> DeviceGoneError:
        return DeviceGoneError(
            f"does not answer at {self.path}: its process has ended",
            field=self.device,
            remedy="Start it anew; phoslab resume does.",
        )


class RefusedError(DeviceError):
    """The bench or one of its devices refused; `code` says it in one word."""

    def __init__(self, problem: str, *, device: str, field: str | None, remedy: str, code: str) -> None:
        super().__init__(problem, file=device if field else None, field=field or device, remedy=remedy)
        self.code = code


class BenchClock:
    """The bench's clock, a `Clock`: it flows as real time does, and jumps when a plan sleeps.

    It reads a file that the bench shares, so looking at it costs a microsecond and works from any thread; only
    sleeping asks the bench, which lets all that it simulates happen meanwhile.

    Args:
        folder: of the bench.
        link: to it.
        device_s: says what the rig controller's clock shows, where a driver knows.
    """

    def __init__(self, folder: Path, link: Link, device_s: Callable[[], float | None] | None = None) -> None:
        self._link = link
        self.device_s = device_s or _unknown
        try:
            handle = os.open(folder / TIME_FILE, os.O_RDONLY)
            try:
                self._time = mmap.mmap(handle, TIME.size, access=mmap.ACCESS_READ)
            finally:
                os.close(handle)
        except (OSError, ValueError) as error:
            raise PhoslabError(
                "is not the folder of a simulated bench", file=folder, remedy="Start the bench first."
            ) from error

    def _read(self) -> tuple[float, float]:
        """Simulated time, and the wall clock in s since 1970."""
        while True:
            count, zero, ahead, start, step = TIME.unpack(self._time[:])
            now = time.monotonic() - zero + ahead
            if count % 2 == 0 and self._time[:8] == struct.pack("<Q", count):
                return now, start + now + step

    def mono_s(self) -> float:
        """Simulated seconds since the bench was started."""
        return self._read()[0]

    def wall(self) -> datetime:
        """The simulated moment in UTC; a fault may set it."""
        return _EPOCH + timedelta(seconds=self._read()[1])

    def sleep_until(self, mono_s: float) -> None:
        """Jump there; lamp, door, sample, controller and camera go through all that happens on the way."""
        if mono_s > self.mono_s():
            self._link.ask("sleep_until", mono_s=mono_s)


class Hands:
    """Hands in the simulated dark room: what a person does when a plan asks for it."""

    def __init__(self, link: Link) -> None:
        self._link = link

    def place(
        self,
        *,
        target: str = "sample",
        lvf: str = "none",
        filter_name: str = "none",
        light: str = "lamp",
        angle_deg: float = 0.0,
    ) -> None:
        """Make the bench stand so.

        Args:
            target: what lies under the camera: "sample" (the first piece), "sample 2" ..., "card", "checker",
                "patch:NAME" (one colour of the checker, large), "nothing".
            lvf: "none", "camera" (before it), "sample" (on it).
            filter_name: of a colour filter between light and target (`lighting-filters` has them), or "none".
            light: "lamp" (the rig's, switched by the controller); "led" or "mercury", which are then on.
            angle_deg: by which the target is turned away from the camera.

        Raises:
            DeviceError: there is no such thing.
        """
        self._link.ask(
            "place", target=target, lvf=lvf, filter=filter_name, light=light, angle_deg=float(angle_deg)
        )

    def filters(self) -> list[str]:
        """Return the names of the colour filters that are there."""
        return list(self._link.ask("filters")["filters"])

    def inject(self, fault: str) -> None:
        """Let something go wrong: "camera-busy@12", "stuck-door@90s", or "camera-gone" for now."""
        self._link.ask("inject", fault=fault)

    def repair(self) -> None:
        """Mend what is stuck."""
        self._link.ask("repair")


def _unknown() -> float | None:
    return None
