"""Measure one exact step against a pass that only copies: python tests/benchmarks/solver_step.py [TEXELS]

Two states on TEXELS² texels (2048 by default) with a two-channel excitation texture. The copying pass reads and
writes the same textures and computes nothing but a choice. The goal is a ratio of at most 1.25. Medians of 20,
taken in turns in one process, so that a busy machine slows both.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from statistics import median

import numpy as np

from phoslab.render.device import Device, set_uniforms
from phoslab.render.gpu_scene import MaterialTextures
from phoslab.render.phosphor_step import GROUP, PhosphorStep

RUNS = 20

COPY = """#version 430
layout(local_size_x = 64) in;
uniform sampler2D r_in;
uniform sampler2D excitation;
layout(rg32f, binding = 0) writeonly uniform image2D r_out;

void main() {
    ivec2 texel = ivec2(gl_GlobalInvocationID.xy);
    if (texel.x >= imageSize(r_out).x) return;
    // A choice instead of a sum: every channel of both textures must be read, or the compiler drops the fetch.
    imageStore(r_out, texel, max(texelFetch(r_in, texel, 0), texelFetch(excitation, texel, 0)));
}
"""


def seconds(device: Device, work: Callable[[], None]) -> float:
    device.ctx.finish()
    start = time.perf_counter()
    work()
    device.ctx.finish()
    return time.perf_counter() - start


def main(texels: int = 2048) -> None:
    size = (texels, texels)
    rng = np.random.default_rng(0)
    with Device() as device:
        r = device.texture(size, 2, rng.uniform(0, 1, (texels, texels, 2)))
        excitation = device.texture(size, 2, rng.uniform(0, 1, (texels, texels, 2)))
        target = device.texture(size, 2)
        kr = np.array([0.2, 0.01])
        one = device.texture_array((1, 1), 1)
        material = MaterialTextures(device.texture((1, 1), 2), one, one, 2, kr)
        step = PhosphorStep(device, material, "exact")
        program = device.ctx.compute_shader(COPY)

        def copy() -> None:
            r.use(0)
            target.bind_to_image(0, read=False, write=True)
            excitation.use(1)
            set_uniforms(program, r_in=0, excitation=1)
            device.dispatch(program, size, group=GROUP)

        works = {
            "copy": copy,
            "exact step, lit": lambda: step.run(r, target, 1 / 60, excitation, dark=False),
            "exact step, dark": lambda: step.run(r, target, 1 / 60, excitation, dark=True),
        }
        times: dict[str, list[float]] = {name: [] for name in works}
        for _ in range(RUNS + 2):
            for name, work in works.items():
                times[name].append(seconds(device, work))
        print(f"{device.renderer}, {texels} x {texels} texels, two states; medians of {RUNS}")
        copied = median(times["copy"][2:])
        for name, taken in times.items():
            print(
                f"{name:18} {median(taken[2:]) * 1e3:7.2f} ms   {median(taken[2:]) / copied:5.2f} of a copy"
            )
        program.release()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
