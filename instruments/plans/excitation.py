"""How fast light of each wavelength excites: the glow after exposures of growing length through the LVF, which lies on
the sample (Nalbach 2017, 8.4.6).

The sample first rests in the dark until nothing is left in it. It is then lit for a time t, the lamp goes off, the
door opens, and a frame is taken. t doubles until the glow no longer grows; then times between are measured where it
grew most. Each t needs a sample without excitation, so each is a part of its own, with its rest before it.

A lamp that has rested as long is cold, and no shutter keeps its light from the sample while it warms up. So either a
hand puts the grey card in the sample's place for the warm-up, or the light is a cold lamp's (docs/accuracy.md).
"""

from __future__ import annotations

from collections.abc import Generator
from itertools import pairwise
from typing import Any

from phoslab.instruments.devices import Exposure
from phoslab.instruments.plans.darks import dark_frames
from phoslab.instruments.plans.ladder import HIGHEST, LOWEST, TARGET, gain
from phoslab.instruments.plans.steps import (
    Dark,
    Door,
    Lamp,
    Part,
    Plan,
    Setup,
    Shoot,
    Shot,
    Stage,
    Step,
    Wait,
)
from phoslab.instruments.plans.warm_up import warm_up
from phoslab.plan_parameters import Excitation

GROWTH = 3.0
"""What the next frame is exposed for, after a doubling. Light that comes twice as long brings twice the glow where
all is linear; traps that fill one another make it more, and the frame before may have been taken a little late."""

_REHEARSED_S = 120.0
"""Time in which a rehearsal's sample is excited."""


def excitation(p: Excitation, setup: Setup) -> Plan:
    """Doubled times until the glow changes by less than `p.change`, then `p.between` times between; dark frames."""
    used: set[Exposure] = set()
    ladder = setup.ladder.up_to(p.longest_s)
    # The first glow is faint: the longest exposure that needs no amplification.
    exposure = next(e for e in reversed(ladder.rungs) if e.iso == ladder.isos[0])
    signal: dict[float, float] = {}
    lit_s = p.first_s
    while lit_s <= p.last_s * 1.001:
        shot = yield from _excite(p, setup, lit_s, len(signal), exposure, used)
        signal[lit_s] = shot.level / gain(shot.exposure)
        exposure = ladder.aim(shot.exposure, shot.level, TARGET / GROWTH)
        if len(signal) > 1 and signal[lit_s] < (1 + p.change) * signal[lit_s / 2]:
            break
        lit_s *= 2
    for lit_s in _between(signal, p.between):
        # Less than the glow after the next longer exposure, which is known.
        brighter = min(t for t in signal if t > lit_s)
        exposure = ladder.reaching(TARGET / signal[brighter])
        shot = yield from _excite(p, setup, lit_s, len(signal), exposure, used)
        signal[lit_s] = shot.level / gain(shot.exposure)
    yield from dark_frames(used, p.darks)


def _excite(
    p: Excitation, setup: Setup, lit_s: float, k: int, exposure: Exposure, used: set[Exposure]
) -> Generator[Step, Any, Shot]:
    """One exposure time; return the frame. A badly exposed frame is followed at once by a better one."""
    rehearsed = 0.6 * lit_s / (lit_s + _REHEARSED_S)
    yield Part(f"{lit_s:g} s of light")
    yield Lamp("off")
    yield Door("closed")
    sample = Stage("sample" if p.samples == 1 else f"sample {k % p.samples + 1}", lvf="sample")
    if p.warm_up == "none":
        yield sample
    yield Dark(p.dark_s)
    if p.warm_up == "card":
        # The filter stays: only what lies under it is exchanged, and the sample goes on resting elsewhere.
        yield Stage("card", lvf="sample")
        yield from warm_up("lamp", setup)
        yield Lamp("off")
        yield Door("closed")
        yield sample
    yield Lamp("on")
    yield Wait(lit_s, f"exciting for {lit_s:g} s")
    off_s: float = yield Lamp("off")
    yield Wait(setup.fade_s, "the lamp fades", since_s=off_s)
    yield Door("open")
    shot: Shot = yield Shoot("excitation", exposure, rehearsed=rehearsed * gain(exposure))
    used.add(exposure)
    better = setup.ladder.up_to(p.longest_s).aim(exposure, shot.level)
    if better != exposure and not LOWEST <= shot.level <= HIGHEST:
        shot = yield Shoot("excitation", better, rehearsed=rehearsed * gain(better))
        used.add(better)
    yield Door("closed")
    return shot


def _between(signal: dict[float, float], n: int) -> list[float]:
    """The middles, as ratios, of the `n` steps in which the glow grew most, ascending."""
    times = sorted(signal)
    steps = sorted(pairwise(times), key=lambda step: signal[step[1]] - signal[step[0]], reverse=True)
    return sorted(round((a * b) ** 0.5, 2) for a, b in steps[:n])
