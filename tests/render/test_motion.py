"""Things that move: where they are, what light they catch on the way, and pictures that do not depend on each other."""

from __future__ import annotations

import numpy as np
import pytest

import phoslab
from phoslab import kinetics
from phoslab.render import TransportParameters, load_scene, render
from phoslab.render.atlas_geometry import AtlasGeometry
from phoslab.render.gbuffer import GBuffer
from phoslab.render.motion import CUBIC, Channel
from phoslab.render.phosphor_state import Stepping
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.render.tiles import Tiles

FLOAT32 = 64 * 2.0**-24
FROM, TO = (-0.4, 0.0, 1.0), (0.4, 0.0, 1.0)


@pytest.fixture
def carried(quad, lamp_toml, green_toml):
    """The quad, and a lamp that is carried along it during the first 2 of its 10 s of light."""
    quad.lamp(FROM).animate("lamp", "translation", [0, 2], [FROM, TO])
    return quad.text(lamp_toml + green_toml)


def state_at(device, path, t_s: float, step_s: float) -> np.ndarray:
    scene = load_scene(path)
    with device.scope():
        renderer = Renderer(device, scene, RenderParameters((8, 8), 1, Stepping(step_s=step_s)))
        renderer.frame(t_s)
        return renderer.states[0].shown.read().astype(np.float64)


def by_hand(light, steps, t_s: float = 4.0) -> np.ndarray:
    """The float64 state at `t_s`: `steps` steps under the lamp where it is in their middle, then the lamp at rest."""
    centre = (np.arange(64) + 0.5) / 64 - 0.5
    x, y = np.meshgrid(centre, centre)
    r = np.zeros((64, 64, 1))
    for k in range(steps + 1):
        at, dt = (-0.4 + 0.8 * (k + 0.5) / steps, 2 / steps) if k < steps else (0.4, t_s - 2)
        E = ((x - at) ** 2 + y**2 + 1.0)[..., None] ** -1.5 * light.irradiance_at_1m
        r = kinetics.advance(phoslab.preset("green"), r, E, dt)
    return r


def test_a_lamp_that_is_carried_charges_what_it_passes(carried, device):
    """Each step under the light of its middle, as in float64; 8 steps and one at rest, each of some 16 roundings."""
    path = carried.write()
    want = by_hand(load_scene(path).lights[0], 8)
    np.testing.assert_allclose(state_at(device, path, 4.0, 0.25), want, rtol=9 * FLOAT32)


def test_the_error_of_a_step_falls_with_its_square(carried, device):
    path = carried.write()
    truth = by_hand(load_scene(path).lights[0], 2000)
    coarse, fine = (np.abs(state_at(device, path, 4.0, step) - truth).max() for step in (0.5, 0.25))
    # The next order of the midpoint rule is the fourth: some per cent here.
    assert coarse / fine == pytest.approx(4, rel=0.1)


def test_a_picture_in_motion_does_not_depend_on_which_came_before(carried):
    scene = load_scene(carried.write())
    film = render(scene, [*np.linspace(0.0, 3.0, 14)], size=(8, 8), step_s=0.1)
    alone = render(scene, [film[9].time_s, film[5].time_s], size=(8, 8), step_s=0.1)
    assert (film[9].radiance == alone[0].radiance).all()
    assert (film[5].radiance == alone[1].radiance).all()


def test_after_the_last_key_and_in_the_dark_no_step_is_taken(carried, device, monkeypatch):
    from phoslab.render.phosphor_state import PhosphorState

    excited = []
    excite = PhosphorState.excite
    monkeypatch.setattr(PhosphorState, "excite", lambda self, *a: (excited.append(1), excite(self, *a)))
    renderer = Renderer(
        device, load_scene(carried.write()), RenderParameters((8, 8), 1, Stepping(step_s=0.25))
    )
    renderer.frame(1e6)
    assert len(excited) == 1 + 8 + 1  # at first, on the way, at rest


def test_a_lamp_that_moves_alone_asks_for_no_new_view(carried, device, monkeypatch):
    """Pictures are those of a renderer that drew none before."""
    scene, transport = load_scene(carried.write()), TransportParameters("tiles", directions=2)
    parameters = RenderParameters((8, 8), 1, Stepping(step_s=0.25), transport)
    drawn = []
    for part, name in ((GBuffer, "run"), (AtlasGeometry, "run"), (Tiles, "prepare")):
        run = getattr(part, name)
        monkeypatch.setattr(part, name, lambda self, *a, run=run: (drawn.append(run), run(self, *a))[1])
    with device.scope():
        renderer = Renderer(device, scene, parameters)
        last = [renderer.frame(t).radiance for t in (0.1, 0.9, 1.7)][-1]
    assert len(drawn) == 3
    with device.scope():
        np.testing.assert_array_equal(last, Renderer(device, scene, parameters).frame(1.7).radiance)


def test_a_shadow_that_moved_away_stays_on_the_wall(quad, device, lamp_toml, green_toml):
    """A card goes out of the light after half of it: what it hid is charged half as long."""
    card = np.array([[-0.1, -0.1, 0.0], [0.1, -0.1, 0.0], [0.1, 0.1, 0.0], [-0.1, 0.1, 0.0]])
    quad.mesh("card", card, translation=[0, 0, 0.05])
    quad.animate("card", "translation", [0, 5, 5.0001], [[0, 0, 0.05], [0, 0, 0.05], [5, 0, 0.05]], "STEP")
    quad.lamp((0, 0, 20)).text(lamp_toml.replace("= 2.0", "= 40.0") + green_toml)
    r = state_at(device, quad.write(), 10.0, 0.5)[..., 0]
    green, light = phoslab.preset("green"), load_scene(quad.write()).lights[0]
    hidden, lit = (kinetics.advance(green, [0.0], light.irradiance_at_1m / 400, t)[0] for t in (5.0, 10.0))
    assert r[32, 32] == pytest.approx(hidden, rel=1e-3)  # the cosine and distance at 20 m
    assert r[4, 4] == pytest.approx(lit, rel=2e-3)


def test_a_camera_that_moves_changes_what_is_seen_and_no_state(quad, device, lamp_toml, green_toml):
    quad.lamp().text(lamp_toml + green_toml)
    still = render(quad.write(), ["2"], size=(16, 16), device=device)[0].radiance
    quad.animate("camera", "translation", [0, 2], [[0, 0, 2], [0, 0, 4]])
    path = quad.write()
    moved = render(path, ["0.001", "2"], size=(16, 16), device=device)
    np.testing.assert_allclose(state_at(device, path, 2.0, 1 / 60), by_lamp(path, 2.0), rtol=FLOAT32)
    assert (moved[1].radiance[8, 1] == 0).all()  # beside the quad, which is half as large now
    assert (still[8, 1] > 0).any()


def by_lamp(path, t_s: float) -> np.ndarray:
    centre = (np.arange(64) + 0.5) / 64 - 0.5
    x, y = np.meshgrid(centre, centre)
    E = 2 * (x**2 + y**2 + 4.0)[..., None] ** -1.5 * load_scene(path).lights[0].irradiance_at_1m
    return kinetics.advance(phoslab.preset("green"), np.zeros((64, 64, 1)), E, t_s)


def test_glow_follows_what_moves(build, rooms):
    """The form factor of two disks, after one of them has come to its place."""
    rooms.facing_disks(build)
    build.animate("sender", "translation", [0, 1], [[0, 0, 2], [0, 0, 0]])
    tiles = TransportParameters("tiles", directions=16)
    frames = render(build.write(), ["0.5", "1"], size=(32, 32), supersampling=1, transport=tiles)
    faded = np.exp(-0.5 * 1.0)
    L = frames[1].radiance
    seen = L[L.max(axis=-1) > 0].mean(axis=0)
    np.testing.assert_allclose(seen, rooms.form_factor() * faded * np.array([1.0, 2.0, 4.0]), rtol=0.005)
    assert frames[0].radiance.max() < L.max()


def test_a_turn_takes_the_shorter_way_at_constant_speed():
    q = np.array([[0, 0, 0, 1.0], [0, 0, -np.sin(np.pi / 4), -np.cos(np.pi / 4)]])
    for s in (0.25, 0.5):
        np.testing.assert_allclose(
            Channel("rotation", np.array([0.0, 1.0]), q).at(s),
            [0, 0, np.sin(np.pi / 4 * s), np.cos(np.pi / 4 * s)],
            atol=1e-12,
        )


def test_a_cubic_spline_passes_its_keys_with_their_tangents():
    """t³ on [0, 2] is its own spline."""
    t = np.array([0.0, 2.0])
    keys = np.array([[[3 * s**2], [s**3], [3 * s**2]] for s in t])
    channel = Channel("scale", t, keys, CUBIC)
    np.testing.assert_allclose([channel.at(s)[0] for s in (0, 0.5, 1.3, 2, 9)], [0, 0.125, 2.197, 8, 8])


@pytest.mark.parametrize(
    ("path", "times", "values", "says"),
    [
        ("translation", [1, 0], [FROM, TO], "do not ascend"),
        ("translation", [0, np.nan], [FROM, TO], "is not finite"),
        ("translation", [0], [FROM, TO], "has not one translation a key"),
        ("scale", [0, 1], [[1, 1, 1], [0, 1, 1]], "scaled to nothing at 1 s"),
        ("translation", [0, 1], [FROM, [1e12, 0, 0]], "farther than 1e+09 m at "),
        ("rotation", [0, 1], [[0, 0, 0, 1], [0, 0, 0, 0]], "a rotation of no length"),
    ],
)
def test_a_motion_that_makes_no_sense_is_refused(
    quad, lamp_toml, green_toml, refuses, path, times, values, says
):
    quad.lamp().animate("quad", path, times, values).text(lamp_toml + green_toml)
    assert says in refuses(render, quad.write(), ["1"], size=(8, 8), step_s=0.5)
