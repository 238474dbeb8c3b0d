"""What every camera on a cable has in common: readings, a thread for what takes time, frames judged by content.

A driver says how to connect, set, release and fetch; everything that a plan may rely on is here.
"""

from __future__ import annotations

import abc
import contextlib
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from phoslab.instruments.cameras.content import check_raw
from phoslab.instruments.devices import Clock, DeviceError, Exposure, Reading, Status


@dataclass(frozen=True)
class Opened:
    """When a shutter opened.

    Args:
        mono_s: best guess.
        uncertainty_s: by how much it may be off at most.
    """

    mono_s: float
    uncertainty_s: float


class Tethered(abc.ABC):
    """A `Camera` of phoslab.instruments.devices.

    Args:
        name: what messages, journals and readings call it.
        clock: that stamps its readings.
    """

    def __init__(self, name: str, clock: Clock) -> None:
        self._name, self._clock = name, clock
        self._doing = threading.Lock()
        self._exposure: Exposure | None = None
        self._opened: Opened | None = None
        self._exposures = 0
        self._unsaved = False
        self._staged = False
        self._stopped = threading.Event()

    # --- what a driver says -------------------------------------------------------------------

    @property
    @abc.abstractmethod
    def suffix(self) -> str:
        """See Camera, as the two below."""

    @property
    @abc.abstractmethod
    def choices(self) -> dict[str, Sequence[float]]: ...

    @property
    @abc.abstractmethod
    def facts(self) -> dict[str, Any]: ...

    @abc.abstractmethod
    def _connect(self) -> None:
        """Begin anew, and refuse a camera that is not set as it should be."""

    @abc.abstractmethod
    def _disconnect(self) -> None:
        """Let it go; may raise anything."""

    @abc.abstractmethod
    def _apply(self, exposure: Exposure) -> None:
        """Set it."""

    @abc.abstractmethod
    def _release(self, exposure: Exposure | None) -> Opened:
        """Expose once, and return when the frame can be fetched; `_stopped` asks for an early end."""

    @abc.abstractmethod
    def _fetch(self, path: Path) -> None:
        """Write the last frame's bytes to a path, as they come."""

    @abc.abstractmethod
    def _forget(self) -> None:
        """Drop the last frame, which has been saved."""

    # --- what a plan asks ---------------------------------------------------------------------

    @property
    def name(self) -> str:
        """What messages, journals and readings call it."""
        return self._name

    def stage(self) -> list[Any]:
        """Connect anew, and check that the camera is set as it should be."""
        with self._doing:
            self._staged = False
            self._stopped.clear()
            self._connect()
            self._staged, self._unsaved = True, False
        return [self]

    def unstage(self) -> list[Any]:
        """Let it go."""
        self.stop()
        with self._doing:
            with contextlib.suppress(
                Exception
            ):  # it is gone, or lets go badly: either way we are done with it
                self._disconnect()
            self._staged = False
        return [self]

    def stop(self, *, success: bool = False) -> None:
        """Give up the exposure that goes on; what it made is lost."""
        self._stopped.set()

    def set(self, value: Exposure) -> Status:
        """Set time, speed and aperture; a value that cannot be set ends the status with an error."""

        def act() -> None:
            self._check_choices(value)
            self._apply(value)
            self._exposure = value

        return self._start(f"set {value.exposure_s:g} s, ISO {value.iso:g}", act)

    def trigger(self) -> Status:
        """Expose once; the status ends when the frame can be saved. A frame that was not saved is dropped."""
        return self._start("expose", self._expose)

    def save(self, path: Path) -> None:
        """Write the last exposure's RAW file to `path`; see Camera.

        Raises:
            DeviceError: there is none, it is no RAW file, it was made with other settings, or it does not come whole.
        """
        with self._doing:
            if not self._unsaved:
                raise DeviceError("has no frame to save", field=self._name, remedy="Expose first.")
            self._fetch(path)
            check_raw(path, self._name, {} if self._exposure is None else asdict(self._exposure))
            self._forget()
            self._unsaved = False

    def read(self) -> dict[str, Reading]:
        """Return the number of exposures, the settings, and `start` and `start_uncertainty` of the last exposure."""
        self._check_staged()
        now = self._clock.mono_s()
        values: dict[str, tuple[Any, str, float]] = {self._name: (self._exposures, "", now)}
        if self._exposure is not None:
            for name, unit in (("exposure_s", "s"), ("iso", ""), ("f_number", "")):
                value = getattr(self._exposure, name)
                if value is not None:
                    values[name] = (value, unit, now)
        if self._opened is not None:
            values["start"] = (self._opened.mono_s, "s", self._opened.mono_s)
            values["start_uncertainty"] = (self._opened.uncertainty_s, "s", self._opened.mono_s)
        return {name: self._reading(*value) for name, value in values.items()}

    def describe(self) -> dict[str, Any]:
        """Return bluesky's data keys for `read`."""
        return {
            name: {
                "source": f"phoslab:{self._name}",
                "dtype": "integer" if isinstance(reading["value"], int) else "number",
                "shape": [],
                "units": reading["unit"],
            }
            for name, reading in self.read().items()
        }

    # --- how ----------------------------------------------------------------------------------

    def _expose(self) -> None:
        if self._unsaved:
            self._forget()
            self._unsaved = False
        self._stopped.clear()
        self._opened = self._release(self._exposure)
        self._exposures += 1
        self._unsaved = True

    def _start(self, command: str, act: Callable[[], None]) -> Status:
        status = self._status(command)

        def run() -> None:
            try:
                with self._doing:
                    self._check_staged()
                    act()
            except Exception as error:
                status.finish(error)
            else:
                status.finish()

        threading.Thread(target=run, name=f"{self._name}: {command}", daemon=True).start()
        return status

    def _status(self, command: str) -> Status:
        """The kind of status that goes out."""
        return Status(self._name, command)

    def _check_staged(self) -> None:
        if not self._staged:
            raise DeviceError("is not staged", field=self._name, remedy="Stage it first.")

    def _check_choices(self, value: Exposure) -> None:
        for name, known in self.choices.items():
            wanted = getattr(value, name)
            if wanted is None or not known:
                continue
            nearest = min(known, key=lambda choice: abs(choice - wanted))
            if abs(nearest - wanted) > 0.01 * nearest:
                raise DeviceError(
                    f"cannot set {name} to {wanted:g}",
                    field=self._name,
                    remedy=f"The nearest that it offers is {nearest:g}.",
                )

    def _reading(self, value: Any, unit: str, mono_s: float) -> Reading:
        now, device = self._clock.mono_s(), self._clock.device_s()
        return {
            "value": value,
            "unit": unit,
            "timestamp": self._clock.wall().timestamp() - (now - mono_s),
            "mono_s": mono_s,
            "device_s": None if device is None else device - (now - mono_s),
        }

    def _pause(self, seconds: float) -> None:
        """Wait in real time, unless it is stopped.

        Raises:
            DeviceError: it was stopped.
        """
        if self._stopped.wait(seconds):
            raise DeviceError("was stopped", field=self._name, remedy="Expose again.")

    def _patiently(
        self, act: Callable[[], object], busy: Callable[[Exception], bool], patience_s: float
    ) -> None:
        """Do it, and again while the camera says that it is busy, for a while."""
        until = time.monotonic() + patience_s
        while True:
            try:
                act()
                return
            except Exception as error:
                if not busy(error) or time.monotonic() > until:
                    raise
            self._pause(0.1)
