"""The one writer of sessions: header, journal and frames, each on disk before the next step.

    with Recorder(folder, header, SystemClock()) as recorder:
        command = recorder.command("lamp", "set", {"to": "off"})
        ...                                             # tell the lamp, hear its answer
        recorder.ack(command, ok=True, reply="OK")
        recorder.edge("lamp", "off", at_mono_s=t)
        recorder.frame(camera.save, suffix="dng", role="decay", at_mono_s=t, exposure_s=0.5, iso=100, f_number=2.8)

Leaving the block closes the session: `complete`, or `interrupted` if an exception went through. `Recorder.resume` goes
on with one that was interrupted, or whose writer died. As long as a recorder is open no other can be, in any process.
phoslab.session reads what this writes; docs/formats-session.md describes it.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from types import TracebackType
from typing import Any, TypeVar

import tomli_w

from phoslab import journal, schemas
from phoslab.errors import PhoslabError
from phoslab.files import sha256, umask, write_text
from phoslab.instruments.devices import Clock, DeviceError
from phoslab.instruments.session_folder import check_free, lock, sweep
from phoslab.session import SCHEMA, Session

T = TypeVar("T")


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
        self._prepare(Path(path), clock)
        whole = {"schema": SCHEMA, "started": _rfc3339(clock.wall()), **header}
        schemas.check(whole, "session-1", file=self.path / "session.toml")
        check_free(self.path)
        try:
            self._create(whole)
        except OSError as error:
            raise PhoslabError(
                f"cannot be created ({error.strerror})",
                file=self.path,
                remedy="Choose a folder that you may write to.",
            ) from error

    @classmethod
    def resume(cls, path: str | os.PathLike[str], clock: Clock, *, reason: str = "resumed") -> Recorder:
        """Go on with a session that was interrupted, or whose writer died; see docs/formats-session.md.

        Half a last line is cut off, files that no line names are moved to `unlisted/`, and the session's monotonic
        time goes on from its last line by as much as the wall clock says has passed.

        Raises:
            PhoslabError: it is complete, damaged, in use by another process, or no session.
        """
        recorder = cls.__new__(cls)
        recorder._prepare(Path(path), clock)
        lines = recorder.path / "journal.jsonl"
        try:
            # Locked before it is read: until then its writer may live.
            recorder._journal = os.open(lines, os.O_RDWR | os.O_APPEND | os.O_NOFOLLOW)
            lock(recorder._journal, recorder.path)
        except OSError as error:
            raise PhoslabError(
                f"cannot be opened ({error.strerror})",
                file=lines,
                remedy="Name the folder of a session that you may write to.",
            ) from error
        try:
            recorder._continue(reason)
        except BaseException:
            recorder.abandon()
            raise
        return recorder

    def _prepare(self, path: Path, clock: Clock) -> None:
        self.path = path
        self._frames = path / "frames"
        self._clock = clock
        self._journal: int | None = None
        self._seq = 0
        self._n_frames = 0  # the number of the next one
        self._n_kept = 0
        self._offset_s = 0.0
        self._deviations_s: list[float] = []

    def _create(self, header: Mapping[str, Any]) -> None:
        """Write the beginning under another name and rename it: a session is whole, with its first line, or absent."""
        target = self.path
        target.parent.mkdir(parents=True, exist_ok=True)
        sweep(target)
        building = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
        try:
            building.chmod(0o777 & ~umask())
            self.path, self._frames = building, building / "frames"
            self._frames.mkdir()
            write_text(building / "session.toml", tomli_w.dumps(header))
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND
            self._journal = os.open(building / "journal.jsonl", flags, 0o666)
            lock(self._journal, target)
            self.path, self._frames = target, target / "frames"
            self._write("begin", {"schema": journal.SCHEMA})
            _sync_folder(building)
            building.rename(target)  # onto an empty folder, too, but never onto one that holds something
            _sync_folder(target.parent)
        except BaseException:
            self.abandon()
            shutil.rmtree(building, ignore_errors=True)
            if os.path.lexists(target):
                check_free(target)
            raise

    def _continue(self, reason: str) -> None:
        assert self._journal is not None
        lines = self.path / "journal.jsonl"
        content = lines.read_bytes()
        whole = content.rfind(b"\n") + 1
        session = Session.open(self.path)
        if session.complete:
            raise PhoslabError(
                "is complete",
                file=self.path,
                remedy="There is nothing to resume; measure into a new folder.",
            )
        notes = [reason]
        if whole < len(content):
            os.ftruncate(self._journal, whole)
            notes.append(f"{len(content) - whole} bytes of a half-written line were cut off")
        notes += self._put_aside({frame.name for frame in session.frames})
        last = session.events[-1]
        passed_s = (self._clock.wall() - datetime.fromisoformat(last.wall)).total_seconds()
        self._offset_s = last.mono_s + max(0.0, passed_s) - self._clock.mono_s()
        self._seq = last.seq + 1
        self._n_kept = len(session.frames)
        self._n_frames = 1 + max((int(Path(frame.name).stem) for frame in session.frames), default=-1)
        self._deviations_s = [
            e.fields["at_mono_s"] - e.fields["planned_mono_s"]
            for e in session.events
            if "planned_mono_s" in e.fields
        ]
        self._write("resume", {"reason": "; ".join(notes)})

    def _put_aside(self, known: set[str]) -> list[str]:
        """Move what the journal does not name out of frames/, keeping it; say what was moved.

        A crash between saving a frame and writing its line leaves a whole frame, one while saving it a part.
        """
        extra = sorted(p.name for p in self._frames.iterdir() if p.name not in known)
        aside = self.path / "unlisted"
        for name in extra:
            aside.mkdir(exist_ok=True)
            target = aside / name
            n = 1
            while os.path.lexists(target):
                target = aside / f"{Path(name).stem}-{n}{Path(name).suffix}"
                n += 1
            (self._frames / name).rename(target)
        if extra:
            _sync_folder(aside)
            _sync_folder(self._frames)
        return [f"{name} has no line and was moved to unlisted/" for name in extra]

    def mono_s(self) -> float:
        """Now, in s of the session's monotonic clock, which goes on where an interruption left it."""
        return self._clock.mono_s() + self._offset_s

    @property
    def offset_s(self) -> float:
        """What to add to the clock's `mono_s` for the session's; the times that methods take are the session's."""
        return self._offset_s

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

    def answered(self, command: int, act: Callable[[], T]) -> T:
        """Do what `command` says and return what comes of it; a device's failure is acknowledged before it goes on."""
        try:
            return act()
        except DeviceError as error:
            self.ack(command, ok=False, reply=str(error))
            raise

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
        planned_mono_s: float | None = None,
        start_uncertainty_s: float | None = None,
        suffix: str = "dng",
    ) -> str:
        """Save one exposure and write its line; return its name in frames/.

        The line is written once the frame is whole on disk: a journal never names what is not there.

        Args:
            source: a file to move in, or a function that writes the frame to the path it is given.
            role: dark, flat, mercury, led, filter:NAME, lamp, emission, decay or excitation.
            at_mono_s, at_device_s: when the shutter opened.
            exposure_s, iso, f_number: the settings; None for a lens that does not report its aperture.
            planned_mono_s: when it should have opened; None if no moment was planned.
            start_uncertainty_s: by how much `at_mono_s` may be off; None if nobody knows.
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
        if planned_mono_s is not None:
            line["planned_mono_s"] = _us(planned_mono_s)
        if start_uncertainty_s is not None:
            line["start_uncertainty_s"] = _us(start_uncertainty_s)
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
        self._n_kept += 1
        if planned_mono_s is not None:
            self._deviations_s.append(at_mono_s - planned_mono_s)
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

    @property
    def summary(self) -> dict[str, Any]:
        """What the session has come to: frames, and how far their exposures began from the planned instants."""
        late_s = self._deviations_s
        return {
            "frames": self._n_kept,
            "planned": len(late_s),
            "deviation_median_s": _us(median(map(abs, late_s))) if late_s else None,
            "deviation_worst_s": _us(max(late_s, key=abs)) if late_s else None,
        }

    def close(self, reason: str) -> None:
        """Write the last line, `complete` or `interrupted`, and how planned instants were met; twice is harmless."""
        if self._journal is None:
            return
        try:
            timed = {"summary": self.summary} if self._deviations_s else {}
            self._write("end", {"reason": reason, **timed})
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Let the session go without a last line, as a crash would."""
        if self._journal is not None:
            os.close(self._journal)  # which unlocks it
            self._journal = None

    def _checked(self, event: str, fields: Mapping[str, Any]) -> dict[str, Any]:
        line = {
            "seq": self._seq,
            "mono_s": _us(self.mono_s()),
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
