"""What the RAW workers do: decode a frame, average a region of it with its noise, bin it to a preview.

It runs in limited processes (phoslab.limited); phoslab.raw is how to call it. A job returns plain values
and arrays, or {"refused": why, "remedy": what to do}.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SATURATED = 0.99
"""A pixel at this share of the way from black to white counts as saturated: where a column clips varies."""


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


def decode(path: str) -> RawFrame | dict[str, Any]:
    """Decode a file with LibRaw, or say why not."""
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


def job_values(path: str) -> dict[str, Any]:
    """The fields of a `RawFrame`."""
    frame = decode(path)
    return frame if isinstance(frame, dict) else {k: v for k, v in vars(frame).items() if k != "path"}


def job_settings(path: str) -> dict[str, Any]:
    """The settings that a whole frame says it was made with."""
    frame = decode(path)
    if isinstance(frame, dict):
        return frame
    return {"exposure_s": frame.exposure_s, "iso": frame.iso, "f_number": frame.f_number}


def job_means(
    path: str,
    box: list[int] | None = None,
    mask: NDArray[np.uint8] | None = None,
    mask_shape: list[int] | None = None,
) -> dict[str, Any]:
    """The fields of a `phoslab.raw.RegionMeans`, over rows and columns `box` or a packed mask."""
    frame = decode(path)
    if isinstance(frame, dict):
        return frame
    h, w = frame.values.shape
    use = np.zeros((h, w), dtype=bool)
    if mask is not None and mask_shape is not None:
        if mask_shape != [h, w]:
            return _mask_refused(frame, mask_shape)
        use = _unpacked(mask, frame)
    elif box is not None:
        y0, y1, x0, x1 = box
        if not (0 <= y0 < y1 <= h and 0 <= x0 < x1 <= w):
            return _region_refused(f"has {h} x {w} pixels, and the region {tuple(box)} is not inside")
        use[y0:y1, x0:x1] = True
    if not use.any():
        return _region_refused("has no pixel in the region")
    return {**_means(frame, use), **_about(frame)}


def job_regions(
    path: str, masks: NDArray[np.uint8], mask_shape: list[int], find_hot: bool, n_noise: int
) -> dict[str, Any]:
    """Means as in `job_means` over several regions of one frame, stacked; one decoding serves all.

    Args:
        masks: (n_regions, bytes) packed.
        find_hot: also return `hot`, the flat indices of pixels in the masks that stand far above their kind, as hot
            ones do in the dark, and leave them out of the means.
        n_noise: of how many regions, from the first, the noise is wanted; of the others it is NaN.
    """
    frame = decode(path)
    if isinstance(frame, dict):
        return frame
    if mask_shape != list(frame.values.shape):
        return _mask_refused(frame, mask_shape)
    uses = [_unpacked(mask, frame) for mask in masks]
    hot = np.zeros(0, np.int64)
    if find_hot:
        hot = _hot(frame, functools.reduce(np.logical_or, uses))
        for use in uses:
            use.ravel()[hot] = False
    if not all(use.any() for use in uses):
        return _region_refused("has no pixel in the region")
    found = [_means(frame, use, noise=k < n_noise) for k, use in enumerate(uses)]
    return {**{key: np.stack([f[key] for f in found]) for key in found[0]}, "hot": hot, **_about(frame)}


_HOT = 8.0
"""Standard deviations above the median of its colour from which a pixel in the dark is hot: one in 10^15 by noise."""

_MOST_HOT = 0.02
"""Where more than this share of the pixels stands out, it is no defect of single pixels."""


def _hot(frame: RawFrame, use: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Flat indices of hot pixels among those in use."""
    limit = np.full(4, np.inf)
    for cfa, (x, u) in planes(frame.cfa, frame.values, use):
        # Rows with some 10^4 pixels tell a median to 1 %.
        k = max(1, np.count_nonzero(u) // 20_000)
        some = x[::k][u[::k]].astype(float)
        if not some.size:
            continue
        middle = float(np.median(some))
        spread = max(1.4826 * float(np.median(np.abs(some - middle))), 1.0)
        limit[cfa] = min(limit[cfa], middle + _HOT * spread)
    # Few stand out above the lowest limit: only those are asked for their colour.
    bright = np.flatnonzero(frame.values > min(limit.min(), 65535))
    bright = bright[use.ravel()[bright]]
    hot = bright[frame.values.ravel()[bright] > limit[frame.cfa.ravel()[bright]]]
    return hot if hot.size <= _MOST_HOT * np.count_nonzero(use) else hot[:0]


def _unpacked(mask: NDArray[np.uint8], frame: RawFrame) -> NDArray[np.bool_]:
    h, w = frame.values.shape
    return np.unpackbits(mask, count=h * w).reshape(h, w).astype(bool)


def _mask_refused(frame: RawFrame, mask_shape: list[int]) -> dict[str, Any]:
    h, w = frame.values.shape
    return _region_refused(f"has {h} x {w} pixels where the region's mask has {mask_shape}")


def _about(frame: RawFrame) -> dict[str, Any]:
    return {
        "exposure_s": frame.exposure_s,
        "iso": frame.iso,
        "f_number": frame.f_number,
        "shape": list(frame.values.shape),
    }


def _means(frame: RawFrame, use: NDArray[np.bool_], *, noise: bool = True) -> dict[str, Any]:
    """Mean, its variance and numbers of pixels of each colour over pixels in use; see `phoslab.raw.RegionMeans`.

    The variance takes most of the time: without `noise` it is NaN.
    """
    # Only the mask's bounding box is looked at.
    rows, columns = np.flatnonzero(use.any(axis=1)), np.flatnonzero(use.any(axis=0))
    bounds = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    cfa, values, use = frame.cfa[bounds], frame.values[bounds], use[bounds]
    n, n_saturated, sums = np.zeros(3, np.int64), np.zeros(3, np.int64), np.zeros(3)
    # In whole numbers, and by LibRaw's colours only where a pixel is as bright as the lowest limit: most have none.
    limit = np.ceil(frame.black + SATURATED * (frame.white - frame.black)).astype(np.int64)
    if values.max() >= limit.min():
        clipped = use & (values >= limit[cfa])
        of_libraw = _sums(clipped, cfa)
        n_saturated += of_libraw[:3]
        n_saturated[1] += of_libraw[3]
        use = use & ~clipped
    for libraw, (total, count) in enumerate(zip(_sums(values * use, cfa), _sums(use, cfa), strict=True)):
        colour = 1 if libraw == 3 else libraw
        n[colour] += count
        sums[colour] += total - frame.black[libraw] * count
    differences: list[list[Array]] = [[], [], []]
    signals: list[list[Array]] = [[], [], []]
    for libraw, (x, u) in planes(cfa, values, use) if noise else ():
        colour = 1 if libraw == 3 else libraw
        for d, signal in _second_differences(x, u):
            differences[colour].append(d)
            signals[colour].append(signal - frame.black[libraw])
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums / n
        pixel_variance = [
            _variance_at(mean[k], np.concatenate(differences[k]), np.concatenate(signals[k]))
            if noise
            else np.nan
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
    }


def _region_refused(problem: str) -> dict[str, Any]:
    return {"refused": problem, "remedy": "Choose the region in a frame of the same camera and size."}


def _period(cfa: NDArray[np.uint8]) -> int:
    """After how many pixels the pattern repeats: 2 (Bayer) or 6 (X-Trans)."""
    cfa = cfa[:12, :12]
    bayer = np.array_equal(cfa[2:], cfa[:-2]) and np.array_equal(cfa[:, 2:], cfa[:, :-2])
    return 2 if bayer else 6


def planes(cfa: NDArray[np.uint8], *images: NDArray[Any]) -> Iterator[tuple[int, list[NDArray[Any]]]]:
    """Split images (h, w) into planes of one pixel a pattern: LibRaw's colour and the planes of all images.

    All pixels of a plane have one colour, one black level and lie one pattern apart.
    """
    period = _period(cfa)
    for y in range(min(period, cfa.shape[0])):
        for x in range(min(period, cfa.shape[1])):
            plane = (slice(y, None, period), slice(x, None, period))
            yield int(cfa[y, x]), [image[plane] for image in images]


def _sums(image: NDArray[Any], cfa: NDArray[np.uint8]) -> NDArray[np.int64]:
    """(4,) sums of the pixels of each of LibRaw's colours.

    Down the columns first, along memory: four times as fast as sums over `planes`.
    """
    sums = np.zeros(4, np.int64)
    period = _period(cfa)
    for y in range(min(period, cfa.shape[0])):
        columns = image[y::period].sum(axis=0, dtype=np.int64)
        for x in range(min(period, cfa.shape[1])):
            sums[cfa[y, x]] += columns[x::period].sum()
    return sums


def _second_differences(x: NDArray[np.uint16], use: NDArray[np.bool_]) -> Iterator[tuple[Array, Array]]:
    """Second differences of a plane down columns and along rows, where all three pixels count; and their means."""
    # Some 10^5 triples tell a variance to 1 %: of a large region every k-th row is enough.
    k = max(1, use.size // 100_000)
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
    """Noise variance of a pixel with signal `mean`; see `phoslab.raw.region_means` for why this way.

    Args:
        mean: DN above black.
        d: (n,) second differences.
        signal: (n,) DN above black where they were taken.
    """
    offset, slope = noise_law(d, signal)
    return max(0.0, offset + slope * mean)


def noise_law(d: Array, signal: Array) -> tuple[float, float]:
    """Noise variance of a pixel as (offset, slope) of a line in its signal, NaN where nothing says.

    Args:
        d: (n,) second differences.
        signal: (n,) DN above black where they were taken.
    """
    n_groups = min(8, d.size // 64)
    if n_groups < 2:
        return (float(np.mean(d**2) / 6) if d.size else float("nan")), 0.0
    # Groups by brightness; what lies within one need not be sorted.
    cuts = [d.size * k // n_groups for k in range(1, n_groups)]
    groups = np.split(np.argpartition(signal, cuts), cuts)
    at = np.array([signal[g].mean() for g in groups])
    variance = np.array([_clipped_mean_square(d[g]) / 6 for g in groups])
    # Theil-Sen: the median of the slopes of all pairs does not heed a minority of groups full of edges.
    i, j = np.triu_indices(n_groups, 1)
    slope = max(0.0, float(np.median((variance[j] - variance[i]) / np.maximum(at[j] - at[i], 1e-9))))
    return float(np.median(variance - slope * at)), slope


def _clipped_mean_square(d: Array) -> float:
    """Mean square of `d` without outliers: those beyond 4 standard deviations as the median sees them."""
    # The median of the square of a normal deviate is 0.4549. One DN at least: numbers are whole.
    typical = max(float(np.median(d**2)) / 0.4549, 1.0)
    return float(np.mean(d[d**2 <= 16 * typical] ** 2))


def job_preview(path: str, largest: int) -> dict[str, Any]:
    """The fields of a `phoslab.raw.Preview`."""
    frame = decode(path)
    if isinstance(frame, dict):
        return frame
    h, w = frame.values.shape
    # Bins of whole patterns, so that each holds every colour.
    period = _period(frame.cfa)
    patterns = max(1, -(-max(h, w) // (period * largest)))
    side = period * patterns
    rows, columns = h // side, w // side
    if rows == 0 or columns == 0:
        return _region_refused(f"has only {h} x {w} pixels")
    light, n, saturated = np.zeros((3, rows, columns)), np.zeros(3), np.zeros((rows, columns), dtype=bool)
    limit = np.ceil(frame.black + SATURATED * (frame.white - frame.black))
    for y in range(period):
        # Down the columns first, along memory.
        strips = frame.values[y : rows * side : period].reshape(rows, patterns, w)
        total, brightest = strips.sum(axis=1, dtype=np.uint32), strips.max(axis=1)
        for x in range(period):
            cfa = frame.cfa[y, x]
            colour = 1 if cfa == 3 else cfa
            bins = (rows, columns, patterns)
            place = (slice(None), slice(x, columns * side, period))
            mean = total[place].reshape(bins).mean(axis=2) / patterns
            light[colour] += (mean - frame.black[cfa]) / (frame.white[cfa] - frame.black[cfa])
            n[colour] += 1
            saturated |= brightest[place].reshape(bins).max(axis=2) >= limit[cfa]
    return {
        "image": np.moveaxis(light, 0, -1) / n,
        "saturated": saturated,
        "bin": side,
        "shape": [h, w],
    }
