"""The scene `occluder`: an open crate turned away from what glows, so that its inside must stay dark.

The situation of Nalbach 2017, Fig. 6.5: no line from the glowing panel enters the crate.
"""

from __future__ import annotations

from pathlib import Path

from phoslab.sample_data.glb import GlbWriter
from phoslab.sample_data.shapes import box, panel

# The crate's outside, and how thick its walls are, in m.
LOW, HIGH, WALL = (-0.55, 0.0, -0.35), (0.55, 0.7, 0.35), 0.03


def write(folder: Path) -> None:
    """Write a floor, a panel that glows behind, and a crate that is open in front."""
    glb = GlbWriter()
    glb.camera("camera", eye=(0.9, 1.5, 2.9), target=(0.0, 0.35, -0.1), yfov_deg=36)
    white, wood = glb.material((0.8, 0.8, 0.78)), glb.material((0.72, 0.62, 0.5))
    glb.mesh("floor", panel((-3, 0, 3), (6, 0, 0), (0, 0, -6)), white)
    glb.mesh("panel", panel((-1.1, 0.05, -1.0), (2.2, 0, 0), (0, 1.3, 0)), white)
    (x0, y0, z0), (x1, y1, z1) = LOW, HIGH
    for name, low, high in (
        ("crate-back", (x0, y0, z0), (x1, y1, z0 + WALL)),
        ("crate-top", (x0, y1 - WALL, z0 + WALL), (x1, y1, z1)),
        ("crate-left", (x0, y0, z0 + WALL), (x0 + WALL, y1 - WALL, z1)),
        ("crate-right", (x1 - WALL, y0, z0 + WALL), (x1, y1 - WALL, z1)),
    ):
        glb.mesh(name, box(low, high), wood)
    glb.save(folder / "scene.glb")
    (folder / "scene.toml").write_text(TOML, encoding="utf-8")


TOML = """\
# A crate that is open in front, and a glowing panel behind it: no glow reaches its inside.
# Made by phoslab.sample_data.make_scenes.
schema = "phoslab-scene/1"
gltf = "scene.glb"

[units]
system = "relative"
radiance_factor = 0.001

[phosphors.panel]
material = "preset:green"
atlas_texels = 128

[initial]
state = "saturated"

[render]
size = [512, 512]
supersampling = 2
times = ["0", "60"]

[display]
exposures = [{ from = "0", exposure = "auto" }, { from = "30", exposure = "auto" }]
"""
