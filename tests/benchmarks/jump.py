"""Measure that a picture costs its light changes and not its time: python tests/benchmarks/jump.py [SCENE]

A renderer that stands at 0 is asked for a picture 6 s and 6 h on, each after the same three changes of light. The goal
is that the two cost the same within 10 %. Medians of 20, taken in turns in one process.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from statistics import median

from phoslab.programmes import Switched
from phoslab.render import Scene, load_scene
from phoslab.render.device import Device
from phoslab.render.light_course import Course
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.render.schedule import Schedule
from phoslab.sample_data.make_scenes import SCENES

RUNS = 20
WARM_UP = 2
TIMES_S = (6.0, 6 * 3600.0)
CHANGES = Course(Switched(((0.0, 2.0), (3.0, 5.0))))  # at 2, 3 and 5 s


def three_changes(scene: Scene) -> Scene:
    return replace(scene, schedule=Schedule(dict.fromkeys(scene.schedule.courses, CHANGES)))


def main(path: str = str(SCENES / "fading")) -> None:
    scene = three_changes(load_scene(path))
    with Device() as device:
        renderer = Renderer(device, scene, RenderParameters(scene.size, scene.supersampling))
        times: dict[float, list[float]] = {t: [] for t in TIMES_S}
        for _ in range(RUNS + WARM_UP):
            for t, taken in times.items():
                renderer.bring_states_to(0.0)
                device.ctx.finish()
                start = time.perf_counter()
                renderer.frame(t)
                device.ctx.finish()
                taken.append(time.perf_counter() - start)
        print(f"{device.renderer}, three changes of light; medians of {RUNS}")
    short, long = (median(taken[WARM_UP:]) for taken in times.values())
    print(f"after 6 s  {short * 1e3:7.1f} ms")
    print(f"after 6 h  {long * 1e3:7.1f} ms")
    print(f"ratio      {long / short:7.3f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
