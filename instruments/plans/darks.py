"""Dark frames: lamp off and door closed, at every setting that a session used."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from typing import Any

from phoslab.instruments.devices import Exposure
from phoslab.instruments.plans.steps import Door, Lamp, Part, Shoot, Step


def dark_frames(used: Iterable[Exposure], n: int) -> Generator[Step, Any, None]:
    """Take `n` frames at each exposure time and ISO; the aperture does not matter in the dark.

    They follow the frames they belong to, when the sensor is as warm.
    """
    settings = {(e.exposure_s, e.iso): e for e in used}
    yield Part("dark frames")
    yield Lamp("off")
    yield Door("closed")
    for key in sorted(settings):
        for _ in range(n):
            yield Shoot("dark", settings[key], rehearsed=0.0)
