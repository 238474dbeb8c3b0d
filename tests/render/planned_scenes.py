"""Scenes drawn at random, from a seed, to hold plans against the truth: rooms, materials, lamps, times and bounds.

None of the models of the planner are used to draw them: materials have rates over five decades, spectra of any shape.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.sample_data.glb import GlbWriter, place
from phoslab.sample_data.shapes import box, panel, sphere

EDGES = np.linspace(400, 700, 9).tolist()
LAMPS = ("blackbody:2700", "blackbody:6500", "illuminant:D65", "line:450,30", "line:520,40", "line:405,20")

WALLS = {
    "floor": ((-1, 0, 1), (2, 0, 0), (0, 0, -2)),
    "back": ((-1, 0, -1), (2, 0, 0), (0, 2, 0)),
    "left": ((-1, 0, 1), (0, 0, -2), (0, 2, 0)),
    "right": ((1, 0, -1), (0, 0, 2), (0, 2, 0)),
    "ceiling": ((-1, 2, -1), (2, 0, 0), (0, 0, 2)),
}


@dataclass(frozen=True)
class Drawn:
    """A scene, the one time at which it is looked at, and how wrong its picture may be."""

    folder: Path
    time: str
    bound: str


def draw(folder: Path, seed: int) -> Drawn:
    """Write the scene of a seed into a folder."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    glb = GlbWriter()
    glb.camera("camera", eye=(0.0, 1.0, 3.9), target=(0.0, 1.0, 0.0), yfov_deg=39)
    names = [*list(WALLS)[: int(rng.integers(1, len(WALLS) + 1))]]
    for name in names:
        glb.mesh(name, panel(*WALLS[name]), glb.material(rng.uniform(0.2, 0.8, 3).tolist()))
    for k in range(int(rng.integers(1, 4))):
        name = f"thing-{k}"
        at = (float(rng.uniform(-0.7, 0.7)), 0.0, float(rng.uniform(-0.6, 0.6)))
        size = float(rng.uniform(0.15, 0.45))
        shape = sphere(size) if rng.random() < 0.5 else box((-size, 0, -size), (size, 2 * size, size))
        glb.mesh(
            name,
            shape,
            glb.material(rng.uniform(0.2, 0.8, 3).tolist()),
            place(at, (0, float(rng.uniform(0, 90)), 0)),
        )
        names.append(name)
    lamps = [f"lamp-{k}" for k in range(int(rng.integers(1, 5)))]
    for lamp in lamps:
        eye = (float(rng.uniform(-0.9, 0.9)), float(rng.uniform(1.2, 1.9)), float(rng.uniform(0, 1.5)))
        glb.light(lamp, "point", eye, (0.0, 0.5, 0.0))
    glb.save(folder / "scene.glb")

    glowing = rng.permutation(names)[: int(rng.integers(1, min(6, len(names)) + 1))]
    for name in glowing:
        (folder / f"{name}.json").write_text(json.dumps(_material(str(name), rng)), encoding="utf-8")
    on_s = float(10 ** rng.uniform(0, 3))
    lit = rng.random() < 0.2
    time = f"off-{on_s / 2:.6g}s" if lit else f"off+{10 ** rng.uniform(-1, np.log10(6 * 3600)):.6g}s"
    lines = ['schema = "phoslab-scene/1"', 'gltf = "scene.glb"', "[units]", "radiance_factor = 1.0"]
    for lamp in lamps:
        lines += [
            f"[lights.{lamp}]",
            f'spectrum = "{rng.choice(LAMPS)}"',
            f"irradiance_at_1m = {10 ** rng.uniform(-1.5, 0.5):.6g}",
            f"schedule = [[0, {on_s:.6g}]]",
        ]
    lines += ["[phosphors]", *(f'{n} = {{ material = "{n}.json", atlas_texels = 128 }}' for n in glowing)]
    lines += ["[render]", "size = [64, 64]", "supersampling = 2", f'times = ["{time}"]']
    (folder / "scene.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return Drawn(folder, time, f"{10 ** rng.uniform(np.log10(0.5), 1):.2g}%")


def _material(name: str, rng: np.random.Generator) -> dict[str, Any]:
    n = int(rng.integers(1, 5))
    kr = np.sort(10 ** rng.uniform(-4.5, 0.5, n))[::-1]
    ke = rng.uniform(0.02, 0.3, n)[:, None] * _humps(rng, n, 400, 520)
    full = rng.uniform(0.2, 1.0, n)[:, None] * _humps(rng, n, 480, 640)
    return {
        "schema": "phoslab-material/1",
        "name": name,
        "band_edges_nm": EDGES,
        "kr_per_s": kr.tolist(),
        "ke_m2_per_J": (ke * 0.05).tolist(),
        "emission": full.tolist(),
        "calibration": "relative",
        "reference_irradiance": [1.0] * 8,
    }


def _humps(rng: np.random.Generator, n: int, low: float, high: float) -> NDArray[np.float64]:
    centres = (np.array(EDGES[1:]) + EDGES[:-1]) / 2
    middle, width = rng.uniform(low, high, (n, 1)), rng.uniform(25, 70, (n, 1))
    return np.asarray(np.exp(-(((centres - middle) / width) ** 2)))
