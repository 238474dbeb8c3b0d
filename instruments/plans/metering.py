"""Find a setting at which light is well exposed: trial frames of the role `meter`, which no fit looks at."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

from phoslab.instruments.devices import Exposure
from phoslab.instruments.plans.ladder import Ladder
from phoslab.instruments.plans.steps import Door, Lamp, Setup, Shoot, Shot, Step, Wait

TRIALS = 8
RECHARGE_S = 60.0
"""Light between two trials on a glow; a trial takes some seconds of it."""

_LOW, _GOOD, _HIGH = 0.15, 0.30, 0.70
"""Levels from which a trial says how to do better, within which there is no need to."""


def meter(ladder: Ladder, start: Exposure | None = None) -> Generator[Step, Any, Exposure]:
    """Return the setting at which what the camera sees now is well exposed; the light must be steady."""
    exposure = start if start in ladder.rungs else ladder.middle
    for _ in range(TRIALS):
        shot: Shot = yield Shoot("meter", exposure)
        exposure, sure = _better(ladder, shot)
        if sure:
            break
    return exposure


def meter_glow(
    ladder: Ladder, setup: Setup, charge_s: float, start: Exposure | None = None
) -> Generator[Step, Any, Exposure]:
    """Return the setting for the first frame after lamp-off: the lamp goes off for each trial, and on again after it.

    Every trial sees the glow just as the first frame will, so the fastest part of a decay cannot overexpose it.

    Args:
        charge_s: how long the lamp has shone before.
    """
    exposure = start if start in ladder.rungs else ladder.middle
    for _ in range(TRIALS):
        off_s: float = yield Lamp("off")
        yield Wait(setup.fade_s, "the lamp fades", since_s=off_s)
        yield Door("open")
        shot: Shot = yield Shoot("meter", exposure)
        yield Door("closed")
        yield Lamp("on")
        yield Wait(min(RECHARGE_S, charge_s), "charging again after a trial")
        exposure, sure = _better(ladder, shot)
        if sure:
            break
    return exposure


def _better(ladder: Ladder, shot: Shot) -> tuple[Exposure, bool]:
    """What to take instead, and whether that is sure to serve: a frame far off the mark says little about how far."""
    if shot.frame is None:
        return shot.exposure, False
    if _GOOD <= shot.level <= _HIGH:
        return shot.exposure, True
    better = ladder.aim(shot.exposure, shot.level)
    return better, _LOW <= shot.level <= _HIGH or better == shot.exposure
