"""The scene `corridor`: sixteen metres of corridor with the glowing marks of an escape route."""

from __future__ import annotations

from pathlib import Path

from phoslab.sample_data.glb import GlbWriter
from phoslab.sample_data.shapes import box, panel

LENGTH, WIDTH, HEIGHT = 16.0, 2.0, 2.4
STRIP, OFF_WALL = 0.12, 0.004


def write(folder: Path) -> None:
    """Write the corridor, strips along its walls, a frame around the door at its end, and things in the way."""
    glb = GlbWriter()
    glb.camera("camera", eye=(0.15, 1.5, -0.3), target=(0.0, 1.05, -8.0), yfov_deg=52)
    for k, z in enumerate((-3.0, -8.0, -13.0)):
        glb.light(f"lamp-{k}", "point", (0.0, 2.3, z), (0.0, 2.3, z - 1.0))
    plaster, lino = glb.material((0.78, 0.78, 0.75)), glb.material((0.45, 0.47, 0.48))
    door, paint = glb.material((0.55, 0.42, 0.33)), glb.material((0.85, 0.88, 0.75))
    w, d = WIDTH / 2, LENGTH
    glb.mesh("floor", panel((-w, 0, 0), (WIDTH, 0, 0), (0, 0, -d)), lino)
    glb.mesh("ceiling", panel((-w, HEIGHT, -d), (WIDTH, 0, 0), (0, 0, d)), plaster)
    glb.mesh("left", panel((-w, 0, 0), (0, 0, -d), (0, HEIGHT, 0)), plaster)
    glb.mesh("right", panel((w, 0, -d), (0, 0, d), (0, HEIGHT, 0)), plaster)
    glb.mesh("end", panel((-w, 0, -d), (WIDTH, 0, 0), (0, HEIGHT, 0)), plaster)
    glb.mesh("door", box((-0.45, 0, -d), (0.45, 2.0, -d + 0.03)), door)
    glb.mesh("cupboard", box((-w, 0, -6.2), (-w + 0.45, 1.8, -5.2)), door)
    glb.mesh("crate", box((0.3, 0, -4.2), (0.8, 0.5, -3.7)), door)
    for name, y in (("low", 0.2), ("high", 1.0)):
        glb.mesh(f"left-{name}", panel((-w + OFF_WALL, y, 0), (0, 0, -d), (0, STRIP, 0)), paint)
        glb.mesh(f"right-{name}", panel((w - OFF_WALL, y, -d), (0, 0, d), (0, STRIP, 0)), paint)
    z = -d + 0.04
    glb.mesh("frame-left", panel((-0.6, 0, z), (STRIP, 0, 0), (0, 2.15, 0)), paint)
    glb.mesh("frame-right", panel((0.6 - STRIP, 0, z), (STRIP, 0, 0), (0, 2.15, 0)), paint)
    glb.mesh("frame-top", panel((-0.6, 2.15 - STRIP, z + 0.002), (1.2, 0, 0), (0, STRIP, 0)), paint)
    glb.save(folder / "scene.glb")
    (folder / "scene.toml").write_text(TOML, encoding="utf-8")


TOML = """\
# A corridor with glowing strips along its walls and around its door; the lamps fail after a minute.
# Made by phoslab.sample_data.make_scenes.
schema = "phoslab-scene/1"
gltf = "scene.glb"

[units]
system = "relative"
radiance_factor = 0.001

[lights.lamp-0]
spectrum = "blackbody:4000"
irradiance_at_1m = 1.0
schedule = [[0, 60]]

[lights.lamp-1]
spectrum = "blackbody:4000"
irradiance_at_1m = 1.0
schedule = [[0, 60]]

[lights.lamp-2]
spectrum = "blackbody:4000"
irradiance_at_1m = 1.0
schedule = [[0, 60]]

[phosphors]
left-low = { material = "preset:green", atlas_texels = 256 }
left-high = { material = "preset:green", atlas_texels = 256 }
right-low = { material = "preset:green", atlas_texels = 256 }
right-high = { material = "preset:green", atlas_texels = 256 }
frame-left = { material = "preset:yellow", atlas_texels = 64 }
frame-right = { material = "preset:yellow", atlas_texels = 64 }
frame-top = { material = "preset:yellow", atlas_texels = 64 }

[initial]
state = "empty"

[render]
size = [512, 512]
supersampling = 2
times = ["off-1s", "off+1s", "off+60s"]

[display]
exposures = [
  { from = "0", exposure = "auto" },
  { from = "off", exposure = "auto" },
  { from = "off+30s", exposure = "auto" },
]
"""
