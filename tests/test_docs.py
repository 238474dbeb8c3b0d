"""Every example in the code and in docs/ does what it says."""

import doctest
import importlib
import pkgutil
from pathlib import Path

import pytest

DOCS = sorted((Path(__file__).parent.parent / "docs").glob("*.md"))


PACKAGES = (
    "",
    ".app",
    ".app.trades",
    ".fitting",
    ".instruments",
    ".instruments.bench",
    ".instruments.cameras",
    ".instruments.plans",
    ".presets",
    ".render",
    ".schemas",
    ".trades",
)


def _modules():
    """The names of all modules, without those that act when they are imported."""
    names = set()
    for package in PACKAGES:
        home = importlib.import_module(f"phoslab{package}")
        names |= {f"phoslab{package}.{m.name}" for m in pkgutil.iter_modules(home.__path__)}
    return sorted(names - {"phoslab.__main__", "phoslab.checkout"})


def test_modules_of_every_package_are_found():
    assert {"phoslab.kinetics", "phoslab.fitting.decay", "phoslab.instruments.recorder"} <= set(_modules())


@pytest.mark.parametrize("name", _modules())
def test_examples_in_docstrings_hold(name):
    assert doctest.testmod(importlib.import_module(name)).failed == 0


@pytest.mark.parametrize("page", DOCS, ids=lambda p: p.name)
def test_examples_in_docs_hold(page):
    assert doctest.testfile(str(page), module_relative=False).failed == 0
