"""Which serial ports there are, and the one that a rig file means.

A rig file names a port by its path (`/dev/serial/by-id/...`, `/dev/ttyACM0`) or, better, by the USB adapter's identity
(`usb:2341:0043`, `usb:2341:0043:85734323`), which holds when it comes back under another path.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from phoslab.instruments.devices import DeviceError, DeviceGoneError

_USB = re.compile(r"usb:([0-9a-fA-F]{4}):([0-9a-fA-F]{4})(?::(.+))?")


def resolve(port: str, *, field: str = "port") -> str:
    """Return the path of the port that `port` names, as of now.

    Args:
        port: a path, or `usb:VID:PID` or `usb:VID:PID:SERIAL` in hexadecimal.
        field: what to call it in an error.

    Raises:
        DeviceGoneError: it is not there; the remedy lists what is.
        DeviceError: there are several, it is not yours to open, or nothing that could be a serial port.
    """
    usb = _USB.fullmatch(port)
    if usb is not None:
        vid, pid, serial_number = int(usb[1], 16), int(usb[2], 16), usb[3]
        fitting = [
            found
            for found in _ports()
            if (found.vid, found.pid) == (vid, pid) and serial_number in (None, found.serial_number)
        ]
        if len(fitting) > 1:
            numbers = ", ".join(f"{port}:{found.serial_number}" for found in fitting)
            raise DeviceError(
                f"names {len(fitting)} adapters of the same kind ({port})",
                remedy=f"Add the serial number of the one that you mean: {numbers}.",
                field=field,
            )
        if not fitting:
            raise DeviceGoneError(f"is not there ({port})", remedy=_what_there_is(), field=field)
        return str(fitting[0].device)
    if port.startswith("usb:") or not port.startswith("/"):
        raise DeviceError(
            f"is {port!r}, which is neither a path nor usb:VID:PID[:SERIAL]",
            remedy=_what_there_is(),
            field=field,
        )
    path = Path(port)
    if not path.exists():
        raise DeviceGoneError(f"is not there ({port})", remedy=_what_there_is(), field=field)
    if not path.is_char_device():
        raise DeviceError(f"is no serial port ({port})", remedy=_what_there_is(), field=field)
    if not os.access(path, os.R_OK | os.W_OK):
        raise DeviceError(
            f"is not yours to open ({port})",
            remedy='Type: sudo usermod -aG dialout "$USER", then log in again.',
            field=field,
        )
    return port


def holder(path: str) -> str:
    """Say which process has locked a port ("process 4711 (python3)"), as far as the system tells; else "".

    A lock is found in /proc/locks by the inode of what it is on: proc(5).
    """
    try:
        status = Path(path).stat()
        where = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
        for line in Path("/proc/locks").read_text().splitlines():
            words = line.split()
            if where in words and int(words[4]) > 0:
                name = Path(f"/proc/{words[4]}/comm").read_text().strip()
                return f"process {words[4]} ({name})"
    except (OSError, ValueError, IndexError):
        pass
    return ""


def _ports() -> list[ListPortInfo]:
    return sorted(list_ports.comports(), key=lambda found: str(found.device))


def _what_there_is() -> str:
    usb = [found for found in _ports() if found.vid is not None]
    if not usb:
        return "Connect it: there is no serial port on USB now (phoslab doctor lists all)."
    listing = ", ".join(
        f"{found.device} (usb:{found.vid:04x}:{found.pid:04x}"
        + (f":{found.serial_number}" if found.serial_number else "")
        + f", {found.description})"
        for found in usb
    )
    return f"There is: {listing}."
