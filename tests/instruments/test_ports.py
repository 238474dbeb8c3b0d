"""Serial ports by path and by USB identity; what is not there is refused with what is."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from phoslab.errors import PhoslabError
from phoslab.instruments import ports


def _adapter(path: str, vid: int, pid: int, serial_number: str | None, description: str) -> ListPortInfo:
    found = ListPortInfo(path)
    found.vid, found.pid, found.serial_number, found.description = vid, pid, serial_number, description
    return found


UNO = _adapter("/dev/ttyACM0", 0x2341, 0x0043, "85734", "Arduino Uno")
OTHER_UNO = _adapter("/dev/ttyACM1", 0x2341, 0x0043, "11111", "Arduino Uno")
NANO = _adapter("/dev/ttyUSB0", 0x1A86, 0x7523, None, "USB Serial")


@pytest.fixture
def plugged(monkeypatch: pytest.MonkeyPatch) -> list[ListPortInfo]:
    """What this machine would list; no USB adapter can be had in a test."""
    there: list[ListPortInfo] = []
    monkeypatch.setattr(list_ports, "comports", lambda: list(there))
    return there


def test_an_adapter_is_found_wherever_it_comes_back(plugged: list[ListPortInfo]) -> None:
    plugged += [NANO, UNO]
    assert ports.resolve("usb:2341:0043") == "/dev/ttyACM0"
    assert ports.resolve("usb:1A86:7523") == "/dev/ttyUSB0"
    plugged.remove(UNO)
    plugged.append(_adapter("/dev/ttyACM7", 0x2341, 0x0043, "85734", "Arduino Uno"))
    assert ports.resolve("usb:2341:0043:85734") == "/dev/ttyACM7"


def test_of_two_alike_the_serial_number_must_be_given(plugged: list[ListPortInfo]) -> None:
    plugged += [UNO, OTHER_UNO]
    with pytest.raises(PhoslabError, match="usb:2341:0043:85734, usb:2341:0043:11111"):
        ports.resolve("usb:2341:0043")
    assert ports.resolve("usb:2341:0043:11111") == "/dev/ttyACM1"


@pytest.mark.parametrize(
    "port", ["usb:ffff:0000", "usb:2341:0043:999", "/dev/ttyACM99", "COM3", "usb:nonsense", ""]
)
def test_what_is_not_there_is_refused_with_what_is(plugged: list[ListPortInfo], port: str) -> None:
    plugged += [UNO, NANO]
    with pytest.raises(PhoslabError, match=r"/dev/ttyACM0 \(usb:2341:0043:85734, Arduino Uno\)") as refused:
        ports.resolve(port, field="lamp")
    assert str(refused.value).startswith("lamp is")


def test_without_any_adapter_the_remedy_is_to_connect_it(plugged: list[ListPortInfo]) -> None:
    with pytest.raises(PhoslabError, match="Connect it"):
        ports.resolve("usb:2341:0043")


def test_a_file_is_no_serial_port(tmp_path: Path) -> None:
    path = tmp_path / "ttyACM0"
    path.touch()
    with pytest.raises(PhoslabError, match="is no serial port"):
        ports.resolve(str(path))


def test_the_holder_of_a_lock_is_named() -> None:
    master, slave = os.openpty()
    path = os.ttyname(slave)
    assert ports.holder(path) == ""
    fcntl.flock(slave, fcntl.LOCK_EX)
    assert ports.holder(path).startswith(f"process {os.getpid()} (")
    os.close(slave)
    os.close(master)
