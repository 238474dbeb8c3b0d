"""Trials of quick ways to transport glow, against what is known of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from phoslab.render import load_scene, path_tracer
from phoslab.render.glow_transport import TransportParameters
from phoslab.render.planning import planner as planning
from phoslab.render.planning.bounds import parse_bound
from phoslab.render.planning.costs import load_costs
from phoslab.render.planning.pilot import look
from phoslab.render.planning.planner import Planner, Request
from phoslab.render.planning.reduced import whole
from phoslab.render.planning.trial import (
    MIDDLE,
    ROUNDS,
    SIDE,
    WINDOWS,
    Trial,
    can_try,
    estimate,
    trial_size,
    windows,
)
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.render.tiles import TILE
from phoslab.sample_data.make_scenes import SCENES

BOUND, SIZE, AT = parse_bound("2%"), (192, 128), "off+1s"
THREE = (380.0, 480.0, 580.0, 780.0)
TILES = {"method": "tiles", "directions": 8}


@pytest.fixture(scope="module")
def cornell():
    scene = load_scene(SCENES / "cornell")
    edges = scene.transport.edges_nm
    few = tuple(float(edges[np.abs(edges - nm).argmin()]) for nm in THREE)
    plain = replace(whole(scene), bands_nm=(edges[0], *few[1:-1], edges[-1]))
    return plain, look(scene, [scene.schedule.parse_time(AT)], SIZE)


def tried(cornell, device, rounds, size=SIZE, **gi):
    plain, pilot = cornell
    quick = replace(plain, gi={**TILES, **gi})
    made = Trial(pilot, size, quick, device)
    for samples in rounds:
        made.follow(samples)
    return made.found(made.draw(quick))


def planned(scene, bound, device):
    moment = scene.schedule.parse_time(AT)
    return Planner(Request(scene, (512, 512), (AT,), (moment,), parse_bound(bound)), load_costs(), device)


def on_picture(window, camera, size, corners):
    """Return (n, 2) where corners of a window's picture, in its half sides, lie on the whole picture in pixels."""
    half = np.tan(window.yfov_rad / 2)
    away = np.column_stack([half * np.asarray(corners, float), -np.ones(len(corners))])
    away = away @ (camera.world_to_view[:3, :3] @ window.world_to_view[:3, :3].T).T
    focal = size[1] / 2 / np.tan(camera.yfov_rad / 2)
    return away[:, :2] / -away[:, 2:] * focal * [1, -1] + np.array(size) / 2


CORNERS = ((-1, 1), (1, 1), (1, -1), (-1, -1))


def test_windows_lie_in_the_picture_and_see_its_pixels_as_large_as_they_are():
    """From the upper left on, clockwise; a window covers as many pixels as it has: near the corners of a picture, where
    a pixel is seen aslant, to a few per cent."""
    camera = load_scene(SCENES / "cornell").camera
    found, (w, h) = windows(camera, SIZE)
    assert (w, h) == (SIDE, SIDE)
    assert len(found) == WINDOWS**2
    for k, window in enumerate(found):
        row, column = divmod(k, WINDOWS)
        points = on_picture(window, camera, SIZE, CORNERS)
        middle = points.mean(axis=0)
        np.testing.assert_allclose(points, middle + SIDE / 2 * np.array(CORNERS) * [1, -1], atol=0.15 * SIDE)
        assert (abs(middle / np.array(SIZE) * WINDOWS - np.array([column, row]) - 0.5) < 0.5).all()
        x, y = points.T
        area = 0.5 * abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1)))
        assert area == pytest.approx(SIDE**2, rel=0.05)


def test_what_is_compared_is_the_middle_of_what_is_drawn():
    """Windows are whole tiles, of which there are no parts then."""
    assert SIDE == TILE
    camera = load_scene(SCENES / "cornell").camera
    for drawn, compared in zip(windows(camera, SIZE)[0], windows(camera, SIZE, MIDDLE)[0], strict=True):
        np.testing.assert_array_equal(drawn.world_to_view, compared.world_to_view)
        assert np.tan(compared.yfov_rad / 2) / np.tan(drawn.yfov_rad / 2) == pytest.approx(MIDDLE / SIDE)


def test_a_small_picture_is_one_window(cornell, device):
    camera = load_scene(SCENES / "cornell").camera
    assert windows(camera, (64, 48)) == ([camera], (64, 48))
    assert trial_size((64, 48)) == (64, 48)
    assert trial_size((768, 512)) == (WINDOWS * SIDE, WINDOWS * SIDE)
    pytest.importorskip("mitsuba")
    found = tried(cornell, device, (16,), size=(7, 6))
    assert found is not None
    assert 0 < found.spread < np.inf


@pytest.mark.parametrize("variant", [path_tracer.SCALAR, path_tracer.LLVM])
def test_cameras_see_side_by_side_what_each_sees_alone(device, variant):
    """Glow that comes straight. Scalar paths begin anywhere in a pixel, which moves edges: a per cent."""
    pytest.importorskip("mitsuba")
    if variant != path_tracer.SCALAR and path_tracer.find_llvm() is None:
        pytest.skip("no LLVM")
    scene = load_scene(SCENES / "cornell")
    moment = scene.schedule.parse_time(AT)
    cameras = windows(scene.camera, SIZE)[0][1:64:9]
    n = len(cameras)

    def picture(some):
        renderer = Renderer(
            device,
            scene,
            RenderParameters((len(some) * SIDE, SIDE), 2, transport=TransportParameters("tiles")),
        )
        renderer.look_through(some)
        return renderer, renderer.frame(moment).radiance - renderer.reflected(moment)

    with device.scope():
        renderer, together = picture(cameras)
        alone = np.concatenate([picture([camera])[1] for camera in cameras], axis=1)
        np.testing.assert_allclose(together, alone, atol=1e-5 * alone.max())
        from phoslab.render.reference import Reference

        meshes = Reference(device, renderer.surroundings, TransportParameters("reference")).meshes()
    how = {"reflections": 0, "samples": 64, "grid": 2, "variant": variant}
    traced = path_tracer.trace(meshes, cameras, (SIDE, SIDE), **how)
    each = [path_tracer.trace(meshes, [camera], (SIDE, SIDE), **how) for camera in cameras]
    assert traced.shape == (SIDE, n * SIDE, scene.transport.n)
    within = 0.01 if variant == path_tracer.SCALAR else 1e-6
    assert np.abs(traced - np.concatenate(each, axis=1)).mean() < within * traced.mean()
    # A texel is nearest there and bilinear here.
    assert np.abs(traced - together).mean() < 0.02 * traced.mean()


@pytest.mark.parametrize("lit", [64, 20])
def test_an_estimate_lies_within_its_standard_errors(lit):
    """Errors and noise that differ from window to window, as light does. 97.5 % of draws exceed two on either side; of
    300, 94 % are four standard errors below. What is unlike makes the error look larger, not smaller."""
    rng = np.random.default_rng(1)
    light, off, noisy = (rng.lognormal(0, 0.4, 64) for _ in range(3))
    light[lit:] = 0.0
    truth = np.repeat(light[:, None], 64, axis=1)

    def draw(parts):
        error = 0.03 * (truth * off[:, None])[parts] * rng.standard_normal((64, 64))
        one, other = (
            truth[parts] * (1 + 0.06 * noisy[parts, None] * rng.standard_normal((64, 64))) for _ in range(2)
        )
        return estimate(truth[parts] + error, one, other)

    want = (0.03 * np.sqrt(2 / np.pi) * (light * off).sum() / light.sum()) ** 2
    found = [draw(rng.integers(0, 64, 64)) for _ in range(300)]
    found = [f for f in found if f is not None]
    assert len(found) > 100
    assert np.mean([f.at_most**2 > want for f in found]) > 0.94
    assert np.mean([f.at_least**2 < want for f in found]) > 0.94
    assert np.median([f.spread for f in found]) < want


@pytest.mark.parametrize("lit", [0, 1, 10])
def test_of_light_that_few_windows_see_nothing_is_told(lit):
    light = np.zeros((64, 16))
    light[:lit] = 1.0
    assert estimate(light, light, light) is None


def test_an_estimate_is_never_surer_than_its_spread():
    """However much noise was taken off."""
    rng = np.random.default_rng(2)
    for _ in range(50):
        one, other = (1 + 0.5 * rng.standard_normal((64, 4)) for _ in range(2))
        found = estimate((one + other) / 2, one, other)
        assert found.square < 0
        assert found.at_most >= np.sqrt(2 * found.spread)
        assert found.at_least == 0.0


def test_light_that_a_way_loses_is_found(cornell, device, monkeypatch):
    """A fifth; the rest is right within the error of tiles."""
    pytest.importorskip("mitsuba")
    right = tried(cornell, device, ROUNDS[:2], directions=64, bounces=2)
    monkeypatch.setattr(
        Renderer,
        "reflected",
        lambda self, t, reflected=Renderer.reflected: np.float32(0.8) * reflected(self, t),
    )
    dark = tried(cornell, device, ROUNDS[:2], directions=64, bounces=2)
    assert right.at_most < 0.1
    assert dark.square**0.5 == pytest.approx(0.2, abs=right.at_most)


def test_more_paths_leave_less_open(cornell, device):
    pytest.importorskip("mitsuba")
    coarse, fine = (tried(cornell, device, rounds, bounces=2) for rounds in ((16,), (16, 64, 256)))
    assert coarse.at_least < fine.square**0.5 < coarse.at_most
    assert fine.spread < 0.7 * coarse.spread
    assert fine.noise < 0.5 * coarse.noise


def test_where_paths_take_long_what_is_quicker_is_tried_and_counts_as_it_does_here(cornell, device):
    pytest.importorskip("mitsuba")
    scene = cornell[1].scene
    planner = planned(scene, "2%", device)
    chosen, holds = planner.choose()
    assert holds
    rival = planner.rival(chosen) if chosen.gi["method"] == "reference" else chosen
    assert rival.gi["method"] == "tiles"
    assert planner.was_tried(rival.gi)
    other = planned(scene, "2%", device)
    elsewhere, here = other.way(rival.gi), planner.way(rival.gi)
    assert not other.was_tried(rival.gi)
    assert here.left_out == elsewhere.left_out
    assert here.error < elsewhere.error  # of the trade the worst scene counts, which cornell is not
    paths = {"method": "reference", "samples": 361, "full": True}
    assert not planner.try_quicker(replace(chosen, gi=paths))


def test_what_is_not_seen_in_the_windows_is_not_taken_to_be_right(cornell, device, monkeypatch):
    """Windows beside all that is lit: nothing is known, and paths are traced."""
    pytest.importorskip("mitsuba")
    scene = cornell[1].scene
    near = planning.Trial

    class Elsewhere(near):
        def __init__(self, *args):
            super().__init__(*args)
            turned = [
                replace(c, world_to_view=np.diag([-1.0, 1, -1, 1]) @ c.world_to_view) for c in self._cameras
            ]
            self._cameras, self._wide = turned, turned

    monkeypatch.setattr(planning, "Trial", Elsewhere)
    planner = planned(scene, "1%", device)
    chosen, _ = planner.choose()
    assert chosen.gi["method"] == "reference"
    assert not planner.was_tried(planner.rival(chosen).gi)


@pytest.mark.parametrize(("bound", "rounds", "ways"), [("0.1%", 2, 2), ("4%", 1, 1)])
def test_a_trial_ends_when_it_is_known_whether_a_way_will_do(
    cornell, device, monkeypatch, bound, rounds, ways
):
    """A bound that is far from what tiles err by takes few rounds, and the finest tiles where others will not do."""
    pytest.importorskip("mitsuba")
    followed, drawn = [], []
    follow, draw = Trial.follow, Trial.draw
    monkeypatch.setattr(Trial, "follow", lambda self, n: (followed.append(n), follow(self, n)))
    monkeypatch.setattr(Trial, "draw", lambda self, quick: (drawn.append(quick.gi), draw(self, quick))[1])
    planner = planned(cornell[1].scene, bound, device)
    paths = {"method": "reference", "samples": 65536, "full": True}
    assert planner.try_quicker(replace(cornell[0], gi=paths))
    assert 1 <= len(followed) <= rounds
    assert len(drawn) == ways
    assert all(planner.was_tried(gi) for gi in drawn)


def test_a_trial_ends_when_more_paths_tell_no_more(cornell, device, monkeypatch):
    pytest.importorskip("mitsuba")
    monkeypatch.setattr(planning, "NO_SURER", 1e-9)
    followed = []
    follow = Trial.follow
    monkeypatch.setattr(Trial, "follow", lambda self, n: (followed.append(n), follow(self, n)))
    planner = planned(cornell[1].scene, "1%", device)
    paths = {"method": "reference", "samples": 65536, "full": True}
    planner.try_quicker(replace(cornell[0], gi=paths))
    assert followed == [*ROUNDS[:2]]  # of the first, nothing is known to be surer than


def test_what_windows_cannot_show_is_not_tried():
    assert can_try({"method": "tiles"})
    assert not can_try({"method": "tiles", "filter_px": 8})
    assert not can_try({"method": "dss-z"})
