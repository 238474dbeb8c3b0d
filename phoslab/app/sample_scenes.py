"""The sample scenes, by name: `phoslab render cornell` needs no path."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from phoslab.errors import PhoslabError

HELP = "a scene.toml, its folder, or the name of a sample scene"


def find_scene(given: Path) -> Path:
    """Return the path that SCENE means: what is there, or else the sample scene of that name.

    Raises:
        PhoslabError: neither is there, and it looks like a name.

    >>> find_scene(Path("cornell")).name
    'cornell'
    """
    if given.exists() or len(given.parts) != 1 or given.suffix:
        return given
    samples = Path(str(files("phoslab.sample_data") / "scenes"))
    if not (samples / given).is_dir():
        names = ", ".join(sorted(p.name for p in samples.iterdir() if p.is_dir()))
        raise PhoslabError(
            "is neither here nor a sample scene",
            file=given,
            remedy=f"Name a scene.toml, a folder with one, or one of: {names}.",
        )
    return samples / given
