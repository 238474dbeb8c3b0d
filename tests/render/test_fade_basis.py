"""Fading in the dark as a weighted sum of pictures, against rendering every frame."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

from phoslab.app.cli import main
from phoslab.render import TransportParameters, load_scene, render, render_fade_basis
from phoslab.render.device import Device
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.sample_data.make_scenes import SCENES

# Some 30 roundings on the way to a pixel, and sums of 32 terms: as many half units in the last place of the brightest.
FLOAT32 = 128 * 2.0**-24
TIMES = ("off", "off+0.3s", "off+7s", "off+60s")
TILES = TransportParameters("tiles", directions=4)
WAYS = {
    "none": TransportParameters(),
    "tiles": TILES,
    "tiles, sent on": TransportParameters("tiles", directions=4, bounces=3),
    "dss-z": TransportParameters("dss-z", directions=2, surfel=0.05),
}


@pytest.mark.parametrize("transport", WAYS.values(), ids=WAYS)
@pytest.mark.parametrize("name", ["cornell", "fading"])
def test_the_sum_equals_the_frames(name, transport):
    """Materials of several rates, one of two states, charged unevenly by a lamp."""
    scene = load_scene(SCENES / name)
    with Device() as device:
        p = RenderParameters((64, 48), 1, transport=transport)
        renderer = Renderer(device, scene, p)
        moments = [scene.schedule.parse_time(t) for t in TIMES]
        frames = [renderer.frame(t).radiance for t in moments]
        basis = renderer.fade_basis(moments[0])
    assert len(basis.rates_per_s) >= 2
    for t, frame in zip(moments, frames, strict=True):
        np.testing.assert_allclose(basis.at(t), frame, rtol=FLOAT32, atol=FLOAT32 * frame.max())


def test_the_traced_picture_fades_by_the_same_sum():
    """Paths are others where an emitter is left out, so only the light of the whole picture can agree: of 24² pixels x
    256 paths of a relative deviation below 4, the mean of each is known to 1 %; 3 % is two of their difference."""
    pytest.importorskip("mitsuba")
    scene = load_scene(SCENES / "cornell")
    transport = TransportParameters("reference", samples=256)
    with Device() as device:
        renderer = Renderer(device, scene, RenderParameters((24, 24), 1, transport=transport))
        t0, t1 = (scene.schedule.parse_time(t) for t in ("off", "off+9s"))
        renderer.frame(t1)
        want = renderer.transport.reflected.sum(axis=(0, 1))
        seen = renderer.frame(t1).radiance.sum(axis=(0, 1)) - want
        basis = renderer.fade_basis(t0)
    got = basis.at(t1).sum(axis=(0, 1)) - seen
    bright = want > 0.1 * want.max()
    np.testing.assert_allclose(got[bright], want[bright], rtol=0.03)


def test_a_basis_of_dss_is_near_and_is_not_taken_unasked(tmp_path, capsys, monkeypatch):
    """How far a disk's light is followed depends on its brightness: to --epsilon (2 %) of the frame's glow."""
    dss = TransportParameters("dss", surfel=0.05)
    scene = load_scene(SCENES / "cornell")
    frames = render(scene, [f"off+{k}s" for k in range(8)], size=(24, 24), transport=dss)
    alone = render(scene, ["off+7s"], size=(24, 24), transport=dss)
    np.testing.assert_array_equal(frames[7].radiance, alone[0].radiance)
    basis = render_fade_basis(scene, "off", size=(24, 24), transport=dss)
    off = basis.at(scene.schedule.parse_time("off+7s")) - alone[0].radiance
    assert 0 < np.abs(off).max() < 0.05 * alone[0].radiance.max()
    args = ["render", "cornell", "--size", "16x16", "--gi", "dss", "-o", str(tmp_path / "a.basis.exr")]
    assert main(args) == 0
    assert "within some per cent" in capsys.readouterr().out


@pytest.mark.parametrize("option", [["--solver", "euler"], ["--step", "1"], ["--debug", "gbuffer"]])
def test_what_a_basis_cannot_have_is_refused(tmp_path, capsys, option):
    out = tmp_path / "a.basis.exr"
    assert main(["render", "cornell", "--size", "16x16", "-o", str(out), *option]) == 1
    assert f"{option[0]} cannot be chosen" in capsys.readouterr().err
    assert not out.exists()


def test_a_film_in_the_dark_takes_as_many_pictures_as_there_are_rates(monkeypatch):
    drawn = []
    draw = Renderer._draw
    monkeypatch.setattr(Renderer, "_draw", lambda *a: (drawn.append(1), draw(*a))[1])
    film = render(SCENES / "cornell", [f"off+{k}s" for k in range(40)], size=(16, 16), transport=TILES)
    scene = load_scene(SCENES / "cornell")
    rates = {r for d in scene.phosphors for r in d.phosphor.optics.uniform_kr.tolist()}
    assert len(drawn) == len(rates)
    assert len(film) == 40


def test_no_sum_before_it_begins_nor_in_the_light(refuses):
    scene = load_scene(SCENES / "cornell")
    basis = render_fade_basis(scene, "off+1s", size=(8, 8))
    assert "before 21 s" in refuses(basis.at, 20.5)
    assert "cannot begin at 5 s: a light is on" in refuses(render_fade_basis, scene, 5.0, size=(8, 8))


def test_a_basis_file_gives_any_later_picture(tmp_path, capsys):
    path, out = tmp_path / "glow.basis.exr", tmp_path / "late.exr"
    args = ["render", str(SCENES / "cornell"), "--size", "32x24", "--gi", "tiles"]
    assert main([*args, "-o", str(path)]) == 0
    assert main(["render", str(path), "-o", str(out), "--at", "off+12s", "--json"]) == 0
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert said["files"] == [str(out)]
    want = tmp_path / "want.exr"
    assert main([*args, "-o", str(want), "--at", "off+12s"]) == 0
    import OpenEXR

    with OpenEXR.File(str(out)) as a, OpenEXR.File(str(want)) as b:
        assert a.channels().keys() == b.channels().keys()
        for name, channel in b.channels().items():
            pixels = channel.pixels
            np.testing.assert_allclose(
                a.channels()[name].pixels, pixels, rtol=FLOAT32, atol=FLOAT32 * np.abs(pixels).max()
            )


def test_a_file_that_is_no_basis_is_refused_in_one_sentence(tmp_path, capsys):
    path = tmp_path / "no.basis.exr"
    assert (
        main(
            ["render", str(SCENES / "occluder"), "-o", str(tmp_path / "a.exr"), "--at", "0", "--size", "8x8"]
        )
        == 0
    )
    (tmp_path / "a.exr").rename(path)
    assert main(["render", str(path), "-o", str(tmp_path / "b.png")]) == 1
    assert "is not a fade basis" in capsys.readouterr().err
    path.write_bytes(b"nothing")
    assert main(["render", str(path), "-o", str(tmp_path / "b.png")]) == 1
    assert "cannot be read as an OpenEXR image" in capsys.readouterr().err


def test_a_basis_is_shown_as_its_scene_is(tmp_path, capsys):
    """`occluder` has its exposure chosen anew at 30 s, when its green has faded far: a picture of then is not black."""
    path = tmp_path / "occluder.basis.exr"
    assert main(["render", "occluder", "-o", str(path), "--at", "0", "--size", "24x24", "--gi", "none"]) == 0
    direct, late = tmp_path / "direct.png", tmp_path / "late.png"
    assert (
        main(["render", "occluder", "-o", str(direct), "--at", "30", "--size", "24x24", "--gi", "none"]) == 0
    )
    assert main(["render", str(path), "-o", str(late), "--at", "30"]) == 0
    assert "black" not in capsys.readouterr().out
    seen = [np.asarray(Image.open(p), dtype=int) for p in (direct, late)]
    assert seen[0].max() > 100
    assert abs(seen[0] - seen[1]).max() <= 1


@pytest.mark.parametrize(
    "option",
    [
        ["--gi", "none"],
        ["--filter", "0"],
        ["--samples", "9"],
        ["--state-format", "f16"],
        ["--trade", "trade.json"],
        ["--max-error", "3%"],
        ["--size", "9x9"],
        [],
    ],
)
def test_what_is_rendered_already_takes_no_options_of_rendering(tmp_path, capsys, option):
    path, out = tmp_path / "glow.basis.exr", tmp_path / ("late.exr" if option else "late.basis.exr")
    assert main(["render", "fading", "-o", str(path), "--size", "16x12", "--gi", "none"]) == 0
    capsys.readouterr()
    assert main(["render", str(path), "-o", str(out), *option]) == 1
    assert (option[0] if option else "late.basis.exr") in capsys.readouterr().err
    assert not out.exists()
