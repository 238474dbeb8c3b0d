"""Glow in the picture: what the rate equations say, at any time, by any way there."""

from __future__ import annotations

import numpy as np
import pytest

import phoslab
from phoslab import kinetics
from phoslab.bands import rebin
from phoslab.maps import write_map
from phoslab.render import load_scene, render
from phoslab.render.device import read_texture
from phoslab.render.phosphor_state import PhosphorState
from phoslab.render.renderer import Renderer, RenderParameters

FLOAT32 = 64 * 2.0**-24
SATURATED = '\n[initial]\nstate = "saturated"\n'


def test_saturated_quad_shows_the_emitted_radiance(quad, lamp_toml, green_toml):
    """L = Σ Λ kr r times the radiance factor, in every band and every pixel of the quad."""
    quad.camera().lamp().text(lamp_toml.replace("[[0, 10]]", "[[1, 2]]") + green_toml + SATURATED)
    frame = render(quad.write(), ["0"], size=(16, 16))[0]
    want = 0.5 * kinetics.emitted_radiance(phoslab.preset("green"), [1.0])
    np.testing.assert_allclose(frame.radiance, np.broadcast_to(want, (16, 16, 8)), rtol=FLOAT32)


def test_state_after_a_schedule_equals_the_reference(quad, device, lamp_toml, green_toml):
    """Charge 10 s, rest 5 s, charge 3 s, fade 20 s: the float64 kinetics with the texel's own irradiance."""
    toml = lamp_toml.replace("[[0, 10]]", "[[0, 10], [15, 18]]") + green_toml
    scene = load_scene(quad.lamp((0, 0, 1)).text(toml).write())
    renderer = Renderer(device, scene, RenderParameters((8, 8), 1))
    renderer.frame(38.0)
    green = phoslab.preset("green")
    centre = (np.arange(64) + 0.5) / 64 - 0.5
    x, y = np.meshgrid(centre, centre)
    E = (x**2 + y**2 + 1.0)[..., None] ** -1.5 * scene.lights[0].irradiance_at_1m
    r = np.zeros((64, 64, 1))
    for light, dt in ((E, 10.0), (0 * E, 5.0), (E, 3.0), (0 * E, 20.0)):
        r = kinetics.advance(green, r, light, dt)
    # Four light changes, each a step of some 16 roundings.
    np.testing.assert_allclose(renderer.states[0].shown.read(), r, rtol=4 * FLOAT32)


def test_each_set_of_lights_excites_by_its_own_irradiance(quad, device, lamp_toml, green_toml):
    """One lamp, then another, then both."""
    right = np.eye(4)
    right[:3, 3] = [0.4, 0, 0.5]
    quad.lamp((-0.2, 0, 1)).light("right", "point", right)
    second = lamp_toml.split("[lights.lamp]")[1].replace("[[0, 10]]", "[[4, 12]]").replace("2.0", "0.3")
    toml = lamp_toml.replace("[[0, 10]]", "[[0, 4], [8, 12]]") + "[lights.right]" + second + green_toml
    scene = load_scene(quad.text(toml).write())
    renderer = Renderer(device, scene, RenderParameters((8, 8), 1))
    renderer.frame(12.0)
    centre = (np.arange(64) + 0.5) / 64 - 0.5
    x, y = np.meshgrid(centre, centre)

    def irradiance(light, at_x: float, at_z: float) -> np.ndarray:
        d2 = (x - at_x) ** 2 + y**2 + at_z**2
        return (at_z / d2**1.5)[..., None] * light.irradiance_at_1m

    left, right_E = irradiance(scene.lights[0], -0.2, 1.0), irradiance(scene.lights[1], 0.4, 0.5)
    r = np.zeros((64, 64, 1))
    for E in (left, right_E, left + right_E):
        r = kinetics.advance(phoslab.preset("green"), r, E, 4.0)
    np.testing.assert_allclose(renderer.states[0].shown.read(), r, rtol=4 * FLOAT32)


def test_any_time_costs_the_light_changes_and_not_the_frames(
    quad, device, lamp_toml, green_toml, monkeypatch
):
    steps = []
    run = PhosphorState._run
    monkeypatch.setattr(PhosphorState, "_run", lambda *a, **k: (steps.append(1), run(*a, **k))[1])
    toml = lamp_toml.replace("[[0, 10]]", "[[0, 1], [2, 3]]") + green_toml
    scene = load_scene(quad.lamp().text(toml).write())
    renderer = Renderer(device, scene, RenderParameters((8, 8), 1))
    renderer.frame(6.0)
    assert len(steps) == 4
    renderer.frame(6 * 3600.0)
    assert len(steps) == 5


def test_frames_do_not_depend_on_which_frames_came_before(quad, lamp_toml, green_toml):
    """Evaluated from the anchor: a film's last frame is the frame rendered alone, bit by bit, also backwards."""
    scene = load_scene(quad.lamp().text(lamp_toml + green_toml).write())
    film = render(scene, [*np.linspace(0, 20, 41)], size=(8, 8))
    alone = render(scene, [20.0], size=(8, 8))[0]
    assert (film[40].radiance == alone.radiance).all()
    both = render(scene, ["off+10s", "1"], size=(8, 8))
    assert both[0].time_s == 20.0
    assert (both[0].radiance == alone.radiance).all()


def test_equilibrium_start_is_the_equilibrium_under_its_lights(quad, device, lamp_toml, green_toml):
    toml = lamp_toml.replace("[[0, 10]]", "[[100, 200]]") + green_toml
    toml += '\n[initial]\nstate = "equilibrium"\nlights = ["lamp"]\n'
    scene = load_scene(quad.lamp((0, 0, 1)).text(toml).write())
    renderer = Renderer(device, scene, RenderParameters((8, 8), 1))
    centre = (np.arange(64) + 0.5) / 64 - 0.5
    x, y = np.meshgrid(centre, centre)
    E = (x**2 + y**2 + 1.0)[..., None] ** -1.5 * scene.lights[0].irradiance_at_1m
    want = kinetics.equilibrium(phoslab.preset("green"), E)
    np.testing.assert_allclose(renderer.states[0].shown.read(), want, rtol=FLOAT32)


def test_euler_approaches_the_exact_state_as_its_step_shrinks(quad, lamp_toml, green_toml):
    scene = load_scene(quad.lamp((0, 0, 1)).text(lamp_toml + green_toml).write())
    exact = render(scene, ["off+3s"], size=(8, 8))[0].radiance
    errors = []
    for step in (1 / 8, 1 / 16, 1 / 32):
        euler = render(scene, ["off+3s"], size=(8, 8), solver="euler", step_s=step)[0].radiance
        errors.append(np.abs(euler - exact).max() / exact.max())
    # First order: half the step, half the error (within the next order's share).
    assert errors[0] / errors[1] == pytest.approx(2, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(2, rel=0.1)


def test_euler_refuses_where_it_would_overshoot(quad, lamp_toml, green_toml, refuses):
    bright = lamp_toml.replace("irradiance_at_1m = 2.0", "irradiance_at_1m = 1e4")
    path = quad.lamp((0, 0, 1)).text(bright + green_toml).write()
    message = refuses(render, path, ["5"], solver="euler")
    assert "overshoots on 'quad'" in message
    assert "--solver exact" in message


@pytest.mark.parametrize("edges", [[400, 500, 600, 700], [380, 400, 437.5, 475, 512.5, 550, 600, 650, 700]])
def test_glow_keeps_its_energy_in_other_bands(edges, quad, lamp_toml, green_toml):
    """Three bands, or eight others: the glow's integral over wavelength is the material's."""
    toml = f"\n[render]\nbands_nm = {edges}\n" + lamp_toml.replace("[[0, 10]]", "[[1, 2]]")
    frame = render(quad.lamp().text(toml + green_toml + SATURATED).write(), ["0"], size=(8, 8))[0]
    assert frame.radiance.shape[-1] == len(edges) - 1
    green = phoslab.preset("green")
    L = 0.5 * kinetics.emitted_radiance(green, [1.0])
    np.testing.assert_allclose(frame.radiance[4, 4] @ np.diff(edges), L @ green.bands.widths_nm, rtol=FLOAT32)
    np.testing.assert_allclose(frame.radiance[4, 4], rebin(L, green.bands, frame.bands), rtol=FLOAT32)


def test_instances_of_one_mesh_have_their_own_state(quad, device, lamp_toml, green_toml):
    """Two nodes share the quad; one lies in the other's shadow."""
    quad.node(name="hidden", mesh=0, translation=[0, 0, -0.5], scale=[0.2, 0.2, 1])
    scene = load_scene(quad.lamp((0, 0, 1)).text(lamp_toml + green_toml).write())
    renderer = Renderer(device, scene, RenderParameters((8, 8), 1))
    renderer.frame(5.0)
    assert [d.name for d in scene.phosphors] == ["quad", "hidden"]
    lit, hidden = (state.shown.read() for state in renderer.states)
    assert lit.min() > 0.1
    assert (hidden == 0).all()


def test_maps_replace_their_fields_texel_by_texel(quad, lamp_toml):
    """Left half: half the emission and no albedo; the picture shows both, row 0 of a map at v = 0."""
    green = phoslab.preset("green")
    n = 16
    emission = np.broadcast_to(green.emission, (n, n, 1, 8)).astype("f4").copy()
    emission[:, : n // 2] *= 0.5
    albedo = np.full((n, n, 8), 0.5, dtype="f4")
    albedo[: n // 2] = 0.25
    write_map(quad.folder / "emission.exr", emission)
    write_map(quad.folder / "albedo.exr", albedo, by_band=True)
    text = green.to_json().replace('"albedo": null', f'"albedo": {[0.9] * 8}')
    text = text.replace('"maps": null', '"maps": {"emission": "emission.exr", "albedo": "albedo.exr"}')
    (quad.folder / "mapped.json").write_text(text, encoding="utf-8")
    toml = lamp_toml + '\n[phosphors.quad]\nmaterial = "mapped.json"\natlas_texels = 32\n' + SATURATED
    dark = lamp_toml.replace("[[0, 10]]", "[[1, 2]]") + toml.removeprefix(lamp_toml)
    quad.lamp().text(dark)
    frames = render(quad.write(), ["0", "1"], size=(16, 16))
    L = 0.5 * kinetics.emitted_radiance(green, [1.0])
    np.testing.assert_allclose(frames[0].radiance[8, 2], L / 2, rtol=FLOAT32)
    np.testing.assert_allclose(frames[0].radiance[8, 13], L, rtol=FLOAT32)
    reflected = frames[1].radiance[..., 7]  # 662-700 nm: no glow there
    assert reflected[13, 8] / reflected[2, 8] == pytest.approx(0.5, rel=0.01)  # top row is v = 1


def test_mesh_without_texture_coordinates_gets_an_atlas_that_shows_no_seam(build, device, lamp_toml):
    """An octahedron, tilted: each lit side glows alike in every pixel, up to the edges of its chart."""
    corners = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]) * 0.6
    upper = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4]])
    lower = np.array([[2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    tilt = np.array([0.2, -0.35, 0, 0.915])
    build.mesh("quad", corners, np.concatenate([upper, lower]), uv=None, rotation=tilt.tolist())
    build.camera(distance=4.0, yfov=0.3)
    towards = np.ones(3) / np.sqrt(3)
    x = np.array([1.0, 0, -1]) / np.sqrt(2)
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([x, np.cross(towards, x), towards])
    build.light("lamp", "directional", matrix)
    toml = lamp_toml + '\n[phosphors.quad]\nmaterial = "preset:green"\natlas_texels = 64\n'
    renderer = Renderer(device, load_scene(build.text(toml).write()), RenderParameters((192, 192), 1))
    glow = renderer.frame(11.0).radiance[..., 3]
    normals = read_texture(renderer.gbuffer.normal_w)[::-1, :, :3].round(2)
    sides = np.unique(normals[glow > 0], axis=0)
    assert len(sides) >= 2
    for side in sides:
        seen = glow[(normals == side).all(axis=-1)]
        assert seen.size > 500
        # One face has one normal and one light: only rounding may differ.
        np.testing.assert_allclose(seen, np.median(seen), rtol=FLOAT32)


def test_mirrored_node_is_lit_on_its_outside(quad, lamp_toml, green_toml):
    quad.gltf["nodes"][0]["scale"] = [-1, 1, 1]
    quad.gltf["nodes"][0]["rotation"] = [0, 1, 0, 0]  # about y: its outside looks to -z, away from the camera
    frame = render(quad.lamp((0, 0, 1)).text(lamp_toml + green_toml).write(), ["off+1"], size=(8, 8))[0]
    assert (frame.radiance == 0).all()


def test_base_colour_textures_repeat_with_their_first_row_at_v_0(build, lamp_toml, tmp_path):
    """A texture of red over blue on texture coordinates 0..2: four stripes, v upwards in this picture."""
    from PIL import Image

    Image.fromarray(np.array([[[255, 0, 0]], [[0, 0, 255]]], dtype=np.uint8)).save(tmp_path / "t.png")
    uv = np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]])
    build.mesh("quad", uv=uv).camera().lamp((0, 0, 5))
    build.gltf["images"], build.gltf["textures"] = [{"uri": "t.png"}], [{"source": 0}]
    build.gltf["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    frame = render(build.text(lamp_toml).write(), ["0"], size=(32, 32))[0]
    # The camera sees y from -0.51 to 0.51: texel centres of the texture are at v = 0.25, 0.75, 1.25, 1.75.
    long = frame.radiance[..., 7]  # 662-700 nm
    rows = [round(15.5 - (v / 2 - 0.5) / 1.0213 * 32) for v in (0.25, 0.75, 1.25, 1.75)]
    assert [bool(long[row, 16] > 0.5 * long.max()) for row in rows] == [True, False, True, False]
