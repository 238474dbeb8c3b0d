"""Sessions that do not hold what a fit needs: what cannot be determined is said and why; the rest is delivered."""

import json
import shutil
from importlib.resources import as_file, files

import pytest

from phoslab.app.cli import main

CONTENT = ("frame", "sha256", "bytes", "exposure_s")


@pytest.fixture(scope="module")
def samples():
    with as_file(files("phoslab.sample_data") / "sessions") as folder:
        yield folder


@pytest.fixture
def told(samples, tmp_path, capsys):
    """What `fit` says of a copy of the sample decay whose journal was edited, and its exit code."""

    def fit(edit, *options):
        folder = tmp_path / "session"
        shutil.copytree(samples / "green-decay", folder)
        lines = [json.loads(x) for x in (folder / "journal.jsonl").read_text().splitlines()]
        shots = [x for x in lines if x["event"] == "exposure"]
        edit(
            [x for x in shots if x["role"] == "decay"],
            {x["exposure_s"]: x for x in shots if x["role"] == "dark"},
            folder,
        )
        (folder / "journal.jsonl").write_text("".join(json.dumps(x) + "\n" for x in lines))
        code = main(["fit", str(folder), "-o", str(tmp_path / "m.json"), *options])
        said = capsys.readouterr()
        assert (tmp_path / "m.json").exists() == (code == 0)
        return code, said.out + said.err

    return fit


def becomes(shot, other):
    shot.update({k: other[k] for k in CONTENT})


def backwards(decay, darks, folder):
    """The light rises."""
    contents = [dict(x) for x in decay]
    for shot, other in zip(decay, reversed(contents), strict=True):
        becomes(shot, other)


def dark(decay, darks, folder):
    """Nothing glows."""
    for shot in decay:
        shutil.copy(folder / "frames" / darks[shot["exposure_s"]]["frame"], folder / "frames" / shot["frame"])
        shot.update({k: darks[shot["exposure_s"]][k] for k in ("sha256", "bytes")})


def others(decay, darks, folder):
    """All frames but one are not of the decay."""
    for shot in decay[1:]:
        shot["role"] = "flat"


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (backwards, "every channel rises instead of falling"),
        (dark, "shows no sample that stands out from the dark"),
        (others, "every channel has values at one time only: a rate needs two"),
    ],
)
def test_a_session_without_a_decay_is_refused_with_the_reason(told, edit, words):
    code, said = told(edit)
    assert code == 1
    assert words in said
    assert "Traceback" not in said


def test_two_exposures_at_one_time_are_named(told):
    def repeat(decay, darks, folder):
        for key in ("at_mono_s", "at_device_s"):
            decay[5][key] = decay[4][key]

    code, said = told(repeat)
    assert code == 0
    assert "0004.dng and 0005.dng were exposed at once" in said


def test_states_that_few_frames_do_not_tell_apart_are_said_not_to_be_determined(told):
    def few(decay, darks, folder):
        for shot in decay[3:]:
            shot["role"] = "flat"

    code, said = told(few, "--states", "2")
    assert code == 0
    assert "9 values for 6 parameters are few" in said
    assert "The data do not determine the rates" in said


def test_without_a_calibration_rates_are_delivered_and_the_rest_is_named(samples, tmp_path, capsys):
    folders = [str(samples / "green" / plan) for plan in ("decay", "emission", "excitation", "lamp")]
    assert main(["fit", *folders, "-o", str(tmp_path / "m.json"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert len(said["kr_per_s"]) == 3
    missing = " ".join(said["missing"])
    for what in ("excitation rates (ke)", "the spectrum of the glow"):
        assert what in missing
    assert "--lvf" in missing


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (["fit", "emission", "-o", "OUT"], "none of a decay: without it there are no rates"),
        (
            ["spectrum", "decay", "--lvf", "lvf.json", "-o", "OUT"],
            "Name a session of the plan 'lamp' or 'emission'",
        ),
        (["calibrate", "decay", "-o", "OUT"], "Name one session of the plan 'lvf'"),
        (["spectrum", "emission", "--lvf", "none.json", "-o", "OUT"], "Write it with `phoslab calibrate"),
    ],
)
def test_a_session_of_another_plan_is_told_which_is_needed(samples, tmp_path, capsys, command, words):
    names = {"OUT": tmp_path / "out"} | {
        n: samples / "green" / n for n in ("decay", "emission", "lvf.json", "none.json")
    }
    assert main([str(names.get(word, word)) for word in command]) == 1
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
