"""The lines that host and rig controller exchange: text, an asterisk, four digits of checksum.

docs/rig-protocol.md says what they mean.

>>> encode("17 LAMP OFF")
b'17 LAMP OFF*DFAD\\n'
>>> decode(b"17 LAMP OFF*DFAD")
'17 LAMP OFF'
>>> decode(b"17 LAMP OFG*DFAD") is None
True
"""

from __future__ import annotations

import binascii
import re
from collections.abc import Mapping
from dataclasses import dataclass

PROTOCOL = 1
BAUD = 115200
LONGEST = 200
"""Bytes of a line with its checksum, without its line feed; a receiver may drop what is longer."""

_LINE = re.compile(rb"([\x20-\x29\x2B-\x7E]+)\*([0-9A-F]{4})")
_REPLY = re.compile(r"(OK|ERR) (\d{1,5}) (\d{1,20})(?: (.*))?")
_EVENT = re.compile(r"EV (\d{1,20}) ([A-Z]+)(?: (.*))?")


def crc16(text: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF, nothing reflected; b"123456789" gives 0x29B1."""
    return binascii.crc_hqx(text, 0xFFFF)


def encode(text: str) -> bytes:
    """Return a line with its checksum and line feed."""
    raw = text.encode("ascii")
    return b"%s*%04X\n" % (raw, crc16(raw))


def decode(line: bytes) -> str | None:
    """Return a line's text, None if it is garbled: no checksum, a wrong one, or bytes that do not belong."""
    found = _LINE.fullmatch(line.strip(b"\r\n"))
    if found is None or len(line) > LONGEST + 2 or crc16(found[1]) != int(found[2], 16):
        return None
    return found[1].decode("ascii")


@dataclass(frozen=True)
class Reply:
    """What the controller answers to request `id` (0: to a line it could not read).

    Args:
        ok: whether it did it.
        id: of the request.
        device_us: its clock when it did.
        code: why not, "" if it did.
        fields: what it tells.
    """

    ok: bool
    id: int
    device_us: int
    code: str
    fields: Mapping[str, str]


@dataclass(frozen=True)
class Event:
    """What the controller says unasked: its name, when it happened, and what more there is to tell."""

    device_us: int
    name: str
    fields: Mapping[str, str]


def parse(text: str) -> Reply | Event | None:
    """Return what a controller's line says, None if it says nothing that this version knows.

    >>> parse("OK 17 2500000 lamp=OFF").fields
    {'lamp': 'OFF'}
    >>> parse("ERR 18 2600000 RANGE").code
    'RANGE'
    >>> parse("EV 2700000 LIGHT state=OFF").name
    'LIGHT'
    """
    if reply := _REPLY.fullmatch(text):
        ok, rest = reply[1] == "OK", reply[4] or ""
        code = "" if ok else rest.partition(" ")[0]
        return Reply(ok, int(reply[2]), int(reply[3]), code, _fields(rest))
    if event := _EVENT.fullmatch(text):
        return Event(int(event[1]), event[2], _fields(event[3] or ""))
    return None


def _fields(text: str) -> dict[str, str]:
    pairs = (word.partition("=") for word in text.split())
    return {key: value for key, equals, value in pairs if equals}


class Lines:
    """Cuts a stream of bytes into lines; what is longer than any line may be is dropped up to its end."""

    def __init__(self) -> None:
        self._rest = b""
        self._too_long = False

    def feed(self, data: bytes) -> list[bytes]:
        """Return the lines that `data` completes, without their ends and without empty ones."""
        *whole, self._rest = (self._rest + data).split(b"\n")
        if whole and self._too_long:
            whole[0], self._too_long = b"\xff", False  # garbled, whatever its end looks like
        if len(self._rest) > LONGEST:
            self._rest, self._too_long = b"", True
        return [line for line in (line.strip(b"\r") for line in whole) if line]
