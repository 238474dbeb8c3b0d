"""A session goes on after whatever stopped it: nothing is lost, nothing overwritten, no two writers at once."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest

from phoslab.errors import PhoslabError
from phoslab.instruments.bench.bench import SimulatedClock
from phoslab.instruments.recorder import Recorder
from phoslab.session import Session

HEADER = {
    "plan": {"name": "check", "parameters": {}},
    "sample": {"name": "none"},
    "camera": {"make": "a", "model": "b"},
    "software": {"phoslab": "0"},
}
SETTINGS: dict[str, Any] = {"role": "flat", "exposure_s": 1.0, "iso": 100, "f_number": None}


class ShiftedClock(SimulatedClock):
    """Another day's clock: its own monotonic origin, a wall clock that is `later_s` ahead of the first one's."""

    def __init__(self, later_s: float) -> None:
        super().__init__()
        self._start += timedelta(seconds=later_s)


def frame(recorder: Recorder, content: bytes, **more: Any) -> str:
    return recorder.frame(
        lambda path: path.write_bytes(content), **{**SETTINGS, "at_mono_s": recorder.mono_s(), **more}
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A session of two frames whose writer died after 100 s."""
    clock = SimulatedClock()
    recorder = Recorder(tmp_path / "s", HEADER, clock)
    frame(recorder, b"first")
    clock.sleep_until(100.0)
    frame(recorder, b"second")
    recorder.abandon()
    return tmp_path / "s"


def test_a_resumed_session_goes_on_in_lines_frames_and_time(folder: Path) -> None:
    with Recorder.resume(folder, ShiftedClock(4000.0)) as recorder:
        assert recorder.mono_s() == pytest.approx(4000.0)
        assert frame(recorder, b"third") == "0002.dng"
    session = Session.open(folder)
    assert session.complete
    assert session.warnings == ()
    assert [f.path.read_bytes() for f in session.frames] == [b"first", b"second", b"third"]
    assert session.frames[-1].start_s == pytest.approx(4000.0)


def test_time_never_goes_back_even_if_the_wall_clock_was_set_back(folder: Path) -> None:
    with Recorder.resume(folder, ShiftedClock(-86400.0)) as recorder:
        frame(recorder, b"third")
    session = Session.open(folder)
    assert session.complete
    assert session.frames[-1].start_s >= 100.0


@pytest.mark.parametrize("torn", [b"{", b'{"seq": 3, "mono_s": 100.0', '{"seq": 3, "é'.encode()[:-1]])
def test_half_a_last_line_is_cut_off_and_said(folder: Path, torn: bytes) -> None:
    journal = folder / "journal.jsonl"
    whole = journal.read_bytes()
    journal.write_bytes(whole + torn)
    with Recorder.resume(folder, ShiftedClock(200.0)):
        pass
    assert journal.read_bytes().startswith(whole)
    session = Session.open(folder)
    assert session.complete
    (resumed,) = (e for e in session.events if e.event == "resume")
    assert f"{len(torn)} bytes" in resumed.fields["reason"]


def test_files_without_a_line_are_moved_aside_and_kept(folder: Path) -> None:
    (folder / "frames" / "0002.dng").write_bytes(b"whole, but its line was never written")
    (folder / "frames" / ".0002-part.dng").write_bytes(b"half")
    (folder / "unlisted").mkdir()
    (folder / "unlisted" / "0002.dng").write_bytes(b"from the crash before")
    with Recorder.resume(folder, ShiftedClock(200.0)) as recorder:
        assert frame(recorder, b"third") == "0002.dng"
    session = Session.open(folder)
    assert session.complete
    assert session.warnings == ()
    kept = sorted((p.name, p.read_bytes()) for p in (folder / "unlisted").iterdir())
    assert kept == [
        (".0002-part.dng", b"half"),
        ("0002-1.dng", b"whole, but its line was never written"),
        ("0002.dng", b"from the crash before"),
    ]


def test_a_complete_session_is_not_resumed(folder: Path) -> None:
    Recorder.resume(folder, ShiftedClock(200.0)).close("complete")
    before = (folder / "journal.jsonl").read_bytes()
    with pytest.raises(PhoslabError, match="is complete"):
        Recorder.resume(folder, ShiftedClock(300.0))
    assert (folder / "journal.jsonl").read_bytes() == before


def test_a_damaged_session_is_not_resumed(folder: Path) -> None:
    (folder / "frames" / "0000.dng").write_bytes(b"FIRST")
    with pytest.raises(PhoslabError, match="was altered"):
        Recorder.resume(folder, ShiftedClock(200.0))


def test_a_session_can_be_resumed_again_and_again(folder: Path) -> None:
    for day in range(1, 4):
        recorder = Recorder.resume(folder, ShiftedClock(day * 86400.0))
        frame(recorder, bytes([day]))
        if day < 3:
            recorder.abandon()
        else:
            recorder.close("complete")
    session = Session.open(folder)
    assert session.complete
    assert len(session.frames) == 5
    assert session.warnings == ()


HOLD = """
import sys, time
from pathlib import Path
sys.path.insert(0, str(Path(sys.argv[2])))
from phoslab.instruments.recorder import Recorder
from phoslab.instruments.system_clock import SystemClock
recorder = Recorder.resume(Path(sys.argv[1]), SystemClock())
print("held", flush=True)
time.sleep(60)
"""


def test_a_second_process_is_refused_by_the_pid_of_the_first_until_that_dies(folder: Path) -> None:
    import phoslab

    where = str(Path(phoslab.__file__).parent.parent)
    holder = subprocess.Popen([sys.executable, "-c", HOLD, folder, where], stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(PhoslabError, match=f"in use by process {holder.pid}"):
            Recorder.resume(folder, ShiftedClock(0.0))
        os.kill(holder.pid, signal.SIGKILL)
        holder.wait()
        Recorder.resume(folder, ShiftedClock(10.0)).close("complete")
    finally:
        holder.kill()
        holder.wait()


def test_the_writer_of_a_new_session_holds_it(tmp_path: Path) -> None:
    held = pytest.raises(PhoslabError, match=f"in use by process {os.getpid()}")
    with Recorder(tmp_path / "s", HEADER, SimulatedClock()), held:
        Recorder.resume(tmp_path / "s", SimulatedClock())
    with pytest.raises(PhoslabError, match="is complete"):
        Recorder.resume(tmp_path / "s", SimulatedClock())


@pytest.mark.parametrize("step", ["fsync", "rename", "mkdir"])
def test_a_session_that_cannot_be_begun_leaves_nothing(
    tmp_path: Path, step: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder appears with its first line, in one rename."""

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    (tmp_path / "home").mkdir()
    with monkeypatch.context() as broken:
        broken.setattr(os, step, fail)
        with pytest.raises(PhoslabError):
            Recorder(tmp_path / "home" / "s", HEADER, SimulatedClock())
    assert list((tmp_path / "home").iterdir()) == []


def test_the_last_line_says_how_well_planned_instants_were_met(tmp_path: Path) -> None:
    clock = SimulatedClock()
    recorder = Recorder(tmp_path / "s", HEADER, clock)
    clock.sleep_until(50.0)
    for planned_s, start_s in ((10.0, 10.001), (20.0, 20.004), (30.0, 29.990)):
        frame(recorder, b"x", at_mono_s=start_s, planned_mono_s=planned_s, start_uncertainty_s=0.002)
    frame(recorder, b"unplanned")
    recorder.abandon()
    with Recorder.resume(tmp_path / "s", clock) as recorder:
        frame(recorder, b"x", at_mono_s=40.003, planned_mono_s=40.0)
    last = json.loads((tmp_path / "s" / "journal.jsonl").read_text().splitlines()[-1])
    # Sizes 1, 4, 10 and 3 ms: the median is between 3 and 4, and the worst is early.
    assert last["summary"] == {
        "frames": 5,
        "planned": 4,
        "deviation_median_s": pytest.approx(0.0035),
        "deviation_worst_s": pytest.approx(-0.010),
    }
