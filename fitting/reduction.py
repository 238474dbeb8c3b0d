"""From the frames of a decay session to numbers: one linear signal a channel and frame, with its noise.

Each frame is decoded once by the limited workers, which return its means: memory does not grow with their number.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.measured_camera import MeasuredCamera
from phoslab.fitting.region import find_sample, surroundings
from phoslab.raw import RegionMeans, preview, regions_means
from phoslab.session import Frame, Session

Array = NDArray[np.float64]

# A mean over a region with more saturated pixels than this is too low by more than its noise.
_SATURATED_SHARE = 1e-3

# A decay whose brightest value is not this many standard deviations of its noise has nothing to fit.
_VISIBLE = 10.0


@dataclass(frozen=True)
class ReducedDecay:
    """A decay and what was noticed on the way.

    Args:
        data: the decay; its signal is that of the frame's middle, if the camera's shading is known.
        region: (h, w) the pixels that were averaged.
        warnings: one sentence each.
        shading: mean shading of the region, which was divided out; 1 where it is unknown.
        scattered: (3,) light beside the sample as a share of the light on it, which was taken off.
        hot_pixels: how many pixels of the region were left out as hot.
        camera: whose settings, noise and shading were taken.
    """

    data: DecayData
    region: NDArray[np.bool_]
    warnings: tuple[str, ...]
    shading: float = 1.0
    scattered: tuple[float, ...] = (0.0, 0.0, 0.0)
    hot_pixels: int = 0
    camera: MeasuredCamera = field(default_factory=MeasuredCamera)


def reduce_decay(
    session: Session,
    progress: Callable[[int, int], None] | None = None,
    camera: MeasuredCamera | None = None,
) -> ReducedDecay:
    """Average the sample over each decay frame: darks subtracted; exposure, ISO and aperture divided out.

    Args:
        session: a session with the plan "decay".
        progress: called with (frames done, frames in all).
        camera: what flats have told of the camera.

    Raises:
        PhoslabError: no lamp edge, no decay frame, no dark frame for some setting, or too much is over-exposed.
    """
    frames, warnings = _frames(session)
    off_s = session.lamp_off_s
    assert off_s is not None
    camera = camera or MeasuredCamera()
    _check_darks(session, frames)
    settings = {(f.exposure_s, f.iso) for f in frames}
    dark_frames = [f for f in session.frames_of("dark") if (f.exposure_s, f.iso) in settings]
    # The decay only falls: the sample is brightest in the first frame.
    first = preview(frames[0].path)
    region = find_sample(first)
    around = surroundings(first)
    regions = [region] if around is None else [region, around]
    n_all = len(frames) + len(dark_frames)
    dark_means, found = regions_means(
        dark_frames, regions, find_hot=True, n_noise=1, progress=_counted(progress, 0, n_all)
    )
    hot = _repeated(found)
    kept = [_without(mask, hot) for mask in regions]
    lights, _ = regions_means(frames, kept, n_noise=1, progress=_counted(progress, len(dark_frames), n_all))
    dark_of = _average_darks(dark_frames, [m[0] for m in dark_means], camera)
    dark_around = _average_darks(dark_frames, [m[-1] for m in dark_means], camera)

    scattered = np.zeros(3)
    if around is not None:
        scattered = _scattered(frames, lights, dark_of, dark_around)
    shading = 1.0 if camera.shading is None else camera.shading.mean(region)
    signal = np.empty((len(frames), 3))
    sigma = np.empty_like(signal)
    for row, (frame, (light, *_)) in enumerate(zip(frames, lights, strict=True)):
        dark, dark_variance = dark_of[frame.exposure_s, frame.iso]
        scale = camera.factor(frame) * (1 - scattered) / shading
        signal[row] = (light.mean - dark) * scale
        sigma[row] = np.sqrt(_variance(light, frame, camera) + dark_variance) * scale
        total = light.n_saturated + light.n_pixels
        sigma[row, light.n_saturated > _SATURATED_SHARE * total] = np.inf
    sigma[~np.isfinite(signal)] = np.inf
    signal[~np.isfinite(signal)] = 0.0
    lost = int(np.isinf(sigma).sum())
    if lost > sigma.size / 2:
        raise PhoslabError(
            f"is over-exposed: {lost} of {sigma.size} values are saturated",
            file=session.path,
            remedy="Record it anew with shorter exposures, a lower ISO or a smaller aperture.",
        )
    if lost:
        warnings.append(f"{lost} of {sigma.size} values are saturated and left out.")
    with np.errstate(invalid="ignore"):
        seen = float(np.max(signal / sigma))
    if not seen > _VISIBLE:
        raise PhoslabError(
            f"does not glow: its brightest value stands {max(seen, 0.0):.2g} standard deviations above the dark frames",
            file=session.path,
            remedy="Charge the sample longer, expose longer, and check that the dark frames are dark.",
        )
    data = DecayData(
        t_s=np.array([f.start_s - off_s for f in frames]),
        exposure_s=np.array([camera.settings.exposure_s(f.exposure_s) for f in frames]),
        signal=signal,
        sigma=sigma,
        repeatability=camera.repeatability,
    )
    return ReducedDecay(
        data=data,
        region=kept[0],
        warnings=tuple(warnings),
        shading=shading,
        scattered=tuple(float(s) for s in scattered),
        hot_pixels=int(np.count_nonzero(region & ~kept[0])),
        camera=camera,
    )


def decay_frames(session: Session) -> tuple[Frame, ...]:
    """The frames of a decay that were taken after the lamp went off for good."""
    return tuple(_frames(session)[0])


def _frames(session: Session) -> tuple[list[Frame], list[str]]:
    """The decay's frames, and what was left out; see `reduce_decay` for the errors."""
    frames = session.frames_of("decay")
    off_s = session.lamp_off_s
    if session.header.plan != "decay" or not frames:
        raise PhoslabError(
            f"is of the plan {session.header.plan!r} with {len(frames)} decay frames",
            file=session.path,
            remedy="Name a session of the plan 'decay'.",
        )
    if off_s is None:
        raise PhoslabError(
            "never says when the lamp went off",
            file=session.path / "journal.jsonl",
            remedy="Times are counted from there: record the session anew.",
        )
    lit = [f.name for f in frames if f.start_s < off_s]
    fading = [f for f in frames if f.start_s >= off_s]
    if not fading:
        raise PhoslabError(
            "has no decay frame after the lamp went off", file=session.path, remedy="Record the session anew."
        )
    if not lit:
        return fading, []
    return fading, [f"{len(lit)} frames from before the lamp went off are left out: {', '.join(lit)}."]


def _check_darks(session: Session, frames: Sequence[Frame]) -> None:
    """Refuse, before anything is decoded, a session that lacks a dark frame for some setting."""
    dark = {(f.exposure_s, f.iso) for f in session.frames_of("dark")}
    missing = sorted({(f.exposure_s, f.iso) for f in frames} - dark)
    if missing:
        settings = ", ".join(f"{t:g} s at ISO {iso:g}" for t, iso in missing)
        raise PhoslabError(
            f"has no dark frame for {settings}",
            file=session.path,
            remedy="Black level and dark current cannot be told from light without: record dark frames with it.",
        )


def _average_darks(
    frames: Sequence[Frame], means: Sequence[RegionMeans], camera: MeasuredCamera
) -> dict[tuple[float, float], tuple[Array, Array]]:
    """Return, by (exposure time, ISO), the mean dark signal (3,) and the variance of that mean."""
    settings = [(f.exposure_s, f.iso) for f in frames]
    averages = {}
    for setting in set(settings):
        same = [(f, m) for f, m, s in zip(frames, means, settings, strict=True) if s == setting]
        averages[setting] = (
            np.mean([m.mean for _, m in same], axis=0),
            np.sum([_variance(m, f, camera) for f, m in same], axis=0) / len(same) ** 2,
        )
    return averages


def _variance(means: RegionMeans, frame: Frame, camera: MeasuredCamera) -> Array:
    """Variance (3,) of a region's means: by photon transfer where the ISO's is known, else from the pixels.

    Pixels of a frame also differ in sensitivity, which is the same in all frames of a region and no noise between them;
    pairs of frames do not see it. At the means' own signal: with thousands of pixels its noise biases nothing.
    """
    noise = camera.noise.get(frame.iso)
    if noise is None:
        return means.variance
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(noise.variance(means.mean) / means.n_pixels)


def _repeated(found: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Pixels that stand out in two dark frames or more, or in the only one: what comes once is a cosmic ray."""
    if not found:
        return np.zeros(0, np.int64)
    index, times = np.unique(np.concatenate(found), return_counts=True)
    return np.asarray(index[times >= min(2, len(found))])


def _without(mask: NDArray[np.bool_], hot: NDArray[np.int64]) -> NDArray[np.bool_]:
    kept = mask.copy()
    kept.ravel()[hot] = False
    return kept if kept.any() else mask


def _scattered(
    frames: Sequence[Frame],
    lights: Sequence[tuple[RegionMeans, ...]],
    dark_of: dict[tuple[float, float], tuple[Array, Array]],
    dark_around: dict[tuple[float, float], tuple[Array, Array]],
) -> Array:
    """(3,) light beside the sample as a share of that on it: what lens and room scatter, the same in all frames.

    From the frames' sums, in which bright frames count as their light does.
    """
    on, beside = np.zeros(3), np.zeros(3)
    for frame, (light, around) in zip(frames, lights, strict=True):
        setting = frame.exposure_s, frame.iso
        if light.n_saturated.any():
            continue
        on += np.nan_to_num(light.mean - dark_of[setting][0])
        beside += np.nan_to_num(around.mean - dark_around[setting][0])
    share = np.divide(beside, on, out=np.zeros(3), where=on > 0)
    return np.asarray(np.clip(share, 0.0, 0.5))


def _counted(
    progress: Callable[[int, int], None] | None, before: int, total: int
) -> Callable[[int, int], None] | None:
    return None if progress is None else lambda done, _: progress(before + done, total)
