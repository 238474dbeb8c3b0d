"""Measure what the renderer's other approximations cost and err: python tests/benchmarks/approximations.py [SCENE]

One at a time is made coarser or finer than in the scene, and both its pictures (lit, and 1 s after) are compared with
the same scene with that one at its finest: mean |a - b| / mean b over the pixels and bands. The time is that of a first
picture, with all that is prepared for it, over that of the scene as it stands: the median of `RUNS`, taken in turns.
"""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray

from phoslab.colorimetry import xyz_matrix
from phoslab.render import Scene, load_scene
from phoslab.render.device import Device
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.render.shadow_map import ShadowMapParameters
from phoslab.sample_data.make_scenes import SCENES

RUNS = 5
LIT, GLOW = "off-1s", "off+1s"


@dataclass(frozen=True, eq=False)
class Case:
    """A scene and how it is rendered."""

    scene: Scene
    parameters: RenderParameters


def as_it_stands(folder: Path) -> Case:
    scene = load_scene(folder)
    return Case(scene, RenderParameters(scene.size, scene.supersampling))


def with_atlas(case: Case, texels: int) -> Case:
    drawables = tuple(
        d if d.phosphor is None else replace(d, phosphor=replace(d.phosphor, atlas_texels=texels))
        for d in case.scene.drawables
    )
    return replace(case, scene=replace(case.scene, drawables=drawables))


def with_samples(case: Case, side: int) -> Case:
    return replace(case, parameters=replace(case.parameters, supersampling=side))


def with_shadows(case: Case, tile: int) -> Case:
    return replace(case, parameters=replace(case.parameters, shadow_map=ShadowMapParameters(tile)))


def with_bands(folder: Path, n: int, work: Path) -> Case:
    """The scene with n equal transport bands over 400 to 700 nm, from a copy of its folder."""
    copy = work / f"bands-{n}"
    shutil.copytree(folder, copy)
    file = copy / "scene.toml"
    edges = [float(e) for e in np.linspace(400, 700, n + 1)]
    file.write_text(re.sub(r"(?m)^\[render\]$", f"[render]\nbands_nm = {edges}", file.read_text()))
    return as_it_stands(copy)


def draw(device: Device, case: Case) -> tuple[float, list[NDArray[np.float64]]]:
    """Return the time to the first picture in s, and both pictures as (h, w, 3) XYZ."""
    schedule = case.scene.schedule
    with device.scope():
        device.ctx.finish()
        begin = time.perf_counter()
        renderer = Renderer(device, case.scene, case.parameters)
        frames = [renderer.frame(schedule.parse_time(LIT))]
        took = time.perf_counter() - begin
        frames.append(renderer.frame(schedule.parse_time(GLOW)))
    to_xyz = xyz_matrix(case.scene.transport)
    return took, [f.radiance.astype(np.float64) @ to_xyz for f in frames]


def error(picture: NDArray[np.float64], finest: NDArray[np.float64]) -> float:
    return float(np.abs(picture - finest).mean() / finest.mean())


def main(path: str = str(SCENES / "fading")) -> None:
    folder = Path(path)
    base = as_it_stands(folder)
    with Device() as device, tempfile.TemporaryDirectory() as work:
        sweeps = {
            "atlas texels along a side": {n: with_atlas(base, n) for n in (64, 128, 256, 512, 1024)},
            "samples along a pixel": {n: with_samples(base, n) for n in (1, 2, 3, 6)},
            "shadow map texels": {n: with_shadows(base, n) for n in (256, 512, 1024, 2048, 4096)},
            "transport bands": {n: with_bands(folder, n, Path(work)) for n in (3, 8, 16, 32)},
        }
        print(
            f"{device.renderer}, {folder.name}, {base.scene.size[0]} x {base.scene.size[1]}; medians of {RUNS}"
        )
        for name, cases in sweeps.items():
            times: dict[int | None, list[float]] = {}
            for _ in range(RUNS):
                for n, case in [(None, base), *cases.items()]:
                    took, pictures = draw(device, case)
                    times.setdefault(n, []).append(took)
                    if n == max(cases):
                        finest = pictures
            print(f"{name:28} {'lit':>8} {'glow':>8}  time / that of the scene")
            for n, case in cases.items():
                lit, glow = (error(a, b) for a, b in zip(draw(device, case)[1], finest, strict=True))
                print(f"  {n:<26} {lit:8.1e} {glow:8.1e}  {median(times[n]) / median(times[None]):.2f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
