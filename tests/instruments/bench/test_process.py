"""The bench as a process: one clock, a controller on a pseudo-terminal, and an end of its own."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from benches import Laboratory, laboratory
from boards import eventually
from contracts import DoorContract, LampContract

from phoslab.errors import PhoslabError
from phoslab.instruments import rig_parts
from phoslab.instruments.bench import rig
from phoslab.instruments.controller import RigController, RigDoor, RigLamp
from phoslab.instruments.devices import Clock, DeviceError, DeviceGoneError, DeviceTimeoutError
from phoslab.instruments.recorder import Recorder
from phoslab.instruments.simulated import BenchClock, Link
from phoslab.instruments.system_clock import SystemClock

HEADER = {
    "plan": {"name": "check", "parameters": {}},
    "sample": {"name": "none"},
    "camera": {"make": "a", "model": "b"},
    "software": {"phoslab": "0"},
}


@pytest.fixture(scope="module")
def lab() -> Iterator[Laboratory]:
    with rig.start("green", seed=3) as bench:
        yield laboratory(bench)


@pytest.fixture
def controller(lab: Laboratory) -> Iterator[RigController]:
    made = RigController(lab.bench.port, clock=lab.clock)
    yield made
    for device in (made.lamp, made.door):
        device.unstage()
    lab.hands.repair()


def trouble_of(controller: RigController) -> DeviceError | None:
    """What the lamp's reading raises, at the latest after three seconds."""
    raised: list[DeviceError] = []

    def asked() -> bool:
        try:
            controller.lamp.read()
        except DeviceError as error:
            raised.append(error)
        return bool(raised)

    eventually(asked, 3)
    return raised[0] if raised else None


# --- the controller's contracts, in the bench's time at rate 1 ---


class TestLamp(LampContract):
    """See LampContract."""

    @pytest.fixture
    def lamp(self, lab: Laboratory) -> Iterator[RigLamp]:
        made = RigController(lab.bench.port)  # in real time, as the contract's own clock is
        yield made.lamp
        made.lamp.unstage()

    @pytest.fixture
    def shines(self, lab: Laboratory):  # type: ignore[no-untyped-def]
        return lambda: lab.state()["current"]


class TestDoor(DoorContract):
    """See DoorContract."""

    @pytest.fixture
    def door(self, lab: Laboratory) -> Iterator[RigDoor]:
        made = RigController(lab.bench.port)
        yield made.door
        made.door.unstage()


# --- time ---


def test_four_hours_pass_in_a_moment_for_every_clock(lab: Laboratory, controller: RigController) -> None:
    controller.door.stage()
    clock: Clock = controller.clock
    before = lab.clock.mono_s(), lab.clock.wall(), clock.device_s()
    begin = time.monotonic()
    lab.clock.sleep_until(before[0] + 4 * 3600)
    real_s = time.monotonic() - begin
    controller.status()
    passed_s = lab.clock.mono_s() - before[0]
    assert 4 * 3600 <= passed_s < 4 * 3600 + real_s + 5
    assert (lab.clock.wall() - before[1]).total_seconds() == pytest.approx(passed_s, abs=1)
    assert before[2] is not None
    # The controller's clock is 20 ppm fast: 0.29 s in four hours; an exchange dates it to some ms.
    device_s = clock.device_s()
    assert device_s is not None
    assert device_s - before[2] == pytest.approx(lab.clock.mono_s() - before[0], abs=1)


def test_the_clock_reads_the_same_from_two_places_and_never_goes_back(lab: Laboratory) -> None:
    other = BenchClock(lab.bench.folder, lab.link)
    last = lab.clock.mono_s()
    for clock in (other, lab.clock) * 50:
        now = clock.mono_s()
        assert now >= last
        last = now
        lab.clock.sleep_until(now + 0.5)
    lab.clock.sleep_until(last - 100)  # long past: no jump back
    assert lab.clock.mono_s() >= last


def test_a_jump_of_an_hour_is_no_silence_of_the_host_and_a_promise_is_in_simulated_time(
    lab: Laboratory, controller: RigController
) -> None:
    controller.lamp.stage()
    now = lab.clock.mono_s()
    controller.lamp.allow_until(now + 1700)
    controller.lamp.set("on").wait(5)
    lab.clock.sleep_until(now + 1600)
    assert controller.status()["lamp"] == "ON"
    lab.clock.sleep_until(now + 1700)
    assert eventually(lambda: not lab.state()["current"], 5)


def test_the_controllers_own_limits_act_in_the_middle_of_a_jump_and_at_their_moment(lab: Laboratory) -> None:
    controller = RigController(lab.bench.port, clock=lab.clock, max_on_s=600)
    controller.lamp.stage()
    now = lab.clock.mono_s()
    controller.lamp.allow_until(now + 4000)
    controller.lamp.set("on").wait(5)
    on_s = controller.lamp.read()["lamp"]["device_s"]
    lab.clock.sleep_until(now + 3600)
    status = controller.status()
    assert (status["lamp"], status["why"]) == ("OFF", "MAXON")
    assert on_s is not None
    # The controller looks once a pass of the jump, at the microsecond after its limit.
    assert int(status["since"]) / 1e6 - on_s == pytest.approx(600, abs=1e-3)
    controller.lamp.unstage()


# --- ends ---

HOST = """
import json, sys, time
sys.path[:] = json.loads(sys.argv[1])
from pathlib import Path
from phoslab.instruments.bench import rig
from phoslab.instruments.controller import RigController
from phoslab.instruments.simulated import BenchClock, Link
bench = rig.find(Path(sys.argv[2]))
clock = BenchClock(bench.folder, Link(bench.socket))
controller = RigController(bench.port, clock=clock)
controller.lamp.stage()
controller.lamp.allow_until(clock.mono_s() + 5400)
controller.lamp.set("on").wait(5)
print("on", flush=True)
time.sleep(60)
"""


def test_the_lamp_goes_out_when_the_host_is_killed_and_a_new_host_finds_the_bench(tmp_path: Path) -> None:
    import json

    with rig.start("green", folder=tmp_path / "bench") as bench:
        link = Link(bench.socket)
        host = subprocess.Popen(
            [sys.executable, "-c", HOST, json.dumps(sys.path), str(bench.folder)],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert host.stdout is not None
        assert host.stdout.readline() == "on\n"
        assert link.ask("state")["current"]
        host.kill()
        died = time.monotonic()
        while link.ask("state")["current"] and time.monotonic() - died < 10:
            time.sleep(0.01)
        # The heartbeat keeps it on for 2 s after the last beat; half a second is for a busy machine.
        assert time.monotonic() - died < 2.5
        host.wait()
        again = rig.find(bench.folder)
        assert again is not None
        assert again.pid == bench.pid


def test_a_bench_without_a_host_ends_by_itself_and_takes_its_folder_along() -> None:
    bench = rig.start("green", linger_s=0.5)
    folder = bench.folder
    with contextlib.closing(Link(bench.socket)):
        time.sleep(1.5)
        assert rig.find(folder) is not None
    assert eventually(lambda: not folder.exists(), 10)
    assert rig.find(folder) is None
    bench.stop()


def test_a_bench_that_is_told_to_end_does_so_whatever_it_is_doing() -> None:
    """Hosts come and go all the while, so that the signal meets it within a request."""
    bench = rig.start("green")

    ended = threading.Event()

    def come_and_go() -> None:
        while not ended.is_set():
            with contextlib.suppress(DeviceGoneError):  # more than it takes at once
                Link(bench.socket).close()

    hosts = [threading.Thread(target=come_and_go) for _ in range(4)]
    for host in hosts:
        host.start()
    time.sleep(0.2)
    os.kill(bench.pid, signal.SIGTERM)
    try:
        assert eventually(lambda: not bench.folder.exists(), 10)
    finally:
        ended.set()
        bench.stop()


def test_ctrl_c_is_for_the_host(lab: Laboratory) -> None:
    os.kill(lab.bench.pid, signal.SIGINT)
    time.sleep(0.2)
    assert lab.state()["ok"]


def test_a_bench_that_was_killed_is_named_and_a_new_one_goes_on_where_time_has_got_to(tmp_path: Path) -> None:
    bench = rig.start("green", folder=tmp_path / "a")
    lab = laboratory(bench)
    os.kill(bench.pid, signal.SIGKILL)
    bench.stop()
    with pytest.raises(DeviceGoneError, match="its process has ended"):
        lab.clock.sleep_until(1e6)
    assert lab.clock.mono_s() > 0  # a program can still say when that was
    at = datetime(2026, 3, 1, 12, 0, tzinfo=UTC)
    with rig.start("green", folder=tmp_path / "b", at=at, mono_s=7200.0) as second:
        clock = laboratory(second).clock
        assert 7200 <= clock.mono_s() < 7260
        assert timedelta(0) <= clock.wall() - at < timedelta(seconds=60)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"sample": "stickers"}, "no sample of the bench.*green"),
        ({"sample": "green", "faults": ["camera-lazy@3"]}, "names no fault.*camera-busy"),
    ],
)
def test_what_cannot_be_simulated_is_refused_with_what_can(arguments: dict, words: str) -> None:  # type: ignore[type-arg]
    with pytest.raises(PhoslabError, match=words):
        rig.start(**arguments)


def test_a_stranger_on_the_socket_does_no_harm(lab: Laboratory) -> None:
    import socket

    for line in (b"\n", b"nonsense\n", b"[]\n", b'{"do": 3}\n', b'{"do": "place"}\n', b"x" * 200_000 + b"\n"):
        with socket.socket(socket.AF_UNIX) as stranger:
            stranger.settimeout(10)
            stranger.connect(str(lab.bench.socket))
            with contextlib.suppress(OSError):
                stranger.sendall(line)
                answer = stranger.recv(1000)
                assert answer == b"" or b'"ok": false' in answer
    assert lab.state()["ok"]


# --- faults of the controller and its cable, at the driver ---


@pytest.mark.parametrize("fault", ["garbled-ack", "lost-ack"])
def test_a_reply_that_does_not_arrive_costs_a_repetition_and_nothing_else(
    lab: Laboratory, controller: RigController, fault: str
) -> None:
    controller.door.stage()
    lab.hands.inject(fault)
    controller.door.set("open").wait(10)
    assert lab.state()["door"] == 1.0
    controller.door.set("closed").wait(10)
    assert lab.state()["door"] == 0.0


def test_a_reset_of_the_controller_is_noticed_and_staging_recovers(
    lab: Laboratory, controller: RigController
) -> None:
    controller.lamp.stage()
    controller.lamp.set("on").wait(5)
    lab.hands.inject("controller-reset")
    assert not lab.state()["current"]
    assert "has been reset" in str(trouble_of(controller))
    controller.lamp.stage()
    controller.lamp.set("on").wait(5)
    assert lab.state()["current"]


def test_a_cable_that_comes_back_under_another_path_is_found_again(
    lab: Laboratory, controller: RigController
) -> None:
    controller.lamp.stage()
    controller.lamp.set("on").wait(5)
    before = Path(lab.bench.port).resolve()
    lab.hands.inject("serial-unplug")
    trouble = trouble_of(controller)
    assert isinstance(trouble, DeviceGoneError)
    assert "rig has gone" in str(trouble)
    assert eventually(lambda: not lab.state()["current"], 5)  # nobody tells the controller to go on
    assert eventually(lambda: Path(lab.bench.port).exists(), 5)
    assert Path(lab.bench.port).resolve() != before
    controller.lamp.stage()
    assert controller.lamp.read()["lamp"]["value"] == "off"


def test_a_cable_that_is_pulled_again_while_it_is_out_comes_back_all_the_same(
    lab: Laboratory, controller: RigController
) -> None:
    for _ in range(2):
        lab.hands.inject("serial-unplug")
    assert eventually(lambda: Path(lab.bench.port).exists(), 5)
    controller.lamp.stage()
    assert controller.lamp.read()["lamp"]["value"] == "off"


def test_a_bench_whose_controller_breaks_down_ends() -> None:
    """A folder that is gone is one way: a cable cannot be plugged in again there."""
    bench = rig.start("green")
    lab = laboratory(bench)
    lab.hands.inject("serial-unplug")
    shutil.rmtree(bench.folder)
    try:
        assert eventually(lambda: not rig._alive(bench.pid), 10)
    finally:
        bench.stop()


def test_a_stuck_door_is_an_error_until_it_is_repaired(lab: Laboratory, controller: RigController) -> None:
    controller.door.stage()
    controller.door.set("closed").wait(10)
    lab.hands.inject("stuck-door")
    with pytest.raises(DeviceError, match="door did not become open"):
        controller.door.set("open").wait(10)
    assert lab.state()["door"] == 0.0
    lab.hands.repair()
    controller.door.stage()
    controller.door.set("open").wait(10)
    controller.door.set("closed").wait(10)


def test_the_doors_time_out_counts_on_the_controllers_clock_as_its_own_limit_does(
    lab: Laboratory, controller: RigController, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which a jump sets forward here, and which a busy machine slows down under simavr."""
    monkeypatch.setattr(rig_parts, "DOOR_S", 1.5)
    controller.door.stage()
    controller.door.set("closed").wait(60)
    lab.hands.inject("stuck-door")
    moving = controller.door.set("open")
    assert eventually(lambda: controller.status()["drive"] == "OPEN")
    # By the machine's clock the controller's limit of 3 s would be there first, after 1.4 s.
    lab.clock.sleep_until(lab.clock.mono_s() + 1.6)
    with pytest.raises(DeviceTimeoutError, match=r"door did not do 'DOOR OPEN' within 1\.5 s"):
        moving.wait(60)


def test_a_stuck_relay_is_an_alarm_and_the_other_relay_opens(
    lab: Laboratory, controller: RigController
) -> None:
    alarms: list[DeviceError] = []
    controller.subscribe(alarms.append)
    controller.lamp.stage()
    lab.hands.inject("stuck-relay")
    assert not lab.state()["current"]  # it sticks once it has been closed, not before
    controller.lamp.set("on").wait(5)
    controller.lamp.set("off").wait(5)
    assert lab.state()["current"]
    assert eventually(lambda: not lab.state()["current"], 5)
    assert eventually(lambda: any("ALTHOUGH" in str(alarm) for alarm in alarms), 5)
    with pytest.raises(DeviceError, match="SHINES ALTHOUGH"):
        controller.lamp.read()


def test_a_second_process_is_refused_session_and_port_and_disturbs_neither(tmp_path: Path) -> None:
    """It is another program on the same bench, that does what a resume does."""
    session = tmp_path / "s"
    with (
        rig.start("green", session=session) as bench,
        Recorder(session, HEADER, SystemClock()) as recorder,
    ):
        lab = laboratory(bench)
        controller = RigController(bench.port, clock=lab.clock)
        lab.camera.stage()
        controller.lamp.stage()
        controller.lamp.set("on").wait(5)
        controller.lamp.allow_until(lab.clock.mono_s() + 60)
        journal = (session / "journal.jsonl").read_bytes()
        lab.hands.inject("second-process")
        word = bench.folder / "rival.json"
        assert eventually(word.exists, 30)
        told = json.loads(word.read_text())
        mine = f"is in use by process {os.getpid()}"
        assert mine in told["session"]
        assert mine in told["port"]
        assert lab.state()["current"]  # no greeting has switched it off
        assert (session / "journal.jsonl").read_bytes() == journal
        recorder.note("and goes on")
        controller.lamp.unstage()


def test_a_step_of_the_wall_clock_leaves_the_others_alone(lab: Laboratory) -> None:
    before = lab.clock.mono_s(), lab.clock.wall()
    lab.hands.inject("clock-step")
    after = lab.clock.mono_s(), lab.clock.wall()
    assert (after[1] - before[1]).total_seconds() - (after[0] - before[0]) == pytest.approx(3600, abs=0.1)
    assert after[0] - before[0] < 60


def test_a_fault_happens_at_its_moment_also_in_a_jump(tmp_path: Path) -> None:
    with rig.start("green", faults=["clock-step@90s"]) as bench:
        clock = laboratory(bench).clock
        start = clock.wall() - timedelta(seconds=clock.mono_s())
        clock.sleep_until(80)
        assert clock.wall() - start < timedelta(seconds=90)
        clock.sleep_until(100)
        assert clock.wall() - start > timedelta(seconds=3690)
