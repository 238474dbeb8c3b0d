"""Wait until a light, and the sensor with it, is stable: frame after frame until the level no longer drifts.

Nalbach 2017, 8.4.1: lamp and camera reach a stable temperature before a series begins, since both the lamp's output
and the sensor's noise depend on it.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import Any, Literal

from phoslab.instruments.plans.ladder import HIGHEST
from phoslab.instruments.plans.metering import meter
from phoslab.instruments.plans.steps import Cold, Door, Lamp, Setup, Shoot, Shot, Step, Wait

EVERY_S = 30.0
N_STABLE = 4
STABLE = 0.005
"""Largest difference among `N_STABLE` frames, as a share: shutters repeat no better."""


def warm_up(light: Literal["lamp", "led", "mercury"], setup: Setup) -> Generator[Step, Any, None]:
    """Leave the light on and the door open, and the light stable, or warm for the rig file's `warm_up_s`.

    Does nothing if the light is warm already. The LED and the mercury lamp are switched by hand.
    """
    if not (yield Cold(light)):
        return
    if light == "lamp":
        yield Lamp("on")
    yield Door("open")
    exposure = yield from meter(setup.ladder)
    levels: list[float] = []
    began_s: float | None = None
    while True:
        # A rehearsal never finds it stable, and so counts the longest time.
        shot: Shot = yield Shoot("meter", exposure, rehearsed=0.4 + 0.1 * (len(levels) % 2))
        began_s = shot.start_s if began_s is None else began_s
        if shot.level > HIGHEST and exposure != setup.ladder.rungs[0]:
            # It has become so bright that frames no longer tell whether it still grows.
            exposure, levels = setup.ladder.aim(exposure, shot.level), []
            continue
        levels.append(shot.level)
        recent = levels[-N_STABLE:]
        if len(recent) == N_STABLE and max(recent) - min(recent) <= STABLE * max(recent):
            return
        if shot.start_s - began_s >= setup.warm_up_s:
            return
        yield Wait(EVERY_S, f"the {light} warms up")
