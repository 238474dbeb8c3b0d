"""phoslab: measure, fit and render phosphorescent materials.

>>> import phoslab
>>> phoslab.preset("green").kr_per_s.tolist()
[0.227]
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phoslab.material import Material as Material
    from phoslab.presets import preset as preset

__version__ = "0.1.0"

if (Path(__file__).resolve().parent.parent / "pyproject.toml").is_file():
    importlib.import_module("phoslab.checkout")

_HOME = {"Material": "phoslab.material", "preset": "phoslab.presets"}
_PACKAGES = ("fitting", "instruments", "kinetics", "render")


def __getattr__(name: str) -> Any:
    """Import parts when they are first used: `import phoslab` itself costs next to nothing."""
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    if name in _PACKAGES:
        return importlib.import_module(f"phoslab.{name}")
    raise AttributeError(f"module 'phoslab' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME, *_PACKAGES})
