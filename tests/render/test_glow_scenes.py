"""The scenes whose glow lights other things: small, sound, and lit by what their names say."""

from __future__ import annotations

import numpy as np
import pytest

from phoslab.render import load_scene, render
from phoslab.sample_data import scene_occluder
from phoslab.sample_data.make_scenes import SCENES, WRITERS

GLOWING = ("cornell", "occluder", "confetti", "corridor", "lantern")


@pytest.mark.parametrize("name", GLOWING)
def test_the_scene_that_ships_is_the_one_that_its_module_writes(name, tmp_path):
    WRITERS[name](tmp_path)
    for file in ("scene.glb", "scene.toml"):
        assert (tmp_path / file).read_bytes() == (SCENES / name / file).read_bytes()


@pytest.mark.parametrize("name", GLOWING)
def test_it_is_small_and_without_a_warning_and_glows_at_each_of_its_times_in_the_dark(name):
    assert sum(path.stat().st_size for path in (SCENES / name).iterdir()) < 3e5
    scene = load_scene(SCENES / name)
    frames = render(scene, size=(64, 64), supersampling=1)
    assert frames.warnings == ()
    dark = [f for f in frames.frames if scene.schedule.dark_for_s(f.time_s) is not None]
    assert len(dark) >= 2
    for frame in dark:
        assert (frame.radiance.max(axis=-1) > 0).mean() > 0.01


def test_no_line_from_the_panel_enters_the_crate():
    """Every point of the panel lies behind the plane of the crate's back; its opening faces the other way."""
    (panel,) = (d for d in load_scene(SCENES / "occluder").drawables if d.name == "panel")
    assert (panel.geometry.positions[:, 2] < scene_occluder.LOW[2]).all()
    crate = [d for d in load_scene(SCENES / "occluder").drawables if d.name.startswith("crate")]
    corners = np.concatenate([d.geometry.positions for d in crate])
    np.testing.assert_allclose(corners.min(axis=0), scene_occluder.LOW, atol=1e-6)
    np.testing.assert_allclose(corners.max(axis=0), scene_occluder.HIGH, atol=1e-6)
