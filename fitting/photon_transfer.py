"""A camera's noise from pairs of frames: the photon-transfer curve (Janesick 2007; EMVA 1288).

    σ² = read² + gain S,      S and σ of a pixel in DN

The slope is DN per electron, since electrons come as Poisson says; the offset is the noise of reading. The mean of dark
frames against their exposure time is the dark current.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.raw import decoded
from phoslab.session import Frame, Session

Array = NDArray[np.float64]


_LONG_S = 0.5
"""Dark current is some DN a second at most: in shorter frames a black level that drifts hides it."""


@dataclass(frozen=True)
class Noise:
    """Noise at one ISO, each with its standard error.

    Args:
        gain: DN per electron.
        read_dn: noise of reading, DN.
        dark_dn_per_s: dark current, DN per second; None where no dark frame is long enough to show it.
        pairs: how many pairs of frames.
        chi2_per_dof: of the line; far above 1 where noise is not of this kind.
    """

    gain: tuple[float, float]
    read_dn: tuple[float, float]
    dark_dn_per_s: tuple[float, float] | None
    pairs: int
    chi2_per_dof: float

    def variance(self, signal_dn: Array) -> Array:
        """Noise variance in DN² of a pixel with a signal in DN above black."""
        return np.asarray(self.read_dn[0] ** 2 + self.gain[0] * np.maximum(signal_dn, 0.0))


def photon_transfer(session: Session) -> dict[float, Noise]:
    """Noise by ISO from a session of the plan `flats`; an ISO with fewer than two levels is left out.

    Memory holds a hundred numbers a pair, whatever the size of a frame.

    Raises:
        PhoslabError: the session holds no two flat frames at one setting.
    """
    pairs = [*_pairs(session.frames_of("flat")), *_pairs(session.frames_of("dark"))]
    if not any(a.role == "flat" for a, _ in pairs):
        raise PhoslabError(
            "holds no two flat frames at the same setting",
            file=session.path,
            remedy="Record a session of the plan 'flats': noise is told from pairs.",
        )
    others = [{"other": str(b.path.absolute())} for _, b in pairs]
    answers = decoded("phoslab.raw_pairs:job_pair", [a.path for a, _ in pairs], others)
    found = {}
    for iso in sorted({a.iso for a, _ in pairs}):
        mine = [(pair, answer) for pair, answer in zip(pairs, answers, strict=True) if pair[0].iso == iso]
        levels = {a.exposure_s for (a, _), _ in mine if a.role == "flat"}
        if len(levels) < 2:
            continue
        found[iso] = _fit(
            [x for _, x in mine],
            [(a.exposure_s, x) for (a, _), x in mine if a.role == "dark"],
        )
    return found


def _pairs(frames: Sequence[Frame]) -> list[tuple[Frame, Frame]]:
    """Frames one after another at the same setting, each in one pair."""
    found, k = [], 0
    while k + 1 < len(frames):
        a, b = frames[k], frames[k + 1]
        if (a.exposure_s, a.iso, a.f_number) == (b.exposure_s, b.iso, b.f_number):
            found.append((a, b))
            k += 1
        k += 1
    return found


def _fit(answers: list[dict[str, Array]], darks: list[tuple[float, dict[str, Array]]]) -> Noise:
    mean, variance, n = (np.concatenate([x[key] for x in answers]) for key in ("mean", "variance", "n"))
    A = np.stack([np.ones_like(mean), mean], axis=1)
    model = variance
    # A variance of n draws has the standard error σ² sqrt(2 / n): of the fitted σ², not the measured one, which would
    # favour what fell low.
    for _ in range(4):
        error = np.maximum(model, 1 / 12) * np.sqrt(2 / n)
        solved = np.linalg.lstsq(A / error[:, None], variance / error, rcond=None)[0]
        model = A @ solved
    error = np.maximum(model, 1 / 12) * np.sqrt(2 / n)
    chi2 = float(np.sum(((variance - model) / error) ** 2)) / max(mean.size - 2, 1)
    covariance = np.linalg.inv((A / error[:, None]).T @ (A / error[:, None])) * max(1.0, chi2)
    read = float(np.sqrt(max(solved[0], 1e-12)))
    by_time: dict[float, list[float]] = defaultdict(list)
    for exposure_s, x in darks:
        # The median of the tiles: a hot pixel is not what a pixel does.
        by_time[exposure_s].append(float(np.median(x["mean"])))
    dark = None
    if len(by_time) > 2 and max(by_time) >= _LONG_S:
        t = np.array([s for s, values in by_time.items() for _ in values])
        y = np.array([v for values in by_time.values() for v in values])
        line, around = np.polyfit(t, y, 1, cov="unscaled")
        scatter = float(np.sum((np.polyval(line, t) - y) ** 2)) / max(t.size - 2, 1)
        dark = (float(line[0]), float(np.sqrt(around[0, 0] * scatter)))
    return Noise(
        gain=(float(solved[1]), float(np.sqrt(covariance[1, 1]))),
        read_dn=(read, float(np.sqrt(covariance[0, 0])) / (2 * read)),
        dark_dn_per_s=dark,
        pairs=len(answers),
        chi2_per_dof=chi2,
    )
