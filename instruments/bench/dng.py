"""DNG files of a Bayer sensor, as LibRaw reads them, bit for bit."""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

# tifffile leaves the EXIF pointer to its own readers and refuses to write it, and without EXIF LibRaw reads
# ISO 0. So a placeholder of the preceding number keeps the place in the (sorted) list of tags.
_PLACEHOLDER, _EXIF = 34664, 34665

_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _UNDEFINED = 1, 2, 3, 4, 5, 7


@dataclass(frozen=True)
class Sensor:
    """What a DNG says about the sensor.

    Args:
        make, model: of the camera.
        active_area: (top, left, bottom, right) of the pixels that see light. Top and left are even:
            LibRaw 0.22 moves odd ones by a pixel and then mixes up the black levels.
        cfa: ((a, b), (c, d)) colour of the pixels at the active area's corner; 0 red, 1 green, 2 blue.
        black: ((a, b), (c, d)) black levels of the same pixels, DN.
        white: level at which a pixel saturates, DN.
    """

    make: str
    model: str
    active_area: tuple[int, int, int, int]
    cfa: tuple[tuple[int, int], tuple[int, int]]
    black: tuple[tuple[int, int], tuple[int, int]]
    white: int


def write_dng(
    path: Path,
    values: NDArray[np.uint16],
    sensor: Sensor,
    *,
    exposure_s: float,
    iso: int,
    f_number: float,
    taken: str,
    description: str,
    compressed: bool = False,
) -> None:
    """Write one frame to `path`; see `dng`."""
    path.write_bytes(
        dng(
            values,
            sensor,
            exposure_s=exposure_s,
            iso=iso,
            f_number=f_number,
            taken=taken,
            description=description,
            compressed=compressed,
        )
    )


def dng(
    values: NDArray[np.uint16],
    sensor: Sensor,
    *,
    exposure_s: float,
    iso: int,
    f_number: float,
    taken: str,
    description: str,
    compressed: bool = False,
) -> bytes:
    """Return one frame as a file's content.

    Args:
        values: (rows, columns) of the whole sensor, masked borders included, DN.
        sensor: see `Sensor`.
        exposure_s, iso, f_number: go into EXIF.
        taken: local time as EXIF has it: "2026:01:15 18:00:00".
        description: ImageDescription.
        compressed: as lossless JPEG, as cameras write them; needs the package imagecodecs.
    """
    top, left, bottom, right = sensor.active_area
    flat_cfa = [c for row in sensor.cfa for c in row]
    # Of no consequence here (nothing is demosaiced for its colours), but a DNG must have one: from XYZ to camera.
    matrix = [6988, -1384, -714, -5631, 13410, 2447, -1485, 2204, 7318]
    tags: list[tuple[int, int | str, int, Any, bool]] = [
        (271, _ASCII, 0, sensor.make, True),
        (272, _ASCII, 0, sensor.model, True),
        (33421, _SHORT, 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, _BYTE, 4, bytes(flat_cfa), True),  # CFAPattern
        (_PLACEHOLDER, _LONG, 1, 0, True),
        (50706, _BYTE, 4, bytes((1, 4, 0, 0)), True),  # DNGVersion
        (50707, _BYTE, 4, bytes((1, 1, 0, 0)), True),  # DNGBackwardVersion
        (50708, _ASCII, 0, f"{sensor.make} {sensor.model}", True),  # UniqueCameraModel
        (50713, _SHORT, 2, (2, 2), True),  # BlackLevelRepeatDim
        (50714, _SHORT, 4, tuple(b for row in sensor.black for b in row), True),  # BlackLevel
        (50717, _LONG, 1, sensor.white, True),  # WhiteLevel
        (50719, _LONG, 2, (4, 4), True),  # DefaultCropOrigin
        (50720, _LONG, 2, (right - left - 8, bottom - top - 8), True),  # DefaultCropSize
        (50721, "2i", 9, [n for m in matrix for n in (m, 10000)], True),  # ColorMatrix1
        (50728, "2I", 3, (1, 2, 1, 1, 1, 2), True),  # AsShotNeutral
        (50778, _SHORT, 1, 21, True),  # CalibrationIlluminant1: D65
        (50829, _LONG, 4, sensor.active_area, True),  # ActiveArea
    ]
    how: dict[str, Any] = {"compression": None}
    if compressed:
        lossless = {"lossless": True, "bitspersample": 16, "predictor": 1}
        how = {"compression": "jpeg", "compressionargs": lossless, "rowsperstrip": values.shape[0]}
    buffer = io.BytesIO()
    tifffile.imwrite(
        buffer,
        values,
        byteorder="<",
        photometric="CFA",
        metadata=None,
        description=description,
        software="phoslab bench",
        extratags=tuple(tags),
        **how,
    )
    return _with_exif(buffer.getvalue(), _exif(exposure_s, iso, f_number, taken))


def _with_exif(tiff: bytes, entries: list[tuple[int, int, int, bytes]]) -> bytes:
    """Append an EXIF directory and let the placeholder point to it."""
    data = bytearray(tiff)
    data += b"\0" * (len(data) % 2)
    start = len(data)
    (first,) = struct.unpack_from("<I", data, 4)
    (n_tags,) = struct.unpack_from("<H", data, first)
    for entry in range(first + 2, first + 2 + 12 * n_tags, 12):
        if struct.unpack_from("<H", data, entry)[0] == _PLACEHOLDER:
            struct.pack_into("<HHII", data, entry, _EXIF, _LONG, 1, start)
    outside = start + 2 + 12 * len(entries) + 4
    directory, values = struct.pack("<H", len(entries)), b""
    for tag, kind, count, value in entries:
        if len(value) <= 4:
            place = value.ljust(4, b"\0")
        else:
            place = struct.pack("<I", outside + len(values))
            values += value + b"\0" * (len(value) % 2)
        directory += struct.pack("<HHI", tag, kind, count) + place
    return bytes(data) + directory + struct.pack("<I", 0) + values


def _exif(exposure_s: float, iso: int, f_number: float, taken: str) -> list[tuple[int, int, int, bytes]]:
    """(tag, type, count, value) in ascending order of the tags."""

    def rational(number: float) -> bytes:
        fraction = Fraction(number).limit_denominator(100_000)
        return struct.pack("<II", fraction.numerator, fraction.denominator)

    date = taken.encode() + b"\0"
    return [
        (33434, _RATIONAL, 1, rational(exposure_s)),  # ExposureTime
        (33437, _RATIONAL, 1, rational(f_number)),  # FNumber
        (34855, _SHORT, 1, struct.pack("<H", iso)),  # ISOSpeedRatings
        (36864, _UNDEFINED, 4, b"0231"),  # ExifVersion
        (36867, _ASCII, len(date), date),  # DateTimeOriginal
    ]
