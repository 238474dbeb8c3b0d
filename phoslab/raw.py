"""RAW frames as linear numbers: undemosaiced values, means over a region, a small preview.

Nothing is interpolated: a mean over a region needs each colour's own pixels only. The colour of a pixel
is what LibRaw says of that pixel; sensors are not all RGGB, and crops shift the pattern. Frames are
decoded in limited worker processes (phoslab.limited), because nobody vouches for a file.

Signals are in DN (the sensor's digital numbers) above black, linear in light.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.limited import Failure, Workers, shared
from phoslab.session import Frame

Array = NDArray[np.float64]
Region = NDArray[np.bool_] | tuple[int, int, int, int]
"""A mask (h, w) over the visible pixels, or rows and columns (y0, y1, x0, x1), ends excluded."""

SATURATED = 0.99
"""A pixel at this share of the way from black to white counts as saturated: where a column clips varies."""

SETTING_TOLERANCE = 0.08
"""Nominal and true settings differ by up to 7 % (1/60 s is 1/64 s); third stops are 26 % apart."""


@dataclass(frozen=True, eq=False)
class RawFrame:
    """One frame as the sensor gave it, cut to its visible pixels.

    Args:
        path: the file.
        values: (h, w) uint16, DN.
        cfa: (h, w) uint8, LibRaw's colour of each pixel, an index into `black` and `white`; 3 is a second green.
        black: (4,) black level of each of LibRaw's colours, DN.
        white: (4,) level at which each of LibRaw's colours saturates, DN.
        exposure_s, iso, f_number: from EXIF; None where it does not say.
    """

    path: Path
    values: NDArray[np.uint16]
    cfa: NDArray[np.uint8]
    black: Array
    white: Array
    exposure_s: float | None
    iso: float | None
    f_number: float | None

    @property
    def colours(self) -> NDArray[np.uint8]:
        """(h, w) colour of each pixel: 0 red, 1 green (both greens), 2 blue."""
        return np.where(self.cfa == 3, np.uint8(1), self.cfa)

    @property
    def linear(self) -> NDArray[np.float32]:
        """(h, w) DN above black; noise takes it below zero."""
        return self.values.astype(np.float32) - self.black.astype(np.float32)[self.cfa]

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """(h, w) the pixels whose value says only "at least this much light"."""
        limit = self.black + SATURATED * (self.white - self.black)
        return np.asarray(self.values >= limit[self.cfa])


@dataclass(frozen=True, eq=False)
class RegionMeans:
    """Mean signal of red, green and blue pixels over a region of one frame.

    Args:
        path: the file.
        mean: (3,) DN above black; NaN for a colour without usable pixels.
        variance: (3,) variance of `mean` from the pixels' noise, DN²; NaN where it cannot be told.
        n_pixels: (3,) pixels that count.
        n_saturated: (3,) pixels that were left out because they are saturated.
        full_scale: (3,) DN from black to white.
        exposure_s, iso, f_number: the settings; None where nothing says.
        shape: (h, w) of the frame.
    """

    path: Path
    mean: Array
    variance: Array
    n_pixels: NDArray[np.int64]
    n_saturated: NDArray[np.int64]
    full_scale: Array
    exposure_s: float | None
    iso: float | None
    f_number: float | None
    shape: tuple[int, int]


@dataclass(frozen=True, eq=False)
class Preview:
    """A frame binned to a small picture, for finding a region in it.

    Args:
        path: the file.
        image: (h', w', 3) linear camera RGB, 0 = black, 1 = white level; each value is a mean of pixels.
        saturated: (h', w') bins with a saturated pixel in them.
        bin: side of a bin in pixels.
        shape: (h, w) of the frame.
    """

    path: Path
    image: Array
    saturated: NDArray[np.bool_]
    bin: int
    shape: tuple[int, int]

    def full_mask(self, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Blow a mask over the preview's bins (h', w') up to one over the frame's pixels (h, w).

        Pixels of the right and lower rim that fill no bin are outside.
        """
        full = np.zeros(self.shape, dtype=bool)
        blown = np.repeat(np.repeat(mask, self.bin, axis=0), self.bin, axis=1)
        full[: blown.shape[0], : blown.shape[1]] = blown
        return full


def read_raw(path: str | os.PathLike[str], *, workers: Workers | None = None) -> RawFrame:
    """Decode one frame to undemosaiced visible values.

    Raises:
        PhoslabError: the file is missing, is no Bayer RAW frame, is damaged, or takes too much time or memory.
    """
    (answer,) = _decoded("_job_values", [Path(path)], {}, workers, None)
    return RawFrame(path=Path(path), **answer)


def region_means(
    path: str | os.PathLike[str], region: Region, *, workers: Workers | None = None
) -> RegionMeans:
    """Mean signal above black of each colour over `region` of one frame; see `RegionMeans`.

    The variance comes from the pixels themselves. With x₋, x₀, x₊ three neighbours of one colour in a row
    or column, d = x₋ - 2 x₀ + x₊ is free of any linear gradient, and E[d²] = 6 σ² for independent noise of
    variance σ². Edges would dominate a plain mean of d²/6; but a sensor's noise variance is affine in the
    signal (read noise plus shot noise), so its mean over the region is its value at the mean signal. It is
    read off a line through the clipped means of eight groups of equal size, from dim to bright, fitted so
    that a minority of groups full of edges has no say. 1/n of it is the variance of the mean.

    Not in it: what all pixels share (the black level's error, a lamp that flickers). A sample with a grain
    of a few pixels makes it too large.

    Saturated pixels are left out and counted. A mean with any is too low: shorten the exposure.

    Raises:
        PhoslabError: as `read_raw`; or the region does not fit the frame.
    """
    (answer,) = _decoded("_job_means", [Path(path)], _region_job(region), workers, None)
    return _means(Path(path), answer)


def frame_means(
    frames: Sequence[Frame],
    region: Region,
    *,
    workers: Workers | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[RegionMeans, ...]:
    """`region_means` of many frames of a session, decoded in parallel, with the journal's settings.

    Args:
        frames: the session's frames.
        region: the same for all.
        progress: called with (frames done, frames in all).

    Raises:
        PhoslabError: as `region_means`; or a frame's own EXIF disagrees with the journal about exposure
            time, ISO or aperture by more than `SETTING_TOLERANCE`: then one of them is wrong, and the
            signal cannot be told.
    """
    paths = [frame.path for frame in frames]
    answers = _decoded("_job_means", paths, _region_job(region), workers, progress)
    results = []
    for frame, answer in zip(frames, answers, strict=True):
        means = _means(frame.path, answer)
        _check_settings(frame, means)
        results.append(
            replace(
                means, exposure_s=frame.exposure_s, iso=frame.iso, f_number=frame.f_number or means.f_number
            )
        )
    return tuple(results)


def preview(path: str | os.PathLike[str], *, largest: int = 512, workers: Workers | None = None) -> Preview:
    """Bin one frame to a linear RGB picture of at most `largest` bins a side.

    Raises:
        PhoslabError: as `read_raw`.
    """
    (answer,) = _decoded("_job_preview", [Path(path)], {"largest": largest}, workers, None)
    return Preview(path=Path(path), **{**answer, "shape": tuple(answer["shape"])})


def exposure_factor(exposure_s: float, iso: float, f_number: float | None) -> float:
    """Factor that turns DN into DN of one second at ISO 100 and f/1: N² / (t ISO/100).

    A lens that does not report its aperture (None) counts as f/1: signals of one series compare with
    each other as long as nobody turns it.

    >>> exposure_factor(0.5, 200, 2.0)
    4.0
    """
    return (f_number or 1.0) ** 2 / (exposure_s * iso / 100)


def per_second(means: RegionMeans) -> tuple[Array, Array]:
    """Mean (3,) and variance (3,) of the signal with exposure time, ISO and aperture divided out.

    In DN of one second at ISO 100 and f/1 (its square for the variance).

    Raises:
        PhoslabError: exposure time or ISO is not known.
    """
    if means.exposure_s is None or means.iso is None:
        raise PhoslabError(
            "does not say its exposure time and ISO",
            file=means.path,
            remedy="Use frames of a session, whose journal has them.",
        )
    factor = exposure_factor(means.exposure_s, means.iso, means.f_number)
    return means.mean * factor, means.variance * factor**2


def _region_job(region: Region) -> dict[str, Any]:
    if isinstance(region, tuple):
        return {"box": [int(n) for n in region]}
    return {"mask": np.packbits(region), "mask_shape": list(region.shape)}


def _means(path: Path, answer: dict[str, Any]) -> RegionMeans:
    return RegionMeans(path=path, **{**answer, "shape": tuple(answer["shape"])})


def _check_settings(frame: Frame, means: RegionMeans) -> None:
    for name, unit in (("exposure_s", " s"), ("iso", ""), ("f_number", "")):
        said, found = getattr(frame, name), getattr(means, name)
        if said is None or found is None:
            continue
        if abs(np.log(found / said)) > np.log1p(SETTING_TOLERANCE):
            raise PhoslabError(
                f"is {found:.6g}{unit} in the file's own EXIF data and {said:.6g}{unit} in the session's journal",
                file=frame.path,
                field=name,
                remedy="One of them is wrong: leave this session out, or record it again.",
            )


def _decoded(
    job: str,
    paths: Sequence[Path],
    parameters: dict[str, Any],
    workers: Workers | None,
    progress: Callable[[int, int], None] | None,
) -> list[dict[str, Any]]:
    """Run one of the jobs below on every file; the answers in order."""
    for path in paths:
        if not path.is_file():
            raise PhoslabError("does not exist", file=path, remedy="Name a RAW file (DNG, CR2, NEF ...).")
    answers: dict[int, dict[str, Any]] = {}
    jobs = [{"path": str(path.absolute()), **parameters} for path in paths]
    for index, answer in (workers or shared()).run_as_done(f"phoslab.raw:{job}", jobs):
        if isinstance(answer, Failure):
            raise PhoslabError(
                f"cannot be decoded: it {answer.reason}",
                file=paths[index],
                remedy="It is damaged or no RAW file: copy it again from the camera.",
            )
        if "refused" in answer:
            raise PhoslabError(answer["refused"], file=paths[index], remedy=answer["remedy"])
        answers[index] = answer
        if progress:
            progress(len(answers), len(paths))
    return [answers[index] for index in range(len(paths))]


# From here on: what runs in the worker. It returns plain values, or {"refused": why, "remedy": what to do}.


def _decode(path: str) -> RawFrame | dict[str, Any]:
    import rawpy

    try:
        with rawpy.imread(path) as raw:
            pattern = raw.raw_pattern if raw.raw_type == rawpy.RawType.Flat else None
            if pattern is None or raw.color_desc not in (b"RGBG", b"RGBE") or raw.raw_image is None:
                return {
                    "refused": "is not a frame of a colour sensor with red, green and blue pixels",
                    "remedy": "Use the camera's RAW file, not one converted to linear DNG or made by another sensor.",
                }
            values = raw.raw_image_visible.copy()
            cfa = raw.raw_colors_visible
            black = np.array(raw.black_level_per_channel, dtype=float)
            white = np.full(4, float(raw.white_level))
            if raw.camera_white_level_per_channel is not None:
                levels = np.array(raw.camera_white_level_per_channel, dtype=float)
                white = np.where(levels > 0, np.minimum(white, levels), white)
            settings = raw.other
    except rawpy.LibRawError as error:
        reason = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else str(error)
        return {
            "refused": f"cannot be decoded: LibRaw says {reason!r}",
            "remedy": "It is damaged or no RAW file: copy it again from the camera.",
        }
    if values.size == 0 or cfa.shape != values.shape or not np.all(black < white):
        return {
            "refused": "declares an impossible size or black and white level",
            "remedy": "It is damaged: copy it again from the camera.",
        }

    def known(setting: float) -> float | None:
        return float(setting) if np.isfinite(setting) and setting > 0 else None

    return RawFrame(
        path=Path(path),
        values=values,
        cfa=cfa,
        black=black,
        white=white,
        exposure_s=known(settings.shutter_speed),
        iso=known(settings.iso_speed),
        f_number=known(settings.aperture),
    )


def _job_values(path: str) -> dict[str, Any]:
    frame = _decode(path)
    return frame if isinstance(frame, dict) else {k: v for k, v in vars(frame).items() if k != "path"}


def _job_means(
    path: str,
    box: list[int] | None = None,
    mask: NDArray[np.uint8] | None = None,
    mask_shape: list[int] | None = None,
) -> dict[str, Any]:
    frame = _decode(path)
    if isinstance(frame, dict):
        return frame
    h, w = frame.values.shape
    use = np.zeros((h, w), dtype=bool)
    if mask is not None and mask_shape is not None:
        if mask_shape != [h, w]:
            return _region_refused(f"has {h} x {w} pixels where the region's mask has {mask_shape}")
        use = np.unpackbits(mask, count=h * w).reshape(h, w).astype(bool)
    elif box is not None:
        y0, y1, x0, x1 = box
        if not (0 <= y0 < y1 <= h and 0 <= x0 < x1 <= w):
            return _region_refused(f"has {h} x {w} pixels, and the region {tuple(box)} is not inside")
        use[y0:y1, x0:x1] = True
    if not use.any():
        return _region_refused("has no pixel in the region")
    n, n_saturated, sums = np.zeros(3, np.int64), np.zeros(3, np.int64), np.zeros(3)
    differences: list[list[Array]] = [[], [], []]
    signals: list[list[Array]] = [[], [], []]
    for cfa, x, u in _planes(frame, use):
        colour = 1 if cfa == 3 else cfa
        black, white = frame.black[cfa], frame.white[cfa]
        clipped = x >= black + SATURATED * (white - black)
        n_saturated[colour] += np.count_nonzero(u & clipped)
        u = u & ~clipped
        n[colour] += np.count_nonzero(u)
        sums[colour] += x.sum(where=u, dtype=float) - black * np.count_nonzero(u)
        for d, signal in _second_differences(x, u):
            differences[colour].append(d)
            signals[colour].append(signal - black)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums / n
        pixel_variance = [
            _variance_at(mean[k], np.concatenate(differences[k]), np.concatenate(signals[k]))
            for k in range(3)
        ]
        variance = np.array(pixel_variance) / n
    full_scale = (frame.white - frame.black)[[0, 1, 2]]
    full_scale[1] = min(full_scale[1], frame.white[3] - frame.black[3])
    return {
        "mean": mean,
        "variance": variance,
        "n_pixels": n,
        "n_saturated": n_saturated,
        "full_scale": full_scale,
        "exposure_s": frame.exposure_s,
        "iso": frame.iso,
        "f_number": frame.f_number,
        "shape": [h, w],
    }


def _region_refused(problem: str) -> dict[str, Any]:
    return {"refused": problem, "remedy": "Choose the region in a frame of the same camera and size."}


def _period(cfa: NDArray[np.uint8]) -> int:
    """After how many pixels the pattern repeats: 2 (Bayer) or 6 (X-Trans)."""
    bayer = np.array_equal(cfa[2:], cfa[:-2]) and np.array_equal(cfa[:, 2:], cfa[:, :-2])
    return 2 if bayer else 6


def _planes(
    frame: RawFrame, use: NDArray[np.bool_]
) -> Iterator[tuple[int, NDArray[np.uint16], NDArray[np.bool_]]]:
    """Split a frame into planes of one pixel a pattern: LibRaw's colour, values and mask of each.

    All pixels of a plane have one colour, one black level and lie one pattern apart. Only the mask's bounding
    box is looked at.
    """
    period = _period(frame.cfa)
    rows, columns = np.flatnonzero(use.any(axis=1)), np.flatnonzero(use.any(axis=0))
    box = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    cfa, values, mask = frame.cfa[box], frame.values[box], use[box]
    for y in range(min(period, mask.shape[0])):
        for x in range(min(period, mask.shape[1])):
            plane = (slice(y, None, period), slice(x, None, period))
            yield int(cfa[y, x]), values[plane], mask[plane]


def _second_differences(x: NDArray[np.uint16], use: NDArray[np.bool_]) -> Iterator[tuple[Array, Array]]:
    """Second differences of a plane down columns and along rows, where all three pixels count; and their means."""
    # Some 10^5 triples tell a variance to 1 %: of a large region every k-th row is enough.
    k = max(1, use.size // 200_000)
    middle = slice(1, x.shape[0] - 1, k)
    down = [slice(0, x.shape[0] - 2, k), middle, slice(2, x.shape[0], k)]
    along = [
        (slice(None, None, k), slice(0, -2)),
        (slice(None, None, k), slice(1, -1)),
        (slice(None, None, k), slice(2, None)),
    ]
    for places in (down, along):
        triple = use[places[0]] & use[places[1]] & use[places[2]]
        a, b, c = (x[place][triple].astype(float) for place in places)
        yield a - 2 * b + c, (a + b + c) / 3


def _variance_at(mean: float, d: Array, signal: Array) -> float:
    """Noise variance of a pixel with signal `mean`; see `region_means` for why this way.

    Args:
        mean: DN above black.
        d: (n,) second differences.
        signal: (n,) DN above black where they were taken.
    """
    n_groups = min(8, d.size // 64)
    if n_groups < 2:
        return float(np.mean(d**2) / 6) if d.size else float("nan")
    groups = np.array_split(np.argsort(signal), n_groups)
    at = np.array([signal[g].mean() for g in groups])
    variance = np.array([_clipped_mean_square(d[g]) / 6 for g in groups])
    # Theil-Sen: the median of the slopes of all pairs does not heed a minority of groups full of edges.
    i, j = np.triu_indices(n_groups, 1)
    slope = max(0.0, float(np.median((variance[j] - variance[i]) / np.maximum(at[j] - at[i], 1e-9))))
    return max(0.0, float(np.median(variance - slope * (at - mean))))


def _clipped_mean_square(d: Array) -> float:
    """Mean square of `d` without outliers: those beyond 4 standard deviations as the median sees them."""
    # The median of the square of a normal deviate is 0.4549. One DN at least: numbers are whole.
    typical = max(float(np.median(d**2)) / 0.4549, 1.0)
    return float(np.mean(d[d**2 <= 16 * typical] ** 2))


def _job_preview(path: str, largest: int) -> dict[str, Any]:
    frame = _decode(path)
    if isinstance(frame, dict):
        return frame
    h, w = frame.values.shape
    # Bins of whole patterns (2 and 6 both divide 6), so that each holds every colour.
    side = _period(frame.cfa)
    side *= max(1, -(-max(h, w) // (side * largest)))
    rows, columns = h // side, w // side
    if rows == 0 or columns == 0:
        return _region_refused(f"has only {h} x {w} pixels")
    cut = (slice(rows * side), slice(columns * side))
    relative = (frame.linear / (frame.white - frame.black).astype(np.float32)[frame.cfa])[cut]
    colours = frame.colours[cut]

    def binned(image: NDArray[Any]) -> Array:
        return np.asarray(image.reshape(rows, side, columns, side).sum(axis=(1, 3), dtype=float))

    channels = [binned(relative * (colours == k)) / binned(colours == k) for k in range(3)]
    return {
        "image": np.stack(channels, axis=-1),
        "saturated": binned(frame.saturated[cut]) > 0,
        "bin": side,
        "shape": [h, w],
    }
