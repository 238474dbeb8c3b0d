"""The decay: charge the sample, switch the lamp off, and take frames while it fades (Nalbach 2017, 8.4.4)."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from typing import Any

from phoslab.instruments.devices import Exposure
from phoslab.instruments.plans.darks import dark_frames
from phoslab.instruments.plans.metering import meter_glow
from phoslab.instruments.plans.steps import Door, Lamp, Part, Plan, Setup, Shoot, Shot, Stage, Step, Wait
from phoslab.instruments.plans.warm_up import warm_up
from phoslab.plan_parameters import Decay

SETTLE_S = 0.2
"""From the door's end switch to the first frame: the sample no longer shakes, and the camera can be told in time."""


def decay(p: Decay, setup: Setup) -> Plan:
    """One series of frames from the moment the door is open until `p.until_s`, and their dark frames.

    Exposures follow the fading light. The lamp is warm at its end: it charges the sample for longer than it warms up.
    """
    yield Part("charge and decay")
    yield Stage("sample")
    yield from warm_up("lamp", setup)
    yield Door("closed")
    yield Lamp("on")
    yield Wait(p.charge_s, "charging")
    exposure = yield from meter_glow(setup.ladder.up_to(p.longest_s), setup, p.charge_s)
    # Trials took light; give it back before the series.
    yield Wait(min(600.0, p.charge_s / 4), "charging")
    off_s: float = yield Lamp("off")
    yield Wait(setup.fade_s, "the lamp fades", since_s=off_s)
    open_s: float = yield Door("open")
    first_s = open_s + SETTLE_S - off_s
    if p.spacing == "log":
        after_s = list(log_times(first_s, p.until_s, p.per_decade, setup.cycle_s + 0.5))
    else:
        after_s = list(even_times(first_s, p.until_s, p.interval_s))
    used = yield from fading_frames(setup, "decay", [off_s + t for t in after_s], exposure, p.longest_s)
    yield from dark_frames(used, p.darks)


def even_times(first_s: float, until_s: float, interval_s: float) -> Iterator[float]:
    """Times every `interval_s`, from the first to `until_s` after the first.

    >>> list(even_times(0.6, 15.0, 5.0))
    [0.6, 5.6, 10.6, 15.6]
    """
    # A little more than until_s: the sum of intervals rounds.
    for k in range(int(until_s / interval_s + 1e-9) + 1):
        yield first_s + k * interval_s


def log_times(first_s: float, until_s: float, per_decade: int, gap_s: float) -> Iterator[float]:
    """Times in equal ratios, but never closer than `gap_s`, from the first to `until_s`.

    >>> [round(t, 1) for t in log_times(1.0, 30.0, 2, 2.5)]
    [1.0, 3.5, 11.1, 30.0]
    """
    t_s = first_s
    while t_s < until_s:
        yield t_s
        t_s = max(t_s * 10 ** (1 / per_decade), t_s + gap_s)
    yield until_s


def fading_frames(
    setup: Setup, role: str, at_s: list[float], exposure: Exposure, longest_s: float
) -> Generator[Step, Any, set[Exposure]]:
    """Take a frame at each moment; return the settings that were used.

    The setting follows the light after each frame. Where it changes and there is time before the next frame, the new
    setting takes a frame at once as well: the two overlap, and the step between them can be calibrated.
    A frame that is lost or too late is left out, and the series goes on: a decay cannot be stopped.
    """
    used: set[Exposure] = set()
    level = math.nan  # of the frame before
    for k, moment_s in enumerate(at_s):
        gap_s = at_s[k + 1] - moment_s if k + 1 < len(at_s) else longest_s + setup.cycle_s
        ladder = setup.ladder.up_to(min(longest_s, max(gap_s - setup.cycle_s, 0.0)))
        exposure = ladder.follow(exposure, level)
        shot: Shot = yield Shoot(role, exposure, moment_s, gap_s / 2)
        if shot.frame is None:
            level = math.nan
            continue
        used.add(exposure)
        level = shot.level
        new = ladder.follow(exposure, level)
        spare_s = moment_s + gap_s - (shot.start_s + exposure.exposure_s + setup.cycle_s)
        if new != exposure and k + 1 < len(at_s) and spare_s > new.exposure_s + setup.cycle_s:
            shot = yield Shoot(role, new)
            if shot.frame is not None:
                exposure, level = new, shot.level
                used.add(new)
    return used
