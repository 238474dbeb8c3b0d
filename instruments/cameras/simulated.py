"""The bench's camera, over the bench's socket: it behaves as a camera on a cable does.

camera = SimulatedCamera(Link(bench.socket, "camera"), clock)
camera.stage()
camera.set(Exposure(0.5, 100, 2.8)).wait(10)
camera.trigger().wait(40)
camera.save(Path("0000.dng"))
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from phoslab.instruments.cameras.tethered import Opened, Tethered
from phoslab.instruments.devices import DeviceError, DeviceGoneError, Exposure, Status
from phoslab.instruments.simulated import BenchClock, Link, RefusedError

_BUSY_S = 10.0
"""Real time for which a busy camera is asked again."""

_POLL_S = 0.003
"""Real time between two questions whether the shutter has opened."""


class SimulatedCamera(Tethered):
    """A `Camera` on the simulated bench.

    Args:
        link: to the bench, for this camera alone.
        clock: of the bench.
        name: of the device.
    """

    def __init__(self, link: Link, clock: BenchClock, name: str = "camera") -> None:
        super().__init__(name, clock)
        self._link, self.bench_clock = link, clock
        self._connection = 0
        self._released = threading.Event()
        self._number = 0
        self.ready_s: float | None = None  # when what goes on will be over, once that is known
        self._offers: dict[str, Any] = {}

    @property
    def suffix(self) -> str:
        """Of its files."""
        return "dng"

    @property
    def choices(self) -> dict[str, Sequence[float]]:
        """Third stops, as its dial names them; known once it is staged."""
        return {name: tuple(values) for name, values in self._offers.get("choices", {}).items()}

    @property
    def facts(self) -> dict[str, Any]:
        """Make, model, serial number, and the name of its sensitivities; known once it is staged."""
        return {
            name: self._offers[name]
            for name in ("make", "model", "serial", "sensitivities")
            if name in self._offers
        }

    def _connect(self) -> None:
        self._offers = self._ask("connect")
        self._connection = int(self._offers["connection"])

    def _disconnect(self) -> None:
        pass  # the link stays: staging begins a new conversation on it

    def _apply(self, exposure: Exposure) -> None:
        f_number = exposure.f_number if exposure.f_number is not None else self.choices["f_number"][0]
        dials = {"exposure_s": exposure.exposure_s, "iso": exposure.iso, "f_number": f_number}
        self._patiently(lambda: self._ask("set", **dials), _busy, _BUSY_S)

    def trigger(self) -> Status:
        """See Tethered; it returns when the bench has been told, so that a clock that jumps then jumps after it."""
        self._released.clear()
        status = super().trigger()
        while not status.done and not self._released.wait(_POLL_S):
            pass
        return status

    def _release(self, exposure: Exposure | None) -> Opened:
        shot: dict[str, Any] = {}

        def release() -> None:
            shot["asked_s"] = self._clock.mono_s()
            try:
                shot.update(self._ask("expose"))
            except RefusedError as error:
                if error.code != "full":
                    raise
                # A card that has been emptied may look full until the camera is connected anew.
                self._connect()
                shot.update(self._ask("expose"))

        self._patiently(release, _busy, _BUSY_S)
        self._number = int(shot["number"])
        self._released.set()
        try:
            return self._watch(float(shot["asked_s"]))
        except DeviceError:
            with contextlib.suppress(DeviceError):
                self._ask("abort")
            raise

    def _watch(self, not_before_s: float) -> Opened:
        """See the shutter open, and wait until the frame is there."""
        while True:
            asked_s = self._clock.mono_s()
            state = self._ask("phase", number=self._number)
            if state["phase"] != "lag":
                break
            not_before_s = asked_s
            self._pause(_POLL_S)
        not_after_s = float(
            state["now_s"]
        )  # not this side's: the clock may jump while the answer is on its way
        self.ready_s = float(state["ready_s"])
        while state["phase"] != "ready":
            self._pause(_POLL_S)
            state = self._ask("phase", number=self._number)
        return Opened((not_before_s + not_after_s) / 2, (not_after_s - not_before_s) / 2)

    def _fetch(self, path: Path) -> None:
        answer = self._ask("download", number=self._number)
        path.write_bytes(answer["body"])
        if len(answer["body"]) != answer["size"]:
            raise DeviceError(
                f"sent {len(answer['body'])} of {answer['size']} bytes of a frame",
                field=self._name,
                remedy="Fetch it again.",
            )

    def _forget(self) -> None:
        self._ask("delete", number=self._number)

    def _status(self, command: str) -> Status:
        if command != "expose":
            return super()._status(command)
        self.ready_s = None
        return _Jumping(self._name, command, self)

    def _ask(self, do: str, **arguments: Any) -> dict[str, Any]:
        try:
            return self._link.ask(do, connection=self._connection, **arguments)
        except RefusedError as error:
            if error.code == "gone":
                raise DeviceGoneError(error.problem, field=self._name, remedy=error.remedy) from error
            raise


def _busy(error: Exception) -> bool:
    return isinstance(error, RefusedError) and error.code == "busy"


class _Jumping(Status):
    """A status whose waiting lets simulated time jump: who waits has nothing else to do."""

    def __init__(self, device: str, command: str, camera: SimulatedCamera) -> None:
        super().__init__(device, command)
        self._camera = camera

    def exception(self, timeout: float | None = 0.0) -> Exception | None:
        """As a Status."""
        self._jump(timeout)
        return super().exception(timeout)

    def wait(self, timeout: float | None = None) -> None:
        """As a Status."""
        self._jump(timeout)
        super().wait(timeout)

    def _jump(self, timeout: float | None) -> None:
        until = time.monotonic() + (math.inf if timeout is None else timeout)
        while not self.done and time.monotonic() < until:
            ready_s = self._camera.ready_s
            if ready_s is not None:
                self._camera.bench_clock.sleep_until(ready_s)
                return
            self._ended.wait(_POLL_S)
