"""journal.jsonl: the lines of a session, each checked against the schema, its neighbours and the clocks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any

from phoslab import schemas
from phoslab.errors import PhoslabError
from phoslab.files import inside

SCHEMA = "phoslab-journal/1"

ROLES = ("dark", "flat", "mercury", "led", "filter:NAME", "lamp", "emission", "decay", "excitation", "meter")

WALL_JUMP_S = 1.0
"""A change of wall against monotonic time between two lines that is more than the clocks' own drift."""


@dataclass(frozen=True)
class Event:
    """One journal line: when it was written (seconds, and RFC 3339 in UTC), its event and own fields."""

    seq: int
    mono_s: float
    device_s: float | None
    wall: str
    event: str
    fields: Mapping[str, Any]


def read(content: bytes, path: Path) -> tuple[tuple[Event, ...], list[str]]:
    """Every whole line of the journal, checked, and the warnings they give rise to."""
    warnings = []
    *lines, rest = content.split(b"\n")
    if rest:
        # A line is on disk with its line end or it was being written when the power went.
        warnings.append(f"{path}: line {len(lines) + 1} is half-written (an interruption) and was left out.")
    events: list[Event] = []
    moments: list[datetime] = []
    for number, line in enumerate(lines, start=1):
        event = _read_line(decode(line, path, f"line {number}"), path, number)
        moments.append(moment(event.wall, path, f"line {number}: wall"))
        if events:
            _check_order(events[-1], event, path, number)
            jump_s = (moments[-1] - moments[-2]).total_seconds() - (event.mono_s - events[-1].mono_s)
            if abs(jump_s) > WALL_JUMP_S and event.event != "resume":
                warnings.append(
                    f"{path}: line {number}: the wall clock jumped by {jump_s:+.1f} s against the monotonic clock: "
                    "it was set, or the computer slept. Times are taken from the monotonic clock."
                )
        events.append(event)
    if not events:
        raise PhoslabError(
            "holds no whole line", file=path, remedy="Nothing was recorded: record the session again."
        )
    return tuple(events), warnings


def _read_line(text: str, path: Path, number: int) -> Event:
    where = f"line {number}"
    data = schemas.read_json(text, file=path, where=where)
    if not isinstance(data, dict):
        raise PhoslabError(
            "is not a JSON object", file=path, field=where, remedy="Copy the session folder again."
        )
    if number == 1:
        if data.get("event") != "begin":
            raise PhoslabError(
                f"has the event {data.get('event')!r} where a journal says 'begin'",
                file=path,
                field=where,
                remedy="The journal's beginning is lost: copy the session folder again.",
            )
        check_version(data.get("schema"), SCHEMA, path, f"{where}: schema")
    if data.get("event") == "exposure":
        _check_exposure_names(data, path, where)
    schemas.check(data, "journal-1", file=path, where=f"{where}: ")
    if data["seq"] != number - 1:
        raise PhoslabError(
            f"is {data['seq']} where {number - 1} follows: a line was lost, added or moved",
            file=path,
            field=f"{where}: seq",
            remedy="Copy the session folder again; a journal is never edited.",
        )
    stamps = ("seq", "mono_s", "device_s", "wall", "event")
    return Event(
        **{name: data[name] for name in stamps},
        fields=frozen({name: value for name, value in data.items() if name not in stamps}),
    )


def _check_exposure_names(data: dict[str, Any], path: Path, where: str) -> None:
    """Refuse an unsafe file name and an unknown role in words clearer than a pattern that does not match."""
    if isinstance(name := data.get("frame"), str):
        inside(path.parent / "frames", name, file=path, field=f"{where}: frame")
    role = data.get("role")
    if isinstance(role, str) and role not in ROLES and not role.startswith("filter:"):
        raise PhoslabError(
            f"is {role!r}, which is no role",
            file=path,
            field=f"{where}: role",
            remedy=f"Roles: {', '.join(ROLES)}.",
        )


def _check_order(before: Event, event: Event, path: Path, number: int) -> None:
    if event.mono_s < before.mono_s:
        raise PhoslabError(
            f"goes back from {before.mono_s} to {event.mono_s}, which a monotonic clock never does",
            file=path,
            field=f"line {number}: mono_s",
            remedy="Times in this session mean nothing: record it again.",
        )
    if event.fields.get("at_mono_s", event.mono_s) > event.mono_s:
        raise PhoslabError(
            f"is {event.fields['at_mono_s']}, later than the line itself was written ({event.mono_s})",
            file=path,
            field=f"line {number}: at_mono_s",
            remedy="Times in this session mean nothing: record it again.",
        )
    interrupted = before.event == "end" and before.fields["reason"] == "interrupted"
    if event.event == "begin" or (before.event == "end" and not (interrupted and event.event == "resume")):
        raise PhoslabError(
            f"has the event {event.event!r} after {before.event!r}",
            file=path,
            field=f"line {number}",
            remedy="A closed journal is never continued: copy the session folder again.",
        )


def decode(
    content: bytes,
    path: Path,
    where: str,
    *,
    remedy: str = "The file was damaged: copy the session folder again.",
) -> str:
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise PhoslabError(
            f"is not UTF-8 text (byte {error.start})",
            file=path,
            field=where,
            remedy=remedy,
        ) from None


def check_version(found: Any, known: str, path: Path, where: str) -> None:
    if found != known:
        raise PhoslabError(
            f"is {found!r}, and this phoslab reads {known!r}",
            file=path,
            field=where,
            remedy="Use a version of phoslab that knows this format.",
        )


def moment(wall: str, path: Path, where: str) -> datetime:
    try:
        return datetime.fromisoformat(wall)
    except ValueError:
        raise PhoslabError(
            f"is {wall!r}, which is no moment",
            file=path,
            field=where,
            remedy="Copy the session folder again.",
        ) from None


def frozen(value: Any) -> Any:
    """The same tables and lists, read-only."""
    if isinstance(value, dict):
        return MappingProxyType({key: frozen(item) for key, item in value.items()})
    if isinstance(value, list):
        return tuple(frozen(item) for item in value)
    return value
