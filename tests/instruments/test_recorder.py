"""The recorder: on disk before it returns, never over anything, closed with the truth."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

import phoslab
from phoslab.errors import PhoslabError
from phoslab.instruments.bench.bench import SimulatedClock
from phoslab.instruments.devices import Clock
from phoslab.instruments.recorder import Recorder
from phoslab.instruments.system_clock import SystemClock
from phoslab.session import Session

HEADER = {
    "plan": {"name": "check", "parameters": {}},
    "sample": {"name": "none"},
    "camera": {"make": "a", "model": "b"},
    "software": {"phoslab": "0"},
}
SETTINGS: dict[str, Any] = {"role": "flat", "at_mono_s": 0.0, "exposure_s": 1.0, "iso": 100, "f_number": None}


def recorder_in(folder: Path) -> Recorder:
    return Recorder(folder, HEADER, SimulatedClock())


def journal(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("clock", [SystemClock(), SimulatedClock()])
def test_real_and_simulated_clocks_obey_one_protocol(clock: Clock) -> None:
    assert isinstance(clock, Clock)
    assert clock.mono_s() <= clock.mono_s()
    assert clock.wall().utcoffset() is not None


def test_a_session_on_the_real_clock_reads_back(tmp_path: Path) -> None:
    before = datetime.now(UTC)
    with Recorder(tmp_path / "s", HEADER, SystemClock()) as recorder:
        recorder.note("hello")
    session = Session.open(tmp_path / "s")
    assert session.complete
    assert abs((datetime.fromisoformat(session.header.started) - before).total_seconds()) < 60


def test_a_folder_with_anything_in_it_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(PhoslabError, match="already exists"):
        recorder_in(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["note.txt"]


def test_a_second_recorder_cannot_take_over_a_session(tmp_path: Path) -> None:
    with recorder_in(tmp_path / "s"), pytest.raises(PhoslabError, match="already exists"):
        recorder_in(tmp_path / "s")


def test_a_wrong_header_leaves_no_folder(tmp_path: Path) -> None:
    with pytest.raises(PhoslabError, match=r"sample"):
        Recorder(tmp_path / "s", {**HEADER, "sample": {}}, SimulatedClock())
    assert not (tmp_path / "s").exists()


@pytest.mark.parametrize("step", range(5))
def test_what_a_killed_writer_began_is_swept_away_by_the_next(step: int, tmp_path: Path) -> None:
    """kill -9 between any two steps of the creation; SIGKILL itself, since no handler may tidy up."""
    program = f"""
import os, signal
from phoslab.instruments import recorder
from phoslab.instruments.system_clock import SystemClock
steps = 0
def dying(name, where):
    real = getattr(where, name)
    def call(*arguments, **more):
        global steps
        if steps == {step}:
            os.kill(os.getpid(), signal.SIGKILL)
        steps += 1
        return real(*arguments, **more)
    setattr(where, name, call)
for name, where in [("umask", recorder), ("write_text", recorder), ("lock", recorder), ("_sync_folder", recorder)]:
    dying(name, where)
dying("rename", recorder.Path)
recorder.Recorder({str(tmp_path / "s")!r}, {HEADER!r}, SystemClock())
"""
    environment = {**os.environ, "PYTHONPATH": str(Path(phoslab.__file__).parent.parent)}
    killed = subprocess.run([sys.executable, "-c", program], check=False, env=environment)
    assert killed.returncode == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".s-")
    os.utime(left, (0, 0))  # long ago
    with recorder_in(tmp_path / "s"):
        pass
    assert [p.name for p in tmp_path.iterdir()] == ["s"]


def test_what_another_writer_begins_now_or_holds_a_frame_is_left_alone(tmp_path: Path) -> None:
    begun, with_frame, other = (tmp_path / name for name in (".s-abcdefgh", ".s-12345678", ".t-abcdefgh"))
    for folder in (begun, with_frame, other):
        (folder / "frames").mkdir(parents=True)
    (with_frame / "frames" / "0000.dng").write_bytes(b"light")
    os.utime(with_frame, (0, 0))
    os.utime(other, (0, 0))
    with recorder_in(tmp_path / "s"):
        pass
    assert all(folder.exists() for folder in (begun, with_frame, other))
    assert (with_frame / "frames" / "0000.dng").exists()


def test_every_line_is_synced_before_the_call_returns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = recorder_in(tmp_path / "s")
    synced: list[tuple[int, int]] = []
    real = os.fsync

    def fsync(handle: int) -> None:
        synced.append((handle, os.fstat(handle).st_size))
        real(handle)

    monkeypatch.setattr(os, "fsync", fsync)
    for call in (
        lambda: recorder.note("x"),
        lambda: recorder.command("lamp", "set", {"to": "on"}),
        lambda: recorder.edge("lamp", "on", at_mono_s=0.0),
        lambda: recorder.frame(lambda path: path.write_bytes(b"x"), **SETTINGS),
        lambda: recorder.close("complete"),
    ):
        n = len(journal(tmp_path / "s"))
        call()
        assert len(journal(tmp_path / "s")) == n + 1
        assert synced[-1][1] == (tmp_path / "s" / "journal.jsonl").stat().st_size


@pytest.mark.parametrize("failure", [ValueError("broken"), KeyboardInterrupt()])
def test_an_exception_closes_the_session_as_interrupted_and_goes_on(
    tmp_path: Path, failure: BaseException
) -> None:
    with pytest.raises(type(failure)), recorder_in(tmp_path / "s"):
        raise failure
    assert journal(tmp_path / "s")[-1]["reason"] == "interrupted"
    assert not Session.open(tmp_path / "s").complete


def test_a_camera_that_fails_leaves_neither_file_nor_line(tmp_path: Path) -> None:
    def fail(path: Path) -> None:
        path.write_bytes(b"half a fra")
        raise TimeoutError("camera")

    with recorder_in(tmp_path / "s") as recorder:
        with pytest.raises(TimeoutError):
            recorder.frame(fail, **SETTINGS)
        assert recorder.frame(lambda path: path.write_bytes(b"whole"), **SETTINGS) == "0000.dng"
    assert [p.name for p in (tmp_path / "s" / "frames").iterdir()] == ["0000.dng"]
    assert len(Session.open(tmp_path / "s").frames) == 1


def test_a_frame_is_moved_in_under_the_cameras_suffix(tmp_path: Path) -> None:
    card = tmp_path / "IMG_0001.CR2"
    card.write_bytes(b"raw")
    with recorder_in(tmp_path / "s") as recorder:
        assert recorder.frame(card, suffix="CR2", **SETTINGS) == "0000.CR2"
    assert not card.exists()
    (frame,) = Session.open(tmp_path / "s").frames
    assert frame.path.read_bytes() == b"raw"
    assert frame.f_number is None


def test_a_frame_never_overwrites_another(tmp_path: Path) -> None:
    recorder = recorder_in(tmp_path / "s")
    (tmp_path / "s" / "frames" / "0000.dng").write_bytes(b"somebody else's")
    with pytest.raises(PhoslabError, match="already exists"):
        recorder.frame(lambda path: path.write_bytes(b"mine"), **SETTINGS)
    assert (tmp_path / "s" / "frames" / "0000.dng").read_bytes() == b"somebody else's"


def test_a_frame_with_an_unknown_role_is_refused_before_it_is_taken(tmp_path: Path) -> None:
    taken = []
    with recorder_in(tmp_path / "s") as recorder, pytest.raises(PhoslabError, match="role"):
        recorder.frame(taken.append, **{**SETTINGS, "role": "selfie"})
    assert taken == []


def test_a_full_disk_leaves_no_half_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = recorder_in(tmp_path / "s")
    real = os.write

    def write(handle: int, data: bytes) -> int:
        if len(data) > 20:
            return real(handle, bytes(data[:20]))
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "write", write)
    with pytest.raises(PhoslabError, match="No space left"):
        recorder.note("a text that is longer than what the disk takes")
    monkeypatch.undo()
    recorder.note("after somebody made room")
    recorder.close("complete")
    assert Session.open(tmp_path / "s").complete


def test_nothing_is_written_after_the_end(tmp_path: Path) -> None:
    recorder = recorder_in(tmp_path / "s")
    recorder.close("complete")
    recorder.close("interrupted")
    with pytest.raises(PhoslabError, match="is closed"):
        recorder.note("late")
    assert journal(tmp_path / "s")[-1]["reason"] == "complete"
