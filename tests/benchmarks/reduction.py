"""RAW reduction beside a bare decode of the same files: time, and memory as frames are added.

    PYTHONPATH=. python tests/benchmarks/reduction.py [HEIGHT WIDTH]

1872 by 2808, 5 million pixels, by default; 3744 by 5616 needs 3 GB of disk. Decay sessions of 13 and 37 frames are
made large as in per_pixel_memory.py, and written as cameras write them, as lossless JPEG (pip install imagecodecs). In
turns, every frame is decoded with rawpy, one after the other, and the session is reduced with `reduce_decay`, each in a
process of its own. The goals: at most 1.3 times the decode's time, and memory that does not grow with the number of
frames. Time is that of the clock and that of processors; the reduction decodes two frames at a time, in workers of its
own. Memory is that of all its processes together (PSS).
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

from phoslab.instruments.bench.bench import record_decay
from phoslab.instruments.bench.camera import Camera
from phoslab.instruments.bench.inlay import InlaidBench
from phoslab.session import Session
from tests.benchmarks.per_pixel_memory import SMALL, enlarge, held_bytes

TURNS = 5


def as_cameras_write() -> None:
    """From now on let DNG files of this process be compressed."""
    import imagecodecs  # noqa: F401 - tifffile needs it
    import tifffile

    plain = tifffile.imwrite

    def compressed(file: Any, values: Any, **options: Any) -> Any:
        lossless = {"lossless": True, "bitspersample": 16, "predictor": 1}
        how = {"compression": "jpeg", "compressionargs": lossless, "rowsperstrip": values.shape[0]}
        return plain(file, values, **options | how)

    tifffile.imwrite = compressed


DECODE = """
import sys, rawpy
from phoslab.session import Session
for frame in Session.open(sys.argv[1]).frames:
    with rawpy.imread(str(frame.path)) as raw:
        raw.raw_image_visible.sum()
"""
REDUCE = """
import sys
from phoslab.fitting.reduction import reduce_decay
from phoslab.session import Session
reduce_decay(Session.open(sys.argv[1]))
"""
OPEN = """
import sys, rawpy
from phoslab.fitting.reduction import reduce_decay
from phoslab.session import Session
Session.open(sys.argv[1])
"""


def took(code: str, folder: Path) -> tuple[float, float, int]:
    """Seconds by the clock and of processors, and bytes at most."""
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    most = 0
    with subprocess.Popen([sys.executable, "-c", code, str(folder)]) as process:
        while process.poll() is None:
            most = max(most, held_bytes(process.pid))
            time.sleep(0.05)
    assert process.returncode == 0
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - began, cpu, most


def main() -> None:
    as_cameras_write()
    shape = (int(sys.argv[1]), int(sys.argv[2])) if len(sys.argv) > 2 else (1872, 2808)
    with tempfile.TemporaryDirectory(dir=".") as scratch:
        for n in (13, 37):
            folder = Path(scratch) / str(n)
            record_decay(folder, InlaidBench(5, camera=Camera().resized(SMALL)), n_frames=n)
            enlarge(Session.open(folder), shape)
            turns = [[took(code, folder) for code in (OPEN, DECODE, REDUCE)] for _ in range(TURNS)]
            # What both do before the first frame, checksums included, is not decoding.
            clock = [(r[0] - o[0]) / (d[0] - o[0]) for o, d, r in turns]
            cpu = [(r[1] - o[1]) / (d[1] - o[1]) for o, d, r in turns]
            n_all = len(Session.open(folder).frames)
            ms = [1e3 * median(t[k][0] - t[0][0] for t in turns) / n_all for k in (1, 2)]
            print(
                f"{n_all} frames of {shape[0] * shape[1] / 1e6:.1f} million pixels: {ms[0]:.0f} ms a frame to decode, "
                f"{ms[1]:.0f} to reduce; {median(clock):.2f} by the clock ({min(clock):.2f} to {max(clock):.2f}), "
                f"{median(cpu):.2f} of processors; {median(r[2] for *_, r in turns) / 1e6:.0f} MB at most",
                flush=True,
            )


if __name__ == "__main__":
    main()
