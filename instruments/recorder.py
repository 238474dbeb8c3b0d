"""The one writer of sessions: header, journal and frames, each on disk before the next step.

    with Recorder(folder, header, SystemClock()) as recorder:
        command = recorder.command("lamp", "set", {"to": "off"})
        ...                                             # tell the lamp, hear its answer
        recorder.ack(command, ok=True, reply="OK")
        recorder.edge("lamp", "off", at_mono_s=t)
        recorder.frame(camera.save, suffix="dng", role="decay", at_mono_s=t, exposure_s=0.5, iso=100, f_number=2.8)

Leaving the block closes the session: `complete`, or `interrupted` if an exception went through.
phoslab.session reads what this writes; docs/formats-session.md describes it.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

import tomli_w

from phoslab import journal, schemas
from phoslab.errors import PhoslabError
from phoslab.files import sha256, write_text
from phoslab.instruments.devices import Clock
from phoslab.session import SCHEMA


class SystemClock:
    """This computer's clocks, with no rig controller."""

    def mono_s(self) -> float:
        """Seconds since the computer started, by the clock that nobody can set."""
        return time.monotonic()

    def device_s(self) -> float | None:
        """None: there is no controller."""
        return None

    def wall(self) -> datetime:
        """Now, in UTC."""
        return datetime.now(UTC)

    def sleep_until(self, mono_s: float) -> None:
        """Sleep until `time.monotonic()` says so."""
        time.sleep(max(0.0, mono_s - time.monotonic()))


class Recorder:
    """Creates one session folder and writes it to the end; a context manager.

    Args:
        path: the folder; it must not exist, or be empty.
        header: session.toml without `schema` and `started`, which are added; see session-1.schema.json.
        clock: stamps every line.

    Raises:
        PhoslabError: the folder holds something, the header does not fit the schema, or the disk refuses.
            Every method raises it for a line that does not fit journal-1.schema.json: what the reader would
            refuse is never written.
    """

    def __init__(self, path: str | os.PathLike[str], header: Mapping[str, Any], clock: Clock) -> None:
        self.path = Path(path)
        self._clock = clock
        self._seq = 0
        self._n_frames = 0
        whole = {"schema": SCHEMA, "started": _rfc3339(clock.wall()), **header}
        schemas.check(whole, "session-1", file=self.path / "session.toml")
        try:
            if self.path.is_symlink() or (
                self.path.exists() and (not self.path.is_dir() or any(self.path.iterdir()))
            ):
                raise PhoslabError(
                    "already exists",
                    file=self.path,
                    remedy="Name a new folder: a session is never overwritten.",
                )
            self._frames = self.path / "frames"
            self._frames.mkdir(parents=True)
            write_text(self.path / "session.toml", tomli_w.dumps(whole))
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND
            self._journal: int | None = os.open(self.path / "journal.jsonl", flags, 0o666)
            _sync_folder(self.path)
        except OSError as error:
            raise PhoslabError(
                f"cannot be created ({error.strerror})",
                file=self.path,
                remedy="Choose a folder that you may write to.",
            ) from error
        self._write("begin", {"schema": journal.SCHEMA})

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        if kind is None:
            self.close("complete")
            return
        # What went wrong matters more than that the journal could not be closed (a full disk is both).
        with contextlib.suppress(PhoslabError):
            self.close("interrupted")

    def command(self, device: str, name: str, arguments: Mapping[str, Any]) -> int:
        """Write what a device is about to be told; return the line's number for `ack`."""
        return self._write("command", {"device": device, "name": name, "arguments": dict(arguments)})

    def ack(self, command: int, *, ok: bool, reply: Any = None) -> None:
        """Write what the device answered to `command`."""
        self._write("ack", {"command": command, "ok": ok, "reply": reply})

    def edge(self, device: str, to: str, *, at_mono_s: float, at_device_s: float | None = None) -> None:
        """Write that the lamp went on or off, or the door open or closed, and when (on both clocks)."""
        self._write(
            "edge", {"device": device, "to": to, "at_mono_s": _us(at_mono_s), "at_device_s": _us(at_device_s)}
        )

    def note(self, text: str) -> None:
        """Write a remark for people."""
        self._write("note", {"text": text})

    def frame(
        self,
        source: Path | Callable[[Path], object],
        *,
        role: str,
        at_mono_s: float,
        exposure_s: float,
        iso: float,
        f_number: float | None,
        at_device_s: float | None = None,
        suffix: str = "dng",
    ) -> str:
        """Save one exposure and write its line; return its name in frames/.

        The line is written once the frame is whole on disk: a journal never names what is not there.

        Args:
            source: a file to move in, or a function that writes the frame to the path it is given.
            role: dark, flat, mercury, led, filter:NAME, lamp, emission, decay or excitation.
            at_mono_s, at_device_s: when the shutter opened.
            exposure_s, iso, f_number: the settings; None for a lens that does not report its aperture.
            suffix: of the name: what the camera writes (dng, CR2, NEF).
        """
        name = f"{self._n_frames:04d}.{suffix}"
        target = self._frames / name
        line = {
            "frame": name,
            "role": role,
            "at_mono_s": _us(at_mono_s),
            "at_device_s": _us(at_device_s),
            "exposure_s": exposure_s,
            "iso": iso,
            "f_number": f_number,
            "sha256": "0" * 64,
            "bytes": 0,
        }
        self._checked("exposure", line)  # before a file lies there that no line will name
        if target.exists():
            raise PhoslabError(
                "already exists", file=target, remedy="Something else writes into this session: stop it."
            )
        # Not files.replacing: a device's timeout is an OSError too, and must not be taken for the disk's.
        temporary = target.with_name(f".{target.stem}-part{target.suffix}")
        try:
            if callable(source):
                source(temporary)
            else:
                shutil.copyfile(source, temporary)
            line |= self._keep(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)
        self._n_frames += 1
        self._write("exposure", line)
        if isinstance(source, Path):
            source.unlink()  # last: until here a crash loses nothing
        return name

    def _keep(self, temporary: Path, target: Path) -> dict[str, Any]:
        """Give a whole frame its name, once it is on disk; return its checksum and size."""
        try:
            with temporary.open("rb") as written:
                os.fsync(written.fileno())
            facts = {"sha256": sha256(temporary), "bytes": temporary.stat().st_size}
            temporary.replace(target)
            _sync_folder(self._frames)
        except OSError as error:
            raise PhoslabError(
                f"could not be written ({error.strerror})",
                file=target,
                remedy="Check the disk and its free space.",
            ) from error
        return facts

    def close(self, reason: str) -> None:
        """Write the last line, `complete` or `interrupted`; closing twice is harmless."""
        if self._journal is None:
            return
        try:
            self._write("end", {"reason": reason})
        finally:
            os.close(self._journal)
            self._journal = None

    def _checked(self, event: str, fields: Mapping[str, Any]) -> dict[str, Any]:
        line = {
            "seq": self._seq,
            "mono_s": _us(self._clock.mono_s()),
            "device_s": _us(self._clock.device_s()),
            "wall": _rfc3339(self._clock.wall()),
            "event": event,
            **fields,
        }
        schemas.check(line, "journal-1", file=self.path / "journal.jsonl", where=f"line {self._seq + 1}: ")
        return line

    def _write(self, event: str, fields: Mapping[str, Any]) -> int:
        """Append one line and wait until it is on disk."""
        path = self.path / "journal.jsonl"
        if self._journal is None:
            raise PhoslabError("is closed", file=path, remedy="Record a new session.")
        text = json.dumps(self._checked(event, fields), ensure_ascii=False, allow_nan=False) + "\n"
        before = os.fstat(self._journal).st_size
        try:
            rest = memoryview(text.encode())
            while rest:
                rest = rest[os.write(self._journal, rest) :]
            os.fsync(self._journal)
        except OSError as error:
            # Half a line in the middle would spoil all that follow it.
            with contextlib.suppress(OSError):
                os.ftruncate(self._journal, before)
            raise PhoslabError(
                f"could not be written ({error.strerror})",
                file=path,
                remedy="Check the disk and its free space.",
            ) from error
        self._seq += 1
        return self._seq - 1


def _us(seconds: float | None) -> float | None:
    """A time to the microsecond: no clock here is better."""
    return None if seconds is None else round(seconds, 6)


def _rfc3339(moment: datetime) -> str:
    return moment.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _sync_folder(folder: Path) -> None:
    """Make new names in a folder survive a power cut, where the file system can."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):
            os.fsync(handle)
    finally:
        os.close(handle)
