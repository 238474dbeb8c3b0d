"""RAW frames as linear numbers: undemosaiced values, means over a region, a small preview.

Nothing is interpolated: a mean over a region needs each colour's own pixels only. The colour of a pixel
is what LibRaw says of that pixel; sensors are not all RGGB, and crops shift the pattern. Frames are
decoded in limited worker processes (phoslab.limited), because nobody vouches for a file.

Signals are in DN (the sensor's digital numbers) above black, linear in light.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.limited import Failure, Workers, shared
from phoslab.raw_worker import RawFrame
from phoslab.session import Frame

Array = NDArray[np.float64]
Region = NDArray[np.bool_] | tuple[int, int, int, int]
"""A mask (h, w) over the visible pixels, or rows and columns (y0, y1, x0, x1), ends excluded."""

SETTING_TOLERANCE = 0.08
"""Nominal and true settings differ by up to 7 % (1/60 s is 1/64 s); third stops are 26 % apart."""


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
    (answer,) = decoded("phoslab.raw_worker:job_values", [Path(path)], {}, workers, None)
    return RawFrame(path=Path(path), **answer)


def read_settings(path: str | os.PathLike[str], *, workers: Workers | None = None) -> dict[str, float | None]:
    """Return `exposure_s`, `iso` and `f_number` of a frame, None for what it does not say.

    All of it is decoded: a frame that is cut short is found out.

    Raises:
        PhoslabError: as `read_raw`.
    """
    (answer,) = decoded("phoslab.raw_worker:job_settings", [Path(path)], {}, workers, None)
    return {name: answer[name] for name in ("exposure_s", "iso", "f_number")}


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
    (answer,) = decoded("phoslab.raw_worker:job_means", [Path(path)], _region_job(region), workers, None)
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
    answers = decoded("phoslab.raw_worker:job_means", paths, _region_job(region), workers, progress)
    results = []
    for frame, answer in zip(frames, answers, strict=True):
        means = _means(frame.path, answer)
        check_settings(frame, vars(means))
        results.append(
            replace(
                means, exposure_s=frame.exposure_s, iso=frame.iso, f_number=frame.f_number or means.f_number
            )
        )
    return tuple(results)


def regions_means(
    frames: Sequence[Frame],
    regions: Sequence[NDArray[np.bool_]],
    *,
    find_hot: bool = False,
    n_noise: int | None = None,
    workers: Workers | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[list[tuple[RegionMeans, ...]], list[NDArray[np.int64]]]:
    """`frame_means` over several regions at once: each frame is decoded once, and forgotten.

    Args:
        frames: the session's frames.
        regions: masks (h, w), the same for all frames.
        find_hot: for dark frames: also find pixels that stand out, and leave them out of the means.
        n_noise: of how many regions, from the first, the variance is wanted, which takes most of the time; all.
        progress: called with (frames done, frames in all).

    Returns:
        For each frame the means of each region; and the flat indices of its hot pixels.

    Raises:
        PhoslabError: as `frame_means`.
    """
    parameters = {
        "masks": np.stack([np.packbits(region) for region in regions]),
        "mask_shape": list(regions[0].shape),
        "find_hot": find_hot,
        "n_noise": len(regions) if n_noise is None else n_noise,
    }
    paths = [frame.path for frame in frames]
    answers = decoded("phoslab.raw_worker:job_regions", paths, parameters, workers, progress)
    results, hot = [], []
    for frame, answer in zip(frames, answers, strict=True):
        check_settings(frame, answer)
        about: dict[str, Any] = {
            "exposure_s": frame.exposure_s,
            "iso": frame.iso,
            "f_number": frame.f_number or answer["f_number"],
            "shape": tuple(answer["shape"]),
        }
        parts = ("mean", "variance", "n_pixels", "n_saturated", "full_scale")
        results.append(
            tuple(
                RegionMeans(path=frame.path, **{part: answer[part][k] for part in parts}, **about)
                for k in range(len(regions))
            )
        )
        hot.append(answer["hot"])
    return results, hot


def preview(path: str | os.PathLike[str], *, largest: int = 512, workers: Workers | None = None) -> Preview:
    """Bin one frame to a linear RGB picture of at most `largest` bins a side.

    Raises:
        PhoslabError: as `read_raw`.
    """
    (answer,) = decoded("phoslab.raw_worker:job_preview", [Path(path)], {"largest": largest}, workers, None)
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


def check_settings(frame: Frame, found_in_file: Mapping[str, Any]) -> None:
    """Refuse a frame whose own EXIF settings are more than `SETTING_TOLERANCE` off the journal's.

    Raises:
        PhoslabError: one of them is wrong, and the signal cannot be told.
    """
    for name, unit in (("exposure_s", " s"), ("iso", ""), ("f_number", "")):
        said, found = getattr(frame, name), found_in_file[name]
        if said is None or found is None:
            continue
        if abs(np.log(found / said)) > np.log1p(SETTING_TOLERANCE):
            raise PhoslabError(
                f"is {found:.6g}{unit} in the file's own EXIF data and {said:.6g}{unit} in the session's journal",
                file=frame.path,
                field=name,
                remedy="One of them is wrong: leave this session out, or record it again.",
            )


def decoded(
    job: str,
    paths: Sequence[Path],
    parameters: dict[str, Any] | Sequence[dict[str, Any]],
    workers: Workers | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[dict[str, Any]]:
    """Run a job ("module:function") on every file in the limited workers; the answers in order.

    Args:
        parameters: of the job; the same for all files, or one for each.

    Raises:
        PhoslabError: a file is missing, or its job failed or refused it.
    """
    for path in paths:
        if not path.is_file():
            raise PhoslabError("does not exist", file=path, remedy="Name a RAW file (DNG, CR2, NEF ...).")
    answers: dict[int, dict[str, Any]] = {}
    each = [parameters] * len(paths) if isinstance(parameters, dict) else parameters
    jobs = [{"path": str(path.absolute()), **own} for path, own in zip(paths, each, strict=True)]
    for index, answer in (workers or shared()).run_as_done(job, jobs):
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
