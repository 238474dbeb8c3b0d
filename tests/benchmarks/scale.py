"""Render a million triangles by every way of glow: python tests/benchmarks/scale.py OUT [SCENE...] [--gi WAY...]

relief     a floor of a million triangles under a panel that glows: 12 triangles send, all block
glowing    the same floor glows itself, and the walls are lit by it
rubble     two hundred thousand small pieces of four triangles each, no two of them joined, under the panel

Each picture (384 x 256, 1 sample a pixel) is made by a process of its own: how long it took from the scene's file to
the picture, how much of a core's time the whole process, the most memory that it held, and OUT/SCENE-WAY.png. A way
that fails says so and why.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from phoslab.errors import PhoslabError
from phoslab.sample_data.glb import GlbWriter
from phoslab.sample_data.shapes import Array, Shape, box, panel, surface

SIZE = (384, 256)
SIDE = 708  # quads along the floor: 1,002,528 triangles
PIECES = 200_000
WAYS = ("none", "dss", "dss-z", "tiles", "reference")
PATIENCE_S = 1800

TOML = """\
schema = "phoslab-scene/1"
gltf = "scene.glb"
[units]
radiance_factor = 1.0
[phosphors.{glows}]
material = "preset:green"
atlas_texels = {texels}
[initial]
state = "saturated"
[render]
bands_nm = [400, 500, 600, 700]
[display]
exposures = [{{ from = "0", exposure = "auto" }}]
"""


def relief(u: Array, v: Array) -> Array:
    """Return the floor over the unit square: waves of three sizes, 4 m wide."""
    height = sum(
        a * np.sin(k * 2 * np.pi * u + p) * np.cos(k * 2 * np.pi * v + 2 * p)
        for a, k, p in ((0.15, 2, 0.3), (0.05, 7, 1.1), (0.01, 31, 2.3))
    )
    return np.stack([4 * u - 2, height, 2 - 4 * v], axis=-1)


def rubble(n: int, seed: int = 0) -> Shape:
    """Return `n` tetrahedra, 1 to 3 cm large, strewn over the floor."""
    rng = np.random.default_rng(seed)
    corners = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    q = rng.normal(size=(n, 4))
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    at = rng.uniform([-1.9, -0.1, -1.9], [1.9, 0.3, 1.9], (n, 1, 3))
    each = at + rng.uniform(0.005, 0.015, (n, 1, 1)) * (corners @ turn)
    positions = each[:, faces].reshape(-1, 3)
    a, b, c = positions.reshape(-1, 3, 3).transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    triangles = np.arange(len(positions), dtype=np.uint32).reshape(-1, 3)
    return Shape(positions, np.repeat(normals, 3, axis=0), triangles)


def write(name: str, folder: Path, side: int = SIDE, pieces: int = PIECES) -> Path:
    """Write one of the scenes; return its folder."""
    glb = GlbWriter()
    glb.camera("camera", eye=(0.0, 1.6, 4.6), target=(0.0, 0.35, 0.0), yfov_deg=45)
    grey, white = glb.material((0.6, 0.6, 0.6)), glb.material((0.8, 0.8, 0.8))
    if name == "rubble":
        glb.mesh("ground", panel((-2, -0.2, 2), (4, 0, 0), (0, 0, -4)), white)
        glb.mesh("floor", rubble(pieces), grey)
    else:
        glb.mesh("floor", surface(relief, side, side), grey)
    if name != "glowing":
        glb.mesh("lamp", box((-0.8, 1.4, -0.9), (0.8, 1.44, 0.7)), white)
    glb.mesh("back", panel((-2, -0.3, -2), (4, 0, 0), (0, 2.3, 0)), white)
    glb.mesh("left", panel((-2, -0.3, 2), (0, 0, -4), (0, 2.3, 0)), white)
    glb.mesh("pillar", box((-1.3, -0.3, -1.2), (-1.0, 1.3, -0.9)), white)
    glb.save(folder / "scene.glb")
    glows, texels = ("floor", 1024) if name == "glowing" else ("lamp", 128)
    (folder / "scene.toml").write_text(TOML.format(glows=glows, texels=texels), encoding="utf-8")
    return folder


def draw(path: Path, way: str, out: Path, surfel: float) -> None:
    """Render in this process and print what it took."""
    from phoslab.render import TransportParameters, render

    start = time.perf_counter()
    transport = TransportParameters(way, directions=4, samples=64, surfel=surfel)
    try:
        frames = render(path, ["0"], size=SIZE, supersampling=1, transport=transport)
    except PhoslabError as error:
        print(f"{path.name:10} {way:10} is refused: {error}", flush=True)
        return
    seconds = time.perf_counter() - start
    used = resource.getrusage(resource.RUSAGE_SELF)
    took = f"{seconds:7.1f} s {used.ru_utime + used.ru_stime:7.1f} s of a core {used.ru_maxrss / 1e6:6.2f} GB"
    frames.write(out)
    lit = float(frames[0].radiance.mean())
    said = "".join(f" [{warning}]" for warning in frames.warnings)
    print(f"{path.name:10} {way:10} {took}, mean {lit:.4g}{said}", flush=True)


def in_a_process(what: Callable[..., None], *args: object) -> None:
    """Run it in a process of its own, so that its memory is its own, and end it where it hangs."""
    process = multiprocessing.get_context("spawn").Process(target=what, args=args)
    process.start()
    process.join(PATIENCE_S)
    if process.exitcode is None:
        process.kill()
        print(f"{args}: not done after {PATIENCE_S} s")
    elif process.exitcode:
        print(f"{args}: ended with {process.exitcode}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("scenes", nargs="*", default=["relief", "glowing", "rubble"])
    parser.add_argument("--gi", nargs="+", default=WAYS)
    parser.add_argument("--side", type=int, default=SIDE, help="quads along the floor")
    parser.add_argument("--pieces", type=int, default=PIECES)
    parser.add_argument("--surfel", type=float, default=0.02)
    args = parser.parse_args()
    for name in args.scenes:
        path = write(name, args.out / name, args.side, args.pieces)
        for way in args.gi:
            in_a_process(draw, path, way, args.out / f"{name}-{way}.png", args.surfel)


if __name__ == "__main__":
    main()
