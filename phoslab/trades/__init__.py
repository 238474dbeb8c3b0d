"""What speed and accuracy cost: trade.json, which `phoslab trade` measures and the planner reads.

One of each kind ships with phoslab, measured on the machine that it names; `phoslab trade KIND -o DIR` makes that of
another machine.
"""

from __future__ import annotations

import os
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

from phoslab import schemas
from phoslab.errors import PhoslabError
from phoslab.files import read_regular
from phoslab.journal import decode

SCHEMA = "phoslab-trade/1"

# Of OpenGL on processors, in the name of the renderer: there, time is that of all processors.
SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "swiftshader")

_LARGEST_BYTES = 1 << 24


def load(kind: str, path: str | os.PathLike[str] | None = None) -> dict[str, Any]:
    """Return a trade as plain dicts, lists, texts and numbers.

    Args:
        kind: "solver" ...; what was measured.
        path: a trade.json; None: the one that ships with phoslab.

    Raises:
        PhoslabError: it cannot be read, does not fit trade-1.schema.json, or is of another kind.

    >>> trade = load("solver")
    >>> next(s["bytes_per_texel"] for s in trade["steps"] if s["state_format"] == "f32c")
    16
    """
    if path is None:
        with as_file(files(__package__) / f"{kind}.json") as shipped:
            return _read(kind, shipped)
    return _read(kind, Path(path))


def _read(kind: str, path: Path) -> dict[str, Any]:
    remedy = f"Measure one: phoslab trade {kind} -o DIR; its trade.json lies in DIR."
    text = decode(read_regular(path, _LARGEST_BYTES, remedy=remedy), path, "the file")
    data: Any = schemas.read_json(text, file=path)
    schemas.check(data, "trade-1", file=path)
    if data["kind"] != kind:
        raise PhoslabError(
            f"is {data['kind']!r}, and {kind!r} is asked for", file=path, field="kind", remedy=remedy
        )
    return dict(data)
