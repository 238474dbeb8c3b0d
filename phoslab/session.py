"""Recorded sessions: the folder that one measurement plan leaves, read and checked.

Nothing in a session is trusted. Names stay inside the folder, every frame is compared with the
checksum in the journal, clocks are compared with each other. What makes the data unusable is an
error; what leaves them usable (an interruption, a wall clock that was set) is a warning. See
docs/formats-session.md for the format; phoslab.instruments.recorder writes it.
"""

from __future__ import annotations

import hashlib
import math
import os
import stat
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from phoslab import journal, schemas
from phoslab.errors import PhoslabError
from phoslab.files import inside, sha256
from phoslab.journal import Event

SCHEMA = "phoslab-session/1"

# Far above what a plan writes (a line is some 300 bytes), far below what fills a memory.
_LARGEST_HEADER_BYTES = 1 << 20
_LARGEST_JOURNAL_BYTES = 1 << 28


@dataclass(frozen=True)
class Header:
    """What session.toml says.

    `parameters`, `rig`, `camera`, `lens`, `sample` and `software` are the tables as they stand in the
    file; a name in them ends with its unit. `simulated` is None if real light was measured.
    """

    plan: str
    parameters: Mapping[str, Any]
    sample: Mapping[str, Any]
    camera: Mapping[str, Any]
    lens: Mapping[str, Any]
    rig: Mapping[str, Any]
    room_temperature_C: float | None
    operator: str | None
    software: Mapping[str, str]
    started: str
    simulated: Mapping[str, Any] | None

    @property
    def sample_name(self) -> str:
        """The sample's name."""
        return str(self.sample["name"])

    @property
    def sensitivities(self) -> str | None:
        """Name of the camera's spectral sensitivities in colour-science, if they are known."""
        return self.camera.get("sensitivities")


@dataclass(frozen=True)
class Edge:
    """A lamp or door that changed at `at_s` (monotonic) and `device_s` (controller's clock or None)."""

    device: str
    to: str
    at_s: float
    device_s: float | None


@dataclass(frozen=True)
class Frame:
    """One exposure.

    Args:
        path: the file.
        name: its name in frames/.
        role: one of `phoslab.journal.ROLES`.
        start_s: when the shutter opened, on the session's monotonic clock.
        exposure_s: how long it was open.
        iso: the ISO speed setting.
        f_number: the f-number, or None if the lens does not report it.
        sha256: checksum, verified when the session was opened.
        device_s: when the shutter opened, on the controller's clock, or None.
    """

    path: Path
    name: str
    role: str
    start_s: float
    exposure_s: float
    iso: float
    f_number: float | None
    sha256: str
    device_s: float | None = None


@dataclass(frozen=True)
class Session:
    """A session folder that has passed its checks. Times are seconds of its monotonic clock.

    Args:
        path: the folder.
        header: what session.toml says.
        events: every journal line, in order.
        frames: every exposure, in order.
        edges: every lamp and door change, in order.
        complete: the plan came to its end.
        warnings: what is wrong but leaves the data usable, one sentence each.
        digest: SHA-256 that identifies the session with every frame in it.
    """

    path: Path
    header: Header
    events: tuple[Event, ...]
    frames: tuple[Frame, ...]
    edges: tuple[Edge, ...]
    complete: bool
    warnings: tuple[str, ...]
    digest: str

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> Session:
        """Read the session at `path` and check all of it, frames' checksums included.

        Raises:
            PhoslabError: the folder is no session, or a check failed; the error names file and field.
        """
        try:
            return _open(Path(path))
        except RecursionError:
            raise PhoslabError(
                "holds tables or lists that are nested beyond reason",
                file=path,
                remedy="phoslab did not write this: copy the session folder again.",
            ) from None

    def frames_of(self, role: str) -> tuple[Frame, ...]:
        """The frames of one role, in order; `filter:` stands for every filter."""
        if role == "filter:":
            return tuple(f for f in self.frames if f.role.startswith(role))
        return tuple(f for f in self.frames if f.role == role)

    def edges_of(self, device: str) -> tuple[Edge, ...]:
        """The changes of "lamp" or "door", in order."""
        return tuple(e for e in self.edges if e.device == device)

    @property
    def lamp_off_s(self) -> float | None:
        """When the lamp was last switched off, or None if it never was. Its light may fade after that.

        That it is still off, which whoever resumes a session finds, is no switching.
        """
        edges = self.edges_of("lamp")
        before = ("on", *(e.to for e in edges))
        off = [e.at_s for e, was in zip(edges, before, strict=False) if (was, e.to) == ("on", "off")]
        return off[-1] if off else None


def _open(folder: Path) -> Session:
    if not folder.is_dir():
        raise PhoslabError(
            "is not a folder" if folder.exists() else "does not exist",
            file=folder,
            remedy="Name the folder of a session: it holds session.toml, journal.jsonl and frames/.",
        )
    header_bytes = _read(folder, "session.toml", _LARGEST_HEADER_BYTES)
    journal_bytes = _read(folder, "journal.jsonl", _LARGEST_JOURNAL_BYTES)
    header = _read_header(header_bytes, folder / "session.toml")
    events, warnings = journal.read(journal_bytes, folder / "journal.jsonl")
    complete = events[-1].event == "end" and events[-1].fields["reason"] == "complete"
    if events[-1].event != "end":
        warnings.append(
            f"{folder / 'journal.jsonl'}: has no end line: the session was interrupted, or is still being recorded."
        )
    elif not complete:
        warnings.append(f"{folder / 'journal.jsonl'}: the session was interrupted before its plan was done.")
    warnings += _unlisted(folder, events, complete)  # before the frames: a renamed one is not a missing one
    frames = _read_frames(folder, events)
    warnings += _at_once(frames, folder / "journal.jsonl")
    # The journal holds the checksum of every frame, so these two files identify the whole session.
    identity = hashlib.sha256(
        hashlib.sha256(header_bytes).digest() + hashlib.sha256(journal_bytes).digest()
    ).hexdigest()
    return Session(
        path=folder,
        header=header,
        events=events,
        frames=frames,
        edges=_edges(events, folder / "journal.jsonl"),
        complete=complete,
        warnings=tuple(warnings),
        digest=identity,
    )


def _read(folder: Path, name: str, largest_bytes: int) -> bytes:
    """Read a regular file of the session: no link, no pipe that would block, no file beyond reason."""
    path = inside(folder, name, file=folder, field="the session")
    n_bytes = _size(path, folder, f"{name}, which every session has,")
    if n_bytes > largest_bytes:
        raise PhoslabError(
            f"has {n_bytes} bytes, more than the {largest_bytes} that phoslab reads",
            file=path,
            remedy="This is not a file that phoslab wrote; record the session again.",
        )
    try:
        return path.read_bytes()
    except OSError as error:
        raise PhoslabError(
            f"cannot be read ({error.strerror})", file=path, remedy="Check the permissions and the disk."
        ) from error


def _size(path: Path, owner: Path, subject: str) -> int:
    try:
        status = path.lstat()
    except FileNotFoundError:
        raise PhoslabError(
            "is missing",
            file=owner,
            field=subject,
            remedy="Copy the whole session folder again from where it was recorded.",
        ) from None
    except OSError as error:
        raise PhoslabError(
            f"cannot be read ({error.strerror})", file=path, remedy="Check the permissions and the disk."
        ) from error
    if not stat.S_ISREG(status.st_mode):
        raise PhoslabError(
            "is not a plain file", file=path, remedy="Copy the session folder again; it holds files only."
        )
    return status.st_size


def _read_header(content: bytes, path: Path) -> Header:
    try:
        data = tomllib.loads(journal.decode(content, path, "the file"))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise PhoslabError(
            f"is not valid TOML: {error}", file=path, remedy="Copy the session folder again."
        ) from error
    journal.check_version(data.get("schema"), SCHEMA, path, "schema")
    _check_finite(data, path, "")
    schemas.check(data, "session-1", file=path)
    journal.moment(data["started"], path, "started")
    return Header(
        plan=data["plan"]["name"],
        parameters=journal.frozen(data["plan"]["parameters"]),
        sample=journal.frozen(data["sample"]),
        camera=journal.frozen(data["camera"]),
        lens=journal.frozen(data.get("lens", {})),
        rig=journal.frozen(data.get("rig", {})),
        room_temperature_C=data.get("room_temperature_C"),
        operator=data.get("operator"),
        software=journal.frozen(data["software"]),
        started=data["started"],
        simulated=journal.frozen(data["simulated"]) if "simulated" in data else None,
    )


def _check_finite(value: Any, path: Path, where: str) -> None:
    """TOML, unlike JSON, has nan and inf, which every comparison of a schema lets pass."""
    if isinstance(value, float) and not math.isfinite(value):
        raise PhoslabError(f"is {value}", file=path, field=where, remedy="Write a finite number.")
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        _check_finite(item, path, f"{where}.{key}".lstrip("."))


def _edges(events: tuple[Event, ...], path: Path) -> tuple[Edge, ...]:
    edges = [
        Edge(
            device=e.fields["device"],
            to=e.fields["to"],
            at_s=e.fields["at_mono_s"],
            device_s=e.fields["at_device_s"],
        )
        for e in events
        if e.event == "edge"
    ]
    for device in ("lamp", "door"):
        times = [e.at_s for e in edges if e.device == device]
        if times != sorted(times):
            raise PhoslabError(
                f"of the {device} are not in the order of their at_mono_s",
                file=path,
                field="the edges",
                remedy="Times in this session mean nothing: record it again.",
            )
    return tuple(edges)


def _read_frames(folder: Path, events: tuple[Event, ...]) -> tuple[Frame, ...]:
    lines = folder / "journal.jsonl"
    frames_folder = inside(folder, "frames", file=folder, field="the session")
    frames: dict[str, Frame] = {}
    for event in events:
        if event.event != "exposure":
            continue
        fields = event.fields
        name, where = fields["frame"], f"line {event.seq + 1}: frame"
        if name in frames:
            raise PhoslabError(
                f"is {name!r}, which an earlier line already names",
                file=lines,
                field=where,
                remedy="Copy the session folder again; a journal is never edited.",
            )
        path = inside(frames_folder, name, file=lines, field=where)
        n_bytes = _size(path, folder, f"frames/{name} ({lines.name} line {event.seq + 1})")
        again = "Copy this frame again from where it was recorded."
        if n_bytes < fields["bytes"]:
            raise PhoslabError(
                f"is cut short: {n_bytes} bytes where the journal says {fields['bytes']}",
                file=path,
                remedy=again,
            )
        if n_bytes > fields["bytes"] or _sha256(path) != fields["sha256"]:
            raise PhoslabError(
                "was altered: its content is not what the journal's checksum says", file=path, remedy=again
            )
        frames[name] = Frame(
            path=path,
            name=name,
            role=fields["role"],
            start_s=fields["at_mono_s"],
            exposure_s=fields["exposure_s"],
            iso=fields["iso"],
            f_number=fields["f_number"],
            sha256=fields["sha256"],
            device_s=fields["at_device_s"],
        )
    return tuple(frames.values())


def _at_once(frames: tuple[Frame, ...], lines: Path) -> list[str]:
    """A word on exposures that overlap by more than half of the shorter one: one camera takes one at a time."""
    order = sorted(frames, key=lambda f: f.start_s)
    pairs = [
        (one, other)
        for one, other in pairwise(order)
        if one.start_s + one.exposure_s - other.start_s > min(one.exposure_s, other.exposure_s) / 2
    ]
    if not pairs:
        return []
    one, other = pairs[0]
    return [
        f"{lines}: {one.name} and {other.name} were exposed at once by what it says"
        + (f", and {len(pairs) - 1} more pairs" if len(pairs) > 1 else "")
        + ": the time of one of them is wrong, and what is fitted to it, too."
    ]


def _sha256(path: Path) -> str:
    try:
        return sha256(path)
    except OSError as error:
        raise PhoslabError(
            f"cannot be read ({error.strerror})", file=path, remedy="Check the permissions and the disk."
        ) from error


def _unlisted(folder: Path, events: tuple[Event, ...], complete: bool) -> list[str]:
    """Name the files in frames/ that the journal does not know.

    A crash between saving a frame and writing its line leaves one, so an interrupted session may
    have them; in a complete one somebody added or renamed a file.
    """
    frames_folder = inside(folder, "frames", file=folder, field="the session")
    known = {e.fields["frame"] for e in events if e.event == "exposure"}
    present = [entry.name for entry in frames_folder.iterdir()] if frames_folder.is_dir() else []
    extra = sorted(set(present) - known)
    if not extra:
        return []
    if complete:
        raise PhoslabError(
            "is not in the journal: it was added or renamed",
            file=frames_folder / extra[0],
            remedy="Move it out of the session, or give it back its name.",
        )
    return [
        f"{frames_folder / name}: is not in the journal (an interruption) and was left out." for name in extra
    ]
