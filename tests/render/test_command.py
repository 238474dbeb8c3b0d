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
    from phoslab.render.renderer import PASSES

    out = tmp_path / "glow.png"
    wanted = ",".join(p.name for p in PASSES)
    assert main(["render", scene, "-o", str(out), "--at", "1", "--size", "8x8", "--debug", wanted]) == 0
    views = {path.name.split(".")[1] for path in tmp_path.glob("glow.*.png")}
    assert views == {p.name for p in PASSES}


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--at", "soon"], "'soon' is not understood"),
        (["--size", "640"], "--size is '640'"),
        (["--size", "0x5"], "--size is '0x5'"),
        (["--solver", "magic"], "Use one of: euler, substep, exact"),
        (["--debug", "nothing"], "'nothing' is unknown"),
        (["-o", "glow.jpg"], "Name a .png or .exr"),
        (["--size", "99999x99999"], "more than this OpenGL driver can hold"),
    ],
)
def test_an_error_is_one_sentence_and_exit_code_1(scene, tmp_path, capsys, arguments, says):
    out = tmp_path / "glow.png"
    assert main(["render", scene, "-o", str(out), "--at", "1", "--size", "8x8", *arguments]) == 1
    message = capsys.readouterr().err
    assert says in message
    assert message.count("\n") == 1
    assert not out.exists()
