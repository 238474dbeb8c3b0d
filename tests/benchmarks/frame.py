"""Measure a whole frame with and without phosphorescence: python tests/benchmarks/frame.py [SCENE]

Every pass runs for every frame, as when light and camera move: shadow maps, irradiance and excitation of each texel,
one step of the state, G-buffer, lamp light, glow, resolve. Without: the same scene with its phosphors as plain
surfaces. Medians of 20, taken in turns in one process. Nalbach 2017, 8.5, reports 454 and 448 ms.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from statistics import median

from phoslab.render import Scene, load_scene
from phoslab.render.device import Device
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.sample_data.make_scenes import SCENES

RUNS = 20
STEP_S = 1 / 60


def draw(renderer: Renderer) -> None:
    """Draw one frame from nothing but the meshes and the state."""
    schedule = renderer.scene.schedule
    step = next(schedule.segments(0.0, STEP_S))
    renderer.shadow_map.run()
    for state in renderer.states:
        state.excite()
        state.advance(step)
    renderer.gbuffer.run(renderer.scene.camera)
    renderer.direct_light.run(renderer.gbuffer, renderer.drawables, schedule.factors(0.0))
    for state in renderer.states:
        renderer.glow.run(renderer.gbuffer, state.drawable, state.shown.value, renderer.direct_light.radiance)
    renderer.resolve.run(renderer.direct_light.radiance)
    renderer.resolve.read()


def without_phosphors(scene: Scene) -> Scene:
    return replace(scene, drawables=tuple(replace(d, phosphor=None) for d in scene.drawables))


def main(path: str = str(SCENES / "fading")) -> None:
    scene = load_scene(path)
    parameters = RenderParameters(scene.size, scene.supersampling)
    with Device() as device:
        with_, without = (Renderer(device, s, parameters) for s in (scene, without_phosphors(scene)))
        times: dict[str, list[float]] = {"with": [], "without": []}
        for _ in range(RUNS + 2):
            for name, renderer in (("with", with_), ("without", without)):
                device.ctx.finish()
                start = time.perf_counter()
                draw(renderer)
                device.ctx.finish()
                times[name].append(time.perf_counter() - start)
        texels = sum(s.atlas.size[0] * s.atlas.size[1] for s in with_.states)
        w, h = scene.size
        print(f"{device.renderer}, {w} x {h}, {scene.supersampling}² samples, {texels / 1e6:.2f} M texels")
    for name, taken in times.items():
        print(f"{name:8} {median(taken[2:]) * 1e3:7.1f} ms")
    print(f"ratio    {median(times['with'][2:]) / median(times['without'][2:]):7.3f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
