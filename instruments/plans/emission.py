"""The spectrum of the glow: the charged sample through the LVF, in long exposures (Nalbach 2017, 8.4.3)."""

from __future__ import annotations

from phoslab.instruments.devices import Exposure
from phoslab.instruments.plans.darks import dark_frames
from phoslab.instruments.plans.metering import meter_glow
from phoslab.instruments.plans.steps import Door, Lamp, Part, Plan, Setup, Shoot, Shot, Stage, Wait
from phoslab.instruments.plans.warm_up import warm_up
from phoslab.plan_parameters import Emission


def emission(p: Emission, setup: Setup) -> Plan:
    """`p.frames` frames from lamp-off on, one after another, ever longer as the glow fades; and their dark frames."""
    yield Part("charge and spectrum")
    yield Stage("sample", lvf="camera")
    yield from warm_up("lamp", setup)
    yield Door("closed")
    yield Lamp("on")
    yield Wait(p.charge_s, "charging")
    ladder = setup.ladder.up_to(p.longest_s)
    exposure: Exposure = yield from meter_glow(ladder, setup, p.charge_s)
    off_s: float = yield Lamp("off")
    yield Wait(setup.fade_s, "the lamp fades", since_s=off_s)
    yield Door("open")
    used: set[Exposure] = set()
    for _ in range(p.frames):
        shot: Shot = yield Shoot("emission", exposure)
        used.add(exposure)
        exposure = ladder.follow(exposure, shot.level)
    yield from dark_frames(used, p.darks)
