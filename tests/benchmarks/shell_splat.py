"""Measure the passes of glow: python tests/benchmarks/shell_splat.py [SCENE]

Fragments a second of the splats, beside those of a shader that only writes one colour into the same targets; what a
surfel costs, from ten thousand to a million, and what glows among 200,000 triangles that do not; what each stage takes
of a core; and the memory that the passes take at 768 x 512, atlases and meshes apart. Medians of 5, in turns. Nalbach,
Ritschel and Seidel (2014, 2015) report 84 MB.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any
from unittest.mock import patch

import moderngl
import numpy as np
from scale import TOML, rubble

from phoslab.render import TransportParameters, bounced_z_buffer, deep_screen_space, load_scene
from phoslab.render.bounced_z_buffer import BouncedZBuffer
from phoslab.render.cell_glow import CellGlow
from phoslab.render.deep_screen_space import DeepScreenSpace
from phoslab.render.device import Device, source
from phoslab.render.glow_pixels import GlowPixels
from phoslab.render.lit_cells import LitCells
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.render.shells import ShellLevels
from phoslab.render.surfel_glow import SurfelGlow
from phoslab.render.surfels import View, surfelize
from phoslab.render.tiles import Tiles
from phoslab.sample_data.glb import GlbWriter
from phoslab.sample_data.make_scenes import SCENES
from phoslab.sample_data.shapes import panel

RUNS = 5
SIZE = (768, 512)
PLAIN = """#version 430
layout(location = 0) out vec4 light[LAYERS];
void main() { for (int l = 0; l < LAYERS; ++l) light[l] = vec4(1e-6); }
"""


def taken(device: Device, run: Callable[[], Any], clock: Callable[[], float] = time.perf_counter) -> float:
    """Return how long `run` takes, in s; by the time of processors other programs matter less."""
    device.ctx.finish()
    start = clock()
    run()
    device.ctx.finish()
    return clock() - start


def held_bytes(device: Device) -> int:
    """Return the bytes of all textures and buffers of a device."""
    total = 0
    for scope in device._scopes:
        for thing in scope.made:
            if isinstance(thing, moderngl.Buffer):
                total += thing.size
            elif isinstance(thing, moderngl.Texture | moderngl.TextureArray):
                layers = getattr(thing, "layers", 1)
                total += thing.width * thing.height * layers * thing.components * int(thing.dtype[-1])
    return total


def measure_fragments(device: Device, scene: Any) -> None:
    renderer = Renderer(device, scene, RenderParameters(SIZE, 1, transport=TransportParameters("dss")))
    renderer.frame(scene.schedule.parse_time("off+1s"))
    dss = renderer.transport
    plain = device.ctx.program(
        vertex_shader=source("shell_splat.vert.glsl", dss._defines),
        fragment_shader=PLAIN.replace("LAYERS", str(dss._layers)),
    )
    bare = device.ctx.vertex_array(plain, [])
    rates: dict[str, list[float]] = {"shells": [], "one colour": []}
    dss.shells.shuffle(1)
    with device.scope():
        splats = dss.find_splats(1)
        n = splats.fragments()
        for _ in range(RUNS):
            rates["shells"].append(n / taken(device, lambda: dss.splat(1, splats)))
            plain["target_size"].value = dss.shells.size

            def draw() -> None:
                device.ctx.enable_only(moderngl.BLEND)
                device.ctx.blend_func = moderngl.ONE, moderngl.ONE
                bare.render(vertices=6 * splats.count)
                device.ctx.enable_only(moderngl.NOTHING)

            rates["one colour"].append(n / taken(device, draw))
    for name, values in rates.items():
        print(
            f"{name:12} {median(values) / 1e6:8.1f} M fragments/s of {n / 1e6:.1f} M in {splats.count} splats"
        )
    bare.release()
    plain.release()


def measure_bounced(device: Device, scene: Any, directions: int) -> None:
    """The same of dss-z, whose shader looks in every direction of a pixel whether it meets the disk."""
    find, splat, fragments, seconds = ShellLevels.find_splats, BouncedZBuffer._splat, 0, 0.0

    def found(self: Any, *args: Any, **kwargs: Any) -> Any:
        nonlocal fragments, seconds
        splats = find(self, *args, **kwargs)
        fragments += splats.fragments()
        device.ctx.finish()
        seconds -= time.perf_counter()
        return splats

    def splatted(self: Any, *args: Any) -> None:
        nonlocal seconds
        splat(self, *args)
        device.ctx.finish()
        seconds += time.perf_counter()

    transport = TransportParameters("dss-z", directions=directions)
    with (
        device.scope(),
        patch.object(ShellLevels, "find_splats", found),
        patch.object(BouncedZBuffer, "_splat", splatted),
    ):
        renderer = Renderer(device, scene, RenderParameters(SIZE, 1, transport=transport))
        renderer.frame(scene.schedule.parse_time("off+1s"))
        fragments, seconds = 0, 0.0
        renderer.transport.prepare()
    rate = fragments / seconds / 1e6
    print(
        f"dss-z, {directions} directions: {rate:6.1f} M fragments/s of {fragments / 1e6:.1f} M, "
        f"{rate * directions:.0f} M directions/s"
    )


def measure_bystanders() -> None:
    """One panel that glows over a floor, alone, and with 200,000 triangles in 50,000 pieces about it."""
    for bystanders in (False, True):
        with tempfile.TemporaryDirectory() as folder, Device() as device:
            glb = GlbWriter()
            glb.camera("camera", eye=(0.0, 2.0, 3.5), target=(0.0, 0.3, 0.0), yfov_deg=45)
            white = glb.material((0.6, 0.6, 0.6))
            glb.mesh("panel", panel((-0.5, 1.2, 0.5), (1, 0, 0), (0, 0, -1)), white)
            glb.mesh("floor", panel((-2, 0, 2), (4, 0, 0), (0, 0, -4)), white)
            if bystanders:
                glb.mesh("rubble", rubble(50_000), white)
            glb.save(Path(folder) / "scene.glb")
            (Path(folder) / "scene.toml").write_text(TOML.format(glows="panel", texels=64), encoding="utf-8")
            transport = TransportParameters("dss")
            scene = load_scene(Path(folder))
            renderer = Renderer(device, scene, RenderParameters(SIZE, 1, transport=transport))
            renderer.frame(0.0)
            dss, made, drawn = renderer.transport, [], []
            for _ in range(RUNS):
                made.append(busy(device, dss.prepare))
                drawn.append(busy(device, partial(dss.run, renderer.direct_light.radiance)))
            with device.scope():
                splats = sum(dss.find_splats(k).count for k in range(dss.shells.levels))
            print(
                f"{200_000 * bystanders:6d} bystanders: {dss.surfels.count} surfels in {1e3 * median(made):.1f} ms, "
                f"{splats} splats in {1e3 * median(drawn):.0f} ms of a core"
            )


busy = partial(taken, clock=time.process_time)


def measure_surfels(device: Device, scene: Any) -> None:
    print("surfels   surfelize   splat: us of a core a surfel, with as many fragments each")
    for radius in (0.011, 0.0035, 0.00114):
        with device.scope():
            parameters = TransportParameters("dss", surfel=radius, epsilon=0.05)
            renderer = Renderer(device, scene, RenderParameters(SIZE, 1, transport=parameters))
            renderer.frame(scene.schedule.parse_time("off+1s"))
            dss = renderer.transport
            view = View.of(scene.camera, dss.extent, radius)
            drawables = [d for d in renderer.drawables if d.material is not None]
            made, drawn, fragments = [], [], 1
            for _ in range(RUNS):
                with device.scope():
                    made.append(busy(device, partial(surfelize, device, drawables, dss.extent, view)))
                dss.shells.shuffle(1)
                with device.scope():
                    splats = dss.find_splats(1)
                    fragments = splats.fragments()
                    drawn.append(busy(device, partial(dss.splat, 1, splats)))
            n = dss.surfels.count
            print(
                f"{n:8d} {median(made) / n * 1e6:9.2f} {median(drawn) / n * 1e6:9.2f} {fragments / n:9.1f} fragments"
            )


# What each of them does, without what it calls that is also among them.
STAGES = [
    (deep_screen_space, "surfelize"),
    (bounced_z_buffer, "surfelize"),
    (SurfelGlow, "run"),
    (ShellLevels, "prepare"),
    (ShellLevels, "shuffle"),
    (ShellLevels, "find_splats"),
    (DeepScreenSpace, "splat"),
    (DeepScreenSpace, "_unshuffle"),
    (BouncedZBuffer, "_choose_directions"),
    (BouncedZBuffer, "_begin"),
    (BouncedZBuffer, "_splat"),
    (BouncedZBuffer, "_find_hits"),
    (BouncedZBuffer, "run"),
    (LitCells, "place"),
    (Tiles, "_bound_groups"),
    (Tiles, "_choose_aims"),
    (Tiles, "_find_hits"),
    (Tiles, "_find_guide"),
    (Tiles, "run"),
    (CellGlow, "run"),
    (GlowPixels, "shares"),
    (GlowPixels, "blur"),
    (GlowPixels, "filter"),
    (GlowPixels, "reflect"),
]


def measure_stages(scene: Any) -> None:
    """One new view of the scene, stage by stage, over all levels."""
    spent: dict[str, float] = defaultdict(float)
    inner = [0.0]

    def watched(name: str, step: Callable[..., Any], device: Device) -> Callable[..., Any]:
        def run(*args: Any, **kwargs: Any) -> Any:
            device.ctx.finish()
            start = time.process_time()
            inner.append(0.0)
            result = step(*args, **kwargs)
            device.ctx.finish()
            whole = time.process_time() - start
            spent[name] += whole - inner.pop()
            inner[-1] += whole
            return result

        return run

    for method in ("dss", "dss-z", "tiles"):
        with Device() as device:
            transport = TransportParameters(method, directions=4)
            renderer = Renderer(device, scene, RenderParameters(SIZE, 1, transport=transport))
            renderer.frame(scene.schedule.parse_time("off+1s"))
            way = renderer.transport
            made = f"{len(way.cells.skip)} cells" if method == "tiles" else f"{way.surfels.count} surfels"
            plain = [(owner, name, getattr(owner, name)) for owner, name in STAGES]
            each: list[dict[str, float]] = []
            for owner, name, step in plain:
                setattr(owner, name, watched(f"{owner.__name__.split('.')[-1]}.{name}", step, device))
            for _ in range(RUNS):
                spent.clear()
                if isinstance(way, Tiles):  # as if things had moved
                    way.lit_cells._placed.clear()
                way.prepare()
                way.run(renderer.direct_light.radiance)
                each.append(dict(spent))
            for owner, name, step in plain:
                setattr(owner, name, step)
            print(f"{method}: {made}; ms of a core")
            for name in each[0]:
                print(f"    {name:40} {1e3 * median(e[name] for e in each):9.1f}")


def measure_memory(scene: Any) -> None:
    """The most that is held at once: in dss while a level is drawn, in dss-z while a level's hits are found, in tiles
    whenever a pass looks at the receivers."""
    peak = 0

    def watched(step: Callable[..., Any]) -> Callable[..., Any]:
        def run(self: Any, *args: Any) -> Any:
            nonlocal peak
            peak = max(peak, held_bytes(self._device))
            return step(self, *args)

        return run

    DeepScreenSpace.splat = watched(DeepScreenSpace.splat)  # type: ignore[method-assign]
    BouncedZBuffer._find_hits = watched(BouncedZBuffer._find_hits)  # type: ignore[method-assign]
    GlowPixels.bind_receivers = watched(GlowPixels.bind_receivers)  # type: ignore[method-assign]
    for method, directions in (("dss", 1), ("dss-z", 4), ("dss-z", 8), ("tiles", 4), ("tiles", 8)):
        held = {}
        for name in ("none", method):
            peak = 0
            with Device() as device:
                transport = TransportParameters(name, directions=directions)
                renderer = Renderer(device, scene, RenderParameters(SIZE, 1, transport=transport))
                renderer.frame(scene.schedule.parse_time("off+1s"))
                atlases = sum(
                    int(np.prod(glow.radiance.size)) * 16 * (1 + 4 / 3 * 2) for glow in renderer.glows
                )
                held[name] = max(peak, held_bytes(device)) - int(atlases)
        megabytes = (held[method] - held["none"]) / 1e6
        what = f"{method}, {directions} directions"
        print(f"{what:20} {scene.transport.n} bands {megabytes:6.1f} MB at {SIZE[0]} x {SIZE[1]}")


def main(name: str = "cornell") -> None:
    scene = load_scene(SCENES / name)
    with Device() as device:
        print(device.renderer)
        measure_fragments(device, scene)
        for directions in (1, 4, 8):
            measure_bounced(device, scene, directions)
        measure_surfels(device, scene)
    measure_bystanders()
    measure_stages(scene)
    measure_memory(scene)


if __name__ == "__main__":
    main(*sys.argv[1:])
