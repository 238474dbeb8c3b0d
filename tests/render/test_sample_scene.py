"""The scene that ships: nine materials that glow at once and fade differently."""

from __future__ import annotations

import numpy as np
import pytest

from phoslab.colorimetry import display_srgb
from phoslab.render import load_scene
from phoslab.render.device import Device
from phoslab.render.frames import auto_exposure
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.sample_data.make_scenes import SCENES

TIMES = ("off-1s", "off+1s", "off+80s")


@pytest.fixture(scope="module")
def seen():
    """Display value of the brightest pixel of each phosphor, by time and name, and the lit picture."""
    scene = load_scene(SCENES / "fading")
    with Device() as device:
        renderer = Renderer(device, scene, RenderParameters((160, 120), 1))
        frames = [renderer.frame(scene.schedule.parse_time(t), t) for t in TIMES]
        boxes = {
            d.drawable.name: rectangle
            for d, rectangle in zip(renderer.drawables, renderer.gbuffer.rectangles, strict=True)
            if d.material is not None
        }
    exposures = (auto_exposure(frames[0].xyz), *[auto_exposure(frames[1].xyz)] * 2)
    pictures = [display_srgb(f.xyz, e)[::-1] for f, e in zip(frames, exposures, strict=True)]
    brightest = {
        t: {name: picture[y : y + h, x : x + w].max() for name, (x, y, w, h) in boxes.items()}
        for t, picture in zip(TIMES, pictures, strict=True)
    }
    return brightest, pictures[0], [f.warnings for f in frames]


def test_it_is_small_and_sound(seen):
    assert sum(path.stat().st_size for path in (SCENES / "fading").iterdir()) < 2e6
    assert seen[2] == [(), (), ()]


def test_lit_picture_is_neither_dark_nor_burnt_out(seen):
    assert 0.3 < np.median(seen[1]) < 0.8
    assert (seen[1].min(axis=-1) >= 0.999).mean() < 0.01


def test_every_material_glows_visibly_one_second_after(seen):
    assert len(seen[0]["off+1s"]) == 9
    assert min(seen[0]["off+1s"].values()) > 0.25


def test_materials_fade_differently(seen):
    """After 80 s the paints of 0.23 and 0.25 1/s are gone, those of 0.015 still bright, the others in between."""
    late = seen[0]["off+80s"]
    assert late["orange-cone"] > 0.4
    assert late["red-knot"] > 0.3
    assert 0.05 < late["blue-ball"] < 0.6
    assert 0.05 < late["fitted-pawn"] < 0.6
