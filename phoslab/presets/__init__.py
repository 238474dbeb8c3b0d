"""Measured materials that ship with phoslab."""

from __future__ import annotations

from importlib.resources import as_file, files

from phoslab.errors import PhoslabError
from phoslab.material import Material


def names() -> list[str]:
    """Return the names of all presets, sorted."""
    return sorted(
        entry.name.removesuffix(".json")
        for entry in files(__package__).iterdir()
        if entry.name.endswith(".json")
    )


def preset(name: str) -> Material:
    """Return the preset `name`.

    Raises:
        PhoslabError: there is none of that name.

    >>> preset("stickers-2").kr_per_s.tolist()
    [0.132, 0.009]
    """
    if name not in names():
        raise PhoslabError(
            f"{name!r} is unknown", field="preset", remedy=f"Use one of: {', '.join(names())}."
        )
    with as_file(files(__package__) / f"{name}.json") as path:
        return Material.load(path)
