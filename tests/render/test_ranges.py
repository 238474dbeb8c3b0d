"""What float32 and the promised ranges cannot hold is refused with its field, and without a warning of NumPy's."""

from __future__ import annotations

import json
import os
import warnings

import numpy as np
import pytest

import phoslab
from phoslab.render import load_scene, render


@pytest.fixture(autouse=True)
def _numpy_is_silent():
    """A RuntimeWarning would stand on the user's terminal beside our sentence."""
    with warnings.catch_warnings(action="error"):
        yield


@pytest.fixture
def lit(quad, lamp_toml, green_toml):
    """A sound scene: a lit green quad."""
    return quad.lamp().text(lamp_toml + green_toml)


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("radiance_factor = 0.5", "radiance_factor = 1e300", "units.radiance_factor"),
        ("radiance_factor = 0.5", "radiance_factor = 1e-300", "units.radiance_factor"),
        ("irradiance_at_1m = 2.0", "irradiance_at_1m = 1e300", "lights.lamp.irradiance_at_1m"),
        ("irradiance_at_1m = 2.0", "irradiance_at_1m = " + "9" * 400, "lights.lamp.irradiance_at_1m"),
        ('"blackbody:3000"', '"blackbody:0.001"', "lights.lamp."),
        ("[[0, 10]]", "[[0, 1e300]]", "lights.lamp.schedule[0][1]"),
        ("[[0, 10]]", f"[[0, {'9' * 400}]]", "lights.lamp.schedule[0][1]"),
        ("atlas_texels = 64", "atlas_texels = 64\nradiance_factor = 1e300", "phosphors.quad.radiance_factor"),
        (
            "atlas_texels = 64",
            "atlas_texels = 64\nirradiance_factor = 1e300",
            "phosphors.quad.irradiance_factor",
        ),
        (
            "atlas_texels = 64",
            "atlas_texels = 64\nirradiance_factor = 1e20",
            "phosphors.quad cannot be rendered",
        ),
        ("[units]", "[display]\nexposure = 1e300\n[units]", "display.exposure"),
        ("[units]", "[render]\nbands_nm = [1e-300, 1e300]\n[units]", "render.bands_nm"),
        ("[units]", "[render]\nsize = [0, 0]\n[units]", "render.size"),
    ],
)
def test_a_number_beyond_its_range_is_refused_by_its_field(lit, refuses, old, new, field):
    assert old in lit.toml
    lit.toml = lit.toml.replace(old, new)
    assert f"scene.toml: {field}" in refuses(load_scene, lit.write())


@pytest.mark.parametrize("field", ["kr_per_s", "ke_m2_per_J", "emission"])
@pytest.mark.parametrize("value", [1e300, 3e38, 1e18])
def test_a_material_beyond_the_range_is_refused_by_its_field(lit, refuses, field, value):
    material = json.loads(phoslab.preset("green").to_json())
    place = material[field] if field == "kr_per_s" else material[field][0]
    place[0] = value
    (lit.folder / "m.json").write_text(json.dumps(material), encoding="utf-8")
    lit.toml = lit.toml.replace("preset:green", "m.json")
    message = refuses(load_scene, lit.write())
    assert f"phosphors.quad cannot be rendered: its {field} reaches" in message


@pytest.mark.parametrize("lamp_m", [0.0, 1e-8, 0.1])
def test_all_that_is_allowed_at_once_makes_a_finite_picture(lit, lamp_m):
    material = json.loads(phoslab.preset("green").to_json())
    material["kr_per_s"][0] = 1e6
    material["ke_m2_per_J"][0] = [1e3] * len(material["ke_m2_per_J"][0])
    (lit.folder / "m.json").write_text(json.dumps(material), encoding="utf-8")
    lit.toml = (
        lit.toml.replace("preset:green", "m.json").replace("= 2.0", "= 1e12").replace("= 0.5", "= 1e10")
    )
    lit.gltf["nodes"][-1]["matrix"][14] = lamp_m
    frames = render(lit.write(), ["1", "11"], size=(16, 16))
    assert all(np.isfinite(frame.radiance).all() for frame in frames)
    assert lamp_m < 0.1 or frames[0].radiance.max() > 0


@pytest.mark.parametrize(
    ("node", "change", "says"),
    [
        ("quad", {"scale": [0, 0, 0]}, "node 'quad' is scaled to nothing"),
        ("quad", {"scale": [1, 1, 0]}, "node 'quad' is scaled to nothing"),
        ("quad", {"scale": [1e300, 1e300, 1e300]}, "node 'quad' lies or reaches farther than 1e+09 m"),
        ("quad", {"translation": [0, 0, 1e20]}, "node 'quad' lies or reaches farther than 1e+09 m"),
        ("quad", {"rotation": [0, 0, 0, 0]}, "has a transformation that is not finite"),
        ("quad", {"matrix": [0] * 16}, "node 'quad' is scaled to nothing"),
        ("camera", {"scale": [0, 1, 1]}, "node 'camera' is scaled to nothing"),
        ("camera", {"matrix": [0] * 16}, "node 'camera' is scaled to nothing"),
        ("lamp", {"matrix": None, "scale": [0, 0, 0]}, "node 'lamp' is scaled to nothing"),
        ("lamp", {"matrix": [1.0] * 16}, "node 'lamp' is scaled to nothing"),
    ],
)
def test_a_node_that_cannot_stand_anywhere_is_refused(lit, refuses, node, change, says):
    (place,) = (n for n in lit.gltf["nodes"] if n["name"] == node)
    place.update(change)
    assert says in refuses(load_scene, lit.write())


@pytest.mark.parametrize("near", [1e300, 1e-300, 0.0, -1.0])
def test_a_near_plane_that_is_nowhere_is_refused(lit, refuses, near):
    lit.gltf["cameras"][0]["perspective"]["znear"] = near
    assert "cameras[0] has no valid field of view or near plane" in refuses(load_scene, lit.write())


@pytest.mark.parametrize("index", [-1, 99, True])
@pytest.mark.parametrize(
    ("table", "place"),
    [
        ("meshes", ("nodes", 0, "mesh")),
        ("cameras", ("nodes", 1, "camera")),
        ("nodes", ("scenes", 0, "nodes", 0)),
        ("scenes", ("scene",)),
        ("accessors", ("meshes", 0, "primitives", 0, "attributes", "POSITION")),
        ("accessors", ("meshes", 0, "primitives", 0, "indices")),
        ("materials", ("meshes", 0, "primitives", 0, "material")),
        ("bufferViews", ("accessors", 0, "bufferView")),
        ("buffers", ("bufferViews", 0, "buffer")),
        ("KHR_lights_punctual.lights", ("nodes", 2, "extensions", "KHR_lights_punctual", "light")),
    ],
)
def test_an_index_of_nothing_is_refused(lit, refuses, table, place, index):
    """Python counts negative indices from the end, and takes True for 1."""
    lit.write()
    *parents, last = place
    thing = lit.gltf
    for key in parents:
        thing = thing[key]
    thing[last] = index
    assert f"{table}[{index!r}] does not exist" in refuses(load_scene, lit.write())


@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
@pytest.mark.parametrize("name", ["scene.toml", "scene.gltf", "scene.bin", "t.png", "m.json"])
def test_what_is_no_regular_file_is_not_read(lit, refuses, name, kind):
    from PIL import Image

    Image.new("RGB", (4, 4)).save(lit.folder / "t.png")
    lit.gltf["images"], lit.gltf["textures"] = [{"uri": "t.png"}], [{"source": 0}]
    lit.gltf["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    (lit.folder / "m.json").write_text(phoslab.preset("green").to_json(), encoding="utf-8")
    lit.toml = lit.toml.replace("preset:green", "m.json")
    path = lit.write()
    document = json.loads((lit.folder / "scene.gltf").read_text(encoding="utf-8"))
    document["buffers"][0]["uri"] = "scene.bin"
    (lit.folder / "scene.gltf").write_text(json.dumps(document), encoding="utf-8")
    (lit.folder / "scene.bin").write_bytes(bytes(lit.buffers))
    load_scene(path)
    victim = lit.folder / name
    victim.unlink()
    if kind == "pipe":
        os.mkfifo(victim)
    elif kind == "folder":
        victim.mkdir()
    else:
        victim.symlink_to("/dev/zero")
    message = refuses(load_scene, path)
    assert str(victim) in message or name in message


def test_a_scene_file_of_another_world_is_refused(tmp_path, refuses):
    head = 'schema = "phoslab-scene/1"\ngltf = "scene.gltf"\n'
    path = tmp_path / "scene.toml"
    for text in ("a = " + "[" * 100_000 + "]" * 100_000, "a = " + "[" * 300 + "1" + "]" * 300):
        path.write_text(head + text, encoding="utf-8")
        assert str(path) in refuses(load_scene, path)
    path.write_text(head + "a = " + "9" * 5000, encoding="utf-8")
    assert "is not valid TOML" in refuses(load_scene, path)
    with path.open("wb") as stream:
        stream.truncate(1 << 40)
    assert "more than the" in refuses(load_scene, path)


@pytest.mark.parametrize("time", [1e300, float("nan"), -1.0])
def test_a_time_that_the_scene_never_has_is_refused(lit, refuses, time):
    assert "the time" in refuses(render, lit.write(), [time])
