"""What a file that a camera delivered is: judged by its content, never by its name."""

from __future__ import annotations

import math
from pathlib import Path

from phoslab.errors import PhoslabError
from phoslab.instruments.devices import DeviceError, Exposure
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


def check_raw(path: Path, device: str, exposure: Exposure | None) -> None:
    """Check that a file is a whole RAW frame with the settings that were asked for.

    The decoder runs in a limited process (phoslab.limited): nobody vouches for what a cable delivers.

    Args:
        path: the file.
        device: the camera, for messages.
        exposure: the settings; what is None, or what the file does not say, is not compared.

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
    if exposure is None:
        return
    for name in ("exposure_s", "iso", "f_number"):
        wanted, said = getattr(exposure, name), found[name]
        if wanted is None or said is None:
            continue
        if abs(math.log(said / wanted)) > math.log1p(SETTING_TOLERANCE):
            raise DeviceError(
                f"took the frame with {name} {said:.6g} where {wanted:.6g} was set",
                field=device,
                remedy="Turn its dial to M, and automatic ISO off.",
            )
