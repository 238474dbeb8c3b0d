"""From the frames of a decay session to numbers: one linear signal a channel and frame, with its noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.fitting.decay import DecayData
from phoslab.fitting.region import find_sample
from phoslab.raw import RegionMeans, exposure_factor, frame_means, preview
from phoslab.session import Frame, Session

# Shutters, lens apertures and gain steps of a camera repeat to about this, whatever the light.
REPEATABILITY = 0.005
# A mean over a region with more saturated pixels than this is too low by more than its noise.
_SATURATED_SHARE = 1e-3

# A decay whose brightest value is not this many standard deviations of its noise has nothing to fit.
_VISIBLE = 10.0


@dataclass(frozen=True)
class ReducedDecay:
    """A decay and what was noticed on the way.

    Args:
        data: the decay.
        region: (h, w) the pixels that were averaged.
        warnings: one sentence each.
    """

    data: DecayData
    region: NDArray[np.bool_]
    warnings: tuple[str, ...]


def reduce_decay(session: Session, progress: Callable[[int, int], None] | None = None) -> ReducedDecay:
    """Average the sample over each decay frame: darks subtracted; exposure, ISO and aperture divided out.

    Args:
        session: a session with the plan "decay".
        progress: called with (frames done, frames in all).

    Raises:
        PhoslabError: no lamp edge, no decay frame, no dark frame for some setting, or too much is over-exposed.
    """
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
    frames = tuple(f for f in frames if f.start_s >= off_s)
    warnings = (
        [f"{len(lit)} frames from before the lamp went off are left out: {', '.join(lit)}."] if lit else []
    )
    if not frames:
        raise PhoslabError(
            "has no decay frame after the lamp went off", file=session.path, remedy="Record the session anew."
        )
    _check_darks(session, frames)
    dark_frames = session.frames_of("dark")
    # The decay only falls: the sample is brightest in the first frame.
    region = find_sample(preview(frames[0].path))
    means = frame_means((*frames, *dark_frames), region, progress=progress)
    lights = means[: len(frames)]
    dark_of = _average_darks(dark_frames, means[len(frames) :])

    signal = np.empty((len(frames), 3))
    sigma = np.empty_like(signal)
    for row, (frame, light) in enumerate(zip(frames, lights, strict=True)):
        dark, dark_variance = dark_of[frame.exposure_s, frame.iso]
        scale = exposure_factor(frame.exposure_s, frame.iso, light.f_number)
        signal[row] = (light.mean - dark) * scale
        sigma[row] = np.sqrt(light.variance + dark_variance) * scale
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
        exposure_s=np.array([f.exposure_s for f in frames]),
        signal=signal,
        sigma=sigma,
        repeatability=REPEATABILITY,
    )
    return ReducedDecay(data=data, region=region, warnings=(*session.warnings, *warnings))


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
    frames: Sequence[Frame], means: Sequence[RegionMeans]
) -> dict[tuple[float, float], tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Return, by (exposure time, ISO), the mean dark signal (3,) and the variance of that mean."""
    settings = [(f.exposure_s, f.iso) for f in frames]
    averages = {}
    for setting in set(settings):
        same = [m for s, m in zip(settings, means, strict=True) if s == setting]
        averages[setting] = (
            np.mean([m.mean for m in same], axis=0),
            np.sum([m.variance for m in same], axis=0) / len(same) ** 2,
        )
    return averages
