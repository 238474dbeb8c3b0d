"""`phoslab measure` and `phoslab resume` on the simulated bench: the drivers, plans and recorder of a real rig, run as
a user runs them, with everything going wrong that can."""

from __future__ import annotations

import contextlib
import hashlib
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

import phoslab
from phoslab.app import cli
from phoslab.instruments.bench import rig as bench_rig
from phoslab.instruments.recorder import Recorder
from phoslab.instruments.simulated import Hands, Link
from phoslab.session import Session

SHORT = ("--charge", "30", "--until", "20", "--darks", "1")
"""A decay of 5 frames on the grid. Its first exposures are a trial frame and those of the warm-up."""


def measure(folder: Path, *arguments: str) -> int:
    return cli.main(["measure", "decay", "--simulate", "green", "-o", str(folder), *SHORT, *arguments])


def in_a_process(*arguments: str | Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "phoslab", *map(str, arguments)],
        cwd=Path(phoslab.__file__).parent.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def decay_in_a_process(folder: Path, *more: str) -> subprocess.Popen[str]:
    return in_a_process("measure", "decay", "--simulate", "green", "-o", folder, *SHORT, *more)


def lines(folder: Path) -> list[dict[str, Any]]:
    """The whole lines of a journal that may be growing."""
    path = folder / "journal.jsonl"
    return [json.loads(text) for text in path.read_bytes().split(b"\n")[:-1]] if path.exists() else []


def wait_for(folder: Path, happened: Callable[[list[dict[str, Any]]], bool]) -> None:
    end = time.monotonic() + 60
    while not happened(lines(folder)):
        assert time.monotonic() < end
        time.sleep(0.01)


def lamp_is_on(journal: list[dict[str, Any]]) -> bool:
    edges = [e["to"] for e in journal if e["event"] == "edge" and e["device"] == "lamp"]
    return edges[-1:] == ["on"]


def frames(folder: Path) -> dict[str, str]:
    return {e["frame"]: e["sha256"] for e in lines(folder) if e["event"] == "exposure"}


def on_disk(folder: Path) -> dict[str, str]:
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in (folder / "frames").iterdir()}


def fits(folder: Path) -> None:
    assert cli.main(["fit", str(folder), "--preset", "green", "-o", str(folder.parent / "m.json")]) == 0


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A decay session in which nothing went wrong."""
    folder = tmp_path_factory.mktemp("whole") / "s"
    assert measure(folder, "--seed", "7") == 0
    return folder


# ---- what a session holds


def test_a_session_is_whole_and_says_that_it_was_simulated(whole: Path) -> None:
    session = Session.open(whole)
    assert session.complete
    assert session.warnings == ()
    assert session.header.simulated is not None
    assert session.header.simulated["seed"] == 7
    assert session.header.parameters["until_s"] == 20
    assert len([f for f in session.frames if f.role == "decay"]) >= 5


def test_it_goes_through_fit(whole: Path) -> None:
    fits(whole)


def test_the_lamp_is_off_before_the_door_opens_and_each_frame_has_both_clocks(whole: Path) -> None:
    session = Session.open(whole)
    off_s = session.lamp_off_s
    assert off_s is not None
    opened = [e for e in session.edges_of("door") if e.to == "open"][-1]
    # The plan waits for the lamp's fade, 0.32 s, and the door takes 0.28 s with a jitter of some ms.
    assert opened.at_s - off_s > 0.5
    decay = session.frames_of("decay")
    assert all(f.start_s > opened.at_s for f in decay)
    # Controller and host clocks differ by an offset and 20 ppm: over a session of minutes the offset holds to 10 ms,
    # and the mapping to some more.
    offsets = [f.device_s - f.start_s for f in session.frames if f.device_s is not None]
    assert len(offsets) == len(session.frames)
    assert max(offsets) - min(offsets) < 0.05


def test_its_last_line_says_how_well_planned_instants_were_met(whole: Path) -> None:
    last = lines(whole)[-1]
    assert (last["event"], last["reason"]) == ("end", "complete")
    assert last["summary"]["planned"] == 5
    assert last["summary"]["frames"] == len(frames(whole))
    planned = [e for e in lines(whole) if "planned_mono_s" in e]
    worst = max((e["at_mono_s"] - e["planned_mono_s"] for e in planned), key=abs)
    assert last["summary"]["deviation_worst_s"] == pytest.approx(worst, abs=2e-6)


def test_json_is_one_object_with_the_summary(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert measure(tmp_path / "s", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["complete"] is True
    assert told["sessions"][0]["planned"] == 5


# ---- what is refused before anything is opened


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("measure decay --simulate green -o {full}", "already exists"),
        ("measure decay --simulate mauve -o {new}", "'mauve', which is no sample of the bench"),
        ("measure decay --rig {new}/none.toml -o {new}", "Name a rig file"),
        ("measure decay --rig {rig} -o {new} --seed 3", "simulated bench"),
        ("measure all --simulate green -o {new} --set decay.colour=3", "no parameter 'colour'"),
        ("measure all --simulate green -o {new} --set sing.loud=3", "no plan"),
        ("measure all --simulate green -o {new} --only decay --set flats.levels=3", "no plan"),
        ("measure decay --simulate green -o {new} --charge 50000", "without a break"),
        ("measure decay --rig {rig} -o {new}", "is not there (usb:ffff:0001)"),
        ("measure decay --simulate green -o {new} --fault rain@3", "names no fault"),
        ("resume {full}", "is missing"),
        ("resume {new}", "does not exist"),
    ],
)
def test_what_cannot_work_is_refused_with_nothing_left_behind(
    arguments: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    full, new, rig = tmp_path / "full", tmp_path / "new", tmp_path / "rig.toml"
    full.mkdir()
    (full / "note.txt").write_text("mine")
    rig.write_text(
        'schema = "phoslab-rig/1"\nname = "r"\n'
        '[lamp]\ndriver = "controller"\nport = "usb:ffff:0001"\n'
        '[door]\ndriver = "hand"\n'
        f'[camera]\ndriver = "drop-folder"\nfolder = "{full}"\nexposures_s = [1]\nisos = [100]\n'
    )
    assert cli.main([word.format(full=full, new=new, rig=rig) for word in arguments.split()]) == 1
    assert said in capsys.readouterr().err
    assert [p.name for p in full.iterdir()] == ["note.txt"]
    assert not new.exists()


@pytest.mark.parametrize("arguments", ["--colour 3", "--until x", "--until 0", "--spacing odd"])
def test_an_unknown_parameter_or_value_is_bad_usage(arguments: str, tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as caught:
        measure(tmp_path / "s", *arguments.split())
    assert caught.value.code == 2


def test_a_plan_that_does_not_fit_on_the_disk_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda path: type("Usage", (), {"free": 5_000_000})())
    assert measure(tmp_path / "s") == 1
    assert "frames need" in capsys.readouterr().err
    assert not (tmp_path / "s").exists()


def test_a_dry_run_prints_the_time_line_and_opens_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("a process was started"))
    assert measure(tmp_path / "s", "--dry-run", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["frames"]["decay"] == 5
    # Charge, its quarter again after metering, a trial, at most a warm-up of 15 min, 20 s of decay, two hands.
    assert 30 + 20 < told["duration_s"] < 900 + 38 + 60 + 20 + 120
    assert not (tmp_path / "s").exists()


# ---- what goes wrong while it runs


@pytest.mark.parametrize(
    ("fault", "missed"),
    [
        ("camera-busy", 0),
        ("camera-gone", 1),
        ("card-full", 0),
        ("truncated-download", 0),
        ("late-shutter", 0),
        ("serial-unplug", 0),
        ("garbled-ack", 0),
        ("lost-ack", 0),
        ("controller-reset", 0),
        ("clock-step", 0),
    ],
)
def test_a_decay_survives(fault: str, missed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At most the frame during which it happened is missing; the session is whole, and fits."""
    with_the_second_decay_frame(fault, monkeypatch)
    assert measure(tmp_path / "s") == 0
    session = Session.open(tmp_path / "s")
    assert session.complete
    planned = [e for e in lines(tmp_path / "s") if "planned_mono_s" in e]
    assert 5 - missed <= len(planned) <= 5
    parts = [e["arguments"] for e in lines(tmp_path / "s") if e["event"] == "command" and e["name"] == "part"]
    assert [p["attempt"] for p in parts] == [1, 1]
    assert frames(tmp_path / "s") == on_disk(tmp_path / "s")
    if fault == "late-shutter":
        decay = [e for e in lines(tmp_path / "s") if e["event"] == "exposure" and e["role"] == "decay"]
        late_s = [e["at_mono_s"] - e["planned_mono_s"] for e in planned]
        # The shutter opens 0.7 s after it was told, and the journal knows: the line before told it.
        told_s = max(
            e["mono_s"]
            for e in lines(tmp_path / "s")
            if e.get("name") == "capture" and e["seq"] < decay[1]["seq"]
        )
        assert decay[1]["at_mono_s"] - told_s > 0.7
        # What one shutter did is no rule: the next is not told 0.7 s earlier.
        assert min(late_s) > -0.35
    if fault == "clock-step":
        assert any("wall clock jumped" in w for w in session.warnings)
    fits(tmp_path / "s")


def with_the_second_decay_frame(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a fault happen with the exposure after the first frame of the decay, however many went before."""
    save, injected = Recorder.frame, False

    def saved(self: Recorder, *arguments: Any, **about: Any) -> str:
        nonlocal injected
        name = save(self, *arguments, **about)
        if about["role"] == "decay" and not injected:
            injected = True
            link = Link(socket_of(self.path))
            Hands(link).inject(f"{fault}@{link.ask('state')['exposures'] + 1}")
            link.close()
        return name

    monkeypatch.setattr(Recorder, "frame", saved)


def stop_bench(folder: Path) -> None:
    bench = bench_rig.find(socket_of(folder).parent)
    if bench is not None:
        bench.stop()


def socket_of(folder: Path) -> Path:
    """Of the bench on which a session is being recorded."""
    return Path(Session.open(folder).header.rig["camera"]["port"])


@pytest.mark.parametrize("fault", ["controller-reset@6", "serial-unplug@6"])
def test_a_part_whose_lamp_went_out_begins_again_and_the_first_attempt_is_kept(
    fault: str, tmp_path: Path
) -> None:
    assert measure(tmp_path / "s", "--fault", fault) == 0
    session = Session.open(tmp_path / "s")
    parts = [e["arguments"] for e in lines(tmp_path / "s") if e["event"] == "command" and e["name"] == "part"]
    assert [(p["part"], p["attempt"]) for p in parts] == [
        ("charge and decay", 1),
        ("charge and decay", 2),
        ("dark frames", 1),
    ]
    assert session.complete
    fits(tmp_path / "s")


def test_a_stuck_relay_stops_everything_and_is_said_loudly(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert measure(tmp_path / "s", "--fault", "stuck-relay@1") == 1
    told = capsys.readouterr().err
    assert "SHINES ALTHOUGH IT IS SWITCHED OFF" in told
    assert "Pull the lamp's plug" in told
    parts = [e for e in lines(tmp_path / "s") if e["event"] == "command" and e["name"] == "part"]
    assert len(parts) == 1  # not begun again
    assert not Session.open(tmp_path / "s").complete


def test_a_stuck_door_stops_the_plan_and_names_the_door(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert measure(tmp_path / "s", "--fault", "stuck-door@3") == 1  # while the lamp warms up
    told = capsys.readouterr().err
    assert "door did not become closed" in told
    assert f"phoslab resume {tmp_path / 's'}" in told
    assert not lamp_is_on(lines(tmp_path / "s"))


@pytest.mark.parametrize(
    ("fault", "code", "said"),
    [
        ("disk-full", 1, "Make room on the disk"),
        ("ctrl-c", 1, "phoslab resume"),
        ("kill", -signal.SIGKILL, ""),
    ],
)
def test_what_ends_the_program_loses_nothing_and_a_resume_completes_the_session(
    fault: str, code: int, said: str, tmp_path: Path
) -> None:
    """With the third exposure, while the lamp warms up; processes of their own, which is what these faults end."""
    folder = tmp_path / "s"
    ended = decay_in_a_process(folder, "--fault", f"{fault}@3")
    told, _ = ended.communicate(timeout=120)
    assert ended.returncode == code, told
    assert said in told
    before = frames(folder)
    assert before == on_disk(folder)  # no half of a frame
    assert not Session.open(folder).complete
    again = in_a_process("resume", folder)
    told, _ = again.communicate(timeout=120)
    assert again.returncode == 0, told
    assert Session.open(folder).complete
    assert before.items() <= frames(folder).items()
    assert frames(folder) == on_disk(folder)
    fits(folder)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 40 MB of its own."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=40m", "none", disk], capture_output=True, text=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"a file system can only be mounted by root ({mounted.stderr.strip()})")
    yield disk
    subprocess.run(["umount", "--lazy", disk], check=True)


def test_a_file_system_that_something_else_fills_stops_the_plan_and_a_resume_completes_it(
    small_disk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """To the last byte, between the check of its space and the writing of a frame."""
    save, ballast = Recorder.frame, small_disk / "ballast"

    def filling(self: Recorder, *arguments: Any, **about: Any) -> str:
        if about["role"] == "decay" and not ballast.exists():
            with contextlib.suppress(OSError), ballast.open("wb", buffering=0) as full:
                while True:
                    full.write(bytes(4096))
        return save(self, *arguments, **about)

    monkeypatch.setattr(Recorder, "frame", filling)
    session = small_disk / "s"
    assert measure(session) == 1
    told = capsys.readouterr().err
    assert "No space left on device" in told
    assert f"phoslab resume {session}" in told
    before = frames(session)
    assert before == on_disk(session)  # no half of the frame that did not fit
    ballast.unlink()
    monkeypatch.undo()
    assert cli.main(["resume", str(session)]) == 0
    assert before.items() <= frames(session).items()
    assert frames(session) == on_disk(session)
    fits(session)


# ---- how it ends, and goes on


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_leaves_the_lamp_off_and_the_session_interrupted(
    number: signal.Signals, tmp_path: Path
) -> None:
    process = decay_in_a_process(tmp_path / "s")
    wait_for(tmp_path / "s", lamp_is_on)
    process.send_signal(number)
    told, _ = process.communicate(timeout=60)
    assert process.returncode == 1
    assert f"phoslab resume {tmp_path / 's'}" in told
    journal = lines(tmp_path / "s")
    assert not lamp_is_on(journal)
    assert (journal[-1]["event"], journal[-1]["reason"]) == ("end", "interrupted")
    assert frames(tmp_path / "s") == on_disk(tmp_path / "s")


def test_the_lamp_goes_off_by_itself_when_the_program_is_killed_and_a_resume_completes_the_session(
    tmp_path: Path,
) -> None:
    process = decay_in_a_process(tmp_path / "s")
    wait_for(tmp_path / "s", lambda journal: lamp_is_on(journal) and bool(frames(tmp_path / "s")))
    bench = Link(socket_of(tmp_path / "s"))
    pid = json.loads((bench.path.parent / "endpoints.json").read_text())["pid"]
    assert bench.ask("state")["current"] is True
    process.kill()
    killed = time.monotonic()
    process.communicate(timeout=60)
    while bench.ask("state")["current"]:
        # The controller's watchdog waits for 2 s; half a second is for what is on its way.
        assert time.monotonic() - killed < 2.5
        time.sleep(0.02)
    bench.close()
    before = frames(tmp_path / "s")
    assert cli.main(["resume", str(tmp_path / "s")]) == 0
    session = Session.open(tmp_path / "s")
    assert session.complete
    assert before.items() <= frames(tmp_path / "s").items()
    assert frames(tmp_path / "s") == on_disk(tmp_path / "s")
    parts = [e["arguments"] for e in lines(tmp_path / "s") if e["event"] == "command" and e["name"] == "part"]
    assert [p["attempt"] for p in parts] == [1, 2, 1]
    (word,) = (e["text"] for e in lines(tmp_path / "s") if e["event"] == "note" and "goes on on" in e["text"])
    assert word == f"goes on on the same simulated bench (process {pid}), which has outlived its host"
    # One clock from the first line to the last: no other bench's, and no guess at how long it was away.
    assert max(b - a for a, b in offsets(session)) < 0.05
    fits(tmp_path / "s")


def offsets(session: Session) -> list[tuple[float, float]]:
    """From line to line, by how much the wall clock is ahead of the session's."""
    ahead = [datetime.fromisoformat(e.wall).timestamp() - e.mono_s for e in session.events]
    return list(pairwise(ahead))


def test_a_lamp_that_is_still_off_is_not_switched_off_by_a_resume(tmp_path: Path) -> None:
    """Killed after its last decay frame, a session counts its times from the moment before the first."""
    folder = tmp_path / "s"
    process = decay_in_a_process(folder)
    wait_for(folder, lambda journal: any("dark frames" in str(e) for e in journal))
    process.kill()
    process.communicate(timeout=60)
    assert cli.main(["resume", str(folder)]) == 0
    session = Session.open(folder)
    assert session.complete
    lamp = [e.to for e in session.edges_of("lamp")]
    assert lamp == ["on", "off"] * (len(lamp) // 2)
    assert session.lamp_off_s is not None
    assert session.lamp_off_s < min(f.start_s for f in session.frames_of("decay"))
    fits(folder)


def test_a_second_process_is_refused_and_disturbs_nothing(tmp_path: Path) -> None:
    first = decay_in_a_process(tmp_path / "s")
    wait_for(tmp_path / "s", lamp_is_on)
    second = in_a_process("resume", tmp_path / "s")
    told, _ = second.communicate(timeout=60)
    assert second.returncode == 1
    assert f"in use by process {first.pid}" in told
    first.communicate(timeout=120)
    assert first.returncode == 0
    assert Session.open(tmp_path / "s").complete


def test_a_complete_session_is_not_measured_again(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (whole / "journal.jsonl").read_bytes()
    assert cli.main(["resume", str(whole)]) == 1
    told = capsys.readouterr().err
    assert "is complete" in told
    assert "To go on" not in told
    assert (whole / "journal.jsonl").read_bytes() == before


ALL = (
    *("--only", "lvf,decay,excitation"),
    *("--set", "lvf.filters=L002,L201", "--set", "lvf.darks=1"),
    *("--set", "decay.charge_s=30", "--set", "decay.until_s=10", "--set", "decay.darks=1"),
    *("--set", "excitation.dark_s=600", "--set", "excitation.last_s=4", "--set", "excitation.between=0"),
    *("--set", "excitation.darks=1"),
)


def test_measure_all_killed_at_any_moment_and_resumed_loses_and_overwrites_nothing(tmp_path: Path) -> None:
    """Five kills between moments that the journal shows; tests/benchmarks/kill_and_resume.py makes fifty at random."""
    folder = tmp_path / "all"
    kept: dict[tuple[str, str], str] = {}
    command: tuple[str | Path, ...] = ("measure", "all", "--simulate", "green", "-o", folder, *ALL)
    n_lines = 0
    for _ in range(5):
        process = in_a_process(*command)
        end = time.monotonic() + 60
        # Some more lines than there were; which one is being written then is chance.
        while process.poll() is None and total(folder) < n_lines + 37 and time.monotonic() < end:
            time.sleep(0.002)
        process.kill()
        process.communicate(timeout=60)
        command = ("resume", folder)
        n_lines = total(folder)
        keep(folder, kept)
    assert n_lines > 5 * 30
    last = in_a_process(*command)
    told, _ = last.communicate(timeout=240)
    assert last.returncode == 0, told
    keep(folder, kept)
    sessions = [Session.open(folder / name) for name in ("01-lvf", "02-decay", "03-excitation")]
    assert all(s.complete for s in sessions)
    for session in sessions:
        begun = [e.fields["arguments"] for e in session.events if e.fields.get("name") == "part"]
        done = {e.fields["command"] for e in session.events if e.event == "ack" and e.fields["ok"]}
        finished = [
            e.fields["arguments"]["part"]
            for e in session.events
            if e.fields.get("name") == "part" and e.seq in done
        ]
        assert len(finished) == len(set(finished)), "a finished part was done again"
        assert {b["part"] for b in begun} == set(finished)
    roles = {f.role for f in sessions[0].frames}
    assert {"mercury", "led", "filter:L002", "filter:L201", "dark"} <= roles
    fits(folder / "02-decay")


def total(folder: Path) -> int:
    return sum(p.read_bytes().count(b"\n") for p in folder.glob("*/journal.jsonl"))


def keep(folder: Path, kept: dict[tuple[str, str], str]) -> None:
    """Every frame that was ever acknowledged is there, with the content that it had."""
    for session in folder.glob("[0-9]*"):
        for name, digest in frames(session).items():
            assert kept.setdefault((session.name, name), digest) == digest
    for (session_name, name), digest in kept.items():
        assert hashlib.sha256((folder / session_name / "frames" / name).read_bytes()).hexdigest() == digest


def test_an_excitation_series_goes_on_at_the_next_time_after_a_rest_in_the_dark(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    arguments = ("--dark", "1000", "--last", "8", "--between", "0", "--darks", "1")
    process = in_a_process("measure", "excitation", "--simulate", "green", "-o", folder, *arguments)

    def third_is_lit(journal: list[dict[str, Any]]) -> bool:
        begun = [e["arguments"]["part"] for e in journal if e["event"] == "command" and e["name"] == "part"]
        return begun[-1:] == ["4 s of light"]

    wait_for(folder, third_is_lit)
    process.kill()
    process.communicate(timeout=60)
    stop_bench(folder)
    again = in_a_process("resume", folder)
    said, _ = again.communicate(timeout=120)
    assert again.returncode == 0, said
    session = Session.open(folder)
    (resumed,) = (e for e in session.events if e.event == "resume")
    assert any("has gone meanwhile" in str(e.fields.get("text")) for e in session.events)
    begun = [
        (e.fields["arguments"]["part"], e.fields["arguments"]["attempt"])
        for e in session.events
        if e.fields.get("name") == "part"
    ]
    assert begun[:4] == [("1 s of light", 1), ("2 s of light", 1), ("4 s of light", 1), ("4 s of light", 2)]
    lit_again = min(e.at_s for e in session.edges_of("lamp") if e.to == "on" and e.at_s > resumed.mono_s)
    assert lit_again - resumed.mono_s >= 1000


@pytest.fixture(autouse=True)
def no_bench_is_left(tmp_path: Path) -> Iterator[None]:
    """Benches of killed hosts end by themselves; stop them here rather than let them linger."""
    yield
    for file in tmp_path.rglob("session.toml"):
        with contextlib.suppress(KeyError, OSError, phoslab.errors.PhoslabError):
            stop_bench(file.parent)
