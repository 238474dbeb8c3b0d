"""Calibration of the LVF and spectra through it, on recorded sessions of the bench, against the bench's own truth.

The bench's filter is not the model that is fitted: its map is bent and rippled, its bands have flat
tops and long tails.
"""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from phoslab.app.cli import main
from phoslab.errors import PhoslabError
from phoslab.fitting.lvf import POSITIONS_NM, calibrate
from phoslab.fitting.lvf_curves import GRID_NM
from phoslab.fitting.lvf_file import load, save
from phoslab.fitting.spectrum import NM, measure_spectrum
from phoslab.instruments.bench import lights, scene
from phoslab.instruments.bench.lvf import Lvf
from phoslab.instruments.bench.paints import paint

FILTERS = "L002,L035,L101,L122,L147,L179,L201,L225,L279,L366"


def measured(folder, plan, *options):
    """A session of the simulated bench, recorded by the real plan, drivers and recorder."""
    assert main(["measure", plan, "--simulate", "green", "-o", str(folder), "--json", *options]) == 0
    return folder


@pytest.fixture(scope="module")
def lvf_session(tmp_path_factory):
    return measured(tmp_path_factory.mktemp("lvf") / "lvf", "lvf", "--filters", FILTERS)


@pytest.fixture(scope="module")
def lamp_session(tmp_path_factory):
    return measured(tmp_path_factory.mktemp("lamp") / "lamp", "lamp")


@pytest.fixture(scope="module")
def emission_session(tmp_path_factory):
    return measured(tmp_path_factory.mktemp("emission") / "emission", "emission", "--charge", "600")


@pytest.fixture(scope="module")
def calibration(lvf_session):
    return calibrate([lvf_session])


def edited(session, folder, drop):
    """A copy of a session without the frames of some roles, as an interrupted plan would leave it."""
    shutil.copytree(session, folder)
    lines = [json.loads(x) for x in (folder / "journal.jsonl").read_text().splitlines()]
    kept = []
    for line in lines:
        if line["event"] == "exposure" and drop(line):
            (folder / "frames" / line["frame"]).unlink()
            line = {k: line[k] for k in ("seq", "mono_s", "device_s", "wall")} | {
                "event": "note",
                "text": "left out",
            }
        kept.append(line)
    (folder / "journal.jsonl").write_text("".join(json.dumps(x) + "\n" for x in kept))
    return folder


def true_nm(calibration, places):
    """The wavelength whose band's middle lies at places along the strip, halfway across it."""
    strip = calibration.strip
    a = np.deg2rad(strip.angle_deg)
    y = (strip.top[0] + strip.top[1] * places + strip.bottom[0] + strip.bottom[1] * places) / 2
    right, down = (places * np.cos(a) - y * np.sin(a)) / 200, (places * np.sin(a) + y * np.cos(a)) / 200
    # The bench's camera, as scene.py turns and tilts it.
    b = np.deg2rad(0.8)
    depth = 1 + 0.035 * right - 0.05 * down
    x_mm = scene.WIDTH_MM * (right * np.cos(b) + down * np.sin(b)) / depth
    y_mm = scene.WIDTH_MM * (down * np.cos(b) - right * np.sin(b)) / depth
    u, v = scene.STRIP.across(x_mm, y_mm)
    return Lvf().centre_nm(u + Lvf().tilt * (v - 0.5))


def test_wavelengths_are_found_to_a_fraction_of_a_nanometre(calibration):
    off = POSITIONS_NM - true_nm(calibration, calibration.places_px)
    inner = (POSITIONS_NM >= 420) & (POSITIONS_NM <= 650)
    # Hands put the strip down within 0.04 mm, 0.23 nm, of where the truth is counted from: three of those.
    assert np.abs(off[inner]).max() < 0.7
    error = calibration.map.standard_error_nm(calibration.places_px)
    assert (np.abs(off) < 3 * np.hypot(error, 0.23)).all()


def test_the_lines_of_one_wavelength_are_found_to_be_slanted(calibration):
    # u changes by `tilt` over the strip's width: that is length / width * tilt as dx/dy; to first order also the
    # camera's tilt of 0.05 in 1 (half a degree) lies in it.
    strip = scene.STRIP
    expected = -Lvf().tilt * strip.width_mm / strip.height_mm
    assert calibration.strip.slant == pytest.approx(expected, abs=0.012)


def test_transmission_curves_are_the_benchs(calibration):
    assert calibration.curves is not None
    assert calibration.absolute
    centre = true_nm(calibration, calibration.places_px)
    # A position is read over 4 nm to either side.
    truth = np.mean(
        [_transmission(centre + shift) for shift in np.linspace(-4, 4, 9)],
        axis=0,
    )
    inner = np.flatnonzero((POSITIONS_NM >= 430) & (POSITIONS_NM <= 650))
    for k in inner:
        curve = calibration.curves.curve[k]
        miss = np.sqrt(np.mean((curve - truth[k]) ** 2) / np.mean(truth[k] ** 2))
        # An edge that rises by 0.6 in 10 nm turns an error of 0.7 nm into 7 % of the band's root mean square.
        assert miss < 0.1
    assert (calibration.curves.curve[np.isfinite(calibration.curves.curve)] >= 0).all()


def _transmission(centre_nm):
    """(n, n_nm) of the bench's bands around `centre_nm`, as it computes them along the strip."""
    u = np.linspace(0, 1, 20001)
    at = np.interp(centre_nm, Lvf().centre_nm(u), u)
    return Lvf().transmission(at, GRID_NM)


def test_the_lamps_spectrum_is_that_of_the_bench(calibration, lamp_session):
    found = measure_spectrum(lamp_session, calibration)
    truth = lights.halogen(3000.0)(NM)
    seen = (NM >= 430) & (NM <= 670)
    scale = (found.value[seen] @ truth[seen]) / (found.value[seen] @ found.value[seen])
    off = scale * found.value[seen] / truth[seen] - 1
    # The bound that the result itself states: without flats the lamp's unevenness is unknown, 3 % everywhere; toward
    # the blue, where this lamp is faint and the strip ends, the curves' own error comes to that.
    error = scale * found.standard_error[seen] / truth[seen]
    assert (np.abs(off) < 3 * error).all()
    assert np.median(error) < 1.2 * 0.03
    assert any("--flat" in w for w in found.warnings)


def test_the_glows_spectrum_is_that_of_the_sample(calibration, emission_session):
    found = measure_spectrum(emission_session, calibration)
    fine = np.arange(400.0, 701.0)
    truth = paint("green").emission(fine)
    centroid = (fine * truth).sum() / truth.sum()
    # Shift of the strip by hand, 0.23 nm, and the map's own error, together 3 of 0.4 nm; and the tails' noise.
    assert (found.nm * found.value).sum() / found.value.sum() == pytest.approx(centroid, abs=2.5)
    assert found.peak_nm == pytest.approx(fine[np.argmax(truth)], abs=3.0)
    assert found.end_nm is None


def test_what_a_spectrum_misses_most_is_told_in_size_and_place(calibration, lamp_session):
    found = measure_spectrum(lamp_session, calibration)
    top = np.nanmax(found.measured)
    odd = found.predicted.copy()
    odd[13, 2] = found.measured[13, 2] + 0.4 * top  # more than the lamp is missed anywhere
    share, nm = replace(found, predicted=odd).farthest_off
    assert share == pytest.approx(0.4)
    assert nm == POSITIONS_NM[13]


def test_a_file_gives_back_the_same_numbers(calibration, tmp_path):
    save(calibration, tmp_path / "lvf.json")
    again, digest = load(tmp_path / "lvf.json")
    assert np.array_equal(again.curves.curve, calibration.curves.curve, equal_nan=True)
    assert np.array_equal(again.map.coefficients_nm, calibration.map.coefficients_nm)
    assert again.strip == calibration.strip
    assert again.settings == calibration.settings
    kept = calibration.curves.covariance
    # To seven digits, and what those make negative is 0 again: a share of 45 x 5e-8 of the largest at most.
    np.testing.assert_allclose(again.curves.covariance, kept, rtol=0, atol=3e-6 * np.nanmax(np.abs(kept)))
    assert len(digest) == 64


def test_a_file_that_holds_no_covariance_still_tells_a_spectrum(calibration, lamp_session, tmp_path):
    """Files of before it was kept: the curves' errors count as unrelated, and the spectrum is smoother."""
    save(calibration, tmp_path / "lvf.json")
    data = json.loads((tmp_path / "lvf.json").read_text())
    del data["curves"]["covariance"], data["curves"]["nodes"]
    (tmp_path / "old.json").write_text(json.dumps(data))
    old, _ = load(tmp_path / "old.json")
    assert old.curves.covariance is None
    found, known = (measure_spectrum(lamp_session, c) for c in (old, calibration))
    seen = (NM >= 430) & (NM <= 670)
    error = np.hypot(found.standard_error, known.standard_error)[seen]
    assert (np.abs(found.value - known.value)[seen] < 2 * error).all()


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        (
            "material.json",
            '{"schema": "phoslab-material/1"}',
            "is a material, and is no calibration of the filter",
        ),
        ("fit.json", '{"states": 2}', "has the schema None, and is no calibration"),
        ("campaign.toml", 'sample = "green"', "is no calibration of the filter: it is not valid JSON"),
        ("lvf.json", '{"schema": "phoslab-lvf/99"}', "this phoslab reads 'phoslab-lvf/1'"),
    ],
)
def test_another_file_is_told_from_a_calibration_of_another_version(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(PhoslabError, match=words):
        load(path)


def test_a_covariance_that_is_none_is_refused(calibration, tmp_path):
    save(calibration, tmp_path / "lvf.json")
    data = json.loads((tmp_path / "lvf.json").read_text())
    whole = next(c for c in data["curves"]["covariance"] if c is not None)
    whole[0] = -1.0
    (tmp_path / "bad.json").write_text(json.dumps(data))
    with pytest.raises(PhoslabError, match="some variance is negative"):
        load(tmp_path / "bad.json")


def test_a_missing_line_costs_accuracy_and_not_the_calibration(lvf_session, tmp_path):
    """Without mercury the LED's colours and the filters' edges tell the wavelengths, and it is said."""
    found = calibrate([edited(lvf_session, tmp_path / "s", lambda e: e["role"] == "mercury")])
    inner = (POSITIONS_NM >= 430) & (POSITIONS_NM <= 640)
    off = (POSITIONS_NM - true_nm(found, found.places_px))[inner]
    assert np.abs(off).max() < 2.0
    assert any("no usable frame of a mercury lamp" in w for w in found.warnings)


def test_without_an_led_there_are_wavelengths_and_no_curves(lvf_session, emission_session, tmp_path):
    found = calibrate(
        [edited(lvf_session, tmp_path / "s", lambda e: e["role"] == "led" or e["role"].startswith("filter:"))]
    )
    assert found.curves is None
    inner = (POSITIONS_NM >= 430) & (POSITIONS_NM <= 580)
    assert np.abs((POSITIONS_NM - true_nm(found, found.places_px))[inner]).max() < 2.0
    with pytest.raises(PhoslabError, match="no transmission curves, without which"):
        measure_spectrum(emission_session, found)


def test_a_setting_without_dark_frames_is_left_out_and_said(lvf_session, tmp_path):
    exposures = sorted(
        {
            json.loads(x)["exposure_s"]
            for x in (lvf_session / "journal.jsonl").read_text().splitlines()
            if '"dark"' in x and '"exposure"' in x
        }
    )
    found = calibrate(
        [
            edited(
                lvf_session,
                tmp_path / "s",
                lambda e: e["role"] == "dark" and e["exposure_s"] == exposures[-1],
            )
        ]
    )
    assert any("no dark frame for" in w and "filter:" in w for w in found.warnings)
    assert len(found.filters) < len(FILTERS.split(","))


def test_few_filters_are_said(lvf_session, tmp_path):
    found = calibrate(
        [
            edited(
                lvf_session,
                tmp_path / "s",
                lambda e: e["role"].startswith("filter:") and e["role"] != "filter:L101",
            )
        ]
    )
    assert found.curves is not None
    assert any("Only 1 filters" in w for w in found.warnings)


def test_a_session_of_another_plan_is_refused(lvf_session, lamp_session, calibration):
    with pytest.raises(PhoslabError, match="no session of the plan 'lvf'"):
        calibrate([lamp_session])
    with pytest.raises(PhoslabError, match="is of the plan 'lvf'"):
        measure_spectrum(lvf_session, calibration)


def test_a_strip_that_lies_elsewhere_is_refused(calibration, lamp_session):
    strip = replace(
        calibration.strip,
        top=(calibration.strip.top[0] - 8, 0.0),
        bottom=(calibration.strip.bottom[0] - 8, 0.0),
    )
    with pytest.raises(PhoslabError, match="Calibrate anew"):
        measure_spectrum(lamp_session, replace(calibration, strip=strip))


def test_a_rawtoaces_file_stands_in_for_the_name(lvf_session, calibration, tmp_path):
    nm, values = calibration.sensitivities.nm, calibration.sensitivities.values
    table = {f"{n:g}": v.tolist() for n, v in zip(nm, values, strict=True)}
    content = {"header": {}, "spectral_data": {"index": {"main": ["R", "G", "B"]}, "data": {"main": table}}}
    (tmp_path / "camera.json").write_text(json.dumps(content))
    found = calibrate([lvf_session], camera=tmp_path / "camera.json")
    assert found.sensitivities.name == "camera.json"
    assert np.abs(found.map.nm(found.places_px) - calibration.map.nm(found.places_px)).max() < 0.5


def test_the_commands_write_what_they_say(lvf_session, lamp_session, tmp_path, capsys):
    lvf, table = tmp_path / "lvf.json", tmp_path / "lamp.csv"
    drawn = ["--plot", str(tmp_path / "lvf.svg"), "--report", str(tmp_path / "lvf.html")]
    assert main(["calibrate", str(lvf_session), "-o", str(lvf), *drawn]) == 0
    page = (tmp_path / "lvf.html").read_text()
    assert "<tr><th>mercury 435.83 nm</th>" in page
    assert "nm: as it should be" in page
    assert "<tr><th>known to 1 nm</th>" in page
    assert "[[Wavelengths]]" in capsys.readouterr().out
    assert main(["spectrum", str(lamp_session), "--lvf", str(lvf), "-o", str(table), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    page = str(tmp_path / "lamp.html")
    arguments = ["spectrum", str(lamp_session), "--lvf", str(lvf), "-o", str(table), "--report", page]
    assert main(arguments) == 0
    assert page in capsys.readouterr().out
    assert f"It is highest at {said['peak_nm']:.0f} nm" in (tmp_path / "lamp.html").read_text()
    assert f"the end of what is measured, {NM[-1]:.0f} nm, is as high" in (tmp_path / "lamp.html").read_text()
    assert "it may go on rising" in (tmp_path / "lamp.html").read_text()
    assert "stands a continuation, and the band is no bound" in (tmp_path / "lamp.html").read_text()
    rows = np.array([[float(x) for x in r.split(",")] for r in table.read_text().splitlines() if r[0] != "#"])
    assert np.array_equal(rows[:, 0], NM)
    assert rows[:, 1].max() == 1.0
    assert len(said["band_means"]) == 8
    assert main(["calibrate", str(lvf_session), "-o", str(lvf_session / "lvf.json")]) == 1
    assert "never written to" in capsys.readouterr().err
