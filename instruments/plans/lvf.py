"""Calibration of the linear variable filter (Nalbach 2017, 8.4.2).

A mercury lamp seen through it says which wavelength passes where. A white LED seen through it, alone and behind many
colour filters of known transmission, says how wide the band is that passes. The card under the LED
without the strip, last, says
how evenly that lights it.
"""

from __future__ import annotations

from phoslab.instruments.devices import Exposure
from phoslab.instruments.plans.darks import dark_frames
from phoslab.instruments.plans.metering import meter
from phoslab.instruments.plans.steps import Door, Lamp, Part, Plan, Setup, Shoot, Stage
from phoslab.instruments.plans.warm_up import warm_up
from phoslab.plan_parameters import Lvf, names


def lvf(p: Lvf, setup: Setup) -> Plan:
    """Mercury lamp, LED, LED behind each filter, LED without the LVF; each is a part, so none is asked for twice."""
    used: set[Exposure] = set()
    exposure: Exposure | None = None
    filters = names(p.filters) or setup.filters
    series = [
        ("mercury", "mercury", Stage("card", lvf="camera", light="mercury")),
        ("led", "LED", Stage("card", lvf="camera", light="led")),
        *(
            (
                f"filter:{name}",
                f"filter {name}",
                Stage("card", "camera", name, "led", progress=f"filter {k} of {len(filters)}"),
            )
            for k, name in enumerate(filters, start=1)
        ),
        ("flat", "LED without the LVF", Stage("card", light="led")),
    ]
    for role, part, stage in series:
        yield Part(part)
        yield Lamp("off")
        yield stage
        yield from warm_up(stage.light, setup)
        yield Door("open")
        exposure = yield from meter(setup.ladder, exposure)
        used.add(exposure)
        for _ in range(p.frames):
            yield Shoot(role, exposure)
    yield from dark_frames(used, p.darks)
