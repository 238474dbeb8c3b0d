"""Measure `phoslab fit --per-pixel` on a session of large frames: time, and the memory of all its processes together.

    python tests/benchmarks/per_pixel_memory.py [HEIGHT WIDTH]

3744 by 5600, 21 million pixels, by default; it needs 6 GB of disk. The bench records a small session of a sample that
varies; each frame is then repeated side by side until it is as large as asked for. Memory is the sum of what the
processes hold alone and their share of what they hold together (PSS), polled five times a second.
"""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from phoslab.instruments.bench.bench import STATEMENT, record_decay
from phoslab.instruments.bench.camera import Camera
from phoslab.instruments.bench.dng import write_dng
from phoslab.instruments.bench.inlay import InlaidBench
from phoslab.raw import read_raw
from phoslab.session import Session

SMALL = (288, 400)


def enlarge(session: Session, shape: tuple[int, int]) -> None:
    """Repeat every frame of a session in place, and tell its journal."""
    camera = Camera().resized(shape)
    top, left, *_ = camera.sensor.active_area
    known = {}
    for frame in session.frames:
        small = read_raw(frame.path).values
        times = [-(-want // have) for want, have in zip(shape, small.shape, strict=True)]
        values = np.zeros(camera.size, np.uint16)
        values[top : top + shape[0], left : left + shape[1]] = np.tile(small, times)[: shape[0], : shape[1]]
        write_dng(
            frame.path,
            values,
            camera.sensor,
            exposure_s=frame.exposure_s,
            iso=int(frame.iso),
            f_number=frame.f_number or 1.0,
            taken="2026:01:15 18:00:00",
            description=STATEMENT,
        )
        content = frame.path.read_bytes()
        known[frame.name] = {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}
    journal = session.path / "journal.jsonl"
    lines = [json.loads(line) for line in journal.read_text().splitlines()]
    journal.write_text("".join(json.dumps({**x, **known.get(x.get("frame", ""), {})}) + "\n" for x in lines))


def held_bytes(pid: int) -> int:
    """PSS of a process and all below it."""
    total = 0
    try:
        total += 1024 * int(
            re.search(r"^Pss: *(\d+)", Path(f"/proc/{pid}/smaps_rollup").read_text(), re.M)[1]
        )
        for thread in Path(f"/proc/{pid}/task").iterdir():
            total += sum(held_bytes(int(child)) for child in (thread / "children").read_text().split())
    except (OSError, TypeError):  # it has ended meanwhile
        pass
    return total


def main() -> None:
    shape = (int(sys.argv[1]), int(sys.argv[2])) if len(sys.argv) > 2 else (3744, 5600)
    with tempfile.TemporaryDirectory(dir=".") as scratch:
        folder = Path(scratch) / "session"
        record_decay(folder, InlaidBench(5, camera=Camera().resized(SMALL)))
        enlarge(Session.open(folder), shape)
        print(
            f"{shape[0] * shape[1] / 1e6:.1f} million pixels, {len(Session.open(folder).frames)} frames",
            flush=True,
        )
        command = [sys.executable, "-m", "phoslab", "fit", str(folder), "--preset", "green", "--per-pixel"]
        began, most = time.perf_counter(), 0
        with subprocess.Popen(
            [*command, "-o", str(Path(scratch) / "maps"), "--json"], stdout=subprocess.PIPE, text=True
        ) as fit:
            while fit.poll() is None:
                most = max(most, held_bytes(fit.pid))
                time.sleep(0.2)
            assert fit.stdout is not None
            said = json.loads(fit.stdout.read())
        print(f"{time.perf_counter() - began:.0f} s, {most / 1e9:.2f} GB at most")
        print(
            f"{said['counts']['fitted']:,} of {said['counts']['pixels']:,} pixels fitted, {said['states']} states"
        )


if __name__ == "__main__":
    main()
