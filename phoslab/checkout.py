"""In a checkout, the packages phoslab.render, phoslab.fitting, ... are the folders beside this one.

A wheel has them inside, and never imports this file.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path
from types import ModuleType

BESIDE = ("fitting", "instruments", "render", "sample_data", "shaders")


class _Finder:
    """Finds each of `BESIDE`; what is inside them is found as in any package."""

    @staticmethod
    def find_spec(
        name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        parent, _, last = name.rpartition(".")
        if parent != "phoslab" or last not in BESIDE:
            return None
        folder = Path(__file__).resolve().parent.parent / last
        return spec_from_file_location(name, folder / "__init__.py", submodule_search_locations=[str(folder)])


sys.meta_path.append(_Finder)
