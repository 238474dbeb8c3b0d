"""What the model of a phosphor takes for granted, as measurements that could contradict it.

* Decays from several levels have one shape (Nalbach 2017, Fig. 8.11): after charges of different length.
* The spectrum is constant in time (Fig. 8.9): several frames through the LVF during one decay.
* It does not depend on the light that excited (8.3): again, with a filter before the lamp.
* The glow is the same in all directions (8.3): frames of the sample turned by several angles.

The frames have the roles of what they show, decay or emission; the session's plan is "check", and the journal names
the part that each belongs to.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

from phoslab.instruments.devices import Exposure
from phoslab.instruments.plans.darks import dark_frames
from phoslab.instruments.plans.decay import SETTLE_S, even_times, fading_frames
from phoslab.instruments.plans.ladder import gain
from phoslab.instruments.plans.metering import meter_glow
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
from phoslab.plan_parameters import Check, names, numbers


def check(p: Check, setup: Setup) -> Plan:
    """The four questions in turn, and dark frames for all."""
    charges_s = sorted(numbers(p.charges_s, field="check.charges_s"))
    spectra_s = sorted(numbers(p.spectra_at_s, field="check.spectra_at_s"))
    angles = numbers(p.angles_deg, field="check.angles_deg")
    ladder = setup.ladder.up_to(p.longest_s)
    used: set[Exposure] = set()
    exposure = next(e for e in reversed(ladder.rungs) if e.iso == ladder.isos[0])
    for charge_s in charges_s:
        # From the dark, without trials or warm-up: either would charge the sample further. The first frames of the
        # first series may be badly exposed; the others begin where the one before did.
        yield Part(f"decay after {charge_s:g} s of light")
        yield Lamp("off")
        yield Door("closed")
        yield Stage("sample")
        yield Dark(p.dark_s)
        yield Lamp("on")
        yield Wait(charge_s, "charging")
        off_s: float = yield Lamp("off")
        yield Wait(setup.fade_s, "the lamp fades", since_s=off_s)
        open_s: float = yield Door("open")
        at_s = [off_s + t for t in even_times(open_s + SETTLE_S - off_s, p.until_s, p.interval_s)]
        settings = yield from fading_frames(setup, "decay", at_s, exposure, p.longest_s)
        yield Door("closed")
        used |= settings
        exposure = min(settings, key=gain, default=exposure)
    for name in ("none", *names(p.lamp_filters)):
        yield Part("spectrum in time" + ("" if name == "none" else f", lamp behind {name}"))
        stage = Stage("sample", lvf="camera", filter=name)
        exposure, off_s, _ = yield from _charged(p, setup, stage, charges_s[-1])
        for t_s in spectra_s:
            shot: Shot = yield Shoot("emission", exposure, off_s + t_s)
            used.add(exposure)
            exposure = ladder.follow(exposure, shot.level)
        yield Door("closed")
    for angle in angles:
        yield Part(f"seen from {angle:g} degrees")
        # The same charge each time, so that only the direction differs.
        exposure, _, open_s = yield from _charged(p, setup, Stage("sample", angle_deg=angle), charges_s[-1])
        yield Shoot("decay", exposure, open_s + SETTLE_S)
        used.add(exposure)
        yield Door("closed")
    yield from dark_frames(used, p.darks)


def _charged(
    p: Check, setup: Setup, stage: Stage, charge_s: float
) -> Generator[Step, Any, tuple[Exposure, float, float]]:
    """Charge, find the exposure, switch the lamp off, open the door; return exposure and the two moments."""
    yield stage
    yield from warm_up("lamp", setup)
    yield Door("closed")
    yield Lamp("on")
    yield Wait(charge_s, "charging")
    exposure: Exposure = yield from meter_glow(setup.ladder.up_to(p.longest_s), setup, charge_s)
    off_s: float = yield Lamp("off")
    yield Wait(setup.fade_s, "the lamp fades", since_s=off_s)
    open_s: float = yield Door("open")
    return exposure, off_s, open_s
