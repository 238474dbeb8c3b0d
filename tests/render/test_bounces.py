"""Light that goes from surface to surface before it is seen, and charges what no lamp reaches."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from phoslab.render import TransportParameters, load_scene, render
from phoslab.render.cell_light import CellLight
from phoslab.render.device import read_texture
from phoslab.render.phosphor_state import Stepping
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.sample_data.make_scenes import SCENES


def tiles(path, size, times=("0",), step_s=0.25, **parameters):
    transport = TransportParameters("tiles", **parameters)
    return render(path, [*times], size=size, supersampling=1, transport=transport, step_s=step_s)


@pytest.mark.parametrize("bounces", [2, 3])
def test_closed_box_reads_one_minus_a_power_of_two(build, rooms, bounces):
    """Albedo and emission 0.5: every ray meets the same radiance, so that only float32 is left to differ."""
    L = tiles(rooms.closed_box(build).write(), (24, 24), bounces=bounces, guided=0.0)[0].radiance
    np.testing.assert_allclose(L, 1 - 0.5 ** (bounces + 1), rtol=1e-5)


@pytest.mark.parametrize(("method", "within"), [("dss", 0.02), ("dss-z", 0.05)])
def test_surfels_send_on_what_cells_reflect(build, rooms, method, within):
    """The closed box of albedo and emission 0.5 after two and three reflections: what the last one misses, as after one
    (corners nearer than a disk's radius; holes between disks), and nothing more."""
    path = rooms.closed_box(build).write()
    for bounces in (2, 3):
        transport = TransportParameters(method, bounces=bounces, cell=0.1)
        L = render(path, ["0"], size=(64, 64), supersampling=1, transport=transport)[0].radiance
        assert L.mean() == pytest.approx(1 - 0.5 ** (bounces + 1), rel=within)


@pytest.mark.skipif(importlib.util.find_spec("mitsuba") is None, reason="needs phoslab[reference]")
def test_two_bounces_agree_with_the_path_tracer(tmp_path):
    """What the second reflection adds in the Cornell box, as a share of what the first does, on the picture's mean.
    With a filter: the fewer pixels look in directions of their own, the more is the error of these that of all.

    96² pixels x 256 paths, whose light has a deviation of some 5 times its mean, leave 0.3 % in each of two sums: three
    of both are 1.4 %. The first reflection is off by 1.4 % at this size, and 1.5 % are left for the second to be.
    """
    toml = (SCENES / "cornell" / "scene.toml").read_text(encoding="utf-8")
    (tmp_path / "scene.toml").write_text(toml.replace("[render]\n", "[render]\nbands_nm = [400, 550, 700]\n"))
    (tmp_path / "scene.glb").write_bytes((SCENES / "cornell" / "scene.glb").read_bytes())
    added = {}
    for method in ("tiles", "reference"):
        none, one, two = (
            render(
                tmp_path,
                ["off+1s"],
                size=(96, 96),
                supersampling=1,
                transport=TransportParameters(
                    method if n else "none", bounces=n or 1, samples=256, directions=32, filter_px=4
                ),
            )[0].radiance.mean(axis=(0, 1))
            for n in (0, 1, 2)
        )
        added[method] = (two - one) / (one - none)
    np.testing.assert_allclose(added["tiles"], added["reference"], rtol=0.03)


def lit_state(device, path, t_s, step_s=1.0, method="tiles", **parameters):
    transport = TransportParameters(method, directions=2, **parameters)
    p = RenderParameters((8, 8), 1, Stepping(step_s=step_s), transport)
    renderer = Renderer(device, load_scene(path), p)
    renderer.frame(t_s)
    return renderer


def excitation_in_front(rooms) -> float:
    """a, in 1/s, that the sender of 0.01 gives the middle of the disk before it: ke π L sin² of a band of 100 nm."""
    return float(np.pi * rooms.SENDER**2 / (rooms.SENDER**2 + rooms.APART**2))


@pytest.fixture
def exciting(build, rooms):
    """Two disks that face each other; the saturated sender's first band excites the receiver, which is empty."""
    rooms.facing_disks(build)
    rooms.write_material(build, "sender", [0.01, 0.02, 0.04], [0.0] * 3)
    toml = rooms.write_material(build, "receiver", [0.0] * 3, [0.0] * 3, kr=0.01)
    build.text(toml.replace("atlas_texels = 64", 'atlas_texels = 64\ninitial = { state = "empty" }'))
    # Few texels: each has 256 rays.
    build.toml = build.toml.replace("atlas_texels = 64", "atlas_texels = 12")
    return build


def at_middle(state) -> float:
    """The mean state near the middle of the receiver."""
    position = read_texture(state.atlas.position_w)
    near = (position[..., 3] > 0) & (np.hypot(position[..., 0], position[..., 1]) < 0.1)
    return float(state.shown.read()[near, 0].mean())


def test_glow_charges_what_no_lamp_reaches(exciting, device, rooms):
    """r' = (1 - r) E exp(-kr t) - kr r, by quadrature; 3 %: 256 even rays, of which a third meet the sender, are off
    by some 1 % each and less on the mean of the texels; the step of 1/32 s by 1.6 % of the sender's fading."""
    renderer = lit_state(device, exciting.write(), 1.0, 1 / 32, excites=True)
    r, n = 0.0, 4000
    for k in range(n):
        t = (k + 0.5) / n
        r += ((1 - r) * excitation_in_front(rooms) * np.exp(-0.5 * t) - 0.01 * r) / n
    sender, receiver = sorted(renderer.states, key=lambda s: s.drawable.drawable.name, reverse=True)
    assert at_middle(receiver) == pytest.approx(r, rel=0.03)
    # The sender gets nothing back: the receiver gives off nothing.
    np.testing.assert_allclose(sender.shown.read().max(), np.exp(-0.5), rtol=1e-5)


def test_the_error_of_glow_that_excites_falls_with_the_step(exciting, device):
    states = []
    for step in (0.5, 0.25, 0.125):
        with device.scope():
            states.append(at_middle(lit_state(device, exciting.write(), 1.0, step, excites=True).states[-1]))
    # First order: against 1/8 s, whose error is of that order too, 0.5 s is three times as far off as 0.25 s.
    assert (states[0] - states[2]) / (states[1] - states[2]) == pytest.approx(3, rel=0.1)


def test_without_it_glow_charges_nothing(exciting, device):
    assert at_middle(lit_state(device, exciting.write(), 1.0).states[-1]) == 0.0


def test_a_picture_does_not_depend_on_which_came_before(exciting):
    path = exciting.write()
    film = tiles(path, (8, 8), [0.1, 0.4, 0.6, 0.9], step_s=0.25, excites=True, directions=2)
    alone = tiles(path, (8, 8), [0.9], step_s=0.25, excites=True, directions=2)
    assert (film[3].radiance == alone[0].radiance).all()


def test_glow_that_excites_nothing_is_left_out_and_said_to_be(build, rooms):
    """Materials that glow beside the band that excites them: the state keeps its closed form."""
    build.mesh("a").camera()
    toml = rooms.write_material(build, "a", [0.0, 1.0, 1.0], [0.5] * 3)
    path = build.text(toml + rooms.SATURATED).write()
    frames = tiles(path, (8, 8), [0, 1000.0], step_s=1e-4, excites=True)
    assert "no material is excited" in frames.warnings[0]


def test_in_the_dark_light_is_followed_from_cell_to_cell_for_its_rates_alone(device, monkeypatch):
    """Of `cornell`, for its two rates, and for what float32 rounds off of the first pictures, which are alike: up
    to three times as often. The last picture is that of a renderer that drew none before, to what 64 rays round off."""
    scene = load_scene(SCENES / "cornell")
    parameters = RenderParameters((16, 16), 1, transport=TransportParameters("tiles", bounces=4, cell=0.1))
    rates = {r for d in scene.phosphors for r in d.phosphor.optics.uniform_kr.tolist()}
    followed = []
    follow = CellLight._followed
    monkeypatch.setattr(
        CellLight, "_followed", lambda self, sent: (followed.append(1), follow(self, sent))[1]
    )
    off = scene.schedule.parse_time("off")
    with device.scope():
        renderer = Renderer(device, scene, parameters)
        some = [renderer.frame(off + t).radiance for t in np.linspace(0.1, 20, 30)]
    assert len(followed) <= 3 * len(rates)
    with device.scope():
        alone = Renderer(device, scene, parameters).frame(off + 20).radiance
    np.testing.assert_allclose(some[-1], alone, rtol=1e-4, atol=1e-5 * alone.max())


@pytest.mark.parametrize("islands", ["one", "side by side", "swapped", "turned"])
def test_seams_of_an_atlas_do_not_show_where_glow_charges(build, rooms, device, islands):
    """A disk above the middle of a floor whose atlas is cut there: strips of four texels to either side are charged
    alike, within 1 %, by which the even rays of a single texel are off."""
    at, triangles = rooms.disk(rooms.SENDER, 0.0, -1.0)
    turn = [-np.sqrt(0.5), 0, 0, np.sqrt(0.5)]  # to look down
    uv = at[:, :2] / (2.1 * rooms.SENDER) + 0.5
    rooms.floor_by_wall(build, islands).mesh(
        "sender", at, triangles, uv=uv, rotation=turn, translation=[0, 0.3, 0.5]
    )
    toml = rooms.write_material(build, "sender", [0.01, 0.02, 0.04], [0.0] * 3)
    saturated = 'atlas_texels = 64\ninitial = { state = "saturated" }'
    build.text(toml.replace("atlas_texels = 64", saturated) + "\n[units]\nradiance_factor = 1.0\n")
    renderer = lit_state(device, build.write(), 0.5, 0.5, excites=True)
    (floor,) = (s for s in renderer.states if s.drawable.drawable.name == "floor")
    position = read_texture(floor.atlas.position_w)
    x, r = position[..., 0], floor.shown.read()[..., 0]
    near = (position[..., 3] > 0) & (np.abs(x) < 4 / 64)
    left, right = (r[near & side].mean() for side in (x < 0, x > 0))
    assert left > 0
    assert left == pytest.approx(right, rel=0.01)


def before_a_wall(build, rooms) -> Path:
    """A lamp lights a white wall alone; a small plate beyond the lamp faces the wall."""
    side = np.array([[-2.0, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]])
    build.mesh("wall", side, uv=None).mesh(
        "back", 0.02 * side, translation=[0, 0, 0.5], rotation=[0, 1, 0, 0]
    )
    build.light("lamp", "spot", spot_at(0, 0, 0.45), outerConeAngle=1.4, innerConeAngle=1.39)
    toml = '[lights.lamp]\nspectrum = "flat"\nirradiance_at_1m = 3.0\nschedule = [[0, 1]]\n'
    toml += rooms.write_material(build, "back", [0.0] * 3, [0.5] * 3).replace("64", "16")
    return build.text(toml + "[units]\nradiance_factor = 1.0\n").write()


def irradiance_of_the_plate(path) -> float:
    """By quadrature over the wall: E = ∫ ρ E_wall / π cos cos / d²."""
    light = load_scene(path).lights[0].irradiance_at_1m[0]
    x, y = np.meshgrid(*[np.linspace(-2, 2, 2001)[:-1] + 1e-3] * 2)
    d2, e2 = x**2 + y**2 + 0.25, x**2 + y**2 + 0.45**2
    cone = np.clip((0.45 / np.sqrt(e2) - np.cos(1.4)) / (np.cos(1.39) - np.cos(1.4)), 0, 1) ** 2
    return float(np.sum(light * cone * 0.45 / e2**1.5 / np.pi * 0.25 / d2**2) * 4e-6)


@pytest.mark.parametrize("method", ["tiles", "dss", "dss-z"])
def test_lamp_light_that_is_reflected_charges_what_is_in_the_shadow(build, rooms, device, method):
    """To the 3 % of 256 rays and cells of 1/40."""
    path = before_a_wall(build.camera(4.0, 1.0), rooms)
    with device.scope():
        dark = lit_state(device, path, 0.5).states[0].shown.read()
    lit = lit_state(device, path, 0.5, method=method, lamps=True).states[0]
    assert dark.max() == 0.0
    # a = ke E Δλ, with ke of 1 in a band of 100 nm.
    a = irradiance_of_the_plate(path) * 100.0
    want = a / (a + 0.5) * (1 - np.exp(-(a + 0.5) * 0.5))
    assert lit.shown.read().mean() == pytest.approx(want, rel=0.03)


@pytest.mark.parametrize(("method", "within"), [("dss", 0.03), ("dss-z", 0.14)])
def test_surfels_send_what_their_surface_reflects_of_the_lamp(build, rooms, method, within):
    """The plate, seen from the wall, which is behind the camera: L = ρ E / π. To 3 % as above; for dss-z what disks of
    1.4 times their radius leave open of a plane on which they lie at random: exp(-1.4²)."""
    build.camera(0.3, 0.3)
    build.gltf["nodes"][-1]["rotation"] = [0, 1, 0, 0]
    path = before_a_wall(build, rooms)
    transport = TransportParameters(method, lamps=True, directions=64)
    L = render(path, ["0.5"], size=(16, 16), supersampling=1, transport=transport)[0].radiance
    want = 0.5 * irradiance_of_the_plate(path) / np.pi
    assert L[6:10, 6:10, 0].mean() == pytest.approx(want, rel=within)


def spot_at(x, y, z):
    """A light at a place, that shines along -z."""
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def test_what_cells_bring_is_refused_where_there_are_none(exciting, refuses):
    for method in ("none", "reference"):
        transport = TransportParameters(method, excites=True)
        assert "--gi tiles, dss" in refuses(render, exciting.write(), ["0"], transport=transport, size=(8, 8))
