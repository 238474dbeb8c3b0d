"""Light along the strip in the frames of a session: dark frames and scattered light off, settings divided out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting.settings import Settings
from phoslab.session import Frame, Session
from phoslab.strip import INSIDE, Strip, StripSignal, mean_signal, read_strip

Array = NDArray[np.float64]

_TOO_MANY = 0.02
"""Share of the strip's places that may be saturated before it is said."""

_MOST = 0.5
"""A frame in which more is saturated is left out."""


@dataclass(frozen=True, eq=False)
class StripLight:
    """What the camera sees along the strip of one role's frames.

    Args:
        role: of the frames.
        signal: (n, 3) at the strip's nodes, DN of 1 s at ISO 100 and f/1.
        sigma: (n, 3) its noise, infinite where pixels were saturated or missing.
        frames: how many.
    """

    role: str
    signal: Array
    sigma: Array
    frames: int


def read_light(
    session: Session,
    frames: Sequence[Frame],
    strip: Strip,
    settings: Settings,
    *,
    scattered: bool = True,
    part: tuple[float, float] = INSIDE,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[list[StripLight], list[str]]:
    """Read frames with their dark frames; those of one role are averaged, each by its noise.

    Args:
        scattered: take off what is seen beside the strip; not where no strip lies before the camera.
        part: share of the strip's width to average.

    Returns:
        The light of each role, in the order of the frames; and what was left out and why, one sentence each.
    """
    darks = session.frames_of("dark")
    known = {(f.exposure_s, f.iso) for f in darks}
    usable = [f for f in frames if (f.exposure_s, f.iso) in known]
    warnings = []
    lost = sorted({f.role for f in frames} - {f.role for f in usable})
    if len(usable) < len(frames):
        missing = sorted({(f.exposure_s, f.iso) for f in frames} - known)
        text = ", ".join(f"{t:g} s at ISO {iso:g}" for t, iso in missing)
        warnings.append(
            f"{session.path}: {len(frames) - len(usable)} frames are left out, since there is no dark frame for {text}"
            + (f"; nothing is left of {', '.join(lost)}." if lost else ".")
        )
    needed = [f for f in darks if (f.exposure_s, f.iso) in {(u.exposure_s, u.iso) for u in usable}]
    read = read_strip([*usable, *needed], strip, part=part, progress=progress)
    by_setting: dict[tuple[float, float], list[StripSignal]] = {}
    for frame, signal in zip(needed, read[len(usable) :], strict=True):
        by_setting.setdefault((frame.exposure_s, frame.iso), []).append(signal)
    dark_of = {setting: mean_signal(signals) for setting, signals in by_setting.items()}
    lights: dict[str, list[tuple[Array, Array]]] = {}
    for frame, seen in zip(usable, read, strict=False):
        dark = dark_of[frame.exposure_s, frame.iso]
        factor = 1 / settings.gain(frame.exposure_s, frame.iso, frame.f_number)
        off = seen.beside - dark.beside if scattered else np.zeros(3)
        sigma = np.sqrt(seen.variance + dark.variance) * factor
        sigma[seen.saturated | ~np.isfinite(seen.signal) | ~np.isfinite(dark.signal)] = np.inf
        share = float(seen.saturated.any(axis=1).mean())
        if share > _TOO_MANY:
            warnings.append(
                f"{frame.path}: {share:.0%} of the strip is saturated ({frame.role}); "
                + ("the frame is" if share > _MOST else "what passes there is")
                + " left out. Expose it shorter."
            )
        if share > _MOST or not np.isfinite(sigma).any():
            continue
        lights.setdefault(frame.role, []).append(
            (np.nan_to_num(seen.signal - dark.signal - off) * factor, sigma)
        )
    return [_mean(role, values) for role, values in lights.items()], warnings


def _mean(role: str, values: list[tuple[Array, Array]]) -> StripLight:
    """Average frames of a light, which may fade: a place that any of them lacks would be of other
    moments, and is left out.

    Frames weigh as their typical noise says; a pixel's own would favour what fell low.
    """
    weights = np.array([1 / np.median(s[np.isfinite(s)]) ** 2 for _, s in values])
    weights /= weights.sum()
    signal = np.tensordot(weights, np.stack([x for x, _ in values]), 1)
    sigma = np.sqrt(np.tensordot(weights**2, np.stack([s for _, s in values]) ** 2, 1))
    return StripLight(role, np.where(np.isfinite(sigma), signal, 0.0), sigma, len(values))
