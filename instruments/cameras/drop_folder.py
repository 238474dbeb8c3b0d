"""A camera whose own software writes the frames into a folder: `phoslab` only has to find them, whole.

    camera = DropFolder(Path("~/captures"), SystemClock(), command=["eos-remote", "--shutter", "{exposure_s}"])

Without a command somebody, or an intervalometer, releases the shutter after `trigger`; what it delivers is first seen
in the trial frame of `phoslab measure`, lamp off. Files that were there before are ignored, and so is what the software
writes beside a RAW file; its files stay where they are.

A frame's own EXIF data say when it was taken, to the second, by a clock that nobody has set to this computer's. That
is worse than what is known here, to some tenths of a second, and is not used.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from phoslab.instruments.cameras.content import check_raw, not_raw, suffix_of
from phoslab.instruments.cameras.tethered import Opened, Tethered
from phoslab.instruments.devices import (
    Clock,
    DeviceError,
    DeviceGoneError,
    DeviceTimeoutError,
    Exposure,
)

_LOOK_S = 0.05
_UNFINISHED = (".tmp", ".part", ".partial", ".crdownload")

_Stamp = tuple[int, int]
"""Size, and the time of the last change in ns."""


class DropFolder(Tethered):
    """A `Camera` that is known by its files only.

    Args:
        folder: where they appear, also in folders below it.
        clock: that stamps its readings.
        name: of the device.
        command: releases the shutter; `{exposure_s}`, `{iso}` and `{f_number}` in it are replaced.
        choices: what can be set by the command, or by hand; empty: nothing.
        facts: make, model, serial and sensitivities, as far as they are known.
        patience_s: for a frame after its exposure.
        settle_s: how long a file must not have changed to be taken for whole.
    """

    def __init__(
        self,
        folder: Path,
        clock: Clock,
        name: str = "camera",
        *,
        command: Sequence[str] = (),
        choices: Mapping[str, Sequence[float]] | None = None,
        facts: Mapping[str, Any] | None = None,
        patience_s: float = 60.0,
        settle_s: float = 0.5,
    ) -> None:
        super().__init__(name, clock)
        self._folder, self._command = folder.expanduser(), tuple(command)
        self._choices = {key: tuple(values) for key, values in (choices or {}).items()}
        self._facts = dict(facts or {})
        self._patience_s, self._settle_s = patience_s, settle_s
        self._known: dict[Path, _Stamp] = {}
        self._suffix = "raw"
        self._file: Path | None = None

    @property
    def suffix(self) -> str:
        """Of the last frame, by its content."""
        return self._suffix

    @property
    def choices(self) -> dict[str, Sequence[float]]:
        """What the command, or a hand, can set."""
        return dict(self._choices)

    @property
    def facts(self) -> dict[str, Any]:
        """What the rig says of it."""
        return dict(self._facts)

    @property
    def by_hand(self) -> bool:
        """Whether nothing here releases the shutter: somebody has to after `trigger`."""
        return not self._command

    def _connect(self) -> None:
        if not self._folder.is_dir() or not os.access(self._folder, os.R_OK | os.X_OK):
            raise DeviceGoneError(
                f"should write into {self._folder}, which is no folder that can be read",
                field=self._name,
                remedy="Make it, or name the one that the camera's software writes into.",
            )
        if self._command and shutil.which(self._command[0]) is None:
            raise DeviceError(
                f"is released by {self._command[0]!r}, which is not there",
                field=self._name,
                remedy="Install it, or correct the command in the rig file.",
            )
        self._known = self._look()
        if self._command:  # see what it delivers, before any lamp is on
            shortest = {key: min(values) for key, values in self._choices.items() if values}
            trial = Exposure(
                shortest.get("exposure_s", 1.0), shortest.get("iso", 100.0), shortest.get("f_number")
            )
            self._stopped.clear()
            self._release(trial)
            self._forget()

    def _disconnect(self) -> None:
        pass

    def _apply(self, exposure: Exposure) -> None:
        pass  # the command does it with the exposure; the frame's own data tell whether it did

    def _release(self, exposure: Exposure | None) -> Opened:
        exposure = exposure or self._exposure or Exposure(1.0, 100.0, None)
        self._known = self._look()  # what has come unasked is not the answer
        began_s = self._clock.mono_s()
        self._run(exposure)
        # A command may return before the exposure is over.
        until = time.monotonic() + exposure.exposure_s + self._patience_s
        path, seen_s = self._await_frame(exposure, until)
        self._file, self._suffix = path, suffix_of(path)
        latest_s = max(began_s, seen_s - exposure.exposure_s)
        return Opened((began_s + latest_s) / 2, (latest_s - began_s) / 2 + _LOOK_S)

    def _run(self, exposure: Exposure) -> None:
        if not self._command:
            return
        values = {key: "" if value is None else f"{value:g}" for key, value in asdict(exposure).items()}
        arguments = [_filled(part, values) for part in self._command]
        try:
            done = subprocess.run(
                arguments,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=exposure.exposure_s + self._patience_s,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise DeviceTimeoutError(self._name, " ".join(arguments), error.timeout) from None
        except OSError as error:
            raise DeviceError(
                f"is released by {arguments[0]!r}, which cannot be run ({error.strerror})",
                field=self._name,
                remedy="Correct the command in the rig file.",
            ) from error
        if done.returncode:
            words = (done.stderr or done.stdout).strip().splitlines()
            raise DeviceError(
                f"was not released: {arguments[0]!r} said {(words or ['nothing'])[-1]!r}",
                field=self._name,
                remedy="Run it by hand until it works.",
            )

    def _await_frame(self, exposure: Exposure, until: float) -> tuple[Path, float]:
        """The one new RAW file, whole, and when it was first seen."""
        first_seen: dict[Path, float] = {}
        stable: dict[Path, tuple[_Stamp, float]] = {}
        judged: dict[Path, _Stamp] = {}
        trouble: DeviceError | None = None
        begin = time.monotonic()
        while time.monotonic() < until:
            self._pause(_LOOK_S)
            for path, stamp in self._look().items():
                if self._known.get(path) == stamp or judged.get(path) == stamp:
                    continue
                first_seen.setdefault(path, self._clock.mono_s())
                if path not in stable or stable[path][0] != stamp:
                    stable[path] = stamp, time.monotonic()
                elif stamp[0] and time.monotonic() - stable[path][1] >= self._settle_s:
                    judged[path] = stamp
                    try:
                        self._judge(path, exposure)
                    except FileNotFoundError:
                        continue  # renamed, or taken away again
                    except DeviceError as error:
                        # Perhaps the software is slow and it grows on; perhaps the RAW file is still to come.
                        trouble = trouble if trouble and isinstance(error, _NoRawError) else error
                        continue
                    return path, first_seen[path]
        if trouble is not None:
            raise trouble
        raise DeviceTimeoutError(
            self._name, f"write a frame into {self._folder}", round(time.monotonic() - begin, 1)
        )

    def _judge(self, path: Path, exposure: Exposure) -> None:
        with path.open("rb") as stream:
            kind = not_raw(stream.read(16))
        if kind is not None:
            raise _NoRawError(
                f"wrote {kind} ({path.name}) and no RAW file",
                field=self._name,
                remedy="Let its software save RAW files.",
            )
        check_raw(path, self._name, {name: getattr(exposure, name) for name in self._choices})

    def _fetch(self, path: Path) -> None:
        if self._file is None:
            raise DeviceError("has lost the frame", field=self._name, remedy="Expose again.")
        try:
            content = self._file.read_bytes()
        except FileNotFoundError as error:
            raise DeviceError(
                f"has no {self._file.name} any more: something took it away",
                field=self._name,
                remedy="Let nothing else use the folder meanwhile.",
            ) from error
        path.write_bytes(content)

    def _forget(self) -> None:
        self._file = None

    def _look(self) -> dict[Path, _Stamp]:
        """What there is now, without what calls itself unfinished."""
        found = {}
        try:
            for folder, _, names in os.walk(self._folder):
                for name in names:
                    path = Path(folder) / name
                    if name.startswith(".") or path.suffix.lower() in _UNFINISHED:
                        continue
                    try:
                        status = path.stat(follow_symlinks=False)
                    except FileNotFoundError:
                        continue
                    found[path] = (status.st_size, status.st_mtime_ns)
        except OSError as error:
            raise DeviceGoneError(
                f"should write into {self._folder}, which cannot be read ({error.strerror})",
                field=self._name,
                remedy="Is its disk still there?",
            ) from error
        return found


class _NoRawError(DeviceError):
    """A picture where a RAW file should be; one may lie beside it."""


def _filled(part: str, values: Mapping[str, str]) -> str:
    """Replace `{exposure_s}` and the like, and leave all other braces alone."""
    for key, value in values.items():
        part = part.replace(f"{{{key}}}", value)
    return part
