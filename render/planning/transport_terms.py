"""How glow reaches other surfaces, if it matters at all: every way that was measured, and the path tracer as the last.

What a way leaves out (all reflections, or all after the first few) is read off the pilot's picture. How far off it is
in what it does model comes from measurement: of the path tracer in this scene (`probe.py`), of other ways in those of
the trade, of which the worst counts. The two are added, in the unit of the bound.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.render.glow_methods import METHODS
from phoslab.render.glow_transport import NONE, TransportParameters
from phoslab.render.planning.bounds import Bound
from phoslab.render.planning.costs import Costs
from phoslab.render.planning.pilot import Pilot
from phoslab.render.planning.probe import SIGMAS, PathNoise

Array = NDArray[np.float64]

REFERENCE = "reference"

# Paths a pixel: a grid of k x k or k x (k + 1), as they are stratified; each about half as many again.
_SIDES = (4, 5, 6, 7, 8, 10, 12, 14, 16, 19, 23, 27, 32, 38, 45, 54, 64, 76, 91, 108, 128, 152, 181, 215, 256)
SAMPLES = (4, 6, 9, 12, *(k * k for k in _SIDES))
BOUNCES = (1, 2, 3, 4, 6, 10)

# What n directions err by over what a probe takes n paths to err by at most, of light that is reflected once and of
# light that is sent on: in six drawn scenes 0.05 to 0.24 and 0.04 to 0.19, of 4 to 16 directions.
FEW_ONCE, FEW = 0.45, 0.25


@dataclass(frozen=True)
class Way:
    """One way to transport glow, as `--gi` takes it.

    Args:
        left_out, inexact: what it adds to the error, in the bound's unit.
    """

    gi: Mapping[str, Any]
    left_out: float
    inexact: float

    @property
    def error(self) -> float:
        return self.left_out + self.inexact


def traces_paths() -> bool:
    """Whether the path tracer is installed."""
    return find_spec("mitsuba") is not None


def settings(pilot: Pilot, costs: Costs) -> Iterator[dict[str, Any]]:
    """Yield every way that this machine can take, as parameters of `--gi`."""
    yield {"method": NONE}
    if not pilot.unmet(0).any():
        return
    for measured in costs.gi:
        if measured.method not in METHODS:
            continue
        for n in BOUNCES:
            if (n == 1) == measured.reflects_once:
                yield {"method": measured.method, **measured.parameters, "bounces": n}
    if traces_paths():
        for samples in SAMPLES:
            yield {"method": REFERENCE, "samples": samples, "full": True}


def judge(
    pilot: Pilot,
    bound: Bound,
    costs: Costs,
    path_noise: PathNoise,
    gi: Mapping[str, Any],
    tried: float | None = None,
) -> Way:
    """Return what parameters of `--gi` are expected to err by: as the nearest that was measured.

    Args:
        path_noise: of so many paths a pixel, in this scene; none where it is not known.
        tried: mean relative error of the light that this way reflects in this scene, where that is known.
    """
    method, order = gi["method"], gi.get("bounces", 1)
    if method == NONE:
        return Way(gi, _left_out(pilot, bound, 0), 0.0)
    if method == REFERENCE:
        endless = gi.get("full", False)
        noise = path_noise.of(gi.get("samples", TransportParameters.samples))
        return Way(
            gi,
            0.0 if endless else _left_out(pilot, bound, order),
            _inexact(pilot, bound, None if endless else order, noise, pattern=path_noise.pattern),
        )
    error = _measured(pilot, costs, path_noise, gi) if tried is None else tried
    return Way(gi, _left_out(pilot, bound, order), _inexact(pilot, bound, order, error, _sureness(pilot)))


def _measured(pilot: Pilot, costs: Costs, path_noise: PathNoise, gi: Mapping[str, Any]) -> float:
    """Return the error of what was measured that is nearest; 1 where nothing was.

    Other ways than paths find light for one place in a pixel: it is larger where a pixel sees more that is unlike. And
    they look in some directions: where few paths meet light now and then, so do they. Both add, as squares.
    """
    nearest = costs.nearest(gi)
    if nearest is None:
        return 1.0
    uneven = max(1.0, pilot.reflected_unevenness / costs.unevenness)
    few = FEW_ONCE if gi.get("bounces", 1) == 1 else FEW
    noise = few * path_noise.of(gi.get("directions", TransportParameters.directions))
    return max(nearest.error * uneven, math.hypot(costs.finest_error(nearest) * uneven, noise))


def _left_out(pilot: Pilot, bound: Bound, reflections: int) -> float:
    """Return what the picture errs by without the reflections after the first so many, met by the walks or not."""
    picture = pilot.as_picture(pilot.lamp + pilot.glow + pilot.bounces[:reflections].sum(axis=0))
    unmet = pilot.unmet(reflections)
    return max(
        float(
            sure * bound.error(picture[t], whole, exposure) + bound.error(whole + unmet[t], whole, exposure)
        )
        for t, (sure, whole, exposure) in enumerate(
            zip(_sureness(pilot), pilot.pictures, pilot.exposures, strict=True)
        )
    )


def _inexact(
    pilot: Pilot,
    bound: Bound,
    reflections: int | None,
    error: float,
    sure: Array | float = 1.0,
    pattern: Array | None = None,
) -> float:
    """Return what the picture errs by where reflected light does.

    Args:
        reflections: the most that are kept; None: all.
        error: mean relative error of the reflected light.
        sure: (T,) by how much that light may be more than the pilot's.
        pattern: (h, w, 3) how the error lies over the picture, its mean absolute value being 1; None: the same share
            of reflected light everywhere, and, of ways in which that may go up and down, the worst of `_turns`.
    """
    if not math.isfinite(error):
        return math.inf
    reflected = pilot.as_picture(pilot.bounces[:reflections].sum(axis=0)) + pilot.unmet(0)
    picture = pilot.as_picture(pilot.lamp + pilot.glow) + reflected
    if pattern is None:
        offs = [reflected * turn for turn in _turns(pilot.shape, bound)]
    else:
        offs = [reflected.mean(axis=(1, 2, 3), keepdims=True) * pattern]
    worst = 0.0
    for off in offs:
        wrong = picture + error * off
        if not bound.of_the_whole:
            wrong = np.maximum(wrong, 0.0)
        each = zip(np.broadcast_to(sure, len(wrong)), wrong, picture, pilot.exposures, strict=True)
        worst = max(worst, *(more * bound.error(a, right, exposure) for more, a, right, exposure in each))
    return float(worst)


def _turns(shape: tuple[int, int], bound: Bound) -> Iterator[Array]:
    """Yield (h, w, 1) signs of an error: up and down in turn, and, where the eye counts, up in three of four.

    What goes one way over some width is seen more than what goes up and down from pixel to pixel.
    """
    i, j = np.indices(shape)
    yield np.where((i + j) % 2, 1.0, -1.0)[..., None]
    if not bound.of_the_whole:
        yield np.where(i % 2 & j % 2, -1.0, 1.0)[..., None]


def _sureness(pilot: Pilot) -> Array:
    """Return (T,) by how much reflected light may be more than the pilot's sample of it."""
    reflected = pilot.means()[2].sum(axis=0)
    spread: Array = np.divide(pilot.spread(), reflected, out=np.zeros_like(reflected), where=reflected > 0)
    return 1 + SIGMAS * spread
