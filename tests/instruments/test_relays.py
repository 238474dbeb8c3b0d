"""Relay boards as lamps, and the guardian that switches them off when the host cannot."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial
from boards import HERE, BoardProcess, eventually, raises_soon, same_phoslab
from contracts import LATE_S, LampContract

from phoslab.errors import PhoslabError
from phoslab.instruments.devices import DeviceError, DeviceGoneError, DeviceTimeoutError
from phoslab.instruments.relays import KINDS, RelayLamp


@pytest.fixture(params=sorted(KINDS))
def board(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[BoardProcess]:
    running = BoardProcess(
        [sys.executable, str(HERE / "relay_board.py"), request.param], tmp_path / "relay-port"
    )
    running.kind = request.param
    yield running
    running.close()


@pytest.fixture
def lamp(board: BoardProcess) -> Iterator[RelayLamp]:
    lamp = RelayLamp(board.port, board.kind, accept_no_failsafe=True)
    yield lamp
    lamp.unstage()


@pytest.fixture
def shines(board: BoardProcess) -> Callable[[], bool]:
    return lambda: bool(board.level("lamp"))


class TestLampContract(LampContract):
    pass


def test_a_board_without_a_watchdog_must_be_accepted() -> None:
    with pytest.raises(DeviceError, match="accept_no_failsafe"):
        RelayLamp("/dev/null", "lcus-1", accept_no_failsafe=False)
    assert RelayLamp("/dev/null", "lcus-1", accept_no_failsafe=True).failsafe is False


def test_an_unknown_kind_is_refused_with_those_that_are_known() -> None:
    with pytest.raises(DeviceError, match="lcus-1, kmtronic"):
        RelayLamp("/dev/null", "lcus-8", accept_no_failsafe=True)


def test_a_pulled_cable_is_an_error_that_says_to_look_at_the_lamp(
    board: BoardProcess, lamp: RelayLamp
) -> None:
    lamp.stage()
    lamp.set("on").wait(5)
    board.do("unplug")
    status = lamp.set("off")
    with pytest.raises(DeviceGoneError, match="Look at the lamp"):
        status.wait(5)
    with pytest.raises(DeviceGoneError):
        lamp.read()
    lamp.unstage()
    with pytest.raises(PhoslabError, match="is not there"):
        lamp.stage()
    board.do("plug")
    lamp.stage()
    assert eventually(lambda: not board.level("lamp"))  # staging has switched it off


def test_a_board_that_can_say_how_its_relay_stands_is_believed(board: BoardProcess, lamp: RelayLamp) -> None:
    """A KMTronic board whose supply failed for a moment has forgotten that it was told on; LCUS-1 cannot tell."""
    lamp.stage()
    lamp.set("on").wait(5)
    board.pin("lamp", 1)
    board.do("reset")
    assert lamp.read()[lamp.name]["value"] == {"kmtronic": "off", "lcus-1": "on"}[board.kind]


@pytest.mark.parametrize("board", ["kmtronic"], indirect=True)
def test_a_board_that_does_not_answer_is_a_time_out_with_device_command_and_time(
    board: BoardProcess, lamp: RelayLamp
) -> None:
    lamp.stage()
    board.do("dumb on")
    with pytest.raises(DeviceTimeoutError, match=r"lamp did not do 'say how its relay stands' within 0\.5 s"):
        lamp.read()
    board.do("dumb off")
    lamp.read()  # one lost answer is no reason to give the lamp up


def test_a_second_user_is_told_who_has_the_port(board: BoardProcess, lamp: RelayLamp) -> None:
    lamp.stage()
    with pytest.raises(DeviceGoneError, match=f"in use by process {os.getpid()}"):
        RelayLamp(board.port, board.kind, accept_no_failsafe=True).stage()


def test_a_port_that_takes_nothing_is_a_time_out_with_device_command_and_time(
    board: BoardProcess, lamp: RelayLamp
) -> None:
    lamp.stage()
    os.kill(board.pid, signal.SIGSTOP)
    assert lamp._line is not None
    with contextlib.suppress(serial.SerialTimeoutException):
        while True:  # until the system holds no more for a reader that does not read
            lamp._line.write(b"\0")
    status = lamp.set("off")
    os.kill(board.pid, signal.SIGCONT)
    with pytest.raises(DeviceTimeoutError, match="lamp did not do 'set off' within 1 s"):
        status.wait(5)


HOST = """
import sys, time
from phoslab.instruments.relays import RelayLamp
lamp = RelayLamp(sys.argv[1], sys.argv[2], accept_no_failsafe=True)
lamp.stage()
lamp.allow_until(time.monotonic() + 600)
lamp.set("on").wait(9)
print(lamp._guardian.pid, flush=True)
time.sleep(600)
"""


@pytest.fixture
def host(board: BoardProcess) -> Iterator[subprocess.Popen[str]]:
    """Another process, which has switched the lamp on; its first line is the guardian's PID."""
    running = subprocess.Popen(
        [sys.executable, "-c", HOST, board.port, board.kind],
        stdout=subprocess.PIPE,
        text=True,
        env=same_phoslab(),
    )
    yield running
    running.kill()
    running.wait()
    assert running.stdout is not None
    running.stdout.close()


def guardian_pid(host: subprocess.Popen[str]) -> int:
    assert host.stdout is not None
    return int(host.stdout.readline())


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGSTOP])
def test_the_guardian_switches_off_when_the_host_dies_or_stands_still(
    board: BoardProcess, host: subprocess.Popen[str], number: signal.Signals
) -> None:
    guardian = guardian_pid(host)
    board.pin("lamp", 1)
    host.send_signal(number)
    struck_s = time.monotonic()
    assert board.pin("lamp", 0).mono_s - struck_s < 2.0 + LATE_S
    if number != signal.SIGSTOP:
        assert eventually(lambda: not _lives(guardian))  # and it does not stay behind


def test_a_host_that_stood_still_learns_that_the_lamp_is_off(board: BoardProcess, lamp: RelayLamp) -> None:
    """As when the computer sleeps: the guardian has switched off, and the lamp must not be thought on."""
    lamp.stage()
    lamp.allow_until(time.monotonic() + 600)
    lamp.set("on").wait(5)
    with lamp._lock:  # no heartbeat meanwhile
        assert board.pin("lamp", 0).value == 0
    raises_soon(lamp.read, "by its guardian")


def test_ctrl_c_in_the_terminal_does_not_end_the_guardian(
    board: BoardProcess, host: subprocess.Popen[str]
) -> None:
    guardian = guardian_pid(host)
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        os.kill(guardian, number)
    time.sleep(0.2)
    assert _lives(guardian)
    assert os.getpgid(guardian) != os.getpgid(host.pid)
    host.kill()
    assert board.pin("lamp", 0)


def test_a_lamp_without_its_guardian_goes_out(board: BoardProcess, lamp: RelayLamp) -> None:
    lamp.stage()
    lamp.allow_until(time.monotonic() + 600)
    lamp.set("on").wait(5)
    board.pin("lamp", 1)
    assert lamp._guardian is not None
    lamp._guardian.kill()
    board.pin("lamp", 0)
    raises_soon(lamp.read, "guardian")
    with pytest.raises(DeviceError, match="guardian"):
        lamp.set("on")
    lamp.stage()
    lamp.set("on").wait(5)
    board.pin("lamp", 1, after=2)


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
