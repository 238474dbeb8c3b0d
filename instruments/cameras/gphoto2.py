"""Cameras that libgphoto2 drives over USB, Canon EOS bodies first: the optional package gphoto2.

    camera = GphotoCamera(SystemClock())
    camera.stage()                          # connects, and refuses autofocus, automatic ISO and JPEG
    camera.set(Exposure(0.5, 400, 2.8)).wait(10)
    camera.trigger().wait(40)
    camera.save(Path("0000.CR2"))

What a body calls its settings differs by maker; `NAMES` lists what is tried. Whether it really makes RAW frames is
judged by a trial frame when it is staged, which is before any plan switches a lamp on.
"""

from __future__ import annotations

import contextlib
import importlib
import re
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from phoslab.errors import PhoslabError
from phoslab.instruments.cameras.content import check_raw, suffix_of
from phoslab.instruments.cameras.tethered import Opened, Tethered
from phoslab.instruments.devices import Clock, DeviceError, DeviceGoneError, DeviceTimeoutError, Exposure

NAMES = {
    "exposure_s": ("shutterspeed", "shutterspeed2"),
    "iso": ("iso",),
    "f_number": ("aperture", "f-number"),
}
"""What makers call a setting, the first that is there counts."""

_BUSY_S = 15.0
"""Time for which a camera that says "PTP Device Busy" is asked again."""

_READ_OUT_S = 30.0
"""From closed shutter to a file on the card, at most: a slow card under a long-exposure noise reduction."""

_SETTLE_S, _TRIAL_SETTLE_S = 0.06, 1.0
"""For which more files of the same exposure are waited for: a JPEG beside the RAW file comes last."""

_GIVEN_UP_S = 5.0
"""From the end of an exposure that was stopped until its file has come."""

_RAW_ALONE = "Set its image quality to RAW alone."

_STORE_FULL = "PTP Event 400a"
"""How libgphoto2 passes on PTP's event StoreFull (0x400A), which it does not know itself."""

# Of gphoto2-result.h and gphoto2-port-result.h.
_NO_MEMORY, _NOT_FOUND, _CLAIM, _BUSY, _NO_SPACE = -3, -105, -53, -110, -115
_GONE = (-7, -10, -31, -34, -35, -52, -105)


class GphotoCamera(Tethered):
    """A `Camera` over libgphoto2.

    Args:
        clock: that stamps its readings.
        name: of the device.
        port: as `gphoto2 --auto-detect` writes it ("usb:001,007"); None: the first camera that answers.
        sensitivities: name of its spectral sensitivities, for session.toml.
        lag_s: from command to open shutter: the body's release lag, and by how much that is uncertain, in s.
        trial: take one frame when it is staged, to see what it delivers.
        library: the gphoto2 module; None: the installed one.

    Raises:
        PhoslabError: gphoto2 is not installed.
    """

    def __init__(
        self,
        clock: Clock,
        name: str = "camera",
        *,
        port: str | None = None,
        sensitivities: str | None = None,
        lag_s: tuple[float, float] = (0.075, 0.05),
        trial: bool = True,
        library: Any = None,
    ) -> None:
        super().__init__(name, clock)
        self._gp = library or _installed()
        self._port, self._sensitivities, self._lag_s, self._trial = port, sensitivities, lag_s, trial
        self._camera: Any = None
        self._choices: dict[str, dict[float, str]] = {}
        self._facts: dict[str, Any] = {}
        self._suffix = "raw"
        self._file: tuple[str, str] | None = None
        self._settle_s = _SETTLE_S
        self._given_up_until = 0.0

    @property
    def suffix(self) -> str:
        """Of its files, by the trial frame's content."""
        return self._suffix

    @property
    def choices(self) -> dict[str, Sequence[float]]:
        """What it offers, once it is staged."""
        return {name: tuple(sorted(known)) for name, known in self._choices.items()}

    @property
    def facts(self) -> dict[str, Any]:
        """Make, model and serial number, once it is staged; the sensitivities' name if that was given."""
        known = {} if self._sensitivities is None else {"sensitivities": self._sensitivities}
        return {**self._facts, **known}

    # --- connection ---------------------------------------------------------------------------

    def _connect(self) -> None:
        self._disconnect()
        self._patiently(self._open, self._is_busy, _BUSY_S)
        for name, alias in (("make", "manufacturer"), ("model", "cameramodel"), ("serial", "serialnumber")):
            value = self._value(alias)
            if value is not None:
                self._facts[name] = str(value)
        self._choices = {name: self._offered(aliases) for name, aliases in NAMES.items()}
        self._check_settings()
        if self._trial:
            self._try()

    def _open(self) -> None:
        camera = self._gp.Camera()
        if self._port is not None:
            ports = self._gp.PortInfoList()
            ports.load()
            self._call(lambda: camera.set_port_info(ports[ports.lookup_path(self._port)]))
        self._call(camera.init)
        self._camera = camera

    def _disconnect(self) -> None:
        camera, self._camera = self._camera, None
        if camera is not None:
            with contextlib.suppress(self._gp.GPhoto2Error):
                camera.exit()

    def _check_settings(self) -> None:
        """Bring the body to where it makes frames that can be measured, or say what a hand has to do."""
        for name in ("exposure_s", "iso"):
            # A body that does not tell its ISO is known by its files; what it tells must not be automatic.
            if self._value(NAMES[name][0]) is not None and not self._choices[name]:
                raise self._refused(f"offers no {name} that could be set", "Turn its dial to M.")
        self._prefer("capturetarget", ("Memory card", "Card", "card"))
        self._prefer("imageformat", ("RAW",))
        self._prefer("imagequality", ("RAW", "NEF (Raw)"))
        self._prefer("autoiso", ("Off",))
        self._prefer("autofocus", ("Off",))
        self._prefer("reviewtime", ("None", "Off"))
        for alias, good, problem, remedy in (
            (
                "focusmode",
                ("manual", "mf"),
                "focuses by itself",
                "Switch lens and body to manual focus (MF).",
            ),
            ("autofocus", ("off",), "focuses by itself", "Switch lens and body to manual focus (MF)."),
            ("autoexposuremode", ("manual", "m"), "exposes by itself", "Turn its dial to M."),
            ("expprogram", ("m", "manual"), "exposes by itself", "Turn its dial to M."),
            ("autoiso", ("off",), "sets the ISO by itself", "Switch automatic ISO off."),
            ("imageformat", ("raw", "craw"), "does not make RAW files alone", _RAW_ALONE),
        ):
            value = self._value(alias)
            if value is not None and str(value).strip().lower() not in good:
                raise self._refused(f"{problem} ({alias} is {value!r})", remedy)

    def _prefer(self, alias: str, wanted: Sequence[str]) -> None:
        """Set what can be set; what cannot is judged afterwards."""
        with contextlib.suppress(DeviceError):
            widget = self._widget(alias)
            if widget is None or widget.get_readonly():
                return
            offered = [str(choice) for choice in widget.get_choices()]
            value = next((name for name in wanted if name in offered), None)
            if value is not None and str(widget.get_value()) != value:
                self._write(alias, value)

    def _try(self) -> None:
        """Take a frame and look at it."""
        import tempfile

        # The shortest exposure: nothing has to be on it.
        shortest = min(self._choices["exposure_s"], default=None)
        if shortest is not None:
            self._write(self._alias("exposure_s"), self._choices["exposure_s"][shortest])
        self._stopped.clear()
        self._settle_s = _TRIAL_SETTLE_S
        self._release(None)
        self._settle_s = _SETTLE_S
        with tempfile.TemporaryDirectory(prefix="phoslab-") as folder:
            path = Path(folder) / "trial"
            self._fetch(path)
            check_raw(path, self._name, {})
            self._suffix = suffix_of(path)
        self._forget()

    # --- settings -----------------------------------------------------------------------------

    def _apply(self, exposure: Exposure) -> None:
        for name in NAMES:
            wanted = getattr(exposure, name)
            if wanted is None or not self._choices[name]:
                continue
            nearest = min(self._choices[name], key=lambda known, wanted=wanted: abs(known - wanted))  # type: ignore[misc]
            alias, text = self._alias(name), self._choices[name][nearest]
            self._patiently(lambda alias=alias, text=text: self._write(alias, text), self._is_busy, _BUSY_S)  # type: ignore[misc]
            if (found := _number(str(self._value(alias)))) is None or abs(found / nearest - 1) > 0.02:
                raise self._refused(
                    f"keeps {name} at {self._value(alias)} where {text} was set", "Turn its dial to M."
                )

    def _offered(self, aliases: Sequence[str]) -> dict[float, str]:
        for alias in aliases:
            widget = self._widget(alias)
            if widget is not None and not widget.get_readonly():
                texts = [str(choice) for choice in widget.get_choices()]
                return {value: text for text in texts if (value := _number(text)) is not None}
        return {}

    def _alias(self, name: str) -> str:
        return next(alias for alias in NAMES[name] if self._widget(alias) is not None)

    def _widget(self, alias: str) -> Any:
        """A setting, None if the body has none of that name."""
        try:
            return self._call(lambda: self._camera.get_single_config(alias))
        except (DeviceGoneError, _BusyError):
            raise
        except DeviceError:
            return None

    def _value(self, alias: str) -> Any:
        widget = self._widget(alias)
        return None if widget is None else widget.get_value()

    def _write(self, alias: str, text: str) -> None:
        widget = self._widget(alias)
        if widget is None:
            raise self._refused(f"has no {alias} any more", "Turn its dial to M.")
        widget.set_value(text)
        self._call(lambda: self._camera.set_single_config(alias, widget))

    # --- frames -------------------------------------------------------------------------------

    def _release(self, exposure: Exposure | None) -> Opened:
        exposure_s = 0.0 if exposure is None else exposure.exposure_s
        try:
            before_s, after_s = self._attempt(exposure_s)
        except _FullError:
            # What was on it has been fetched and deleted: many a body notices only when it is connected anew.
            self._reconnect()
            before_s, after_s = self._attempt(exposure_s)
        lag_s, give_s = self._lag_s
        # The command may have waited on its way; that it returned says that the body had it.
        slack_s = max(0.0, after_s - before_s - lag_s)
        return Opened(before_s + lag_s + slack_s / 2, give_s + slack_s / 2)

    def _attempt(self, exposure_s: float) -> tuple[float, float]:
        """Expose, and return when the body was told so: before and after."""
        self._drain()
        moments: list[float] = []

        def trigger() -> None:
            before_s = self._clock.mono_s()
            self._call(self._camera.trigger_capture)
            moments[:] = [before_s, self._clock.mono_s()]

        self._patiently(trigger, self._is_busy, _BUSY_S)
        self._await_file(exposure_s)
        return moments[0], moments[1]

    def _drain(self) -> None:
        """Take what the queue still holds: it is of an exposure before, perhaps one that was stopped."""
        until = max(self._given_up_until, time.monotonic() + _SETTLE_S)
        while time.monotonic() < until:
            kind, data = self._event(1)
            given_up = time.monotonic() < self._given_up_until
            if kind == self._gp.GP_EVENT_TIMEOUT and not given_up:
                return
            if kind == self._gp.GP_EVENT_FILE_ADDED:
                self._delete((str(data.folder), str(data.name)))
                if not given_up:
                    raise self._refused("made another file after an exposure", _RAW_ALONE)
                until = self._given_up_until = 0.0

    def _event(self, wait_ms: int) -> tuple[int, Any]:
        kind, data = self._call(lambda: self._camera.wait_for_event(wait_ms))
        return kind, data

    def _reconnect(self) -> None:
        self._disconnect()
        self._open()
        if self._exposure is not None:
            self._apply(self._exposure)

    def _await_file(self, exposure_s: float) -> None:
        begin = time.monotonic()
        until = begin + exposure_s + _READ_OUT_S
        files: list[tuple[str, str]] = []
        # Bodies never stop to tell of their properties: what counts is the time, not that they fall silent.
        while (left_s := until - time.monotonic()) > 0:
            if self._stopped.is_set() and not files:
                # No body takes a release back: its file will come, and is not of the next exposure.
                self._given_up_until = begin + exposure_s + _GIVEN_UP_S
            self._pause(0.0)
            kind, data = self._event(max(1, min(200, int(1000 * left_s))))
            if kind == self._gp.GP_EVENT_UNKNOWN and str(data).startswith(_STORE_FULL):
                raise _full(self._name)
            if kind == self._gp.GP_EVENT_FILE_ADDED:
                files.append((str(data.folder), str(data.name)))
                until = time.monotonic() + self._settle_s
        if not files:
            raise DeviceTimeoutError(self._name, "expose", round(time.monotonic() - begin, 1))
        if len(files) > 1:
            for file in files:
                self._delete(file)
            raise self._refused(
                f"makes {len(files)} files for an exposure ({', '.join(name for _, name in files)})",
                _RAW_ALONE,
            )
        self._file = files[0]

    def _fetch(self, path: Path) -> None:
        if self._file is None:
            raise self._refused("has lost the frame", "Expose again.")
        folder, name = self._file
        size = int(self._call(lambda: self._camera.file_get_info(folder, name)).file.size)
        file = self._call(lambda: self._camera.file_get(folder, name, self._gp.GP_FILE_TYPE_NORMAL))
        content = memoryview(file.get_data_and_size())
        path.write_bytes(content)
        if len(content) != size:
            raise self._refused(f"sent {len(content)} of {size} bytes of a frame", "Fetch it again.")

    def _forget(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            self._delete(file)

    def _delete(self, file: tuple[str, str]) -> None:
        # What cannot be deleted stays on the card; that it fills up is said when it does.
        with contextlib.suppress(DeviceError):
            self._call(lambda: self._camera.file_delete(*file))

    # --- errors -------------------------------------------------------------------------------

    def _call(self, act: Callable[[], Any]) -> Any:
        """Call the library, and say its errors in words that help.

        Raises:
            _BusyError: it is busy.
            _FullError: its card is full.
            DeviceGoneError: it is not there.
            DeviceError: anything else.
        """
        try:
            return act()
        except AttributeError:
            if self._camera is not None:
                raise
            raise DeviceGoneError("is not connected", field=self._name, remedy="Stage it first.") from None
        except self._gp.GPhoto2Error as error:
            code, words = int(error.code), str(error.string)
            if code == _BUSY or "busy" in words.lower():
                raise _BusyError(
                    "is busy", field=self._name, remedy="Wait a moment and try again."
                ) from error
            if code in (_NO_SPACE, _NO_MEMORY):
                raise _full(self._name) from error
            if code == _CLAIM:
                raise DeviceGoneError(
                    "is held by another program",
                    field=self._name,
                    remedy="Close what imports photos; on a desktop, gio mount -s gphoto2 lets go of it.",
                ) from error
            if code in _GONE:
                raise DeviceGoneError(
                    f"is not there (libgphoto2 says {words!r})",
                    field=self._name,
                    remedy="Switch it on and plug it in; phoslab doctor lists what is connected.",
                ) from error
            raise DeviceError(
                f"failed: libgphoto2 says {words!r} ({code})",
                field=self._name,
                remedy="Switch it off and on again.",
            ) from error

    def _refused(self, problem: str, remedy: str) -> DeviceError:
        return DeviceError(problem, field=self._name, remedy=remedy)

    @staticmethod
    def _is_busy(error: Exception) -> bool:
        return isinstance(error, _BusyError)


class _BusyError(DeviceError):
    """PTP Device Busy."""


class _FullError(DeviceError):
    """No room for another frame."""


def _full(device: str) -> _FullError:
    return _FullError(
        "has a full card", field=device, remedy="Copy away what is on it and format it in the camera."
    )


def _installed() -> Any:
    try:
        return importlib.import_module("gphoto2")
    except ImportError as error:
        raise PhoslabError(
            "needs the package gphoto2, which is not installed",
            field="camera",
            remedy='Install it: pip install "phoslab[camera]".',
        ) from error


def _number(text: str) -> float | None:
    """The value of a choice: "1/125", "0.3", "0.0100s", "f/2.8", "30"; None for "Auto" or "bulb".

    >>> [_number(text) for text in ("1/4", "0.0100s", "f/2.8", "bulb", "Auto")]
    [0.25, 0.01, 2.8, None, None]
    """
    found = re.fullmatch(r"(?:f/)?(\d+(?:\.\d+)?)(?:/(\d+))?\s*s?", text.strip(), re.IGNORECASE)
    if found is None or float(found[1]) == 0 or found[2] == "0":
        return None
    return float(found[1]) / float(found[2] or 1)
