"""What a plan may ask of the rig: lamp, door, camera and clock, whoever made them.

The verbs are those of ophyd and bluesky, so that a bluesky lab can drive the same rig: `stage` makes a device ready,
`set` and `trigger` start something and return a `Status` to wait for, `read` tells what is and since when, `stop` ends
whatever goes on, `unstage` leaves the device safe. Nothing here blocks but `Status.wait`, `Clock.sleep_until` and
`Camera.save`.

Times are in s: `mono_s` of the host's monotonic clock, `device_s` of the rig controller's own, `timestamp` of the wall
clock since 1970, which bluesky keeps.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Literal, Protocol, TypedDict, runtime_checkable

from phoslab.errors import PhoslabError


class DeviceError(PhoslabError):
    """A device refused, failed, or said something that it should not."""


class DeviceGoneError(DeviceError):
    """A device is no longer there: unplugged, switched off, or taken by another program."""


class AlarmError(DeviceError):
    """Something is dangerous (a lamp that shines although it is off), or not to be mended from here: stop all."""


class DeviceTimeoutError(DeviceError):
    """A device did not answer, or did not do what it was told, in time."""

    def __init__(self, device: str, command: str, waited_s: float) -> None:
        super().__init__(
            f"did not do {command!r} within {waited_s:g} s",
            field=device,
            remedy="Check its power and cable; phoslab doctor lists what is connected.",
        )


class Reading(TypedDict):
    """A value with its unit ("" where it has none), and when it came to be so on each clock."""

    value: Any
    unit: str
    timestamp: float
    mono_s: float
    device_s: float | None


class Status:
    """Something that goes on, and how it ends; thread-safe, and what bluesky calls a Status.

    Args:
        device: the device's name, for messages.
        command: what it was told.
    """

    def __init__(self, device: str, command: str) -> None:
        self.device, self.command = device, command
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._error: Exception | None = None
        self._callbacks: list[Callable[[Status], None]] = []

    @property
    def done(self) -> bool:
        """Whether it has ended, well or not."""
        return self._ended.is_set()

    @property
    def success(self) -> bool:
        """Whether it has ended well."""
        return self.done and self._error is None

    def exception(self, timeout: float | None = 0.0) -> Exception | None:
        """Return what went wrong, None if nothing did; wait for the end at most `timeout` s."""
        self._ended.wait(timeout)
        return self._error

    def add_callback(self, callback: Callable[[Status], None]) -> None:
        """Call `callback` with this status at its end, or now if it has ended."""
        with self._lock:
            if not self.done:
                self._callbacks.append(callback)
                return
        callback(self)

    def finish(self, error: Exception | None = None) -> None:
        """End it, once; later calls change nothing."""
        with self._lock:
            if self.done:
                return
            self._error = error
            self._ended.set()
            callbacks, self._callbacks = self._callbacks, []
        for callback in callbacks:
            callback(self)

    def wait(self, timeout: float | None = None) -> None:
        """Wait for the end.

        Raises:
            DeviceTimeoutError: it did not come within `timeout` s; the message names device, command and time.
            Exception: what went wrong.
        """
        if not self._ended.wait(timeout):
            raise DeviceTimeoutError(self.device, self.command, timeout or 0.0)
        if self._error is not None:
            raise self._error


@dataclass(frozen=True)
class Exposure:
    """Settings of a camera.

    Args:
        exposure_s: how long the shutter is open, as the camera names it.
        iso: speed.
        f_number: aperture; None where the lens has none that the camera could set.
    """

    exposure_s: float
    iso: float
    f_number: float | None


@runtime_checkable
class Device(Protocol):
    """What every device can do. What goes wrong between calls is raised by the next ones, until it is staged again."""

    @property
    def name(self) -> str:
        """What messages, journals and readings call it."""

    def stage(self) -> list[Any]:
        """Make it ready: connect, check that it is what it should be, bring it to a safe state."""

    def unstage(self) -> list[Any]:
        """Leave it safe and let it go; harmless when it is not staged, and never raises for a device that is gone."""

    def stop(self, *, success: bool = False) -> None:
        """End at once whatever goes on, safely; may be called from another thread, and at any moment."""

    def read(self) -> dict[str, Reading]:
        """Return its readings by name; the first has the device's own name."""

    def describe(self) -> dict[str, Any]:
        """Return what `read` gives: source, dtype, shape and units by name (bluesky's data keys)."""


@runtime_checkable
class Lamp(Device, Protocol):
    """A lamp. Its reading is "on" or "off" since the edge that made it so."""

    @property
    def failsafe(self) -> bool:
        """Whether the lamp goes out by itself when this host dies, hangs, or lets `allow_until` pass."""

    def set(self, value: Literal["on", "off"]) -> Status:
        """Switch it; the status ends when it is known to be switched."""

    def allow_until(self, mono_s: float) -> None:
        """Promise to be back by then: the lamp is kept on until that moment and no longer.

        A plan renews it step by step; one that hangs lets it pass, and the lamp goes out. So promise some seconds
        more than the step takes. Without any, switching on promises 10 s.
        """


@runtime_checkable
class Door(Device, Protocol):
    """The trapdoor between sample and camera. Its reading is "open", "closed" or "between" since it became so."""

    def set(self, value: Literal["open", "closed"]) -> Status:
        """Move it; the status ends when it has arrived."""


@runtime_checkable
class Camera(Device, Protocol):
    """A camera. Its readings are its settings, and the last exposure's `start` in s with its uncertainty in s."""

    @property
    def suffix(self) -> str:
        """Of the RAW files that it makes: "CR2", "NEF", "dng"."""

    @property
    def choices(self) -> dict[str, Sequence[float]]:
        """Ascending values of `exposure_s`, `iso` and `f_number` that can be set; what cannot be set has none."""

    @property
    def facts(self) -> dict[str, Any]:
        """make, model, serial and sensitivities as session.toml has them, as far as they are known."""

    def set(self, value: Exposure) -> Status:
        """Set time, speed and aperture."""

    def trigger(self) -> Status:
        """Expose once; the status ends when the shutter has closed and the frame can be saved."""

    def save(self, path: Path) -> None:
        """Write the last exposure's RAW file to `path`, whole, and only then forget it; may be called again until then.

        Raises:
            DeviceError: there is none, it is no RAW file, or it does not come whole.
        """


@runtime_checkable
class Clock(Protocol):
    """The clocks that stamp a journal line, and waiting."""

    def mono_s(self) -> float:
        """Seconds of a clock that never goes back."""

    def device_s(self) -> float | None:
        """Seconds of the rig controller's own clock now, or None if there is none."""

    def wall(self) -> datetime:
        """The moment in UTC, which may jump when somebody sets the clock."""

    def sleep_until(self, mono_s: float) -> None:
        """Wait for a moment of `mono_s`; return at once if it has passed."""
