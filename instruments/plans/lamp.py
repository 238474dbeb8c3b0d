"""The exciting lamp's own spectrum: the grey card through the LVF. Excitation rates refer to it (8.4.6)."""

from __future__ import annotations

from phoslab.instruments.plans.darks import dark_frames
from phoslab.instruments.plans.metering import meter
from phoslab.instruments.plans.steps import Door, Lamp, Part, Plan, Setup, Shoot, Stage
from phoslab.instruments.plans.warm_up import warm_up
from phoslab.plan_parameters import Lamp as Parameters


def lamp(p: Parameters, setup: Setup) -> Plan:
    """`p.frames` frames of the card under the lamp, and their dark frames. The lux value stands in the parameters."""
    yield Part("lamp through the LVF")
    yield Stage("card", lvf="camera")
    yield from warm_up("lamp", setup)
    yield Lamp("on")
    yield Door("open")
    exposure = yield from meter(setup.ladder)
    for _ in range(p.frames):
        yield Shoot("lamp", exposure)
    yield Lamp("off")
    yield from dark_frames([exposure], p.darks)
