"""A stand-in for the gphoto2 module: one Canon body, and what the virtual PTP camera cannot do wrong."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any


class FakeError(Exception):
    """GPhoto2Error."""

    def __init__(self, code: int, string: str) -> None:
        super().__init__(f"[{code}] {string}")
        self.code, self.string = code, string


class FakeWidget:
    """A setting."""

    def __init__(self, value: str, choices: list[str], fixed: bool) -> None:
        self._value, self._choices, self._fixed = value, choices, fixed

    def get_value(self) -> str:
        return self._value

    def set_value(self, value: str) -> None:
        self._value = value

    def get_choices(self) -> list[str]:
        return self._choices

    def get_readonly(self) -> int:
        return int(self._fixed)


class FakeLibrary:
    """The module; its attributes say what goes wrong.

    Args:
        content: of every frame.
    """

    GPhoto2Error = FakeError
    GP_EVENT_UNKNOWN, GP_EVENT_TIMEOUT, GP_EVENT_FILE_ADDED, GP_FILE_TYPE_NORMAL = 0, 1, 2, 1

    def __init__(self, content: bytes) -> None:
        self.content = content
        self.values = {
            "manufacturer": "Canon Inc.",
            "cameramodel": "Canon EOS 5D Mark II",
            "serialnumber": "0123456789",
            "shutterspeed": "1/60",
            "iso": "100",
            "aperture": "2.8",
            "capturetarget": "Internal RAM",
            "imageformat": "Large Fine JPEG",
            "focusmode": "Manual",
            "autoexposuremode": "Manual",
        }
        self.choices = {
            "shutterspeed": ["bulb", "1", "0.5", "1/8", "1/60"],
            "iso": ["Auto", "100", "200", "400"],
            "aperture": ["2.8", "4", "5.6"],
            "capturetarget": ["Internal RAM", "Memory card"],
            "imageformat": ["Large Fine JPEG", "RAW", "RAW + Large Fine JPEG"],
        }
        self.fixed = {"manufacturer", "cameramodel", "serialnumber", "focusmode", "autoexposuremode"}
        self.stubborn: set[str] = set()
        self.card: dict[str, bytes] = {}
        self.events: list[tuple[float, str]] = []
        self.captures = self.connections = self.busy = self.cut = 0
        self.files_a_capture = 1
        self.delay_s = 0.0
        self.full = self.unplugged = self.claimed = False

    def Camera(self) -> FakeCamera:  # noqa: N802 (the module's own name)
        return FakeCamera(self)


class FakeCamera:
    """gphoto2.Camera."""

    def __init__(self, library: FakeLibrary) -> None:
        self._library = library

    def _answer(self, *, may_be_busy: bool = True) -> None:
        if self._library.unplugged:
            raise FakeError(-52, "Could not find the requested device on the USB port")
        if may_be_busy and self._library.busy:
            self._library.busy -= 1
            raise FakeError(-110, "I/O in progress" if self._library.busy % 2 else "PTP Device Busy")

    def init(self) -> None:
        if self._library.claimed:
            raise FakeError(-53, "Could not claim the USB device")
        self._answer()
        self._library.connections += 1

    def exit(self) -> None:
        self._answer()

    def get_single_config(self, name: str) -> FakeWidget:
        self._answer(may_be_busy=False)
        if name not in self._library.values:
            raise FakeError(-2, "Bad parameters")
        library = self._library
        return FakeWidget(library.values[name], library.choices.get(name, []), name in library.fixed)

    def set_single_config(self, name: str, widget: FakeWidget) -> None:
        self._answer()
        if name not in self._library.stubborn:
            self._library.values[name] = widget.get_value()

    def trigger_capture(self) -> None:
        self._answer()
        library = self._library
        if library.full:
            raise FakeError(-115, "Not enough free space")
        library.captures += 1
        for k in range(library.files_a_capture):
            name = f"IMG_{library.captures:04d}.{('CR2', 'JPG')[k]}"
            library.card[name] = library.content
            library.events.append((time.monotonic() + library.delay_s, name))

    def wait_for_event(self, timeout_ms: int) -> tuple[int, Any]:
        self._answer(may_be_busy=False)
        until = time.monotonic() + timeout_ms / 1000
        while time.monotonic() < until:
            for event in self._library.events:
                if event[0] <= time.monotonic():
                    self._library.events.remove(event)
                    return FakeLibrary.GP_EVENT_FILE_ADDED, SimpleNamespace(folder="/card", name=event[1])
            time.sleep(0.001)
        return FakeLibrary.GP_EVENT_TIMEOUT, None

    def file_get_info(self, folder: str, name: str) -> Any:
        self._answer(may_be_busy=False)
        return SimpleNamespace(file=SimpleNamespace(size=len(self._library.card[name])))

    def file_get(self, folder: str, name: str, kind: int) -> Any:
        self._answer(may_be_busy=False)
        content = self._library.card[name]
        if self._library.cut:
            self._library.cut -= 1
            content = content[: len(content) // 2]
        return SimpleNamespace(get_data_and_size=lambda: content)

    def file_delete(self, folder: str, name: str) -> None:
        self._answer(may_be_busy=False)
        del self._library.card[name]
