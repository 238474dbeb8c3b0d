"""Signals along a strip in a RAW frame: what each colour's pixels see at each place along a linear variable filter.

Places along the strip are s, in pixels from the frame's middle, along the strip's own direction. Pixels of one colour
are few and lie at places of their own, so a mean over a bin would belong to another place in each colour. Instead the
pixels are fitted by straight lines between nodes (a linear spline, least squares), whose values at the nodes belong to
the nodes. The pixels across the strip are averaged by that (Nalbach 2017, 8.4.2).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from phoslab.raw import check_settings, decoded
from phoslab.raw_worker import SATURATED, decode, noise_law, planes
from phoslab.session import Frame

Array = NDArray[np.float64]

INSIDE = (0.15, 0.85)
"""Share of the strip's width that is averaged: the lens blurs its rims."""

OUTSIDE = ((-0.6, -0.3), (1.3, 1.6))
"""Where, in widths beside the strip, the light is read that the lens scatters over all of the frame."""

_LEAST_DN2 = 1 / 12
"""Numbers are whole: a pixel cannot have less noise than rounding makes."""

NODE_PX = 2.0
"""Least distance of nodes: a colour's pixels lie two pixels apart."""


@dataclass(frozen=True)
class Strip:
    """Where a strip lies in a frame.

    Rotated coordinates in pixels, origin in the frame's middle: x along the strip, y across it.

    Args:
        shape: (h, w) of the frame.
        angle_deg: of x against the rows, clockwise as seen in the picture.
        top, bottom: (offset, slope) of the two long edges, y = offset + slope x.
        slant: dx/dy of the lines of one wavelength; 0 where they are at right angles to x.
        ends_px: x of the first and the last node.
    """

    shape: tuple[int, int]
    angle_deg: float
    top: tuple[float, float]
    bottom: tuple[float, float]
    slant: float
    ends_px: tuple[float, float]

    @property
    def nodes_px(self) -> Array:
        """(n,) s of the nodes."""
        low, high = self.ends_px
        step = max(NODE_PX, (high - low) / 400)
        return np.linspace(low, high, max(2, round((high - low) / step) + 1))

    @property
    def width_px(self) -> float:
        """Distance of the long edges in the middle."""
        return self.bottom[0] - self.top[0]

    def place(self, row: Array, column: Array) -> tuple[Array, Array]:
        """s and v (0 at the upper edge, 1 at the lower one) of pixels."""
        a = np.deg2rad(self.angle_deg)
        dx, dy = column + 0.5 - self.shape[1] / 2, row + 0.5 - self.shape[0] / 2
        x, y = dx * np.cos(a) + dy * np.sin(a), dy * np.cos(a) - dx * np.sin(a)
        top, bottom = self.top[0] + self.top[1] * x, self.bottom[0] + self.bottom[1] * x
        return x - self.slant * (y - (top + bottom) / 2), (y - top) / (bottom - top)

    def middle(self) -> tuple[Array, Array]:
        """Rows and columns (n,) of the nodes, halfway between the long edges."""
        a = np.deg2rad(self.angle_deg)
        x = self.nodes_px
        y = (self.top[0] + self.bottom[0] + (self.top[1] + self.bottom[1]) * x) / 2
        column = x * np.cos(a) - y * np.sin(a) + self.shape[1] / 2 - 0.5
        row = x * np.sin(a) + y * np.cos(a) + self.shape[0] / 2 - 0.5
        return row, column


@dataclass(frozen=True, eq=False)
class StripSignal:
    """What one frame, or the mean of several at one setting, shows along a strip.

    Args:
        nodes_px: (n,) s of the nodes.
        signal: (n, 3) DN above black; NaN where a colour has no usable pixels.
        variance: (n, 3) of it, from the pixels' noise.
        saturated: (n, 3) whether pixels there were saturated: the value is too low.
        beside: (3,) DN beside the strip.
        peak: the largest share of saturation that a pixel inside the strip reaches.
    """

    nodes_px: Array
    signal: Array
    variance: Array
    saturated: NDArray[np.bool_]
    beside: Array
    peak: float


def read_strip(
    frames: Sequence[Frame],
    strip: Strip,
    *,
    part: tuple[float, float] = INSIDE,
    hot: NDArray[np.int64] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[StripSignal]:
    """Read each frame along a strip; frames are decoded one after another by the limited workers.

    Args:
        part: the share of the strip's width to average.
        hot: (m, 2) rows and columns of pixels to leave out.
        progress: called with (frames done, frames in all).

    Raises:
        PhoslabError: as `phoslab.raw.frame_means`; or a frame has another size.
    """
    parameters = {
        "strip": asdict(strip),
        "part": list(part),
        "hot": np.zeros((0, 2), np.int64) if hot is None else hot,
    }
    answers = decoded("phoslab.strip:job_strip", [f.path for f in frames], parameters, progress=progress)
    for frame, answer in zip(frames, answers, strict=True):
        check_settings(frame, answer)
    return [_solved(strip, answer) for answer in answers]


def mean_signal(signals: Sequence[StripSignal]) -> StripSignal:
    """The mean of frames of one light at one setting."""
    n = len(signals)
    return StripSignal(
        nodes_px=signals[0].nodes_px,
        signal=np.mean([s.signal for s in signals], axis=0),
        variance=np.sum([s.variance for s in signals], axis=0) / n**2,
        saturated=np.any([s.saturated for s in signals], axis=0),
        beside=np.mean([s.beside for s in signals], axis=0),
        peak=max(s.peak for s in signals),
    )


def _solved(strip: Strip, answer: dict[str, Any]) -> StripSignal:
    nodes = strip.nodes_px
    signal, variance = np.full((nodes.size, 3), np.nan), np.full((nodes.size, 3), np.inf)
    for c in range(3):
        diagonal, beside, right = answer["diagonal"][c], answer["beside_diagonal"][c], answer["right"][c]
        seen = diagonal > 1e-3 * max(float(diagonal.max()), 1e-300)
        if not seen.any():
            continue
        # Nodes without pixels (off the frame) are held at 0 and left out below.
        banded = np.stack(
            [np.append(0.0, beside), np.where(seen, diagonal, 1.0) + 1e-9 * float(diagonal.max())]
        )
        factor = cholesky_banded(banded)
        values = cho_solve_banded((factor, False), right)
        inverse = cho_solve_banded((factor, False), np.eye(nodes.size))
        offset, slope = answer["law"][c]
        noise = np.maximum(offset + slope * np.maximum(values, 0.0), _LEAST_DN2)
        signal[:, c] = np.where(seen, values, np.nan)
        variance[:, c] = np.where(seen, noise * np.diag(inverse), np.inf)
    return StripSignal(
        nodes, signal, variance, answer["n_saturated"] > 0, answer["beside"], float(answer["peak"])
    )


def job_strip(path: str, strip: dict[str, Any], part: list[float], hot: NDArray[np.int64]) -> dict[str, Any]:
    """In a limited worker: the normal equations of the spline in each colour, and the pixels' noise.

    Noise is an affine law of the signal, from second differences across the strip, along which light hardly changes.
    """
    frame = decode(path)
    if isinstance(frame, dict):
        return frame
    place = Strip(**strip)
    if tuple(place.shape) != frame.values.shape:
        return {
            "refused": f"has {frame.values.shape[0]} x {frame.values.shape[1]} pixels where the strip was found in "
            f"{place.shape[0]} x {place.shape[1]}",
            "remedy": "Calibrate and measure with the same camera at the same picture size.",
        }
    nodes = place.nodes_px
    row, column = _box(place)
    s, v = place.place(row[:, None].astype(float), column[None, :].astype(float))
    inside = (v > part[0]) & (v < part[1]) & (s >= nodes[0]) & (s <= nodes[-1])
    beside = ((v > OUTSIDE[0][0]) & (v < OUTSIDE[0][1])) | ((v > OUTSIDE[1][0]) & (v < OUTSIDE[1][1]))
    kept = np.ones(inside.shape, dtype=bool)
    if hot.size:
        at = hot[np.isin(hot[:, 0], row) & np.isin(hot[:, 1], column)] - [row[0], column[0]]
        kept[at[:, 0], at[:, 1]] = False
    across = 0 if abs(np.cos(np.deg2rad(place.angle_deg))) > 0.7 else 1
    n = nodes.size
    step = (nodes[-1] - nodes[0]) / (n - 1)
    diagonal, off, right = np.zeros((3, n)), np.zeros((3, n - 1)), np.zeros((3, n))
    n_saturated = np.zeros((n, 3), np.int64)
    differences: list[list[Array]] = [[], [], []]
    signals: list[list[Array]] = [[], [], []]
    sums, counts, peak = np.zeros(3), np.zeros(3), 0.0
    box = (slice(row[0], row[-1] + 1), slice(column[0], column[-1] + 1))
    for cfa, (x, used, scattered, at_s) in planes(
        frame.cfa[box], frame.values[box], inside & kept, beside & kept, s
    ):
        colour = 1 if cfa == 3 else cfa
        black, white = frame.black[cfa], frame.white[cfa]
        clipped = x >= black + SATURATED * (white - black)
        if used.any():
            peak = max(peak, float((x[used].max() - black) / (white - black)))
        for d, middle in _differences(x, used & ~clipped, across):
            differences[colour].append(d)
            signals[colour].append(middle - black)
        sums[colour] += x[scattered].sum(dtype=float) - black * np.count_nonzero(scattered)
        counts[colour] += np.count_nonzero(scattered)
        position = (at_s[used] - nodes[0]) / step
        j = np.minimum(position.astype(int), n - 2)
        share = position - j
        bad = clipped[used]
        n_saturated[:, colour] += np.bincount(j[bad], minlength=n) + np.bincount(j[bad] + 1, minlength=n)
        j, share, value = j[~bad], share[~bad], x[used][~bad] - black
        diagonal[colour] += np.bincount(j, (1 - share) ** 2, n) + np.bincount(j + 1, share**2, n)
        off[colour] += np.bincount(j, share * (1 - share), n - 1)[: n - 1]
        right[colour] += np.bincount(j, (1 - share) * value, n) + np.bincount(j + 1, share * value, n)
    laws = [noise_law(np.concatenate(differences[k]), np.concatenate(signals[k])) for k in range(3)]
    with np.errstate(invalid="ignore"):
        mean_beside = np.where(counts > 0, sums / np.maximum(counts, 1), 0.0)
    return {
        "diagonal": diagonal,
        "beside_diagonal": off,
        "right": right,
        "n_saturated": n_saturated,
        "law": np.array(laws),
        "beside": mean_beside,
        "peak": peak,
        "exposure_s": frame.exposure_s,
        "iso": frame.iso,
        "f_number": frame.f_number,
    }


def _box(strip: Strip) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns that hold the strip and what lies beside it, from an even row and column on."""
    a = np.deg2rad(strip.angle_deg)
    x = np.array([e for e in strip.ends_px for _ in range(2)])
    rims = np.array([OUTSIDE[0][0], OUTSIDE[1][1]] * 2)
    top, bottom = strip.top[0] + strip.top[1] * x, strip.bottom[0] + strip.bottom[1] * x
    y = top + rims * (bottom - top)
    column = x * np.cos(a) - y * np.sin(a) + strip.shape[1] / 2
    row = x * np.sin(a) + y * np.cos(a) + strip.shape[0] / 2

    def within(values: Array, size: int) -> NDArray[np.int64]:
        low = min(max(0, int(values.min()) // 6 * 6), size - 1)
        return np.arange(low, max(low + 1, min(size, int(values.max()) + 2)))

    return within(row, strip.shape[0]), within(column, strip.shape[1])


def _differences(x: NDArray[np.uint16], use: NDArray[np.bool_], axis: int) -> list[tuple[Array, Array]]:
    """Second differences of a plane along one axis where all three pixels count, and their means."""
    if axis:
        x, use = x.T, use.T
    triple = use[:-2] & use[1:-1] & use[2:]
    a, b, c = (part[triple].astype(float) for part in (x[:-2], x[1:-1], x[2:]))
    return [(a - 2 * b + c, (a + b + c) / 3)]
