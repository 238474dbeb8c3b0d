"""What every trade leaves: a page to read, tables as CSV, plots as SVG, and trade.json for the planner."""

from __future__ import annotations

import csv
import io
import json
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phoslab import __version__, schemas
from phoslab.app.figures import svg
from phoslab.files import write_text
from phoslab.trades import SCHEMA

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Table:
    """Rows for people and for machines.

    Args:
        name: of the CSV file.
        caption: what it shows and how to read it.
        columns: with units.
        rows: text or numbers; None is empty.
        in_page: whether the page shows it, or only links the file.
    """

    name: str
    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str | float | None]]
    in_page: bool = True


@dataclass(frozen=True)
class Plot:
    """A figure, the name of its SVG file, and what it shows."""

    name: str
    caption: str
    figure: Figure


@dataclass(frozen=True)
class Section:
    """A question, its answer in a few sentences, and the evidence."""

    title: str
    text: Sequence[str]
    evidence: Sequence[Table | Plot]


def write_trade(
    folder: Path,
    kind: str,
    title: str,
    summary: Sequence[str],
    sections: Sequence[Section],
    data: dict[str, Any],
    *,
    gl: str | None = None,
) -> list[Path]:
    """Write index.html, the CSV and SVG files, and trade.json, each whole; return their paths, the page first.

    Args:
        kind: of the trade ("solver").
        summary: the answer in a few sentences.
        data: costs and errors for the planner.
        gl: what rendered, where anything was.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    evidence = [e for s in sections for e in s.evidence]
    written = [folder / "index.html"]
    pictures = {}
    for piece in evidence:
        if isinstance(piece, Table):
            written.append(folder / f"{piece.name}.csv")
            write_text(written[-1], _csv(piece))
        else:
            pictures[piece.name] = svg(piece.figure)
            written.append(folder / f"{piece.name}.svg")
            write_text(written[-1], f'<?xml version="1.0" encoding="utf-8"?>\n{pictures[piece.name]}')
    written.append(folder / "trade.json")
    about = {
        "schema": SCHEMA,
        "kind": kind,
        "phoslab": __version__,
        "machine": machine() | ({"gl": gl} if gl else {}),
    }
    schemas.check({**about, **data}, "trade-1", file=written[-1])
    write_text(written[-1], json.dumps({**about, **data}, indent=1, allow_nan=False) + "\n")
    environment = Environment(
        loader=PackageLoader("phoslab.app.trades", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    environment.filters["cell"] = _cell
    environment.tests["table"] = lambda piece: isinstance(piece, Table)
    page = environment.get_template("trade.html").render(
        title=title,
        summary=summary,
        sections=sections,
        pictures=pictures,
        machine=about["machine"],
        version=__version__,
    )
    write_text(written[0], page)
    return written


def machine() -> dict[str, Any]:
    """Return what the numbers were measured on."""
    import numpy as np

    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        lines = [line for line in cpuinfo.read_text().splitlines() if line.startswith("model name")]
        model = lines[0].partition(":")[2].strip() if lines else model
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "processor": model,
        "cores": cores,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "system": platform.system(),
    }


def _csv(table: Table) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table.columns)
    writer.writerows([["" if cell is None else cell for cell in row] for row in table.rows])
    return text.getvalue()


def _cell(value: str | float | None) -> str:
    """A number as a person reads it."""
    if value is None:
        return "-"
    if isinstance(value, str):
        return value
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
