"""What `phoslab fit`, `export` and the command line itself refuse, and how."""

import json
import math
import os
import shlex
import subprocess
import sys
from importlib.resources import as_file, files

import pytest

from phoslab.app import cli


@pytest.fixture(scope="module")
def session():
    with as_file(files("phoslab.sample_data") / "sessions" / "green-decay") as folder:
        yield folder


def test_fit_never_writes_in_the_session(session, capsys):
    before = (session / "session.toml").read_bytes()
    assert cli.main(["fit", str(session), "--preset", "green", "-o", str(session / "session.toml")]) == 1
    assert "lies in the session" in capsys.readouterr().err
    assert (session / "session.toml").read_bytes() == before


def test_two_outputs_in_one_file_are_refused_before_the_work(session, tmp_path, capsys):
    out = str(tmp_path / "x.json")
    assert cli.main(["fit", str(session), "--preset", "green", "-o", out, "--report", out]) == 1
    assert "named twice" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_an_output_that_is_a_folder_is_refused_before_the_work(session, tmp_path, capsys):
    arguments = ["fit", str(session), "--preset", "green", "-o", str(tmp_path / "m.json")]
    assert cli.main([*arguments, "--report", str(tmp_path)]) == 1
    assert "is a folder" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_export_does_not_overwrite_the_material(tmp_path, capsys):
    from phoslab import preset

    file = tmp_path / "m.json"
    preset("green").save(file)
    before = file.read_text()
    assert cli.main(["export", str(file), "--to", "csv", "-o", str(file)]) == 1
    assert "is the material itself" in capsys.readouterr().err
    assert file.read_text() == before


def test_an_unknown_preset_is_bad_usage(session, tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        cli.main(["fit", str(session), "--preset", "nope", "-o", str(tmp_path / "m.json")])
    assert stopped.value.code == cli.BAD_USAGE
    assert "green" in capsys.readouterr().err


def table(folder):
    path = folder / "decay.csv"
    path.write_text("t_s,lum\n" + "".join(f"{5 * i},{0.9**i + 0.003 * (-1) ** i:.6g}\n" for i in range(20)))
    return path


def test_a_table_is_fitted_without_preset_and_output(tmp_path, capsys):
    assert cli.main(["fit", str(table(tmp_path)), "--states", "1", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["kr_per_s"] == pytest.approx([-math.log(0.9) / 5], rel=0.02)
    assert [p.name for p in tmp_path.iterdir()] == ["decay.csv"]


def test_the_report_of_a_table_gives_intervals_criteria_and_reasons(tmp_path, capsys):
    assert cli.main(["fit", str(table(tmp_path)), "--extrapolate", "50,500"]) == 0
    said = capsys.readouterr().out
    for part in (
        "95 %:",
        "AICc",
        "cross-validation",
        "Becquerel",
        "500 s",
        "beyond the data",
        "sigma-estimated",
    ):
        assert part in said


def test_the_page_of_a_table_explains_its_numbers(tmp_path):
    page = tmp_path / "r.html"
    assert cli.main(["fit", str(table(tmp_path)), "--report", str(page), "--extrapolate", "50"]) == 0
    said = page.read_text()
    assert "<pre" not in said
    for part in (
        "Rates",
        "Amplitudes",
        "How many states?",
        "Other laws",
        "At other times",
        "by construction",
    ):
        assert part in said


def test_the_page_of_a_table_that_misses_promises_no_true_rate(tmp_path):
    path, page = tmp_path / "power.csv", tmp_path / "r.html"
    path.write_text("t_s,lum\n" + "".join(f"{2 * 1.5**i:.6g},{1000 / 1.5**i:.6g}\n" for i in range(18)))
    assert cli.main(["fit", str(path), "--report", str(page)]) == 0
    said = " ".join(page.read_text().split())
    assert "95 of 100 measurements" not in said
    assert "no true rate" in said
    assert "the worst is missed by" in said
    assert "misfit [%]" in said
    warned, _, usual = said.partition("As usual, and good to know")
    assert "other-law" not in said  # sentences, not codes
    assert warned.count("law describes the values better") == 1
    assert "The table gives no σ" in usual


def test_a_name_that_is_not_there_is_said_before_what_else_is_missing(tmp_path, capsys):
    assert cli.main(["fit", str(tmp_path / "missing.csv")]) == 1
    assert "missing.csv: does not exist" in capsys.readouterr().err


def test_the_fit_of_a_table_does_not_overwrite_it(tmp_path, capsys):
    path = table(tmp_path)
    before = path.read_text()
    assert cli.main(["fit", str(path), "-o", str(path)]) == 1
    assert path.read_text() == before


def test_a_decay_alone_is_fitted_and_what_is_missing_stands_first(session, tmp_path, capsys):
    out = tmp_path / "m.json"
    assert cli.main(["fit", str(session), "-o", str(out)]) == 0
    said = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in said[:3]] == ["Note", "Missing", "Missing"]
    assert json.loads(out.read_text())["ke_m2_per_J"][0][0] is None
    assert cli.main(["fit", str(session), "--preset", "green"]) == 1
    assert "-o is missing" in capsys.readouterr().err


def test_the_page_of_a_fit_that_misses_promises_no_true_rate(session, tmp_path):
    pages = []
    for states in ("1", "auto"):
        page = tmp_path / f"{states}.html"
        arguments = ["-o", str(tmp_path / "m.json"), "--states", states, "--report", str(page)]
        assert cli.main(["fit", str(session), *arguments]) == 0
        pages.append(" ".join(page.read_text().split()))
    asked, chosen = pages
    assert "1, as was asked for (--states 1)" in asked
    assert "not a sum of so few exponentials" in asked
    assert "95 of 100 measurements" not in asked
    assert "Of 1 to 3 the largest number" in chosen


def test_a_rising_table_is_one_sentence(tmp_path, capsys):
    path = tmp_path / "r.csv"
    path.write_text("t_s,lum\n" + "".join(f"{i},{i + 1}\n" for i in range(10)))
    assert cli.main(["fit", str(path)]) == 1
    assert "lum rises" in capsys.readouterr().err


def phoslab(*arguments: str, **options):
    return subprocess.run(
        [sys.executable, "-m", "phoslab", *arguments], text=True, timeout=120, check=False, **options
    )


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full on this system")  # noqa: PTH110
def test_a_full_disk_behind_stdout_is_one_sentence():
    with open("/dev/full", "w") as full:  # noqa: PTH123
        done = phoslab("presets", stdout=full, stderr=subprocess.PIPE)
    assert done.returncode == 1
    assert "No space left" in done.stderr
    assert "internal error" not in done.stderr
    assert "Traceback" not in done.stderr


def test_closed_streams_are_no_bug():
    done = subprocess.run(
        f"{shlex.quote(sys.executable)} -m phoslab presets >&-",
        shell=True,
        stderr=subprocess.PIPE,
        timeout=120,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b"")


def test_a_locale_without_the_sign_prints_all_the_same(session, tmp_path):
    done = phoslab(
        *("fit", str(session), "--preset", "green", "-o", str(tmp_path / "m.json")),
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
        capture_output=True,
    )
    assert done.returncode == 0
    assert "\\xb1" in done.stdout


def test_a_name_does_not_steer_the_terminal(tmp_path, capsys):
    assert (
        cli.main(["export", str(tmp_path / "a\x1b[2Jb"), "--to", "csv", "-o", str(tmp_path / "o.csv")]) == 1
    )
    assert "\x1b" not in capsys.readouterr().err


def test_a_session_is_continued_with_a_band_and_bootstrapped(session, tmp_path, capsys):
    arguments = [
        "fit",
        str(session),
        "--preset",
        "green",
        "--states",
        "3",
        "-o",
        str(tmp_path / "m.json"),
        "--json",
    ]
    assert cli.main([*arguments, "--bootstrap", "100", "--extrapolate", "60,3600"]) == 0
    found = json.loads(capsys.readouterr().out)
    inside, far = found["extrapolated"]
    for value, (low, high) in zip(inside["value"], inside["band95"], strict=True):
        assert 0.98 < low / value < high / value < 1.02  # a minute lies within the three that were measured
    assert all(high > 100 * low for low, high in far["band95"])  # nothing is known of an hour
    assert any("3600 s lies beyond the data" in w for w in found["warnings"])
    for (low, high), kr in zip(found["bootstrap95_per_s"], found["kr_per_s"], strict=True):
        assert low < kr < high


def test_what_is_continued_is_said_to_a_person(session, tmp_path, capsys):
    arguments = ["fit", str(session), "--preset", "green", "--states", "3", "-o", str(tmp_path / "m.json")]
    assert cli.main([*arguments, "--extrapolate", "3600"]) == 0
    assert "3600 s: R" in capsys.readouterr().out
