"""Transmission of colour filters by name, from the data of the package lighting-filters."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def transmission(name: str) -> tuple[Array, Array] | None:
    """Wavelengths in nm and transmission (0..1) of a filter, or None if its curve is not known."""
    table = _table().get(name)
    if table is None or not table.get("sd"):
        return None
    pairs = sorted((float(nm), float(share)) for nm, share in table["sd"].items())
    nm, share = np.array(pairs).T
    return nm, share


@cache
def _table() -> dict[str, dict[str, dict[str, str]]]:
    # The file itself: the package's own reader checks all of it with pydantic, which takes longer than to use it.
    text = (files("dataset") / "filters.json").read_text("utf-8")
    table: dict[str, dict[str, dict[str, str]]] = json.loads(text)["filters"]
    return table
