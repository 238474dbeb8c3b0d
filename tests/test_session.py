"""Sessions: what the recorder wrote reads back; what was lost, altered or forged is named."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from phoslab import schemas
from phoslab.errors import PhoslabError
from phoslab.instruments.recorder import Recorder
from phoslab.session import Edge, Session

HEADER = {
    "operator": "Ada",
    "room_temperature_C": 20.5,
    "plan": {"name": "decay", "parameters": {"interval_s": 5.0}},
    "sample": {"name": "star"},
    "camera": {"make": "Canon", "model": "EOS 5D Mark II", "sensitivities": "Nikon 5100 (NPL)"},
    "software": {"phoslab": "0"},
}


class SteppingClock:
    """Half a second passes at each look."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def mono_s(self) -> float:
        self.now_s += 0.5
        return self.now_s

    def device_s(self) -> float | None:
        return None

    def wall(self) -> datetime:
        return datetime(2026, 1, 1, tzinfo=UTC) + timedelta(seconds=self.now_s)


def record(folder: Path) -> None:
    clock = SteppingClock()
    with Recorder(folder, HEADER, clock) as recorder:
        recorder.edge("lamp", "on", at_mono_s=clock.now_s)
        off = recorder.command("lamp", "set", {"to": "off"})
        recorder.ack(off, ok=True, reply="OK")
        recorder.edge("lamp", "off", at_mono_s=clock.now_s)
        for k in range(3):
            recorder.frame(
                lambda path, k=k: path.write_bytes(bytes([k]) * 1000),
                role="decay" if k else "dark",
                at_mono_s=clock.now_s,
                exposure_s=0.25,
                iso=100,
                f_number=2.8,
            )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A complete session of three frames, the first one dark."""
    record(tmp_path / "session")
    return tmp_path / "session"


def edit_line(folder: Path, number: int, change: Callable[[dict[str, Any]], object]) -> None:
    """Change line `number` (from 1) of the journal."""
    path = folder / "journal.jsonl"
    lines = path.read_text().splitlines()
    data = json.loads(lines[number - 1])
    change(data)
    lines[number - 1] = json.dumps(data)
    path.write_text("\n".join(lines) + "\n")


def line_of(folder: Path, event: str) -> int:
    """Number of the first line with `event`."""
    lines = (folder / "journal.jsonl").read_text().splitlines()
    return next(n for n, line in enumerate(lines, start=1) if json.loads(line)["event"] == event)


def refused(folder: Path) -> PhoslabError:
    with pytest.raises(PhoslabError) as caught:
        Session.open(folder)
    assert caught.value.remedy
    return caught.value


def test_what_was_recorded_reads_back(folder: Path) -> None:
    session = Session.open(folder)
    assert session.complete
    assert session.warnings == ()
    assert (session.header.plan, session.header.sample_name) == ("decay", "star")
    assert session.header.parameters["interval_s"] == 5.0
    assert session.header.sensitivities == "Nikon 5100 (NPL)"
    assert session.header.simulated is None
    assert [f.role for f in session.frames] == ["dark", "decay", "decay"]
    frame = session.frames_of("decay")[0]
    assert (frame.name, frame.exposure_s, frame.iso, frame.f_number) == ("0001.dng", 0.25, 100, 2.8)
    assert frame.path.read_bytes() == b"\1" * 1000
    lamp = session.edges_of("lamp")
    assert [e.to for e in lamp] == ["on", "off"]
    assert session.lamp_off_s == lamp[1].at_s < frame.start_s
    assert [e.seq for e in session.events] == list(range(len(session.events)))


@pytest.mark.parametrize(
    ("states", "counts"),
    [
        ("on off on off", 3),
        ("on off off", 1),  # that it is still off was found by whoever resumed the session
        ("off on off", 2),
        ("off", 0),
        ("on", None),
    ],
)
def test_the_last_of_several_lamp_offs_counts(folder: Path, states: str, counts: int | None) -> None:
    edges = tuple(Edge("lamp", to, 10.0 * k, None) for k, to in enumerate(states.split()))
    session = replace(Session.open(folder), edges=edges)
    assert session.lamp_off_s == (None if counts is None else edges[counts].at_s)


def test_a_header_cannot_be_changed(folder: Path) -> None:
    with pytest.raises(TypeError):
        Session.open(folder).header.parameters["interval_s"] = 1.0  # type: ignore[index] # that is the claim


def test_the_digest_tells_sessions_apart(folder: Path, tmp_path: Path) -> None:
    digest = Session.open(folder).digest
    record(tmp_path / "again")
    assert Session.open(tmp_path / "again").digest == digest
    edit_line(folder, 3, lambda line: line["arguments"].update(to="on"))
    assert Session.open(folder).digest != digest


# ---- frames


def test_a_missing_frame_is_named(folder: Path) -> None:
    (folder / "frames" / "0001.dng").unlink()
    assert "frames/0001.dng" in str(refused(folder))


def test_an_altered_frame_is_named(folder: Path) -> None:
    path = folder / "frames" / "0001.dng"
    path.write_bytes(b"\2" + path.read_bytes()[1:])
    error = refused(folder)
    assert (error.file, "altered" in str(error)) == (str(path), True)


def test_a_truncated_frame_is_named(folder: Path) -> None:
    path = folder / "frames" / "0002.dng"
    path.write_bytes(path.read_bytes()[:-1])
    error = refused(folder)
    assert (error.file, "cut short: 999 bytes" in str(error)) == (str(path), True)


def test_a_frame_that_grew_is_named(folder: Path) -> None:
    path = folder / "frames" / "0002.dng"
    path.write_bytes(path.read_bytes() + b"\0")
    assert refused(folder).file == str(path)


def test_a_renamed_frame_is_named_by_the_name_it_has(folder: Path) -> None:
    (folder / "frames" / "0001.dng").rename(folder / "frames" / "IMG_1.dng")
    error = refused(folder)
    assert error.file is not None
    assert error.file.endswith("frames/IMG_1.dng")
    assert "not in the journal" in str(error)


def test_an_extra_frame_is_refused_in_a_complete_session(folder: Path) -> None:
    (folder / "frames" / "0003.dng").write_bytes(b"")
    assert "0003.dng" in str(refused(folder))


def test_an_extra_frame_is_a_warning_after_an_interruption(folder: Path) -> None:
    (folder / "frames" / "0003.dng").write_bytes(b"")
    edit_line(folder, line_of(folder, "end"), lambda line: line.update(reason="interrupted"))
    session = Session.open(folder)
    assert not session.complete
    assert len(session.frames) == 3
    assert any("0003.dng" in warning for warning in session.warnings)


@pytest.mark.parametrize(
    "name",
    ["../session.toml", "/etc/passwd", "a/../../x.dng", "..\\x.dng", "", ".", "0001.dng/", "a/0001.dng"],
)
def test_a_name_that_is_no_plain_frame_is_refused(folder: Path, name: str) -> None:
    number = line_of(folder, "exposure")
    edit_line(folder, number, lambda line: line.update(frame=name))
    assert refused(folder).field == f"line {number}: frame"


def test_a_frame_named_twice_is_refused(folder: Path) -> None:
    first = line_of(folder, "exposure")
    (folder / "frames" / "0000.dng").unlink()
    copied: dict[str, Any] = {}
    edit_line(folder, first + 1, copied.update)
    edit_line(folder, first, lambda line: line.update({k: copied[k] for k in ("frame", "sha256")}))
    assert refused(folder).field == f"line {first + 1}: frame"


@pytest.mark.parametrize("name", ["frames/0001.dng", "journal.jsonl", "session.toml", "frames"])
def test_a_symbolic_link_is_refused(folder: Path, tmp_path: Path, name: str) -> None:
    (folder / name).rename(tmp_path / "elsewhere")
    (folder / name).symlink_to(tmp_path / "elsewhere")
    assert "symbolic link" in str(refused(folder))


@pytest.mark.timeout(10)
@pytest.mark.parametrize("name", ["frames/0001.dng", "journal.jsonl", "session.toml"])
def test_a_pipe_in_place_of_a_file_does_not_block(folder: Path, name: str) -> None:
    (folder / name).unlink()
    os.mkfifo(folder / name)
    assert "not a plain file" in str(refused(folder))


# ---- journal


def test_a_corrupt_line_is_named_by_its_number(folder: Path) -> None:
    path = folder / "journal.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    lines[3] = lines[3][:20] + "\n"
    path.write_text("".join(lines))
    assert refused(folder).field == "line 4"


def test_a_line_that_is_not_text_is_named(folder: Path) -> None:
    path = folder / "journal.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    lines[2] = b"\xff\n"
    path.write_bytes(b"".join(lines))
    assert refused(folder).field == "line 3"


def test_a_half_written_last_line_is_an_interruption(folder: Path) -> None:
    path = folder / "journal.jsonl"
    path.write_bytes(path.read_bytes()[:-10])
    n_lines = path.read_bytes().count(b"\n")
    session = Session.open(folder)
    assert not session.complete
    assert len(session.events) == n_lines
    assert any(f"line {n_lines + 1} is half-written" in w for w in session.warnings)
    assert any("interrupted" in w for w in session.warnings)


def test_a_lost_line_is_named(folder: Path) -> None:
    path = folder / "journal.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    del lines[4]
    path.write_text("".join(lines))
    assert refused(folder).field == "line 5: seq"


def test_a_monotonic_clock_that_goes_back_is_refused(folder: Path) -> None:
    edit_line(folder, 4, lambda line: line.update(mono_s=line["mono_s"] - 1))
    assert refused(folder).field == "line 4: mono_s"


def test_a_frame_from_the_future_is_refused(folder: Path) -> None:
    number = line_of(folder, "exposure")
    edit_line(folder, number, lambda line: line.update(at_mono_s=line["mono_s"] + 1))
    assert refused(folder).field == f"line {number}: at_mono_s"


@pytest.mark.parametrize(("jump_s", "told"), [(0.9, False), (1.2, True), (-3600.0, True)])
def test_a_jump_of_the_wall_clock_is_a_warning_and_times_stay(
    folder: Path, jump_s: float, told: bool
) -> None:
    before = Session.open(folder)
    n_lines = len(before.events)

    def set_clock(line: dict[str, Any]) -> None:
        moment = datetime.fromisoformat(line["wall"]) + timedelta(seconds=jump_s)
        line["wall"] = moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")

    for number in range(5, n_lines + 1):  # somebody set the clock before line 5
        edit_line(folder, number, set_clock)
    session = Session.open(folder)
    assert [("line 5:" in w, "jumped" in w) for w in session.warnings] == [(True, True)] * told
    assert session.frames == before.frames


def test_an_unknown_role_is_named_with_the_known_ones(folder: Path) -> None:
    number = line_of(folder, "exposure")
    edit_line(folder, number, lambda line: line.update(role="selfie"))
    error = refused(folder)
    assert error.field == f"line {number}: role"
    assert "emission" in error.remedy


def test_a_filter_role_carries_the_filters_name(folder: Path) -> None:
    edit_line(folder, line_of(folder, "exposure"), lambda line: line.update(role="filter:Lee 106"))
    session = Session.open(folder)
    assert session.frames_of("filter:") == session.frames_of("filter:Lee 106") == session.frames[:1]


@pytest.mark.parametrize(
    ("event", "change"),
    [
        ("exposure", {"colour": "green"}),
        ("exposure", {"exposure_s": 0}),
        ("exposure", {"sha256": "0" * 63}),
        ("edge", {"device": "door", "to": "on"}),
        ("edge", {"at_mono_s": None}),
        ("command", {"arguments": []}),
        ("ack", {"ok": "yes"}),
        ("end", {"reason": "bored"}),
        ("end", {"wall": "2026-13-01T00:00:00Z"}),
        ("end", {"event": "party"}),
    ],
)
def test_a_line_beyond_the_schema_is_named(folder: Path, event: str, change: dict[str, Any]) -> None:
    number = line_of(folder, event)
    edit_line(folder, number, lambda line: line.update(change))
    assert str(refused(folder).field).startswith(f"line {number}: ")


@pytest.mark.parametrize("depth", [300, 900, 50_000])
def test_lists_in_lists_beyond_reason_are_refused(folder: Path, depth: int) -> None:
    path = folder / "journal.jsonl"
    path.write_text(path.read_text().replace('"OK"', "[" * depth + "]" * depth))
    if depth == 300:
        assert Session.open(folder).complete
    else:
        refused(folder)


def test_an_unknown_journal_version_is_refused(folder: Path) -> None:
    edit_line(folder, 1, lambda line: line.update(schema="phoslab-journal/9"))
    assert "phoslab-journal/9" in str(refused(folder))


def test_a_closed_session_is_never_continued(folder: Path) -> None:
    number = line_of(folder, "end")
    path = folder / "journal.jsonl"
    last = json.loads(path.read_text().splitlines()[-1])
    note = {**last, "seq": last["seq"] + 1, "event": "note", "text": "one more"}
    del note["reason"]
    path.write_text(path.read_text() + json.dumps(note) + "\n")
    assert refused(folder).field == f"line {number + 1}"


def test_an_interrupted_session_may_be_resumed(folder: Path) -> None:
    path = folder / "journal.jsonl"
    edit_line(folder, line_of(folder, "end"), lambda line: line.update(reason="interrupted"))
    end = json.loads(path.read_text().splitlines()[-1])
    again = {**end, "seq": end["seq"] + 1, "event": "resume", "reason": "power cut"}
    complete = {**end, "seq": end["seq"] + 2, "reason": "complete"}
    path.write_text(path.read_text() + json.dumps(again) + "\n" + json.dumps(complete) + "\n")
    assert Session.open(folder).complete


# ---- header


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ('schema = "phoslab-session/1"', 'schema = "phoslab-session/2"', "schema"),
        ('schema = "phoslab-session/1"', "", "schema"),
        ("room_temperature_C = 20.5", "room_temperature_C = nan", "room_temperature_C"),
        ("interval_s = 5.0", "interval_s = inf", "plan.parameters.interval_s"),
        ('name = "star"', "name = 5", "sample.name"),
        ('operator = "Ada"', 'operater = "Ada"', "the top level"),
        ('operator = "Ada"', "operator = ", None),
        ('name = "decay"', 'name = "party"', "plan.name"),
    ],
)
def test_a_wrong_header_names_the_field(folder: Path, old: str, new: str, field: str | None) -> None:
    path = folder / "session.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    error = refused(folder)
    assert (error.file, error.field) == (str(path), field)


@pytest.mark.parametrize("name", ["session.toml", "journal.jsonl"])
def test_a_folder_without_its_files_is_no_session(folder: Path, name: str) -> None:
    (folder / name).unlink()
    assert name in str(refused(folder))


def test_a_session_that_is_not_there_is_named(tmp_path: Path) -> None:
    assert "does not exist" in str(refused(tmp_path / "nothing"))
    (tmp_path / "file").write_text("")
    assert "is not a folder" in str(refused(tmp_path / "file"))


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damage_anywhere_is_named_or_harmless(folder: Path, data: st.DataObject) -> None:
    """Whatever happens to a few bytes, the reader says so in its own words or reads all frames' true bytes."""
    name = data.draw(st.sampled_from(["journal.jsonl", "session.toml"]))
    path = folder / name
    original = path.read_bytes()
    start = data.draw(st.integers(0, len(original) - 1))
    length = data.draw(st.integers(0, 40))
    path.write_bytes(original[:start] + data.draw(st.binary(max_size=8)) + original[start + length :])
    try:
        with contextlib.suppress(PhoslabError):  # and nothing else
            Session.open(folder)
    finally:
        path.write_bytes(original)


@pytest.mark.parametrize("name", ["session-1", "journal-1"])
def test_the_published_schemas_are_valid_and_describe_every_field(name: str) -> None:
    path = Path(schemas.__file__).with_name(f"{name}.schema.json")
    schema = json.loads(path.read_text())
    Draft202012Validator.check_schema(schema)

    def fields(node: Any) -> None:
        if isinstance(node, dict):
            for field, content in node.get("properties", {}).items():
                conditional = set(content) <= {"const"}
                assert conditional or content.get("description"), field
            for child in node.values():
                fields(child)
        elif isinstance(node, list):
            for child in node:
                fields(child)

    fields(schema)
