"""The sample scenes, by name: `phoslab render cornell` needs no path."""

from __future__ import annotations

import argparse
from importlib.resources import files
from pathlib import Path

HELP = "a scene.toml, its folder, or the name of a sample scene"


def scene_path(text: str) -> Path:
    """Return the path that SCENE means: of what is there, or else of the sample scene of that name.

    Raises:
        argparse.ArgumentTypeError: neither is there, and `text` looks like a name.

    >>> scene_path("cornell").name
    'cornell'
    """
    given, samples = Path(text), Path(str(files("phoslab.sample_data") / "scenes"))
    if given.exists() or len(given.parts) != 1 or given.suffix:
        return given
    if not (samples / text).is_dir():
        names = ", ".join(sorted(p.name for p in samples.iterdir() if p.is_dir()))
        raise argparse.ArgumentTypeError(f"{text!r} is neither here nor a sample scene ({names})")
    return samples / text
