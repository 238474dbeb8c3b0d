"""The scene `confetti`: many small triangles, in a glowing knot and in scraps of paper around it."""

from __future__ import annotations

from pathlib import Path

from phoslab.sample_data.glb import GlbWriter, place
from phoslab.sample_data.shapes import knot, panel, scraps


def write(folder: Path, *, charged: bool = False) -> None:
    """Write a corner of a room, a knot of 8000 triangles, and 1400 scraps that fall, some of which glow.

    Args:
        charged: not saturated, but by a lamp that stands near and goes off after a minute, so that no two texels
            glow alike; and with 2400 scraps.
    """
    glb = GlbWriter()
    glb.camera("camera", eye=(0.0, 1.05, 3.0), target=(0.0, 0.55, 0.0), yfov_deg=36)
    if charged:
        glb.light("lamp", "point", (0.7, 1.5, 0.6), (0.0, 0.5, -0.2))
    white, paper = glb.material((0.8, 0.8, 0.78)), glb.material((0.85, 0.83, 0.78))
    glb.mesh("floor", panel((-1.5, 0, 1.5), (3, 0, 0), (0, 0, -2.5)), white)
    glb.mesh("back", panel((-1.5, 0, -1.0), (3, 0, 0), (0, 2, 0)), white)
    glb.mesh("knot", knot(0.4, 0.085), white, place((0.0, 0.08, -0.2), (0, 20, 0)))
    n, glowing = (1700, 700) if charged else (1000, 400)
    glb.mesh("scraps", scraps(n, 0.05, (-1.4, 0.03, -0.95), (1.4, 1.6, 0.6), seed=11), paper)
    glb.mesh("glowing-scraps", scraps(glowing, 0.05, (-1.4, 0.03, -0.95), (1.4, 1.6, 0.6), seed=12), paper)
    glb.save(folder / "scene.glb")
    (lamp, state, times) = (
        (LAMP, "empty", '"off+1s", "off+20s"') if charged else ("", "saturated", '"0", "20"')
    )
    text = TOML.format(lamp=lamp, state=state, times=times)
    (folder / "scene.toml").write_text(text, encoding="utf-8")


LAMP = """\
[lights.lamp]
spectrum = "blackbody:4000"
irradiance_at_1m = 1.0
schedule = [[0, 60]]

"""

TOML = """\
# A glowing knot of small triangles, and scraps of paper that fall around it, some of which glow.
# Made by phoslab.sample_data.make_scenes.
schema = "phoslab-scene/1"
gltf = "scene.glb"

[units]
system = "relative"
radiance_factor = 0.001

{lamp}[phosphors]
knot.material = "preset:green"
knot.atlas_texels = 256
glowing-scraps.material = "preset:orange"
glowing-scraps.atlas_texels = 256

[initial]
state = "{state}"

[render]
size = [512, 512]
supersampling = 2
times = [{times}]
"""
