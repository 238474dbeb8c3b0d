"""Decay tables: what people with a luminance meter have, as CSV."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError, printable
from phoslab.files import read_regular

Array = NDArray[np.float64]

_LARGEST_BYTES = 1 << 26
_REMEDY = (
    "A decay table is CSV with a header: t_s, optionally exposure_s, a column a channel, optionally "
    "<channel>_sigma."
)


@dataclass(frozen=True)
class DecayTable:
    """A table as it was read, row for row.

    Args:
        file: where it came from.
        t_s: (n,) times since lamp-off.
        exposure_s: (n,) over which each value is a mean; 0 where the table does not say.
        signal: (n, n_channels) values; NaN where a cell is empty.
        sigma: (n, n_channels) standard deviations; NaN in a channel that has none.
        channels: names of the channels.
    """

    file: Path
    t_s: Array
    exposure_s: Array
    signal: Array
    sigma: Array
    channels: tuple[str, ...]


def read_table(path: str | PathLike[str]) -> DecayTable:
    """Read a decay table.

    Raises:
        PhoslabError: it is missing, no CSV, lacks `t_s` or a channel, or holds a cell that is no number; the error
            names the row and the column.
    """
    file = Path(path)
    content = read_regular(file, _LARGEST_BYTES, remedy=_REMEDY)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise PhoslabError("is not UTF-8 text", file=file, remedy=_REMEDY) from error
    lines = [(k + 1, line) for k, line in enumerate(text.splitlines()) if line.strip() and line[0] != "#"]
    if not lines:
        raise PhoslabError("holds no table", file=file, remedy=_REMEDY)
    try:
        rows = list(csv.reader(io.StringIO("\n".join(line for _, line in lines)), skipinitialspace=True))
    except csv.Error as error:
        raise PhoslabError(f"is not CSV ({error})", file=file, remedy=_REMEDY) from error
    header = [printable(name.strip()) for name in rows[0]]
    if len(header) == 1 and "t_s" in re.split(r"[;\t]\s*", header[0])[:-1]:
        raise PhoslabError(
            "has no commas between its columns",
            file=file,
            field="the header",
            remedy="Save the table as CSV with commas between columns and points in numbers (812.4).",
        )
    if "t_s" not in header:
        raise PhoslabError(
            f"has no column t_s, but {', '.join(header) or 'none'}",
            file=file,
            field="the header",
            remedy=_REMEDY,
        )
    strays = [
        name for name in header if name == "sigma" or (name.endswith("_sigma") and name[:-6] not in header)
    ]
    if strays:
        raise PhoslabError(
            f"has the σ of no channel: {', '.join(strays)}; its columns are {', '.join(header)}",
            file=file,
            field="the header",
            remedy="Name a column of σ after its channel: <channel>_sigma.",
        )
    if len(set(header)) < len(header):
        raise PhoslabError("names a column twice", file=file, field="the header", remedy=_REMEDY)
    for row, (line, _) in zip(rows[1:], lines[1:], strict=True):
        if any(cell.strip() for cell in row[len(header) :]):
            raise PhoslabError(
                f"has {len(row)} cells for {len(header)} columns",
                file=file,
                field=f"line {line}",
                remedy="Write numbers with a point, not a comma, and name every column.",
            )
    columns = {
        name: np.array(
            [_number(row, k, name, line, file) for row, (line, _) in zip(rows[1:], lines[1:], strict=True)]
        )
        for k, name in enumerate(header)
    }
    channels = tuple(
        name
        for name in header
        if name not in ("t_s", "exposure_s") and not (name.endswith("_sigma") and name[:-6] in header)
    )
    if not channels:
        raise PhoslabError("has no channel beside t_s", file=file, field="the header", remedy=_REMEDY)
    n = len(rows) - 1
    exposure = columns.get("exposure_s", np.zeros(n))
    if (exposure < 0).any() or np.isnan(exposure).any():
        raise PhoslabError(
            "holds a negative or missing value",
            file=file,
            field="exposure_s",
            remedy="Give a time for every row.",
        )
    nothing = np.full(n, np.nan)
    return DecayTable(
        file=file,
        t_s=columns["t_s"],
        exposure_s=exposure,
        signal=np.stack([columns[c] for c in channels], axis=1),
        sigma=np.stack([columns.get(f"{c}_sigma", nothing) for c in channels], axis=1),
        channels=channels,
    )


def _number(row: list[str], column: int, name: str, line: int, file: Path) -> float:
    """Return a cell as a number; NaN for an empty or missing one."""
    cell = row[column].strip() if column < len(row) else ""
    if not cell:
        return float("nan")
    try:
        return float(cell)
    except ValueError as error:
        raise PhoslabError(
            f"is {cell!r}, which is no number",
            file=file,
            field=f"{name} in line {line}",
            remedy="Write numbers with a point, and leave a cell empty where nothing was measured.",
        ) from error
