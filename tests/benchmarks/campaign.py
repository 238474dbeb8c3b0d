"""Measure a whole campaign from RAW frames to report: time, and the memory of all processes together.

    PYTHONPATH=. python tests/benchmarks/campaign.py DIR

DIR holds the sessions of one sample, flats, lvf, lamp, emission, decay and excitation, as `phoslab measure all` writes
them, or is given those of the simulated bench. What a person types is run: `calibrate`, then `fit --report`.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.benchmarks.held_out_pictures import PLANS, measure
from tests.benchmarks.per_pixel_memory import held_bytes


def run(*words: str) -> None:
    """Run a command and print what it took."""
    began, most = time.perf_counter(), 0
    with subprocess.Popen([sys.executable, "-m", "phoslab", *words], stdout=subprocess.DEVNULL) as process:
        while process.poll() is None:
            most = max(most, held_bytes(process.pid))
            time.sleep(0.05)
    assert process.returncode == 0
    print(f"phoslab {words[0]}: {time.perf_counter() - began:.1f} s, {most / 1e6:.0f} MB at most", flush=True)


def main(folder: Path) -> None:
    if not folder.exists():
        measure("green", folder)
    frames = [path for path in folder.glob("*/frames/*") if path.parent.parent.name in PLANS]
    size = sum(path.stat().st_size for path in frames)
    print(f"{len(frames)} frames, {size / 1e6:.0f} MB")
    with tempfile.TemporaryDirectory() as scratch:
        lvf, out = Path(scratch) / "lvf.json", Path(scratch) / "material.json"
        run("calibrate", str(folder / "lvf"), str(folder / "flats"), "-o", str(lvf))
        run("fit", str(folder), "--lvf", str(lvf), "-o", str(out), "--report", str(Path(scratch) / "r.html"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
