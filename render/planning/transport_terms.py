"""How glow reaches other surfaces, if it matters at all: every way that was measured, and the path tracer as the last.

What a way leaves out (all reflections, or all after the first) is read off the pilot's picture; how far off it is in
what it does model comes from measurement. The two are added, in the unit of the bound.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.render.frames import auto_exposure
from phoslab.render.glow_methods import METHODS
from phoslab.render.glow_transport import NONE
from phoslab.render.planning.bounds import Bound
from phoslab.render.planning.costs import Costs, unlike
from phoslab.render.planning.pilot import Pilot

Array = NDArray[np.float64]

REFERENCE = "reference"
SAMPLES = tuple(1 << k for k in range(2, 15))

# What a sample's mean may be off by, in standard errors: one in 40 is worse.
SIGMAS = 2.0


# How far off a way may be in another scene than those of the trade, over the error measured there. Of scenes drawn at
# random, those of the benchmark's first 14 seeds were off by up to 1.9 times what was predicted without it.
ELSEWHERE = 2.0


@dataclass(frozen=True)
class Way:
    """One way to transport glow, as `--gi` takes it.

    Args:
        left_out, inexact: what it adds to the error, in the bound's unit.
    """

    gi: dict[str, Any]
    left_out: float
    inexact: float

    @property
    def error(self) -> float:
        return self.left_out + self.inexact


def traces_paths() -> bool:
    """Whether the path tracer is installed."""
    return find_spec("mitsuba") is not None


def ways(pilot: Pilot, bound: Bound, costs: Costs) -> Iterator[Way]:
    """Yield every way that this machine can take."""
    yield Way({"method": NONE}, _error(pilot, bound, 0, 0.0)[0], 0.0)
    if not pilot.bounces.any():
        return
    one_reflection = _error(pilot, bound, 1, 0.0)[0]
    for measured in costs.gi:
        if measured.method in METHODS:
            gi = {"method": measured.method, **measured.parameters}
            yield Way(gi, one_reflection, _error(pilot, bound, 1, measured.error)[1])
    if traces_paths():
        for samples in SAMPLES:
            noise = costs.path_noise / np.sqrt(samples)
            gi = {"method": REFERENCE, "samples": samples, "full": True}
            yield Way(gi, 0.0, _error(pilot, bound, None, noise)[1])


def inexactness(pilot: Pilot, bound: Bound, costs: Costs, gi: dict[str, Any]) -> Way:
    """Return what any parameters of `--gi` are expected to err by: as the nearest that was measured."""
    method = gi["method"]
    if method == NONE:
        return Way(gi, _error(pilot, bound, 0, 0.0)[0], 0.0)
    if method == REFERENCE:
        order = None if gi.get("full", False) else 1
        left_out, inexact = _error(pilot, bound, order, costs.path_noise / np.sqrt(gi.get("samples", 256)))
        return Way(gi, left_out, inexact)
    alike = [m for m in costs.gi if m.method == method]
    nearest = min(alike, key=lambda m: unlike(m.parameters, gi), default=None)
    left_out, inexact = _error(pilot, bound, 1, 1.0 if nearest is None else nearest.error)
    return Way(gi, left_out, inexact)


def _error(pilot: Pilot, bound: Bound, reflections: int | None, noise: float) -> tuple[float, float]:
    """Return what leaving out later reflections does to the picture, and noise in those that are kept.

    Args:
        reflections: the most that are kept; None: all.
        noise: mean relative error of the reflected light in the scenes of the trade.
    """
    kept = pilot.bounces[:reflections].sum(axis=0)
    straight = pilot.as_picture(pilot.lamp + pilot.glow)
    reflected, whole = pilot.as_picture(kept), pilot.pictures
    sign = np.where(np.indices(pilot.shape).sum(axis=0) % 2, 1.0, -1.0)[..., None]
    sure = _sureness(pilot)
    left_out, inexact = 0.0, 0.0
    for k, exposure in enumerate(exposures(pilot)):
        picture = straight[k] + reflected[k]
        if reflections is not None:
            left_out = max(left_out, sure[k] * bound.error(picture, whole[k], exposure))
        if noise > 0:
            noisy = np.maximum(picture + sign * ELSEWHERE * noise * reflected[k], 0.0)
            inexact = max(inexact, sure[k] * bound.error(noisy, picture, exposure))
    return left_out, inexact


def _sureness(pilot: Pilot) -> Array:
    """Return (T,) by how much reflected light may be more than the pilot's sample of it."""
    reflected = pilot.means()[2].sum(axis=0)
    spread: Array = np.divide(pilot.spread(), reflected, out=np.zeros_like(reflected), where=reflected > 0)
    return 1 + SIGMAS * spread


def exposures(pilot: Pilot) -> list[float]:
    """Return for each moment what brings its luminance to display white."""
    scene, pictures = pilot.scene, pilot.pictures
    found = []
    for t in pilot.moments:
        at = max(k for k, e in enumerate(scene.exposures) if e.from_s <= t)
        factor = scene.exposures[at].factor
        if factor is None:
            first = int(np.argmax(pilot.moments >= scene.exposures[at].from_s))
            factor = auto_exposure(pictures[first].astype(np.float32))
        found.append(factor)
    return found


def slope(pilot: Pilot, bound: Bound) -> float:
    """Return how much a small relative change of the radiance is in the bound's unit: the worst of a few patterns."""
    step, worst = 0.01, 0.0
    for picture, exposure in zip(pilot.pictures, exposures(pilot), strict=True):
        for pattern in ((1.0, 1.0, 1.0), (-1.0, -1.0, -1.0), (1.0, 0.0, -1.0), (-1.0, 1.0, -1.0)):
            changed = picture * (1 + step * np.array(pattern))
            worst = max(worst, bound.error(changed, picture, exposure) / step)
    return worst
