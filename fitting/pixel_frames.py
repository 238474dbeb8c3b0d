"""A session's frames as a decay of every pixel, in memory that does not grow with frames.

The values of one pixel lie in all frames, and all frames of a large sensor fit in no memory: each is decoded once, into
one temporary file that keeps rows of all frames together, and read back strip by strip. A pixel of a map is a cell of
2 x 2 sensor pixels (or a multiple), because that is the smallest that has every colour; nothing is interpolated.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.fitting.compiled import compiled
from phoslab.fitting.measured_camera import MeasuredCamera
from phoslab.fitting.register import Register
from phoslab.raw import check_settings, decoded
from phoslab.raw_worker import SATURATED
from phoslab.session import Frame, Session

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]
Values = NDArray[np.uint16]

_STRIP_BYTES = 24 << 20
_AT_ONCE = 2
# A pixel whose dark frames stand so many standard deviations above those of its colour is hot.
_HOT = 8.0


@dataclass(frozen=True, eq=False)
class PixelFrames:
    """Frames of one session in a temporary file.

    Args:
        file: (strips, frames, rows of a strip, w) uint16.
        shape: (h, w) that is kept: whole cells.
        strip_rows: rows of a strip, whole cells; the last strip may have fewer that count.
        cell: side of a cell in pixels.
        colours: (2, 2) colour of each pixel of the pattern: 0 red, 1 green, 2 blue.
        dark_dn: (n_frames, 2, 2) what a pixel of the pattern reads without light.
        read_dn2: (n_frames,) variance of a pixel without light, DN².
        limit_dn: (2, 2) values that are saturated.
        scale: (n_frames,) from DN to signal a second at ISO 100 and f/1.
        hot: (h, w) pixels to leave out.
        total: (h / cell, w / cell) DN above dark of each cell, all frames together.
        moved_px: (n_frames, 2) by how much each frame lay (down, right) of the first, in pixels of the sensor, before
            it was moved back by whole cells; NaN where the picture was not recognised: taken to lie as the one before.
    """

    file: Path
    shape: tuple[int, int]
    strip_rows: int
    cell: int
    colours: NDArray[np.int64]
    dark_dn: Array
    read_dn2: Array
    limit_dn: Array
    scale: Array
    hot: NDArray[np.bool_]
    total: Pixels
    moved_px: Array

    @property
    def pixels_a_colour(self) -> Array:
        """(3,) pixels of each colour in a cell."""
        counts: Array = np.bincount(self.colours.ravel(), minlength=3) * (self.cell // 2) ** 2.0
        return counts

    def strips(self) -> Iterator[tuple[int, Pixels]]:
        """Yield (first row of cells, signal (n_rows, n_columns, n_frames, 3)) from the top down; NaN where left out."""
        h, w = self.shape
        n = self.scale.size
        with self.file.open("rb") as stream:
            for top in range(0, h, self.strip_rows):
                block = np.fromfile(stream, np.uint16, n * self.strip_rows * w).reshape(n, self.strip_rows, w)
                rows = min(self.strip_rows, h - top)
                signal = np.empty((rows // self.cell, w // self.cell, n, 3), np.float32)
                _cells(
                    block,
                    self.hot[top : top + rows],
                    self.colours,
                    self.dark_dn,
                    self.limit_dn,
                    self.scale,
                    self.cell,
                    signal,
                )
                yield top // self.cell, signal


@contextmanager
def stored(
    session: Session,
    frames: Sequence[Frame],
    folder: Path,
    *,
    side: int = 1,
    camera: MeasuredCamera | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[PixelFrames]:
    """Decode decay frames and their darks into a temporary file, which is gone afterwards.

    Args:
        folder: where the file lies meanwhile: 2 bytes a pixel and frame.
        side: of a cell, in units of the colour pattern.
        camera: whose settings are taken; by default what is written on them.
        progress: called with (frames done, frames in all).

    Raises:
        PhoslabError: a frame cannot be decoded, has another size, or no Bayer pattern; or the disk is too small.
    """
    settings = {(f.exposure_s, f.iso) for f in frames}
    darks = [f for f in session.frames_of("dark") if (f.exposure_s, f.iso) in settings]
    with tempfile.TemporaryDirectory(prefix=".phoslab-", dir=folder) as scratch:
        done = 0

        def answers(some: Sequence[Frame]) -> Iterator[tuple[Frame, dict[str, Any]]]:
            nonlocal done
            for first in range(0, len(some), _AT_ONCE):
                batch = some[first : first + _AT_ONCE]
                found = decoded("phoslab.raw_worker:job_values", [f.path for f in batch], {})
                for frame in batch:
                    answer = found.pop(0)
                    check_settings(frame, answer)
                    done += 1
                    yield frame, answer
                    if progress:
                        progress(done, len(frames) + len(darks))

        scale = np.array([(camera or MeasuredCamera()).factor(f) for f in frames])
        yield _store(frames, darks, Path(scratch) / "frames", side, scale, answers)


def _store(
    frames: Sequence[Frame],
    darks: Sequence[Frame],
    file: Path,
    side: int,
    scale: Array,
    answers: Callable[[Sequence[Frame]], Iterator[tuple[Frame, dict[str, Any]]]],
) -> PixelFrames:
    cell = 2 * side
    hot: NDArray[np.bool_] | None = None
    levels: dict[tuple[float, float], Array] = {}
    spreads: dict[tuple[float, float], float] = {}
    for setting in sorted({(f.exposure_s, f.iso) for f in darks}):
        own = [f for f in darks if (f.exposure_s, f.iso) == setting]
        total: NDArray[np.uint32] | None = None
        for frame, answer in answers(own):
            values = _whole_cells(frame, answer, cell, total)
            total = values.astype(np.uint32) if total is None else total + values
        assert total is not None
        hot = np.zeros(total.shape, bool) if hot is None else hot
        level, variance = np.empty((2, 2)), np.empty((2, 2))
        for y in range(2):
            for x in range(2):
                plane = total[y::2, x::2]
                # Middle and spread as a majority of the pixels has them; whole numbers: at least a DN.
                middle = float(np.median(plane))
                near = plane[np.abs(plane - middle) < _HOT * max(1.0, _spread(plane))]
                level[y, x] = near.mean() / len(own)
                # A twelfth: numbers are whole.
                variance[y, x] = max(float(near.var()), 1 / 12) / len(own)
                hot[y::2, x::2] |= plane > near.mean() + _HOT * max(1.0, float(near.std()))
        levels[setting], spreads[setting] = level, float(variance.mean())
    assert hot is not None
    (h, w), n = hot.shape, len(frames)
    strip_rows = max(1, _STRIP_BYTES // (2 * n * w * cell)) * cell
    strip_rows = min(strip_rows, h)
    needed = 2 * n * w * strip_rows * -(-h // strip_rows)
    free = shutil.disk_usage(file.parent).free
    if free < needed:
        raise PhoslabError(
            f"has {free / 1e9:.1f} GB free, and the frames of all pixels take {needed / 1e9:.1f} GB for a while",
            file=file.parent.parent,
            remedy="Make room, or name an output on another disk.",
        )
    brightness = np.zeros((h // cell, w // cell), np.float32)
    colours, limit = np.zeros((2, 2), np.int64), np.zeros((2, 2))
    register: Register | None = None
    back: tuple[int, ...] = (0, 0)
    sensor_hot, moved = hot.copy(), np.full((n, 2), np.nan)
    with file.open("wb") as stream:
        os.truncate(stream.fileno(), needed)
        for k, (frame, answer) in enumerate(answers(frames)):
            values = _whole_cells(frame, answer, cell, hot)
            cfa = answer["cfa"][:2, :2]
            if k == 0:
                colours[:] = np.where(cfa == 3, 1, cfa)
                limit[:] = (answer["black"] + SATURATED * (answer["white"] - answer["black"]))[cfa]
            finest = _cell_sums(values, 2)
            register = register or Register(finest)
            shift = register.shift(finest)
            if shift is not None:
                moved[k] = 2 * np.array(shift)
                back = tuple(-cell * round(d / cell) for d in moved[k])
            if any(back):
                # By whole cells, so that pixels keep their colours. Where hot ones come to lie is left out in all.
                values = np.roll(values, back, (0, 1))
                hot |= np.roll(sensor_hot, back, (0, 1))
            for s, top in enumerate(range(0, h, strip_rows)):
                stream.seek(2 * (s * n + k) * strip_rows * w)
                stream.write(values[top : top + strip_rows].data)
            dark = np.float32(levels[frame.exposure_s, frame.iso].mean() * cell**2)
            brightness += _cell_sums(values, cell) - dark
    return PixelFrames(
        file=file,
        shape=(h, w),
        strip_rows=strip_rows,
        cell=cell,
        colours=colours,
        dark_dn=np.array([levels[f.exposure_s, f.iso] for f in frames]),
        read_dn2=np.array([spreads[f.exposure_s, f.iso] for f in frames]),
        limit_dn=limit,
        scale=scale,
        hot=hot,
        total=brightness,
        moved_px=moved,
    )


def _cell_sums(values: Values, cell: int) -> NDArray[np.uint32]:
    """(h / cell, w / cell) sums over cells."""
    h, w = values.shape
    sums = np.add.reduceat(values, np.arange(0, h, cell), axis=0, dtype=np.uint32)
    return np.asarray(np.add.reduceat(sums, np.arange(0, w, cell), axis=1, dtype=np.uint32))


def _whole_cells(frame: Frame, answer: dict[str, Any], cell: int, like: NDArray[Any] | None) -> Values:
    """Return a frame's values cut to whole cells; refuse another size than that of the frames before."""
    values, cfa = answer["values"], answer["cfa"]
    bayer = all(np.array_equal(cfa[:2, :2], cfa[y : y + 2, x : x + 2]) for y in (0, 2, 4) for x in (0, 2, 4))
    if not bayer or set(np.unique(cfa[:2, :2])) - {1, 3} != {0, 2}:
        raise PhoslabError(
            "has no Bayer pattern of 2 x 2 pixels",
            file=frame.path,
            remedy="Maps need a camera with one; without --per-pixel, others serve as well.",
        )
    h, w = (n // cell * cell for n in values.shape)
    cut: Values = np.ascontiguousarray(values[:h, :w])
    if not cut.size or (like is not None and like.shape != cut.shape):
        raise PhoslabError(
            f"has {values.shape[0]} x {values.shape[1]} pixels, unlike other frames of this session, or too few",
            file=frame.path,
            remedy="Record the whole session at one size; lower --bin if a cell is larger than the frame.",
        )
    return cut


def _spread(plane: NDArray[Any]) -> float:
    """Standard deviation of a normal distribution with these quartiles."""
    low, high = np.percentile(plane, [25, 75])
    return float(high - low) / 1.349


@compiled
def _cells(
    block: Values,
    hot: NDArray[np.bool_],
    colours: NDArray[np.int64],
    dark_dn: Array,
    limit_dn: Array,
    scale: Array,
    cell: int,
    signal: Pixels,
) -> None:
    """Write the mean of each colour in each cell; NaN where one is saturated, or more than a quarter are hot."""
    total, count, whole, clipped = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    for row in range(signal.shape[0]):
        for k in range(scale.size):
            for column in range(signal.shape[1]):
                total[:], count[:], whole[:], clipped[:] = 0.0, 0.0, 0.0, 0.0
                for y in range(row * cell, row * cell + cell):
                    for x in range(column * cell, column * cell + cell):
                        colour = colours[y % 2, x % 2]
                        value = float(block[k, y, x])
                        whole[colour] += 1
                        if hot[y, x]:
                            continue
                        if value >= limit_dn[y % 2, x % 2]:
                            clipped[colour] += 1
                        total[colour] += value - dark_dn[k, y % 2, x % 2]
                        count[colour] += 1
                for c in range(3):
                    left_out = clipped[c] > 0 or 4 * count[c] < 3 * whole[c]
                    signal[row, column, k, c] = np.nan if left_out else total[c] / count[c] * scale[k]
