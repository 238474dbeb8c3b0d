"""The scene `fading`: a shelf of glow-in-the-dark things in different paints, and a lamp that goes off.

The situation of Nalbach 2017, Fig. 8.1.
"""

from __future__ import annotations

from pathlib import Path

from phoslab.sample_data.glb import GlbWriter, place
from phoslab.sample_data.shapes import (
    bevelled_cube,
    box,
    knot,
    lathe,
    moon,
    planks,
    sphere,
    star,
    sweep,
    torus,
)


def write(folder: Path) -> None:
    """Write nine things in nine materials."""
    glb = GlbWriter()
    glb.camera("camera", eye=(0.10, 1.02, 3.05), target=(0.02, 0.43, -0.35), yfov_deg=30)
    glb.light(
        "lamp", "spot", (-1.55, 2.35, 1.75), (0.05, 0.25, -0.15), innerConeAngle=0.32, outerConeAngle=0.75
    )
    glb.light("sky", "directional", (1.6, 2.2, 2.2), (0.0, 0.2, 0.0))

    floor = glb.material((1.0, 1.0, 1.0), planks(512, seed=7))
    stand = glb.material((0.42, 0.36, 0.33))
    glb.mesh("floor", sweep(width=9.0, depth=4.2, height=4.0, bend=0.5), floor, place((0, 0, 3.0)))
    glb.mesh("plinth", box((-0.34, 0.0, -0.86), (0.44, 0.24, -0.34)), stand)
    glb.mesh("step", box((0.58, 0.0, -0.62), (1.06, 0.12, -0.14)), stand)

    paint = {
        "blue": (0.72, 0.80, 0.86),
        "green": (0.84, 0.88, 0.74),
        "orange": (0.90, 0.66, 0.46),
        "pink": (0.90, 0.68, 0.74),
        "purple": (0.76, 0.68, 0.86),
        "red": (0.88, 0.56, 0.50),
        "white": (0.88, 0.87, 0.84),
        "yellow": (0.90, 0.88, 0.66),
        "fitted": (0.82, 0.86, 0.78),
    }
    number = {name: glb.material(colour) for name, colour in paint.items()}
    vase = [
        (0.0, 0.0), (0.085, 0.0), (0.105, 0.015), (0.150, 0.10), (0.155, 0.16), (0.115, 0.26),
        (0.060, 0.34), (0.052, 0.40), (0.075, 0.45), (0.082, 0.455), (0.070, 0.448), (0.040, 0.40), (0.0, 0.36),
    ]  # fmt: skip
    pawn = [
        (0.0, 0.0), (0.125, 0.0), (0.132, 0.02), (0.125, 0.045), (0.095, 0.06), (0.058, 0.11), (0.045, 0.20),
        (0.055, 0.235), (0.085, 0.245), (0.085, 0.255), (0.050, 0.268), (0.072, 0.305), (0.082, 0.345),
        (0.072, 0.385), (0.040, 0.415), (0.0, 0.423),
    ]  # fmt: skip
    cone = [
        (0.0, 0.0),
        (0.150, 0.0),
        (0.158, 0.008),
        (0.150, 0.030),
        (0.012, 0.400),
        (0.006, 0.408),
        (0.0, 0.410),
    ]
    glb.mesh("blue-ball", sphere(0.17), number["blue"], place((-0.72, 0.0, -0.30)))
    glb.mesh("green-ring", torus(0.165, 0.060), number["green"], place((-0.30, 0.0, 0.20)))
    glb.mesh("orange-cone", lathe(cone, crisp=True), number["orange"], place((0.50, 0.0, 0.10)))
    glb.mesh(
        "purple-cube", bevelled_cube(0.26, 0.035), number["purple"], place((0.14, 0.0, 0.12), (0, 32, 0))
    )
    glb.mesh("pink-vase", lathe(vase), number["pink"], place((-0.13, 0.24, -0.58)))
    glb.mesh("red-knot", knot(0.21, 0.046), number["red"], place((0.82, 0.12, -0.38), (0, -18, 0)))
    glb.mesh("white-moon", moon(0.20, 0.05), number["white"], place((-0.62, 0.87, -1.06), (0, 0, 205)))
    glb.mesh(
        "yellow-star", star(5, 0.20, 0.085, 0.05), number["yellow"], place((0.62, 0.84, -1.06), (0, 0, 12))
    )
    glb.mesh("fitted-pawn", lathe(pawn, crisp=True), number["fitted"], place((0.22, 0.24, -0.56)))
    glb.save(folder / "scene.glb")

    (folder / "scene.toml").write_text(TOML, encoding="utf-8")


TOML = """\
# Nine things in nine glow-in-the-dark materials, lit for twenty seconds, then left in the dark.
# Made by phoslab.sample_data.make_scenes.
schema = "phoslab-scene/1"
gltf = "scene.glb"

[units]
system = "relative"
# The presets' emission is relative: this much of the scene's radiance is one unit of theirs.
radiance_factor = 0.001

[lights.lamp]
spectrum = "blackbody:4500"
irradiance_at_1m = 0.8
schedule = [[0, 20]]

[lights.sky]
spectrum = "illuminant:D65"
irradiance_at_1m = 0.02
schedule = [[0, 20]]

[phosphors]
blue-ball.material = "preset:blue"
green-ring.material = "preset:green"
orange-cone.material = "preset:orange"
pink-vase.material = "preset:pink"
purple-cube.material = "preset:purple"
red-knot.material = "preset:red"
white-moon.material = "preset:white"
yellow-star.material = "preset:yellow"
# What `phoslab fit` made of the sample sessions. Its lamp is the one that was measured, in the unit of the presets'
# (of length 1 over the bands); its radiance is in the camera's unit, and the factor lets it start about as bright as
# the preset green.
fitted-pawn.material = "material.json"
fitted-pawn.irradiance_factor = 1.0
fitted-pawn.radiance_factor = 1.4e-8

[initial]
state = "empty"

[render]
size = [640, 480]
supersampling = 3
times = ["off-1s", "off+1s", "off+80s"]

[display]
# Lamp light and glow differ by orders of magnitude; the glow's exposure is kept, so that fading is seen.
exposures = [{ from = "0", exposure = "auto" }, { from = "off", exposure = "auto" }]
"""
