"""Sessions of large frames: reduction beside a bare decode of the same files, and the memory of a fit of every pixel.

The bench records a small session of a sample that varies; each frame is then repeated side by side until it is as large
as a camera's, and written as cameras write it, as lossless JPEG. That needs imagecodecs, which is of the peers; without
it frames are not compressed and decode in no time.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np

from phoslab.app.trades import fit_process
from phoslab.instruments.bench.bench import STATEMENT, record_decay
from phoslab.instruments.bench.camera import Camera
from phoslab.instruments.bench.dng import write_dng
from phoslab.instruments.bench.inlay import InlaidBench
from phoslab.raw import read_raw
from phoslab.session import Session

_SMALL = (288, 400)
_SEED = 5

# What all three do before the first frame, checksums included, is not decoding: it is measured, and taken off.
_OPEN = """
import sys, rawpy
from phoslab.fitting.reduction import reduce_decay
from phoslab.session import Session
session = Session.open(sys.argv[1])
"""
_DECODE = f"""{_OPEN}
for frame in session.frames:
    with rawpy.imread(str(frame.path)) as raw:
        raw.raw_image_visible.sum()
"""
_REDUCE = f"{_OPEN}reduce_decay(session)\n"


def compressed() -> bool:
    """Whether frames can be written as cameras write them."""
    return importlib.util.find_spec("imagecodecs") is not None


@dataclass(frozen=True)
class Reduced:
    """A session's reduction beside a bare decode, (n_turns,) each; in s a frame, opening taken off.

    Args:
        frames, pixels: how many there are, and in each.
        decode_s, reduce_s: by the clock.
        ratio, cpu_ratio: reduction over decode, by the clock and of processors.
        held_bytes: of the reduction.
    """

    frames: int
    pixels: int
    decode_s: float
    reduce_s: float
    ratio: tuple[float, ...]
    cpu_ratio: float
    held_bytes: int


@dataclass(frozen=True)
class EveryPixel:
    """`phoslab fit --per-pixel` of a session.

    Args:
        frames, pixels: how many there are, and in each.
        fitted, states: pixels of the maps that were fitted, and with how many states.
        clock_s, cpu_s: seconds.
        held_bytes: all processes together, at most.
    """

    frames: int
    pixels: int
    fitted: int
    states: int
    clock_s: float
    cpu_s: float
    held_bytes: int


def record(folder: Path, shape: tuple[int, int], n_frames: int) -> Path:
    """Make a decay session of so many decay frames of (h, w) pixels in `folder`; return it."""
    record_decay(folder, InlaidBench(_SEED, camera=Camera().resized(_SMALL)), n_frames=n_frames)
    _enlarge(Session.open(folder), shape)
    return folder


def reduction(folder: Path, turns: int, tick: Callable[[int], None]) -> Reduced:
    """Time a session's reduction and a bare decode, in turns."""
    times = []
    for _ in range(turns):
        times.append([fit_process.python(code, str(folder)) for code in (_OPEN, _DECODE, _REDUCE)])
        tick(1)
    n = len(Session.open(folder).frames)

    def clock_s(k: int) -> float:
        return median(t[k].clock_s - t[0].clock_s for t in times) / n

    return Reduced(
        frames=n,
        pixels=_pixels(folder),
        decode_s=clock_s(1),
        reduce_s=clock_s(2),
        ratio=tuple((r.clock_s - o.clock_s) / (d.clock_s - o.clock_s) for o, d, r in times),
        cpu_ratio=median((r.cpu_s - o.cpu_s) / (d.cpu_s - o.cpu_s) for o, d, r in times),
        held_bytes=max(r.held_bytes for *_, r in times),
    )


def every_pixel(folder: Path) -> EveryPixel:
    """Fit every pixel of a session, as a person would."""
    maps = folder.parent / f"{folder.name}-maps"
    words = ("fit", str(folder), "--preset", "green", "--per-pixel", "-o", str(maps), "--json")
    took = fit_process.command(*words)
    shutil.rmtree(maps)
    said = json.loads(took.printed)
    return EveryPixel(
        frames=len(Session.open(folder).frames),
        pixels=_pixels(folder),
        fitted=int(said["counts"]["fitted"]),
        states=int(said["states"]),
        clock_s=took.clock_s,
        cpu_s=took.cpu_s,
        held_bytes=took.held_bytes,
    )


def _pixels(folder: Path) -> int:
    return int(read_raw(Session.open(folder).frames[0].path).values.size)


def _enlarge(session: Session, shape: tuple[int, int]) -> None:
    """Repeat every frame of a session in place until it is (h, w), and tell its journal."""
    camera = Camera().resized(shape)
    known = {}
    for frame in session.frames:
        small = read_raw(frame.path).values
        times = [-(-want // have) for want, have in zip(shape, small.shape, strict=True)]
        values = np.zeros(camera.size, np.uint16)
        values[camera.visible] = np.tile(small, times)[: shape[0], : shape[1]]
        write_dng(
            frame.path,
            values,
            camera.sensor,
            exposure_s=frame.exposure_s,
            iso=int(frame.iso),
            f_number=frame.f_number or 1.0,
            taken="2026:01:15 18:00:00",
            description=STATEMENT,
            compressed=compressed(),
        )
        content = frame.path.read_bytes()
        known[frame.name] = {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}
    journal = session.path / "journal.jsonl"
    lines: Sequence[dict[str, str]] = [json.loads(line) for line in journal.read_text().splitlines()]
    journal.write_text("".join(json.dumps({**x, **known.get(x.get("frame", ""), {})}) + "\n" for x in lines))
