"""Everything wrong with a scene gives one clear sentence with the file and the remedy, and nothing half-written."""

from __future__ import annotations

import contextlib
import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import phoslab
from phoslab.errors import PhoslabError
from phoslab.render import load_scene, render
from phoslab.render.device import Device
from phoslab.render.gltf import load_gltf


@pytest.fixture
def lit(quad, lamp_toml, green_toml):
    """A sound scene: a lit green quad."""
    return quad.lamp().text(lamp_toml + green_toml)


def test_a_sound_scene_loads_without_a_warning(lit):
    assert load_scene(lit.write()).warnings == ()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('gltf = "scene.gltf"', 'gltf = "../scene.gltf"', "not a file inside the folder"),
        ('gltf = "scene.gltf"', 'gltf = "/etc/passwd"', "not a file inside the folder"),
        ('gltf = "scene.gltf"', 'gltf = "none.glb"', "none.glb: cannot be read"),
        ("phoslab-scene/1", "phoslab-scene/9", "cannot read"),
        ('"preset:green"', '"preset:mauve"', "unknown preset 'mauve'"),
        ('"preset:green"', '"none.json"', "none.json: cannot be read"),
        ('"preset:green"', '"../green.json"', "not a file inside the folder"),
        (
            "[phosphors.quad]",
            "[phosphors.cube]",
            "phosphors.cube is not in 'scene.gltf'. The names in that file",
        ),
        ("[lights.lamp]", "[lights.sun]", "lights.sun is not in 'scene.gltf'"),
        ('"blackbody:3000"', '"candle"', "unknown spectrum 'candle'"),
        ('"blackbody:3000"', '"line:900,5"', "no light within the transport bands"),
        ("[[0, 10]]", "[[0, 10], [5, 20]]", "out of order"),
        ("[[0, 10]]", "[[10, 0]]", "out of order"),
        ("irradiance_at_1m = 2.0", "irradiance_at_1m = -2.0", "lights.lamp.irradiance_at_1m does not fit"),
        ("irradiance_at_1m = 2.0", "irradiance_at_1m = nan", "irradiance_at_1m is nan"),
        ("radiance_factor = 0.5", "", "Add under [units]"),
        ("[units]", '[units]\nsystem = "absolute"', "has no meaning in an absolute scene"),
        ("atlas_texels = 64", "atlas_texels = 0", "atlas_texels does not fit"),
        ("atlas_texels = 64", "atlas_texel = 64", "atlas_texel"),
        ("[units]", 'camera = "other"\n[units]', "camera.other is not in"),
        ("[units]", "[render]\nbands_nm = [500, 400]\n[units]", "render.bands_nm must be"),
        ("[units]", '[display]\nexposures = [{from = "1", exposure = "auto"}]\n[units]', "ascend from 0"),
        ("[units]", '[initial]\nstate = "equilibrium"\n[units]', "an equilibrium without lights"),
        ("[units]", '[initial]\nstate = "equilibrium"\nlights = ["x"]\n[units]', "unknown light 'x'"),
        ("[units]", "[units", "is not valid TOML"),
    ],
)
def test_a_wrong_scene_file_is_refused(lit, refuses, old, new, says):
    assert old in lit.toml
    lit.toml = lit.toml.replace(old, new)
    message = refuses(load_scene, lit.write())
    assert says in message
    assert str(lit.folder) in message


def test_a_missing_scene_is_refused(tmp_path, refuses):
    assert "Name a scene.toml" in refuses(load_scene, tmp_path)


def test_a_light_that_the_scene_file_leaves_out_is_refused(lit, refuses):
    lit.light("second", "point", np.eye(4))
    assert "lights.second is missing" in refuses(load_scene, lit.write())


def test_light_where_excitation_was_never_measured_names_the_band(lit, refuses):
    lit.toml = lit.toml.replace("preset:green", "preset:gloves")
    message = refuses(load_scene, lit.write())
    assert "phosphors.quad ke_m2_per_J of 'gloves' was never measured at 400-437.5 nm" in message


def test_a_dark_scene_needs_no_excitation(quad, green_toml):
    """A material whose ke was never measured renders as long as no light falls on it."""
    quad.text("[units]\nradiance_factor = 1.0\n" + green_toml.replace("green", "gloves"))
    frame = render(quad.text('[initial]\nstate = "saturated"\n').write(), ["5"], size=(8, 8))[0]
    assert frame.radiance.max() > 0


@pytest.mark.parametrize(
    ("changes", "adds"),
    [
        ({'"calibration": "relative"': '"calibration": "absolute"'}, "`irradiance_factor = ...` and"),
        ({"0.07863752457180867": "0.08"}, "`irradiance_factor = ...`"),
        ({'"provenance": {': '"provenance": {"radiance_unit": "DN/s", '}, "`radiance_factor = ...`"),
    ],
)
def test_mixed_units_are_refused_with_the_factor_to_add(lit, refuses, changes, adds):
    text = phoslab.preset("yellow").to_json()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    (lit.folder / "other.json").write_text(text, encoding="utf-8")
    lit.mesh("second", translation=[2, 0, 0]).text('[phosphors.second]\nmaterial = "other.json"\n')
    message = refuses(load_scene, lit.write())
    assert adds in message
    assert "[phosphors.second]" in message
    lit.text("irradiance_factor = 1.0\nradiance_factor = 1.0\n")
    load_scene(lit.write())


def test_light_and_glow_outside_the_bands_are_reported(lit):
    lit.text("[render]\nbands_nm = [500, 600, 800]\n")
    warnings = load_scene(lit.write()).warnings
    assert any("of the light of 'lamp' lies outside the bands of 'quad'" in w for w in warnings)
    assert any("of the glow of 'quad' lies outside the scene's bands" in w for w in warnings)


def test_an_absolute_material_that_gives_more_than_it_takes_is_reported(lit):
    text = phoslab.preset("green").to_json().replace('"relative"', '"absolute"').replace("0.64", "6.4")
    (lit.folder / "bright.json").write_text(text, encoding="utf-8")
    lit.toml = lit.toml.replace("preset:green", "bright.json").replace(
        "radiance_factor = 0.5", 'system = "absolute"'
    )
    assert any(
        "gives more light than it takes at 400-437.5 nm" in w for w in load_scene(lit.write()).warnings
    )


def test_going_beyond_the_data_is_said_on_every_output(lit, tmp_path):
    frames = render(lit.write(), ["off+180s", "off+181s"], size=(8, 8))
    assert frames[0].warnings == ()
    assert "181 s after the light is beyond the 180 s that the data of 'green' support" in frames[1].warnings
    from PIL import Image

    frames.write(tmp_path / "out.png")
    assert "beyond" in Image.open(tmp_path / "out-off+181s.png").text["phoslab:warnings"]


@pytest.mark.parametrize("time", ["off+x", "soon", "-1", "", "off-20s", "1e999", "1e13"])
def test_a_wrong_time_is_refused(lit, refuses, time):
    assert repr(time) in refuses(render, lit.write(), [time])


def test_counting_from_lamp_off_needs_a_lamp_that_goes_off(lit, refuses):
    lit.toml = lit.toml.replace("schedule = [[0, 10]]", "")
    assert "never happens in this scene" in refuses(render, lit.write(), ["off+1s"])


def test_an_unknown_solver_and_a_wrong_step_are_refused(lit, refuses):
    scene = load_scene(lit.write())
    assert "Use one of: euler, substep, exact" in refuses(render, scene, ["0"], solver="magic")
    assert "the step is -1" in refuses(render, scene, ["0"], solver="euler", step_s=-1)


def test_no_opengl_says_what_to_install(refuses):
    message = refuses(Device, libgl="libNoSuchGL.so.1", libegl="libNoSuchEGL.so.1")
    assert "apt-get install libgl1 libegl1 libgl1-mesa-dri" in message


@pytest.mark.parametrize(
    "shader", ["nonsense;", "layout(std430, binding = 65535) buffer Many { int many[]; };"]
)
def test_a_shader_that_a_driver_cannot_build_is_said(refuses, monkeypatch, shader):
    source = "#version 430\nlayout(local_size_x = 1) in;\n" + shader + "\nvoid main() {}\n"
    monkeypatch.setattr("phoslab.render.device.source", lambda name, defines: source)
    with Device() as device:
        message = refuses(device.compute, "tile_hits")
        assert device.renderer in message
    assert "cannot build the shader 'tile_hits'" in message
    assert "LIBGL_ALWAYS_SOFTWARE=1" in message


def test_a_vertex_that_is_not_a_number_is_refused(build, refuses):
    points = np.array([[-0.5, -0.5, 0], [0.5, np.nan, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    message = refuses(load_scene, build.mesh("quad", points).camera().write())
    assert "mesh 'quad' has a position that is not finite, at vertex 1" in message


def test_degenerate_triangles_are_left_out(build):
    triangles = np.array([[0, 1, 2], [0, 2, 3], [0, 0, 1], [1, 1, 1]])
    scene = load_scene(build.mesh("quad", triangles=triangles).camera().write())
    assert len(scene.drawables[0].geometry.triangles) == 2
    assert np.isfinite(scene.drawables[0].geometry.normals).all()


def test_a_mesh_of_nothing_but_degenerate_triangles_is_refused(build, refuses):
    build.mesh("line", triangles=np.array([[0, 1, 1]])).camera()
    assert "has no triangle with an area" in refuses(load_scene, build.write())


def test_a_textured_mesh_without_coordinates_is_refused(build, refuses, tmp_path):
    from PIL import Image

    Image.new("RGB", (4, 4)).save(tmp_path / "t.png")
    build.mesh("quad", uv=None).camera()
    build.gltf["images"], build.gltf["textures"] = [{"uri": "t.png"}], [{"source": 0}]
    build.gltf["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    assert "no texture coordinates" in refuses(load_scene, build.write())


@pytest.mark.parametrize(
    ("uri", "says"),
    [
        ("../t.png", "not a file inside"),
        ("none.png", "cannot be read"),
        ("%2e%2e/t.png", "not a file inside"),
        ("bad.png", "cannot be read"),
        ("file:///etc/passwd", "cannot be read"),
    ],
)
def test_a_texture_that_is_not_there_or_not_an_image_is_refused(build, refuses, tmp_path, uri, says):
    (tmp_path / "bad.png").write_bytes(b"\x89PNG\r\n\x1a\nnonsense")
    build.mesh("quad").camera()
    build.gltf["images"], build.gltf["textures"] = [{"uri": uri}], [{"source": 0}]
    build.gltf["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    assert says in refuses(load_scene, build.write())


def test_a_scene_without_camera_or_mesh_is_refused(build, refuses):
    assert "holds no perspective camera" in refuses(load_scene, build.mesh("quad").write())
    build.gltf["nodes"].clear()
    build.gltf["scenes"][0]["nodes"].clear()
    assert "holds no mesh" in refuses(load_scene, build.camera().write())


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_gltf_file_is_refused_or_read_but_never_breaks_the_loader(lit, data):
    """Any one value anywhere in the JSON is replaced by something else."""
    lit.toml = lit.toml.split("[units]")[0]
    path = lit.write().with_name("scene.gltf")
    document = json.loads(path.read_text(encoding="utf-8"))
    place, key = document, None
    while isinstance(place, dict | list) and place:
        key = data.draw(st.sampled_from(list(place) if isinstance(place, dict) else list(range(len(place)))))
        parent, place = place, place[key]
        if data.draw(st.booleans()):
            break
    if key is None:
        return
    parent[key] = data.draw(
        st.sampled_from([None, -1, 0, 7, 1 << 40, 0.5, 1e308, "x", "", [], {}, [0], True])
    )
    path.write_text(json.dumps(document), encoding="utf-8")
    with contextlib.suppress(PhoslabError):
        load_gltf(path)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cut=st.integers(0, 4000), flip=st.integers(0, 3999))
def test_a_cut_or_corrupted_glb_is_refused_or_read_but_never_breaks_the_loader(tmp_path, cut, flip):
    from phoslab.sample_data.glb import GlbWriter
    from phoslab.sample_data.shapes import star

    glb = GlbWriter()
    glb.mesh("star", star(5, 0.2, 0.1, 0.05), glb.material((1, 1, 1)))
    glb.camera("camera", (0, 0, 1), (0, 0, 0), 30)
    path = tmp_path / "star.glb"
    glb.save(path)
    content = bytearray(path.read_bytes()[:cut] if cut % 2 else path.read_bytes())
    if flip < len(content):
        content[flip] ^= 0x55
    path.write_bytes(content)
    with contextlib.suppress(PhoslabError):
        load_gltf(path)
