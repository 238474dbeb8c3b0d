"""OpenEXR files in and out, by way of memory.

So a full disk, a pipe or a name that is not UTF-8 is met by Python and not by the library, which knows none of them.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.files import read_regular, replacing

# A map of 8192 x 8192 texels in four states of eight bands, uncompressed, is 8 GB; what is smaller than this is read.
_LARGEST_BYTES = 1 << 33


def write_channels(
    path: str | PathLike[str], channels: Mapping[str, NDArray[np.float32]], attributes: Mapping[str, str]
) -> None:
    """Write (height, width) float32 channels and text attributes as a scan-line image, whole or not at all.

    Raises:
        PhoslabError: the file cannot be written.
    """
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **attributes}
    content = io.BytesIO()
    with OpenEXR.File(header, {k: np.ascontiguousarray(v, "f4") for k, v in channels.items()}) as image:
        image.write(content)
    with replacing(path) as temporary:
        temporary.write_bytes(content.getbuffer())


def read_channels(path: Path, *, remedy: str) -> dict[str, NDArray[Any]]:
    """Return the (height, width) channels of an image by name; see `read_image`."""
    return read_image(path, remedy=remedy)[0]


def read_image(path: Path, *, remedy: str) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return the (height, width) channels of an image by name, and its attributes.

    Raises:
        PhoslabError: it is missing, no regular file, too large or not an OpenEXR image.
    """
    import OpenEXR

    content = io.BytesIO(read_regular(path, _LARGEST_BYTES, remedy=remedy))
    try:
        with OpenEXR.File(content, separate_channels=True) as image:
            channels = {name: np.asarray(channel.pixels) for name, channel in image.channels().items()}
            return channels, dict(image.header())
    except Exception as error:  # the library raises many kinds for what is not an EXR file
        raise PhoslabError(
            f"cannot be read as an OpenEXR image ({error})", file=path, remedy=remedy
        ) from error
