"""The rig controller's driver: the contracts of lamp and door, and every fault of board and line.

All of it runs on the simulated controller and on the firmware under simavr.
"""

from __future__ import annotations

import contextlib
import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial
from boards import BoardProcess, eventually, raises_soon, same_phoslab
from contracts import LATE_S, DoorContract, LampContract

from phoslab.errors import PhoslabError
from phoslab.instruments import link, rig_parts, wire
from phoslab.instruments.controller import RigController, RigDoor, RigLamp
from phoslab.instruments.devices import DeviceError, DeviceGoneError, DeviceTimeoutError


@pytest.fixture
def rig(board: BoardProcess) -> Iterator[RigController]:
    rig = RigController(board.port, max_on_s=60.0, settle_s=0.3)
    yield rig
    rig.lamp.unstage()
    rig.door.unstage()


@pytest.fixture
def lamp(rig: RigController) -> RigLamp:
    return rig.lamp


@pytest.fixture
def door(rig: RigController) -> RigDoor:
    return rig.door


@pytest.fixture
def shines(board: BoardProcess) -> Callable[[], bool]:
    return lambda: bool(board.level("lamp") and board.level("main"))


class TestLampContract(LampContract):
    pass


class TestDoorContract(DoorContract):
    pass


@pytest.fixture
def troubles(rig: RigController) -> list[DeviceError]:
    told: list[DeviceError] = []
    rig.subscribe(told.append)
    return told


@pytest.mark.parametrize("fault", ["garble-replies", "lose-replies", "garble-requests", "lose-requests"])
def test_a_garbled_or_lost_line_is_made_good_and_nothing_is_done_twice(
    board: BoardProcess, lamp: RigLamp, fault: str
) -> None:
    lamp.stage()
    for value in ("on", "off", "on", "off"):
        board.do(f"{fault} 2")
        lamp.set(value).wait(10)  # type: ignore[arg-type]
        assert lamp.read()["lamp"]["value"] == value
    assert eventually(lambda: len([p for p in board.pins if p.name == "lamp"]) == 4)
    assert [pin.value for pin in board.pins if pin.name == "lamp"] == [1, 0, 1, 0]


def test_a_time_out_names_device_command_and_time(board: BoardProcess, lamp: RigLamp) -> None:
    lamp.stage()
    board.do("lose-requests 1000000")
    # The heartbeat may be the first to notice; the lamp is then not even tried.
    with pytest.raises(
        DeviceTimeoutError, match=r"rig did not do '(LAMP ON 2000|PING 0)' within \d(\.\d)? s"
    ):
        lamp.set("on").wait(20)
    board.do("lose-requests 0")


def test_a_host_that_is_not_heard_any_more_loses_the_lamp(
    board: BoardProcess, lamp: RigLamp, troubles: list[DeviceError]
) -> None:
    lamp.stage()
    lamp.allow_until(time.monotonic() + 60)
    lamp.set("on").wait(5)
    cut_s = board.now_s()
    board.do("lose-requests 1000000")
    assert board.pin("lamp", 0).board_us * 1e-6 - cut_s < 2.0 + LATE_S
    board.do("lose-requests 0")
    assert eventually(lambda: bool(troubles), 10)


def test_a_stuck_relay_cannot_be_missed(
    board: BoardProcess, lamp: RigLamp, door: RigDoor, troubles: list[DeviceError]
) -> None:
    lamp.stage()
    door.stage()
    lamp.set("on").wait(5)
    time.sleep(0.3)
    board.do("relay stuck")
    lamp.set("off").wait(5)
    raises_soon(lamp.read, "SHINES ALTHOUGH IT IS SWITCHED OFF")
    assert ["SHINES" in str(error) for error in troubles] == [True]  # told, and told once
    board.pin("main", 0)
    for call in (lamp.read, door.read, lambda: door.set("open"), lambda: lamp.set("on")):
        with pytest.raises(DeviceError, match="SHINES"):
            call()
    lamp.set("off").wait(5)
    lamp.stage()  # somebody says that it is mended; it is not
    raises_soon(lamp.read, "SHINES")


def test_an_alarm_that_many_hear_at_once_is_told_once(
    board: BoardProcess, rig: RigController, lamp: RigLamp, troubles: list[DeviceError]
) -> None:
    """Each time that the controller says it, a thread hears; the heartbeat does, too."""
    lamp.stage()
    lamp.set("on").wait(5)
    time.sleep(0.3)
    board.do("relay stuck")
    lamp.set("off").wait(5)
    with rig.state:  # so that all wait for one another
        assert eventually(lambda: len(_waiting()) >= 2, 10.0)
    assert eventually(lambda: not _waiting())
    raises_soon(lamp.read, "SHINES")
    assert ["SHINES" in str(error) for error in troubles] == [True]


def _waiting() -> list[threading.Thread]:
    """Those that have heard an alarm and not dealt with it yet."""
    return [thread for thread in threading.enumerate() if "_on_alarm" in thread.name]


def test_a_stuck_relay_does_not_hide_behind_other_trouble(board: BoardProcess, lamp: RigLamp) -> None:
    lamp.stage()
    board.do("relay stuck")
    lamp.allow_until(time.monotonic() + 0.3)
    lamp.set("on").wait(5)
    raises_soon(lamp.read, "promise")
    assert eventually(lambda: board.level("main") == 0)
    assert eventually(lambda: "SHINES" in str(_raised(lamp)))


def _raised(lamp: RigLamp) -> DeviceError:
    with pytest.raises(DeviceError) as raised:
        lamp.read()
    return raised.value


def test_a_dead_lamp_is_an_error(board: BoardProcess, lamp: RigLamp) -> None:
    lamp.stage()
    board.do("lamp dead")
    lamp.set("on").wait(5)
    raises_soon(lamp.read, "gives no light")
    assert eventually(lambda: board.level("lamp") == 0)


def test_the_maximum_on_time_is_an_error(board: BoardProcess) -> None:
    rig = RigController(board.port, max_on_s=0.8)
    rig.lamp.stage()
    rig.lamp.set("on").wait(5)
    raises_soon(rig.lamp.read, "maximum on-time")
    rig.lamp.unstage()


@pytest.mark.parametrize("what", ["reset", "hang"])
def test_a_reset_of_the_controller_is_noticed_and_the_lamp_stays_off(
    board: BoardProcess, lamp: RigLamp, troubles: list[DeviceError], what: str
) -> None:
    lamp.stage()
    lamp.allow_until(time.monotonic() + 60)
    lamp.set("on").wait(5)
    board.do(what)
    raises_soon(lamp.read, "has been reset")
    assert len(troubles) == 1
    with pytest.raises(DeviceError, match="has been reset"):
        lamp.set("on")
    time.sleep(1.0)  # several heartbeats
    assert board.level("lamp") == 0
    lamp.stage()
    lamp.set("on").wait(5)
    assert eventually(lambda: board.level("lamp") == 1)


def test_a_pulled_cable_is_noticed_and_the_adapter_may_come_back_elsewhere(
    board: BoardProcess, lamp: RigLamp, troubles: list[DeviceError]
) -> None:
    lamp.stage()
    lamp.allow_until(time.monotonic() + 60)
    lamp.set("on").wait(5)
    pulled_s = board.now_s()
    board.do("unplug")
    raises_soon(lamp.read, "has gone")
    assert isinstance(troubles[0], DeviceGoneError)
    with pytest.raises(PhoslabError, match="is not there"):
        lamp.stage()
    assert board.pin("lamp", 0).board_us * 1e-6 - pulled_s < 2.0 + LATE_S
    taken: list[int] = []
    while not Path(board.paths[0]).exists():  # so that the old name is not given out again
        taken += os.openpty()
    board.do("plug")
    assert len(set(board.paths)) == 2
    lamp.stage()
    lamp.set("on").wait(5)
    assert eventually(lambda: board.level("lamp") == 1)
    for end in taken:
        os.close(end)


def test_a_cable_that_is_pulled_while_the_door_moves_fails_its_status(
    board: BoardProcess, door: RigDoor
) -> None:
    door.stage()
    board.do("door stuck")
    status = door.set("open")
    board.pin("motor", 1)
    board.do("unplug")
    with pytest.raises(DeviceGoneError):
        status.wait(10)


def test_a_stuck_door_fails_its_status_and_can_be_set_again(
    board: BoardProcess, door: RigDoor, lamp: RigLamp
) -> None:
    door.stage()
    board.do("door stuck")
    with pytest.raises(DeviceError, match="door did not become open: its end switch says closed"):
        door.set("open").wait(60)
    board.do("door free")
    door.set("open").wait(60)
    assert door.read()["door"]["value"] == "open"


def test_a_door_of_which_nothing_is_heard_is_a_time_out_of_the_drivers_own(
    board: BoardProcess, door: RigDoor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The controller's own limit of 3 s comes first on a sound board: here it is not waited for."""
    monkeypatch.setattr(rig_parts, "DOOR_S", 0.6)
    door.stage()
    board.do("door stuck")
    with pytest.raises(DeviceTimeoutError, match=r"door did not do 'DOOR OPEN' within 0\.6 s"):
        door.set("open").wait(60)


def test_a_second_process_is_told_who_has_the_port(board: BoardProcess, lamp: RigLamp) -> None:
    lamp.stage()
    program = (
        "import sys\nfrom phoslab.errors import PhoslabError\n"
        "from phoslab.instruments.controller import RigController\n"
        "try: RigController(sys.argv[1]).lamp.stage()\nexcept PhoslabError as error: print(error)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, board.port],
        capture_output=True, text=True, check=True, timeout=60, env=same_phoslab(),
    )  # fmt: skip
    assert f"is in use by process {os.getpid()} (" in done.stdout
    lamp.read()  # and it has stolen nothing


def test_only_the_last_of_the_two_closes_the_line(board: BoardProcess, lamp: RigLamp, door: RigDoor) -> None:
    lamp.stage()
    lamp.set("on").wait(5)
    door.stage()  # which must not disturb the lamp
    assert lamp.read()["lamp"]["value"] == "on"
    door.unstage()
    assert lamp.read()["lamp"]["value"] == "on"


def test_a_limit_that_the_firmware_does_not_allow_is_refused_when_staged(board: BoardProcess) -> None:
    rig = RigController(board.port, max_on_s=1e6)
    with pytest.raises(DeviceError, match="Its own maximum on-time is 14400 s"):
        rig.lamp.stage()


def test_an_edge_is_known_on_the_hosts_clock(board: BoardProcess, lamp: RigLamp) -> None:
    """The board notes by this machine's clock when its pin moved: the mapping must contain that moment.

    Under simavr the board's clock is as slow as the machine makes it, for which no bound on drift holds: there the
    doubt is a busy computer's, on the simulated controller it is the driver's own.
    """
    lamp.stage()
    time.sleep(1.0)  # some heartbeats
    lamp.set("on").wait(5)
    pin = board.pin("lamp", 1)
    readings = lamp.read()
    doubt_s = readings["lamp_uncertainty"]["value"]
    slack_s = 0.002 if pin.mono_s - pin.board_us * 1e-6 < 1e-3 else 0.05  # from the pin to the note about it
    assert abs(readings["lamp"]["mono_s"] - pin.mono_s) <= doubt_s + slack_s


def test_the_clock_knows_both_times(board: BoardProcess, rig: RigController) -> None:
    assert rig.clock.device_s() is None
    rig.lamp.stage()
    first, second = rig.clock.device_s(), rig.clock.device_s()
    assert first is not None
    assert second is not None
    assert second >= first > 0


class _Talker:
    """A pseudo-terminal on which something else than a rig controller sits."""

    def __init__(self, says: bytes) -> None:
        import pty
        import threading
        import tty

        self.master, slave = pty.openpty()
        tty.setraw(slave)
        self.path, self._slave, self._says = os.ttyname(slave), slave, says
        self._thread = threading.Thread(target=self._talk, daemon=True)
        self._thread.start()

    def _talk(self) -> None:
        with contextlib.suppress(OSError):
            while os.read(self.master, 100):
                os.write(self.master, self._says)


@pytest.mark.parametrize(
    ("says", "match"),
    [
        (b"", "says nothing"),
        (b"ok T:21.0 /0.0\r\n", "says things that a rig controller does not say"),
        (wire.encode("ERR 1 5 VERSION"), "does not answer HELLO"),
    ],
)
def test_what_is_no_rig_controller_is_refused(says: bytes, match: str) -> None:
    talker = _Talker(says)
    line = link.Link("rig", talker.path, time.monotonic, lambda event: None, lambda error: None)
    line.open()
    with pytest.raises(DeviceError, match=match):
        link.greet(line, "rig", timeout_s=1.0)
    line.close()


def test_another_version_of_the_protocol_is_refused(
    board: BoardProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(wire, "PROTOCOL", 2)
    with pytest.raises(DeviceError, match="speaks another protocol than version 2"):
        RigController(board.port).lamp.stage()


def test_the_port_is_free_again_after_a_failure(board: BoardProcess) -> None:
    with pytest.raises(DeviceError):
        RigController(board.port, max_on_s=1e6).lamp.stage()
    with serial.Serial(board.port, wire.BAUD, exclusive=True):
        pass


def test_the_hosts_death_switches_off(board: BoardProcess) -> None:
    """kill -9, twice; tests/benchmarks/lamp_off.py does it often and prints the distribution."""
    program = (
        "import sys, time\nfrom phoslab.instruments.controller import RigController\n"
        "rig = RigController(sys.argv[1])\nrig.lamp.stage()\nrig.lamp.allow_until(time.monotonic() + 600)\n"
        "rig.lamp.set('on').wait(9)\nprint('on', flush=True)\ntime.sleep(600)"
    )
    for _ in range(2):
        seen = len(board.pins)
        host = subprocess.Popen(
            [sys.executable, "-c", program, board.port], stdout=subprocess.PIPE, env=same_phoslab()
        )
        assert host.stdout is not None
        assert host.stdout.readline() == b"on\n"
        killed_s = board.now_s()
        host.kill()
        off_s = board.pin("lamp", 0, after=seen).board_us * 1e-6 - killed_s
        # KEEP_S from the last heartbeat on; the rest is for a machine that has other things to do.
        assert off_s < 2.0 + LATE_S
        assert math.isfinite(off_s)
        host.wait()
        host.stdout.close()
