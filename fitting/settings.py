"""What a camera's settings really are: exposure times, ISO and apertures from overlapping frames instead of its dial.

The dial's numbers are rounded: "1/15 s" is 1/16 s. Cameras mean powers of the cube root of two (of its square root
for the aperture), and meet them to a percent or so. Frames of one steady light at two settings say by how much the
signal changes; all of them together say it of each setting (Nalbach 2017, 8.4.1, calibrates such changes out).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.fitting.card import find_card
from phoslab.raw import frame_means, preview
from phoslab.session import Frame, Session

Array = NDArray[np.float64]

KINDS = ("exposure_s", "iso", "f_number")
_POWER = {"exposure_s": 1.0, "iso": 1.0, "f_number": -2.0}
"""The signal goes with this power of a setting."""

_STEADY_S = 30.0
"""Frames farther apart in time do not count as seeing the same light: lamps drift."""


def meant(kind: str, value: float) -> float:
    """The value that a dial's number stands for.

    >>> meant("exposure_s", 1 / 15), meant("exposure_s", 30), round(meant("exposure_s", 0.3), 4)
    (0.0625, 32.0, 0.315)
    >>> round(meant("iso", 1000), 1), round(meant("f_number", 5.6), 3)
    (1007.9, 5.657)
    """
    base, steps = (100.0, 3) if kind == "iso" else (1.0, 6 if kind == "f_number" else 3)
    exact = float(base * 2 ** (round(steps * math.log2(value / base)) / steps))
    # A number that is no third stop, as a computer sets it, means itself.
    return exact if abs(math.log(exact / value)) < 0.075 else value


@dataclass(frozen=True)
class Settings:
    """How settings change the signal.

    Args:
        corrections: by kind and the dial's number, log of signal against what the number stands for; and its standard
            error. Settings that are not there count as what their numbers stand for.
    """

    corrections: Mapping[tuple[str, float], tuple[float, float]] = field(default_factory=dict)

    def exposure_s(self, dial_s: float) -> float:
        """How long the shutter is really open where the dial says `dial_s`."""
        return meant("exposure_s", dial_s) * math.exp(
            self.corrections.get(("exposure_s", dial_s), (0.0, 0.0))[0]
        )

    def gain(self, exposure_s: float, iso: float, f_number: float | None) -> float:
        """Signal of a given light, relative to 1 s at ISO 100 and f/1.

        A lens that does not report its aperture (None) counts as f/1.
        """
        total = 0.0
        for kind, value in zip(KINDS, (exposure_s, iso, f_number), strict=True):
            if value is not None:
                scale = 100.0 if kind == "iso" else 1.0
                total += _POWER[kind] * math.log(meant(kind, value) / scale)
                total += self.corrections.get((kind, value), (0.0, 0.0))[0]
        return math.exp(total)


@dataclass(frozen=True, eq=False)
class SettingsFit:
    """Settings with how well they are known.

    Args:
        settings: the result.
        pairs: how many overlaps.
        misfit: root mean square of what they miss of the overlaps, as a share of the signal.
        warnings: one sentence each.
    """

    settings: Settings
    pairs: int
    misfit: float
    warnings: tuple[str, ...]


def fit_settings(session: Session, progress: Callable[[int, int], None] | None = None) -> SettingsFit:
    """Fit settings to the frames of a `flats` session: neighbours in time that differ in a setting.

    The setting that most frames have counts as exact, of each kind: only ratios can be known.

    Raises:
        PhoslabError: no two frames overlap, or dark frames are missing.
    """
    flats, darks = session.frames_of("flat"), session.frames_of("dark")
    known = {(f.exposure_s, f.iso) for f in darks}
    usable = [f for f in flats if (f.exposure_s, f.iso) in known]
    if not usable:
        raise PhoslabError(
            f"has {len(flats)} flat frames, and dark frames for none of them",
            file=session.path,
            remedy="Record a session of the plan 'flats'.",
        )
    level = _levels(usable, darks, progress)
    pairs = [
        (a, b)
        for a, b in pairwise(usable)
        if _setting(a) != _setting(b)
        and b.start_s - a.start_s < _STEADY_S + a.exposure_s
        and all(level[f.name] is not None for f in (a, b))
    ]
    counts: dict[tuple[str, float], int] = {}
    for frame in [f for pair in pairs for f in pair]:
        for kind, value in _setting(frame).items():
            counts[kind, value] = counts.get((kind, value), 0) + 1
    if not pairs:
        raise PhoslabError(
            "holds no two neighbouring frames that differ in a setting and are both well exposed",
            file=session.path,
            remedy="Record a session of the plan 'flats'.",
        )
    exact = {
        (kind, max((count, value) for (k, value), count in counts.items() if k == kind)[1])
        for kind in {k for k, _ in counts}
    }
    unknown = sorted(set(counts) - exact)
    A, y, sigma = np.zeros((len(pairs), len(unknown))), np.zeros(len(pairs)), np.zeros(len(pairs))
    nominal = Settings()
    for row, (a, b) in enumerate(pairs):
        for frame, sign in ((a, -1.0), (b, 1.0)):
            found = level[frame.name]
            assert found is not None
            y[row] += sign * (
                math.log(found[0]) - math.log(nominal.gain(frame.exposure_s, frame.iso, frame.f_number))
            )
            sigma[row] = math.hypot(sigma[row], found[1])
            for key in _setting(frame).items():
                if key in unknown:
                    A[row, unknown.index(key)] += sign
    # A lamp flickers and a shutter repeats only so well: some promille beside the pixels' noise.
    total: Array = np.hypot(sigma, 0.002)
    weighted = A / total[:, None]
    solved, _, rank, _ = np.linalg.lstsq(weighted, y / total, rcond=1e-9)
    missed = A @ solved - y
    scale = max(1.0, float(np.sum((missed / total) ** 2)) / max(len(pairs) - int(rank), 1))
    covariance = np.linalg.pinv(weighted.T @ weighted) * scale
    # What lies in the null space cannot be told from the rest of its kind.
    told = np.abs(np.linalg.pinv(weighted) @ weighted - np.eye(len(unknown))).max(axis=1) < 1e-6
    corrections = {
        key: (float(solved[k]), float(np.sqrt(covariance[k, k]))) for k, key in enumerate(unknown) if told[k]
    }
    corrections |= dict.fromkeys(exact, (0.0, 0.0))
    lost = [f"{kind} {value:g}" for (kind, value), ok in zip(unknown, told, strict=True) if not ok]
    warnings = (f"{session.path}: no overlap tells {', '.join(lost)} from others.",) if lost else ()
    return SettingsFit(Settings(corrections), len(pairs), float(np.sqrt(np.mean(missed**2))), warnings)


def _setting(frame: Frame) -> dict[str, float]:
    values = {"exposure_s": frame.exposure_s, "iso": frame.iso, "f_number": frame.f_number}
    return {kind: value for kind, value in values.items() if value is not None}


def _levels(
    flats: list[Frame], darks: tuple[Frame, ...], progress: Callable[[int, int], None] | None
) -> dict[str, tuple[float, float] | None]:
    """Signal of the brightest colour on the card in each frame and its relative noise; None if it is
    saturated or weak."""
    card = find_card(preview(flats[0].path)).mask(rim=0.2)
    needed = [f for f in darks if (f.exposure_s, f.iso) in {(u.exposure_s, u.iso) for u in flats}]
    means = frame_means([*flats, *needed], card, progress=progress)
    dark_means: dict[tuple[float, float], list[Array]] = {}
    for frame, found in zip(needed, means[len(flats) :], strict=True):
        dark_means.setdefault((frame.exposure_s, frame.iso), []).append(found.mean)
    levels: dict[str, tuple[float, float] | None] = {}
    for frame, found in zip(flats, means, strict=False):
        signal = found.mean - np.mean(dark_means[frame.exposure_s, frame.iso], axis=0)
        # One colour in all frames: the colour of light does not change with a setting.
        relative = float(np.sqrt(found.variance[1])) / max(float(signal[1]), 1e-9)
        good = found.n_saturated.sum() == 0 and signal[1] > 0.01 * found.full_scale[1]
        levels[frame.name] = (float(signal[1]), relative) if good else None
    return levels
