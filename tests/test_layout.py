"""The one layout rule, the folder X/ is the package phoslab.X, in every way that phoslab can be there."""

from __future__ import annotations

import fnmatch
import importlib
import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from dataclasses import dataclass
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())
PACKAGES: list[str] = PROJECT["tool"]["setuptools"]["packages"]
BESIDE = ("fitting", "instruments", "render", "sample_data", "shaders")  # folders beside phoslab/

# What a user does with any of them. `sys.argv[1]`: where phoslab must come from.
USE = """
import importlib, importlib.util, sys
from pathlib import Path
import phoslab
for package in {packages}:
    found = Path(importlib.import_module(package).__file__)
    assert found.is_relative_to(sys.argv[1]), f"{{package}} is {{found}}, not in {{sys.argv[1]}}"
assert phoslab.preset("green").name == "green"
print("works")
"""
NO_STRAY_NAMES = """
import importlib.util
for name in {beside}:
    assert importlib.util.find_spec(name) is None, f"{{name}} is importable by itself"
"""


@dataclass(frozen=True)
class Installed:
    """A Python that has phoslab, and the folder from which phoslab must come."""

    python: Path
    home: Path


def _sources(to: Path) -> Path:
    """Copy what a wheel is built from, so that no build/ or egg-info appears in the checkout."""
    ignore = shutil.ignore_patterns("__pycache__")
    for name in ("phoslab", *BESIDE):
        shutil.copytree(CHECKOUT / name, to / name, ignore=ignore)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(CHECKOUT / name, to)
    return to


def _python(python: Path | str, *arguments: str, cwd: Path, path: Path | None = None) -> str:
    env = {k: v for k, v in os.environ.items() if not k.startswith(("PHOSLAB_", "PYTHON"))}
    env["PYTHONDONTWRITEBYTECODE"] = "1"
    if path is not None:
        env["PYTHONPATH"] = str(path)
    done = subprocess.run(
        [python, *arguments], cwd=cwd, env=env, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def _pip(python: Path | str, *arguments: str, cwd: Path) -> None:
    common = ["--no-index", "--no-deps", "--no-build-isolation", "--quiet"]
    _python(sys.executable, "-m", "pip", "--python", str(python), *arguments, *common, cwd=cwd)


def _environment(folder: Path) -> Path:
    """Make an environment that shares this one's packages, all but phoslab."""
    _python(sys.executable, "-m", "venv", "--without-pip", str(folder), cwd=folder.parent)
    python = folder / "bin" / "python"
    shared = folder / "shared"
    shared.mkdir()
    for package in Path(sysconfig.get_path("purelib")).iterdir():
        if "phoslab" not in package.name and package.suffix != ".pth":
            (shared / package.name).symlink_to(package)
    where = "import sysconfig; print(sysconfig.get_path('purelib'))"
    purelib = Path(_python(python, "-c", where, cwd=folder).strip())
    (purelib / "shared.pth").write_text(str(shared))
    return python


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    sources = _sources(tmp_path_factory.mktemp("sources"))
    out = tmp_path_factory.mktemp("wheel")
    _pip(sys.executable, "wheel", "-w", str(out), str(sources), cwd=out)
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def from_wheel(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    folder = tmp_path_factory.mktemp("from-wheel")
    python = _environment(folder / "venv")
    _pip(python, "install", str(wheel), cwd=folder)
    return Installed(python, folder)


@pytest.fixture(scope="module")
def editable(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    folder = tmp_path_factory.mktemp("editable")
    sources = _sources(tmp_path_factory.mktemp("checkout"))
    python = _environment(folder / "venv")
    _pip(python, "install", "-e", str(sources), cwd=folder)
    return Installed(python, sources)


def _use(python: Path | str, home: Path, *, cwd: Path, path: Path | None = None) -> None:
    program = USE.format(packages=PACKAGES)
    assert _python(python, "-c", program, str(home), cwd=cwd, path=path) == "works\n"
    assert "usage: phoslab" in _python(python, "-m", "phoslab", "--help", cwd=cwd, path=path)


def test_a_wheel_brings_every_package(from_wheel: Installed, tmp_path: Path) -> None:
    _use(from_wheel.python, from_wheel.home, cwd=tmp_path)
    assert "usage: phoslab" in _python(from_wheel.python.parent / "phoslab", "--help", cwd=tmp_path)


def test_an_editable_install_uses_the_checkout(editable: Installed, tmp_path: Path) -> None:
    _use(editable.python, editable.home, cwd=tmp_path)
    assert "usage: phoslab" in _python(editable.python.parent / "phoslab", "--help", cwd=tmp_path)


def test_a_bare_checkout_works_from_its_own_folder() -> None:
    _use(sys.executable, CHECKOUT, cwd=CHECKOUT)


def test_a_bare_checkout_works_by_pythonpath(tmp_path: Path) -> None:
    _use(sys.executable, CHECKOUT, cwd=tmp_path, path=CHECKOUT)


def test_no_install_brings_a_top_level_name_but_phoslab(
    from_wheel: Installed, editable: Installed, tmp_path: Path
) -> None:
    for python in (from_wheel.python, editable.python):
        _python(python, "-c", NO_STRAY_NAMES.format(beside=BESIDE), cwd=tmp_path)


def test_the_wheel_holds_the_one_name_phoslab(wheel: Path) -> None:
    version = PROJECT["project"]["version"]
    names = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert names == {"phoslab", f"phoslab-{version}.dist-info"}


def test_the_wheel_holds_every_source_file_and_nothing_else(wheel: Path) -> None:
    """A folder that is missing in pyproject.toml, or a kind of data file, would be missed only by users."""
    expected = {
        path.relative_to(CHECKOUT).as_posix()
        for folder in ("phoslab", *BESIDE)
        for path in (CHECKOUT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    expected = {name if name.startswith("phoslab/") else f"phoslab/{name}" for name in expected}
    held = {name for name in zipfile.ZipFile(wheel).namelist() if name.startswith("phoslab/")}
    assert held == expected


@pytest.mark.parametrize(
    "example",
    [
        "py.typed",
        "presets/green.json",
        "schemas/material-1.schema.json",
        "shaders/*.glsl",
        "sample_data/*/*",
        "instruments/firmware/*.c",
    ],
)
def test_the_wheel_holds_data_of_every_kind(wheel: Path, example: str) -> None:
    held = zipfile.ZipFile(wheel).namelist()
    assert fnmatch.filter(held, f"phoslab/{example}"), f"no {example} in the wheel"


def test_the_version_is_the_same_everywhere() -> None:
    import phoslab

    assert phoslab.__version__ == PROJECT["project"]["version"]


def test_the_tests_run_against_what_run_installed() -> None:
    """A checkout on sys.path would shadow the wheel, and every other test would prove the wrong thing."""
    if os.environ.get("PHOSLAB_EXPECT_INSTALLED") != "1":
        pytest.skip("not started by ./run test: any phoslab will do")
    site_packages = sysconfig.get_path("purelib")
    for package in PACKAGES:
        found = importlib.import_module(package).__file__
        assert found is not None
        assert Path(found).is_relative_to(site_packages), f"{package} is {found}"
