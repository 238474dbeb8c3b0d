"""Scenes at which glow transport could break: a right picture or a word, never a crash or silent black."""

from __future__ import annotations

import numpy as np
import pytest

from phoslab.render import TransportParameters, load_scene, render
from phoslab.render.renderer import Renderer, RenderParameters

TILES = TransportParameters("tiles", directions=4, guided=0.0)


# Surfels of the sizes that make these small scenes quick.
EVERY_WAY = {
    "tiles": TILES,
    "dss": TransportParameters("dss", surfel=0.05),
    "dss-z": TransportParameters("dss-z", directions=4, surfel=0.05),
}
each_way = pytest.mark.parametrize("way", EVERY_WAY.values(), ids=EVERY_WAY)


def glow(path, size=(16, 16), transport=TILES):
    return render(path, ["0"], size=size, supersampling=1, transport=transport)


def scaled_box(build, rooms, metres):
    """The closed box of 2 m, that many times as large."""
    rooms.closed_box(build)
    for node in build.gltf["nodes"]:
        node["translation"] = (np.array(node.get("translation", [0.0, 0, 0])) * metres).tolist()
        node["scale"] = [metres] * 3
    build.gltf["cameras"][0]["perspective"]["znear"] *= metres
    return build.write()


@pytest.mark.parametrize("metres", [1e-3, 1e3])
def test_a_room_of_a_millimetre_and_of_a_kilometre_is_as_bright_as_one_of_two_metres(build, rooms, metres):
    """The closed box, scaled: 0.75 in every pixel, to float32."""
    np.testing.assert_allclose(glow(scaled_box(build, rooms, metres))[0].radiance, 0.75, rtol=1e-5)


@pytest.mark.parametrize("way", ["dss", "dss-z"])
def test_surfels_light_a_room_of_any_size_alike(build, rooms, way):
    """On the mean of the picture to 1e-3: a coordinate that is rounded otherwise may move one of a thousand disks."""
    means = []
    for metres in (1e-3, 1.0, 1e3):
        here = type(build)(build.folder)
        means.append(glow(scaled_box(here, rooms, metres), transport=EVERY_WAY[way])[0].radiance.mean())
    np.testing.assert_allclose(means, means[1], rtol=1e-3)
    assert means[1] > 0.7


@each_way
def test_triangles_without_area_and_edges_of_three_change_nothing(build, rooms, way):
    """Three sheets share an edge, and one triangle is a line: it glows, is unfolded, and lights the floor."""
    at = np.array([[0.0, 0, 0], [0, 1, 0], [1, 0.5, 0], [-0.5, 0.5, 0.8], [-0.5, 0.5, -0.8], [0, 0.5, 0]])
    triangles = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4], [0, 1, 5]])
    build.mesh("fan", at, triangles, uv=None)
    floor = np.array([[-3.0, -0.2, -3], [3, -0.2, -3], [3, -0.2, 3], [-3, -0.2, 3]])
    build.mesh("floor", floor, np.array([[0, 2, 1], [0, 3, 2]]), uv=None, colour=(0.8, 0.8, 0.8))
    build.camera(4.0, 0.8)
    path = build.text(rooms.write_material(build, "fan", [1.0] * 3, [0.5] * 3) + rooms.SATURATED).write()
    with_glow, without = (glow(path, (32, 32), t)[0].radiance for t in (way, TransportParameters()))
    assert np.isfinite(with_glow).all()
    assert (with_glow >= without).all()
    assert (with_glow > without).mean() > 0.1


@each_way
def test_without_a_phosphor_it_says_that_there_is_nothing_to_do(quad, lamp_toml, way):
    frames = glow(quad.lamp().text(lamp_toml).write(), (8, 8), way)
    assert frames[0].radiance.max() > 0
    assert any("nothing in the scene is phosphorescent" in warning for warning in frames.warnings)


@each_way
def test_a_camera_inside_a_wall_sees_black_and_says_so(build, rooms, way):
    """Between the two faces of a thick wall that glows on its outsides."""
    from phoslab.sample_data.shapes import box

    wall = box((-5, -5, -0.1), (5, 5, 0.1))
    build.mesh("wall", wall.positions, wall.triangles, uv=None).camera(0.0, 0.5)
    build.gltf["cameras"][0]["perspective"]["znear"] = 0.01
    path = build.text(rooms.write_material(build, "wall", [0.0] * 3, [0.5] * 3) + rooms.SATURATED).write()
    frames = glow(path, transport=way)
    assert frames[0].radiance.max() == 0
    assert any("is black" in warning for warning in frames.warnings)


def test_a_cell_of_a_quarter_of_a_million_texels_sends_their_mean(build, rooms, device):
    """A stamp with a fine atlas in a wide room is one cell: no loop of a shader may end before its last texel."""
    stamp = 0.02 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    build.mesh("stamp", stamp)
    floor = np.array([[-9.0, -1, -9], [9, -1, -9], [9, -1, 9], [-9, -1, 9]])
    build.mesh("floor", floor, np.array([[0, 2, 1], [0, 3, 2]]), uv=None).camera()
    toml = rooms.write_material(build, "stamp", [1.0, 2.0, 4.0], [0.5] * 3).replace("= 64", "= 512")
    path = build.text(toml + rooms.SATURATED).write()
    renderer = Renderer(device, load_scene(path), RenderParameters((8, 8), 1, transport=TILES))
    renderer.frame(0.0)
    emitted = renderer.transport.lit_cells.cell_glow.emitted()
    sends = emitted.max(axis=1) > 0
    assert sends.sum() == 1
    # 2^18 shares of 2^-18 are added in float32, each sum rounded: on the mean far below, at worst 2^18 2^-24.
    np.testing.assert_allclose(emitted[sends][0, :3], [1, 2, 4], rtol=2**-6)
