"""The scene `cornell`: the Cornell box with phosphorescent red and blue walls (Nalbach 2017, Fig. 8.15)."""

from __future__ import annotations

from pathlib import Path

from phoslab.sample_data.glb import GlbWriter, place
from phoslab.sample_data.shapes import box, panel


def write(folder: Path) -> None:
    """Write a room of 2 m, open to the camera, with two boxes in it."""
    glb = GlbWriter()
    glb.camera("camera", eye=(0.0, 1.0, 3.9), target=(0.0, 1.0, 0.0), yfov_deg=39)
    glb.light("lamp", "point", (0.0, 1.8, 0.1), (0.0, 1.8, -1.0))
    white, red, blue = (glb.material(c) for c in ((0.75, 0.75, 0.73), (0.75, 0.45, 0.42), (0.42, 0.50, 0.75)))
    glb.mesh("floor", panel((-1, 0, 1), (2, 0, 0), (0, 0, -2)), white)
    glb.mesh("ceiling", panel((-1, 2, -1), (2, 0, 0), (0, 0, 2)), white)
    glb.mesh("back", panel((-1, 0, -1), (2, 0, 0), (0, 2, 0)), white)
    glb.mesh("red-wall", panel((-1, 0, 1), (0, 0, -2), (0, 2, 0)), red)
    glb.mesh("blue-wall", panel((1, 0, -1), (0, 0, 2), (0, 2, 0)), blue)
    glb.mesh("tall-box", box((-0.3, 0, -0.3), (0.3, 1.2, 0.3)), white, place((-0.36, 0, -0.34), (0, 17, 0)))
    glb.mesh("short-box", box((-0.3, 0, -0.3), (0.3, 0.6, 0.3)), white, place((0.36, 0, 0.34), (0, -18, 0)))
    glb.save(folder / "scene.glb")
    (folder / "scene.toml").write_text(TOML, encoding="utf-8")


TOML = """\
# The Cornell box with phosphorescent red and blue walls, lit for twenty seconds, then left in the dark.
# Made by phoslab.sample_data.make_scenes.
schema = "phoslab-scene/1"
gltf = "scene.glb"

[units]
system = "relative"
radiance_factor = 0.001

[lights.lamp]
spectrum = "blackbody:4500"
irradiance_at_1m = 0.5
schedule = [[0, 20]]

[phosphors]
red-wall.material = "preset:red"
red-wall.atlas_texels = 256
blue-wall.material = "preset:blue"
blue-wall.atlas_texels = 256

[initial]
state = "empty"

[render]
size = [512, 512]
supersampling = 2
times = ["off-1s", "off+1s", "off+20s"]

[display]
exposures = [{ from = "0", exposure = "auto" }, { from = "off", exposure = "auto" }]
"""
