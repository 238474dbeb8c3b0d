"""The scene `lantern`: a lamp is carried past a glowing wall, and a cube leaves its shadow there."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from phoslab.sample_data.glb import GlbWriter
from phoslab.sample_data.shapes import box, panel

# How long the lamp is carried, in s; the cube goes on until later.
CARRIED_S, TURNED_S = 4.0, 8.0


def write(folder: Path) -> None:
    """Write a wall, a floor, a cube that turns and moves, and a lamp that is carried along."""
    glb = GlbWriter()
    glb.camera("camera", eye=(0.5, 1.1, 3.6), target=(0.0, 0.75, 0.0), yfov_deg=38)
    glb.light("lantern", "point", (0, 0, 0), (0, 0, -1))
    t = np.linspace(0.0, CARRIED_S, 9)
    swing = 0.08 * np.sin(2 * np.pi * t)
    path = np.column_stack([-1.3 + 2.6 * t / CARRIED_S, 1.15 + swing, np.full(t.size, 1.1)])
    glb.animate("lantern", translation=(t, path))
    white, paint, cube = glb.material((0.8, 0.8, 0.78)), glb.material((0.85, 0.88, 0.75)), (0.9, 0.8, 0.7)
    glb.mesh("floor", panel((-2, 0, 2), (4, 0, 0), (0, 0, -2)), white)
    glb.mesh("wall", panel((-2, 0, 0), (4, 0, 0), (0, 2, 0)), paint)
    glb.mesh("cube", box((-0.16, -0.16, -0.16), (0.16, 0.16, 0.16)), glb.material(cube))
    ends = np.array([0.0, TURNED_S])
    turn = np.linspace(0.0, TURNED_S, 5)
    half = np.pi * turn / TURNED_S
    glb.animate(
        "cube",
        translation=(ends, np.array([[0.7, 0.3, 0.4], [-0.8, 0.3, 0.4]])),
        rotation=(turn, np.column_stack([0 * half, np.sin(half), 0 * half, np.cos(half)])),
    )
    glb.save(folder / "scene.glb")
    (folder / "scene.toml").write_text(TOML, encoding="utf-8")


TOML = """\
# A lamp is carried past a glowing wall; a glowing cube turns before it and leaves its shadow there.
# Made by phoslab.sample_data.make_scenes.
schema = "phoslab-scene/1"
gltf = "scene.glb"

[units]
system = "relative"
radiance_factor = 0.001

[lights.lantern]
spectrum = "blackbody:4000"
irradiance_at_1m = 1.0
schedule = [[0, 4]]

[phosphors]
wall = { material = "preset:green", atlas_texels = 256 }
cube = { material = "preset:orange", atlas_texels = 128 }

[initial]
state = "empty"

[render]
size = [512, 384]
supersampling = 2
times = ["2", "off+0.5s", "off+4s"]

[display]
exposures = [{ from = "0", exposure = "auto" }, { from = "off", exposure = "auto" }]
"""
