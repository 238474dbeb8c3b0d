"""Films: the pictures that went in, as a player reads them, and nothing half-written."""

from __future__ import annotations

import json

import av
import numpy as np
import pytest

from phoslab.app.cli import main
from phoslab.colorimetry import display_srgb
from phoslab.errors import PhoslabError
from phoslab.render import TransportParameters, load_scene, render, render_film
from phoslab.render.film import MOST_FRAMES, film_times
from phoslab.sample_data.make_scenes import SCENES

TILES = TransportParameters("tiles", directions=4)


def pictures(path):
    with av.open(str(path)) as film:
        stream = film.streams.video[0]
        return stream.average_rate, [f.to_ndarray(format="rgb24") / 255 for f in film.decode(stream)]


def test_a_film_holds_the_pictures_of_its_times(tmp_path):
    """Lamp on, lamp off, then a fade by its basis: each picture's mean is that of the same picture alone.

    Of 8-bit YUV each value is off by a step at most, and its mean by half a step of each of three: 1.5 / 255.
    """
    scene = load_scene(SCENES / "cornell")
    out = tmp_path / "glow.mp4"
    warnings = render_film(scene, out, 19.0, 23.0, 2.0, transport=TILES, size=(64, 48), supersampling=1)
    assert warnings == ()
    rate, film = pictures(out)
    assert rate == 2
    frames = render(scene, film_times(19.0, 23.0, 2.0), transport=TILES, size=(64, 48), supersampling=1)
    assert len(film) == len(frames) == 8
    for shown, frame in zip(film, frames.frames, strict=True):
        want = display_srgb(frame.xyz, frames.exposure_of(frame))
        assert shown.shape == want.shape
        np.testing.assert_allclose(shown.mean(axis=(0, 1)), want.mean(axis=(0, 1)), atol=1.5 / 255)


def test_what_moves_is_seen_to_move(tmp_path):
    out = tmp_path / "lantern.mp4"
    render_film(load_scene(SCENES / "lantern"), out, 1.0, 4.0, 1.0, size=(64, 48), supersampling=1)
    _, film = pictures(out)
    columns = [np.average(np.arange(64), weights=picture.sum(axis=(0, 2))) for picture in film]
    assert (np.diff(columns) > 1).all()


def test_an_odd_size_is_one_pixel_more(tmp_path):
    out = tmp_path / "odd.mp4"
    render_film(load_scene(SCENES / "fading"), out, 21.0, 22.0, 2.0, size=(33, 25), supersampling=1)
    _, film = pictures(out)
    assert film[0].shape == (26, 34, 3)


def test_black_pictures_are_counted(tmp_path):
    """An empty scene before its lamp: black, and said to be; the exposure is chosen on what is first seen."""
    scene = SCENES / "lantern" / "scene.toml"
    late = scene.read_text(encoding="utf-8").replace("[[0, 4]]", "[[1, 4]]")
    (tmp_path / "scene.toml").write_text(late, encoding="utf-8")
    (tmp_path / "scene.glb").write_bytes((SCENES / "lantern" / "scene.glb").read_bytes())
    out = tmp_path / "late.mp4"
    warnings = render_film(load_scene(tmp_path), out, 0.0, 3.0, 1.0, size=(32, 24), supersampling=1)
    assert "1 of 3 pictures are shown black" in warnings[-1]
    _, film = pictures(out)
    assert film[0].max() < 2 / 255
    assert 0.2 < film[1].max() <= 1.0


def test_a_film_that_is_broken_off_leaves_nothing(tmp_path):
    def stop(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render_film(
            load_scene(SCENES / "fading"), tmp_path / "f.mp4", 0.0, 2.0, 4.0, size=(16, 16), progress=stop
        )
    assert list(tmp_path.iterdir()) == []


def test_the_command_writes_a_film(tmp_path, capsys):
    out = tmp_path / "f.mp4"
    arguments = ["--from", "off-1s", "--to", "off+1s", "--fps", "2", "--size", "32x24", "--json"]
    assert main(["render", str(SCENES / "fading"), "-o", str(out), *arguments]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == [str(out)]
    assert len(pictures(out)[1]) == 4


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "--to is missing"),
        (["--to", "0"], "holds no picture"),
        (["--from", "5", "--to", "4"], "holds no picture"),
        (["--to", "1", "--fps", "1e4"], "--fps is 10000 a second"),
        (["--to", "1", "--at", "2"], "--at belongs to single pictures"),
    ],
)
def test_a_film_of_nothing_is_refused(tmp_path, capsys, arguments, says):
    out = tmp_path / "f.mp4"
    assert main(["render", str(SCENES / "fading"), "-o", str(out), *arguments]) == 1
    assert says in capsys.readouterr().err
    assert not out.exists()


def test_a_film_too_long_for_anybody_is_refused():
    with pytest.raises(PhoslabError, match=str(MOST_FRAMES)):
        film_times(0.0, 1e9, 30.0)
