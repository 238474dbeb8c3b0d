"""What a command loads: `--help` nothing but Python's own modules, a command only what it uses.

How long that takes is a measurement, not a test: `python tests/benchmarks/help_cost.py`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest

from phoslab.app.cli import COMMANDS

# Import names of everything that phoslab depends on, extras included.
DEPENDENCIES = {
    *("numpy", "scipy", "colour", "rawpy", "cv2", "OpenEXR", "tifffile", "jsonschema", "serial"),
    *(
        "moderngl",
        "pygltflib",
        "xatlas",
        "PIL",
        "matplotlib",
        "jinja2",
        "rich",
        "tomli_w",
        "gphoto2",
        "mitsuba",
        "numba",
    ),
}
PARTS = {"phoslab.fitting", "phoslab.instruments", "phoslab.render", "phoslab.sample_data", "phoslab.shaders"}

RUN_AND_LIST = """
import atexit, json, sys
before = set(sys.modules)
listing = open(sys.argv.pop(1), "w")
atexit.register(lambda: json.dump(sorted(set(sys.modules) - before), listing))
from phoslab.app.cli import main
sys.exit(main(sys.argv[1:]))
"""


def _loaded(*arguments: str, cwd: Path) -> set[str]:
    """Run a command and return the names of all modules that it loaded."""
    listing = cwd / "modules.json"
    done = subprocess.run(
        [sys.executable, "-c", RUN_AND_LIST, str(listing), *arguments],
        cwd=cwd,
        env={**os.environ, "COLUMNS": "100"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return set(json.loads(listing.read_text()))


@pytest.mark.parametrize(
    "arguments", [("--help",), ("--version",), *((command, "--help") for command in COMMANDS)], ids=" ".join
)
def test_help_loads_pythons_own_modules_and_the_command_line_only(
    arguments: tuple[str, ...], tmp_path: Path
) -> None:
    loaded = _loaded(*arguments, cwd=tmp_path)
    assert {
        name for name in loaded if name.split(".")[0] not in {"phoslab", *sys.stdlib_module_names}
    } == set()
    assert not PARTS & loaded


COLOUR = {"colour", "matplotlib", "PIL", "scipy"}  # colour-science itself loads Matplotlib
RENDER = {"numpy", "jsonschema", "rich", "moderngl", "pygltflib", "xatlas", *COLOUR}
FIT = {"numpy", "scipy", "jsonschema", "rich", "cv2", "rawpy", *COLOUR}


MEASURE = {"phoslab.instruments"}


@pytest.mark.parametrize(
    ("arguments", "dependencies", "parts"),
    [
        ("presets", {"numpy", "jsonschema"}, set()),
        ("presets --json", {"numpy", "jsonschema"}, set()),
        ("export green --to csv -o green.csv", {"numpy", "jsonschema"}, set()),
        # Only to say how long it takes: no device, no decoder.
        ("measure decay --simulate green --dry-run", {"numpy", "scipy", "jsonschema", "tomli_w"}, MEASURE),
        ("doctor", {"serial"}, set()),  # the drivers are tried in processes of their own
        ("fit SESSION --preset green -o m.json", FIT, {"phoslab.fitting"}),
        (
            "fit SESSION --preset green -o m.json --report m.html",
            FIT | {"jinja2"},
            {"phoslab.fitting"},
        ),
        # The only one that compiles.
        (
            "fit SESSION --preset green --per-pixel --bin 4 -o maps",
            FIT | {"numba", "jinja2", "OpenEXR"},
            {"phoslab.fitting"},
        ),
        ("fit TABLE --json", FIT, {"phoslab.fitting"}),
        ("classify TABLE", FIT, {"phoslab.fitting"}),
        ("render SCENE -o glow.png --at 0", RENDER, {"phoslab.render", "phoslab.shaders"}),
    ],
)
def test_a_command_loads_only_what_it_uses(
    arguments: str, dependencies: set[str], parts: set[str], tmp_path: Path
) -> None:
    samples = files("phoslab.sample_data")
    paths = {"SESSION": samples / "sessions" / "green-decay", "SCENE": samples / "scenes" / "fading"}
    paths["TABLE"] = tmp_path / "decay.csv"
    paths["TABLE"].write_text("t_s,lum\n0,1\n10,0.5\n20,0.26\n30,0.12\n")
    loaded = _loaded(*(str(paths.get(word, word)) for word in arguments.split()), cwd=tmp_path)
    assert loaded & DEPENDENCIES <= dependencies
    assert loaded & PARTS <= parts


def test_import_phoslab_loads_no_dependency(tmp_path: Path) -> None:
    program = "import sys, phoslab; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=True
    )
    assert not set(done.stdout.split()) & (DEPENDENCIES | PARTS)
