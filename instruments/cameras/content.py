"""What a file that a camera delivered is: judged by its content, never by its name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from phoslab.errors import PhoslabError
from phoslab.instruments.devices import DeviceError
from phoslab.raw import SETTING_TOLERANCE, read_settings

_SAVE_RAW = "Set the camera's image quality to RAW alone."

_NOT_RAW = (
    (0, b"\xff\xd8\xff", "a JPEG picture"),
    (4, b"ftyphei", "a HEIF picture"),
    (4, b"ftypmif1", "a HEIF picture"),
    (4, b"ftypqt", "a film"),
    (4, b"ftypmp4", "a film"),
    (0, b"\x89PNG", "a PNG picture"),
    (0, b"RIFF", "a film or sound"),
)


def not_raw(content: bytes) -> str | None:
    """Return what a file's first bytes say that it is, if that is surely no RAW file.

    >>> not_raw(bytes.fromhex("ffd8ffe1"))
    'a JPEG picture'
    """
    return next((kind for at, magic, kind in _NOT_RAW if content[at : at + len(magic)] == magic), None)


def suffix_of(path: Path) -> str:
    """Return the suffix that a RAW file's content deserves: CR2, CR3, NEF, ARW, RAF, RW2, ORF, dng; else raw."""
    with path.open("rb") as stream:
        head = stream.read(4096)
    for at, magic, suffix in (
        (8, b"CR\x02", "CR2"),
        (4, b"ftypcrx", "CR3"),
        (0, b"FUJIFILMCCD-RAW", "RAF"),
        (0, b"IIU\0", "RW2"),
        (0, b"IIRO", "ORF"),
        (0, b"IIRS", "ORF"),
    ):
        if head[at : at + len(magic)] == magic:
            return suffix
    if head[:4] not in (b"II*\0", b"MM\0*"):
        return "raw"
    # The others are TIFF files. A DNG has the tag 50706 in its first directory; of the rest the maker decides.
    order: Literal["little", "big"] = "little" if head[:1] == b"I" else "big"

    def number(at: int, size: int) -> int:
        return int.from_bytes(head[at : at + size], order)

    first = number(4, 4)
    tags = {number(first + 2 + 12 * k, 2) for k in range(min(number(first, 2), 300))}
    if 50706 in tags:
        return "dng"
    makers = ((b"NIKON", "NEF"), (b"SONY", "ARW"), (b"PENTAX", "PEF"), (b"SAMSUNG", "SRW"))
    return next((suffix for maker, suffix in makers if maker in head.upper()), "raw")


def check_raw(path: Path, device: str, settings: Mapping[str, float | None]) -> None:
    """Check that a file is a whole RAW frame with the settings that were asked for.

    The decoder runs in a limited process (phoslab.limited): nobody vouches for what a cable delivers.

    Args:
        path: the file.
        device: the camera, for messages.
        settings: exposure_s, iso and f_number; what is None, or what the file does not say, is not compared.

    Raises:
        DeviceError: it is not. The file is left as it is.
    """
    with path.open("rb") as stream:
        head = stream.read(16)
    if (kind := not_raw(head)) is not None:
        raise DeviceError(f"delivers {kind}", field=device, remedy=_SAVE_RAW)
    try:
        found = read_settings(path)
    except PhoslabError as error:
        raise DeviceError(
            f"delivered {len(head) and path.stat().st_size} bytes that are no whole RAW frame: it {error.problem}",
            field=device,
            remedy="Fetch it again; if that does not help, look at the camera's card and image quality.",
        ) from error
    for name, wanted in settings.items():
        said = found[name]
        if wanted is None or said is None:
            continue
        if abs(math.log(said / wanted)) > math.log1p(SETTING_TOLERANCE):
            raise DeviceError(
                f"took the frame with {name} {said:.6g} where {wanted:.6g} was set",
                field=device,
                remedy="Turn its dial to M, and automatic ISO off.",
            )
