"""`phoslab render` from the command line: files, warnings, exit codes."""

from __future__ import annotations

import json

import pytest
from PIL import Image

from phoslab.app.cli import main


@pytest.fixture
def scene(quad, lamp_toml, green_toml):
    return str(quad.lamp().text(lamp_toml + green_toml).write())


def test_it_writes_what_it_says_and_exits_with_0(scene, tmp_path, capsys):
    out = tmp_path / "out" / "glow.png"
    assert main(["render", scene, "-o", str(out), "--at", "0,off+1s", "--size", "20x10"]) == 0
    names = [line.rsplit("/", 1)[-1] for line in capsys.readouterr().out.split()]
    assert names == ["glow-0.png", "glow-off+1s.png"]
    assert Image.open(out.with_name("glow-0.png")).size == (20, 10)


def test_json_lists_files_and_warnings(scene, tmp_path, capsys):
    out = str(tmp_path / "glow.exr")
    assert main(["render", scene, "-o", out, "--at", "off+1000s", "--size", "8x8", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["files"] == [out]
    assert "beyond the 180 s" in said["warnings"][0]


def test_euler_steps_as_asked(scene, tmp_path):
    out = str(tmp_path / "glow.png")
    assert main(["render", scene, "-o", out, "--at", "1", "--solver", "euler", "--step", "0.1"]) == 0


def test_every_pass_shows_what_it_made(scene, tmp_path, capsys):
    from phoslab.render.renderer import DEBUG_NAMES

    out = tmp_path / "glow.png"
    args = ["render", scene, "-o", str(out), "--at", "1", "--size", "8x8", "--gi", "tiles"]
    assert main([*args, "--debug", ",".join(DEBUG_NAMES)]) == 0
    views = {path.name.split(".")[1] for path in tmp_path.glob("glow.*.png")}
    assert views == set(DEBUG_NAMES)


def test_the_command_line_knows_the_names_that_the_renderer_knows():
    """It holds them as literals, so that `--help` loads no renderer."""
    from phoslab.app import glow_options
    from phoslab.app import render as command
    from phoslab.render.fade_basis import SUFFIX
    from phoslab.render.glow_methods import NAMES
    from phoslab.render.renderer import DEBUG_NAMES, TRANSPORT_VIEWS
    from phoslab.render.solvers import SOLVERS
    from phoslab.render.state_formats import FORMATS

    assert command.SOLVERS == tuple(SOLVERS)
    assert command.FORMATS == tuple(FORMATS)
    assert command.PASSES == DEBUG_NAMES
    assert command.VIEWS == TRANSPORT_VIEWS
    assert glow_options.METHODS == NAMES
    assert command.BASIS == SUFFIX


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--at", "soon"], "'soon' is not understood"),
        (["--at", "1,off+x"], "'off+x' is not understood"),
        (["--at", "-1"], "'-1' is before the scene begins"),
        (["--at", "1e999"], "'1e999' is later than 1e+12 s"),
        (["--at", ""], "'' names nothing"),
        (["--at", ","], "',' names nothing"),
        (["--size", "640"], "'640' is no width x height"),
        (["--size", "0x5"], "'0x5' is no width x height"),
        (["--size", "99999x99999"], "each from 1 to 16384"),
        (["--solver", "magic"], "invalid choice: 'magic'"),
        (["--state-format", "f8"], "invalid choice: 'f8'"),
        (["--step", "0"], "'0' is no positive number"),
        (["--step", "nan"], "'nan' is no positive number"),
        (["--step", "soon"], "'soon' is no positive number"),
        (["--gi", "magic"], "invalid choice: 'magic'"),
        (["--directions", "0"], "'0' is no whole number from 1"),
        (["--samples", "1.5"], "'1.5' is no whole number from 1"),
        (["--filter", "3"], "invalid choice: 3"),
        (["--debug", "nothing"], "'nothing' is no pass"),
        (["--debug", ","], "',' names nothing"),
        (["-o", "glow.jpg"], "'glow.jpg' is no file name that ends in .png or .exr or .mp4"),
        (["--fps", "0"], "'0' is no positive number"),
        (["--from", "soon"], "'soon' is not understood"),
        (["-o", "glow"], "'glow' is no file name"),
    ],
)
def test_bad_usage_exits_with_2_before_the_scene_is_looked_at(tmp_path, capsys, arguments, says):
    out = tmp_path / "glow.png"
    with pytest.raises(SystemExit) as exited:
        main(["render", "no-such-scene", "-o", str(out), *arguments])
    assert exited.value.code == 2
    assert says in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--at", "off-20s"], "'off-20s' is before the scene begins"),
        (["--at", "9", "--solver", "euler", "--step", "1000"], "overshoots"),
        (["--gi", "tiles", "--directions", "1000"], "the number of directions is 1000"),
        (["--gi", "tiles", "--cell", "nan"], "the cells' radius is nan"),
        (["--to", "2"], "--to belongs to a film"),
        (["--gi", "tiles", "--surfel", "0.1"], "--surfel is for --gi dss, dss-z, and this is tiles"),
        (["--gi", "none", "--filter", "0"], "--filter is for --gi tiles, dss-z, and this is none"),
        (["--gi", "dss", "--detail", "0.1"], "--detail is for --gi tiles, and this is dss"),
        (["--samples", "9"], "--samples is for --gi reference, and this is tiles"),
        (["--full-transport"], "--full-transport is for --gi reference"),
        (["--gi", "reference", "--lamp-bounces"], "--lamp-bounces is for --gi tiles, dss, dss-z"),
        (["--gi", "reference", "--full-transport", "--bounces", "3"], "--bounces ends light that"),
        (["--trade", "trade.json"], "--trade is for plans"),
    ],
)
def test_an_error_is_one_sentence_and_exit_code_1(scene, tmp_path, capsys, arguments, says):
    out = tmp_path / "glow.png"
    assert main(["render", scene, "-o", str(out), "--at", "1", "--size", "8x8", *arguments]) == 1
    message = capsys.readouterr().err
    assert says in message
    assert message.count("\n") == 1
    assert not out.exists()


def test_an_output_that_cannot_be_written_is_refused_before_rendering(tmp_path, capsys):
    (tmp_path / "glow.png").mkdir()
    assert main(["render", "no-such-scene", "-o", str(tmp_path / "glow.png")]) == 1
    assert "glow.png is a folder" in capsys.readouterr().err.replace(": ", " ")
    (tmp_path / "file").touch()
    assert main(["render", "no-such-scene", "-o", str(tmp_path / "file" / "glow.png")]) == 1
    assert "cannot be written" in capsys.readouterr().err


def test_capital_letters_mean_the_same(scene, tmp_path, capsys):
    out = tmp_path / "GLOW.PNG"
    assert main(["render", scene, "-o", str(out), "--at", "1", "--size", "20X10"]) == 0
    assert Image.open(out).size == (20, 10)
    assert main(["render", scene, "-o", str(tmp_path / "GLOW.EXR"), "--at", "1", "--size", "8X8"]) == 0
    assert (tmp_path / "GLOW.EXR").read_bytes()[:4] == b"\x76\x2f\x31\x01"


def test_a_time_given_twice_is_one_file(scene, tmp_path, capsys):
    out = str(tmp_path / "glow.png")
    assert main(["render", scene, "-o", out, "--at", "1, 1", "--size", "8x8"]) == 0
    assert capsys.readouterr().out.split() == [out]
    from phoslab.render import render

    written = render(scene, ["1", "2", "1"], size=(8, 8)).write(out)
    assert [path.name for path in written] == ["glow-1.png", "glow-2.png"]


def test_nothing_is_said_on_stderr_where_no_terminal_is(scene, tmp_path, capfd):
    assert main(["render", scene, "-o", str(tmp_path / "glow.png"), "--at", "1", "--size", "8x8"]) == 0
    assert capfd.readouterr().err == ""


def test_a_png_names_the_scene_that_it_shows(scene, tmp_path, monkeypatch):
    """Even where the scene is given as a file of the current folder."""
    monkeypatch.chdir(tmp_path)
    assert main(["render", "scene.toml", "-o", "glow.png", "--at", "1", "--size", "8x8"]) == 0
    assert Image.open("glow.png").text["Source"] == f"{tmp_path.name}/scene.toml"
