"""What a picture takes is known before it is made, and a texture is not multiplied on its way."""

from __future__ import annotations

import json
import re
import tracemalloc

import numpy as np
import pytest
from PIL import Image

import phoslab
from phoslab import maps
from phoslab.render import load_scene, memory, render


@pytest.fixture
def lit(quad, lamp_toml, green_toml):
    return quad.lamp().text(lamp_toml + green_toml)


def test_a_picture_that_no_memory_holds_is_refused_before_it_is_made(lit, refuses, monkeypatch):
    monkeypatch.setattr(memory, "available_bytes", lambda: 1_000_000)
    message = refuses(render, lit.write(), ["1"], size=(640, 480))
    assert re.search(
        r"a picture of 640 x 480 pixels takes 0.\d+ GB of memory, and 0.001 GB are free", message
    )
    assert "--size" in message


def test_an_atlas_that_no_memory_holds_is_refused(lit, refuses, monkeypatch):
    monkeypatch.setattr(memory, "available_bytes", lambda: 30_000_000)
    lit.toml = lit.toml.replace("atlas_texels = 64", "atlas_texels = 4096")
    message = refuses(render, lit.write(), ["1"], size=(8, 8))
    assert "a texture takes 0.268 GB of memory" in message
    assert "atlas_texels" in message


def test_what_the_driver_cannot_make_names_the_remedy(device, refuses):
    """A framebuffer of sizes that do not fit is what a lack of memory looks like, too."""
    import moderngl

    def make() -> None:
        raise moderngl.Error("the framebuffer is not complete (UNSUPPORTED)")

    message = refuses(device._store, make)
    assert "the framebuffer is not complete" in message
    assert "--size" in message


def test_a_map_too_wide_for_the_driver_is_named(lit, refuses):
    maps.write_map(lit.folder / "wide.exr", np.ones((1, 20_000, 1), np.float32))
    material = json.loads(phoslab.preset("green").to_json()) | {"maps": {"kr_per_s": "wide.exr"}}
    (lit.folder / "m.json").write_text(json.dumps(material), encoding="utf-8")
    lit.toml = lit.toml.replace("preset:green", "m.json")
    message = refuses(render, lit.write(), ["1"], size=(8, 8))
    assert str(lit.folder / "wide.exr") in message
    assert "the map of kr_per_s of 20000 x 1 texels" in message


def test_a_texture_costs_little_more_than_its_bands(lit):
    """Three colours in float32 and eight bands in float16 are 28 bytes a texel; the decoder takes some for a while."""
    side = 1024
    Image.effect_noise((side, side), 50).convert("RGB").save(lit.folder / "t.png")
    lit.gltf["images"], lit.gltf["textures"] = [{"uri": "t.png"}], [{"source": 0}]
    lit.gltf["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    path = lit.write()
    load_scene(path)  # what is loaded once is no texture
    tracemalloc.start()
    scene = load_scene(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert scene.drawables[0].reflectance.shape == (side, side, 8)
    assert peak < 36 * side * side
