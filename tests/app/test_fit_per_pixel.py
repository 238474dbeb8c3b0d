"""`phoslab fit SESSION --per-pixel`, as it is typed."""

import json
import shutil
from dataclasses import replace
from importlib.resources import as_file, files

import numpy as np
import pytest

from phoslab.app.cli import main
from phoslab.material import Material
from phoslab.render import render
from phoslab.sample_data.glb import GlbWriter
from phoslab.sample_data.shapes import panel

FIT = ["--preset", "green", "--per-pixel", "--states", "2"]


@pytest.fixture(scope="module")
def session():
    with as_file(files("phoslab.sample_data") / "sessions" / "green-decay") as folder:
        yield folder


@pytest.fixture(scope="module")
def folder(session, tmp_path_factory):
    out = tmp_path_factory.mktemp("fit") / "maps"
    assert main(["fit", str(session), *FIT, "-o", str(out)]) == 0
    return out


def test_a_folder_holds_material_maps_previews_and_reports(folder):
    assert {p.name for p in folder.iterdir()} == {
        *("material.json", "kr.exr", "emission.exr", "report.html", "sample.html"),
        *("amplitude.exr", "kr_error.exr", "amplitude_error.exr", "quality.exr", "flags.png"),
        *(f"{name}{i}.png" for name in ("kr", "amplitude") for i in range(1, 3)),
        *(f"kr{i}_error.png" for i in range(1, 3)),
    }
    assert [p.name for p in folder.parent.iterdir()] == ["maps"]
    page = (folder / "report.html").read_text()
    assert "do not glow and are masked" in page
    assert page.count("data:image/png") == 7


def test_json_tells_what_a_program_needs(session, tmp_path, capsys):
    assert main(["fit", str(session), *FIT, "-o", str(tmp_path / "maps"), "--bin", "2", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["states"] == 2
    assert said["counts"]["fitted"] > 300
    rates = [row["median"] for row in said["kr_per_s"]]
    assert rates == pytest.approx(Material.load(said["material"]).kr_per_s, rel=0.05)


def test_a_scene_renders_with_the_maps_and_shows_the_star_upright(folder, tmp_path):
    """Its tip is the photograph's top; the corners are dark; it fades as the sample does."""
    glb = GlbWriter()
    glb.camera("camera", eye=(0, 0.5, 1.2), target=(0, 0.5, 0), yfov_deg=45)
    sheet = panel((-0.5, 0, 0), (1, 0, 0), (0, 1, 0))
    assert sheet.uv is not None
    # In glTF a picture's first row is v = 0, and it is on top.
    sheet = replace(sheet, uv=np.stack([sheet.uv[:, 0], 1 - sheet.uv[:, 1]], axis=1))
    glb.mesh("sheet", sheet, glb.material((0.5, 0.5, 0.5)))
    glb.save(tmp_path / "scene.glb")
    shutil.copytree(folder, tmp_path / "maps")
    (tmp_path / "scene.toml").write_text(
        'schema = "phoslab-scene/1"\ngltf = "scene.glb"\n[units]\nsystem = "relative"\n'
        '[phosphors.sheet]\nmaterial = "maps/material.json"\nradiance_factor = 1e-8\n'
        '[initial]\nstate = "saturated"\n'
    )
    first, later = render(tmp_path, ["0", "60"], size=(64, 64))
    glow = first.radiance.sum(axis=-1)
    assert glow[:6, :6].max() == glow[:6, -6:].max() == 0
    assert glow[32, 32] > 0
    assert glow[6, 32] > 0  # the tip
    assert glow[-7, 32] == 0  # between the feet
    fading = later.radiance.sum(axis=-1)[32, 32] / glow[32, 32]
    material = Material.load(folder / "material.json")
    light = (material.kr_per_s * material.emission.sum(axis=1)) @ np.exp(
        -np.outer(material.kr_per_s, [0, 60])
    )
    assert fading == pytest.approx(
        light[1] / light[0], rel=0.03
    )  # a pixel's noise, and the sample is uniform


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("TABLE --preset green -o OUT", "is a table, which has no pixels"),
        ("SESSION -o OUT", "--preset is missing"),
        ("SESSION --preset green", "-o is missing"),
        ("SESSION SESSION/. --preset green -o OUT", "two sessions have the same name"),
        ("SESSION --preset green -o OUT --scheduler tcp://192.0.2.7:8786", "unencrypted"),
        ("SESSION --preset green -o FULL", "holds something already"),
        ("SESSION --preset green -o TABLE", "is not a folder"),
        ("SESSION --preset green -o INSIDE", "never written to"),
        ("SESSION --preset green -o OUT --report r.html", "into the folder of the maps"),
        ("SESSION --preset green -o OUT --bin 36", "--bin"),
        ("NOWHERE --preset green -o OUT", "NOWHERE"),
    ],
)
def test_what_cannot_be_done_is_said_and_leaves_nothing_behind(arguments, said, session, tmp_path, capsys):
    (tmp_path / "table.csv").write_text("t_s,lum\n0,1\n10,0.5\n")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "note").write_text("mine")
    before = sorted(tmp_path.iterdir())
    places = {
        "TABLE": tmp_path / "table.csv",
        "SESSION": session,
        "SESSION/.": session.parent / "green" / ".." / session.name,
        "OUT": tmp_path / "out",
        "FULL": tmp_path / "full",
        "INSIDE": session / "maps",
    }
    assert main(["fit", "--per-pixel", *(str(places.get(word, word)) for word in arguments.split())]) == 1
    assert said in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == before
    assert not (session / "maps").exists()


def test_several_sessions_get_a_folder_each_and_workers_give_the_same_maps(folder, session, tmp_path):
    distributed = pytest.importorskip("distributed", reason="pip install phoslab[campaign]")
    for name in ("a", "b"):
        shutil.copytree(session, tmp_path / name)
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        arguments = [*FIT, "--scheduler", cluster.scheduler_address, "-o", str(tmp_path / "maps")]
        assert main(["fit", str(tmp_path / "a"), str(tmp_path / "b"), *arguments]) == 0
    assert sorted(p.name for p in (tmp_path / "maps").iterdir()) == ["a", "b"]
    for name in ("kr.exr", "amplitude_error.exr", "quality.exr"):
        assert (tmp_path / "maps" / "b" / name).read_bytes() == (folder / name).read_bytes()


def test_a_folder_of_sessions_lends_its_own_spectrum_rates_and_shading(session, tmp_path, capsys):
    """Nothing is borrowed, and the lens's falloff, which the calibration's flats have told, is taken out."""
    sessions = session.parent / "green"
    arguments = ["--per-pixel", "--lvf", str(sessions / "lvf.json"), "--bin", "4", "--json"]
    assert main(["fit", str(sessions), *arguments, "-o", str(tmp_path / "maps")]) == 0
    said = json.loads(capsys.readouterr().out)
    assert not any("falloff" in w for w in said["warnings"])
    material = Material.load(said["material"])
    assert material.reference_irradiance is not None
    assert material.provenance["settings"]["preset"] is None


def test_pixels_are_averaged_for_maps_only(session, tmp_path, capsys):
    out = tmp_path / "green.json"
    assert main(["fit", str(session), "--preset", "green", "--bin", "2", "-o", str(out)]) == 1
    assert "--bin is for maps" in capsys.readouterr().err
    assert not out.exists()
