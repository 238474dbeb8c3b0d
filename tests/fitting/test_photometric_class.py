"""Classes of safety signs from a decay."""

import json
from dataclasses import replace

import numpy as np
import pytest

from phoslab import preset
from phoslab.app import cli
from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.photometric_class import STANDARDS, Excitation, Glow, classify, din_label, measured
from phoslab.kinetics import emitted_radiance
from phoslab.photometry import luminance

XENON, TUBE, DIM = Excitation(1000, 300), Excitation(200, 1200), Excitation(25, 900)
PSPA, JIS, IMO = (s.name for s in STANDARDS)


def through(standard, name, factor=1.0):
    """A decay that passes exactly through a class's limits, times a factor."""
    s = next(s for s in STANDARDS if s.name == standard)
    t = np.array(s.minutes) * 60
    values = np.array(s.classes[name]) * factor
    return lambda at: np.exp(np.interp(np.log(at), np.log(t), np.log(values)))


def verdict(standard, law, last_s, excitation, first_s=0.0, share=0.0):
    glow = Glow(law, first_s, last_s, lambda t: np.full(np.shape(t), share))
    return next(v for v in classify(glow, excitation) if v.standard == standard)


@pytest.mark.parametrize(
    ("standard", "name", "lower", "excitation"),
    [(PSPA, n, low, XENON) for low, n in zip("ABCDEF", "BCDEFG", strict=True)]
    + [(JIS, "JD", "JC", TUBE), (JIS, "JB", "JA", TUBE)],
)
def test_a_class_begins_at_its_limits_and_ends_just_below(standard, name, lower, excitation):
    assert verdict(standard, through(standard, name), 3600.0, excitation).verdict == name
    assert verdict(standard, through(standard, name, 0.999), 3600.0, excitation).verdict == lower


def test_one_time_that_falls_short_costs_the_class():
    good = through(PSPA, "G")
    assert verdict(PSPA, lambda t: np.where(t > 3000, 40.0, good(t)), 3600.0, XENON).verdict == "D"


def test_below_every_class_needs_no_full_hour():
    v = verdict(PSPA, lambda t: 50.0 * np.sqrt(120 / t), 700.0, XENON)  # 0.46 of A at 2 min, 0.97 at 10
    assert v.verdict == "below the lowest class"
    assert v.reason == "A needs 108 mcd/m2 at 2 min, measured 50"


def test_a_class_names_its_limits_its_condition_and_what_the_next_one_misses():
    v = verdict(PSPA, through(PSPA, "B"), 3600.0, XENON)
    assert v.condition == "if the lamp was a xenon lamp"
    assert "210, 50, 15, 7 mcd/m2 at 2, 10, 30, 60 min" in v.reason
    assert "C needs 690 mcd/m2 at 2 min, measured 210" in v.reason  # 0.30 of it; 0.33 to 0.36 later
    assert "needs" not in verdict(PSPA, through(PSPA, "G"), 3600.0, XENON).reason


def test_a_decay_that_ends_early_is_insufficient_and_says_what_is_missing():
    v = verdict(PSPA, through(PSPA, "C"), 900.0, XENON)
    assert v.verdict == "insufficient data"
    assert (
        "from 0 to 15 min; 30, 60 min are needed (so far it could be C; D needs 260 mcd/m2 at 10 min, measured 140)"
        in v.reason
    )


def test_nothing_is_read_off_before_the_first_value(tmp_path, capsys):
    """Neither a class, nor a share, nor a label: the glow at 2 min is not that at 20."""
    v = verdict(PSPA, through(PSPA, "C"), 3600.0, XENON, first_s=1200.0)
    assert v.verdict == "insufficient data"
    assert list(v.luminance_mcd) == [30, 60]
    assert "from 20 to 60 min; 2, 10 min are needed" in v.reason
    table = tmp_path / "late.csv"
    table.write_text("t_s,lum\n1200,50\n1800,30\n3600,12\n")
    assert cli.main(["classify", str(table)]) == 0
    said = capsys.readouterr().out
    assert "24.00% at 60 min" in said
    assert "at 10 min" not in said


def test_a_class_within_the_error_of_the_readings_is_said_to_be_so():
    sure = verdict(PSPA, through(PSPA, "C", 0.97), 3600.0, XENON, share=0.01)
    assert "within two" not in sure.reason
    assert sure.verdict == "B"
    unsure = verdict(PSPA, through(PSPA, "C", 0.97), 3600.0, XENON, share=0.02)
    assert unsure.verdict == "B"
    assert "within two standard errors of the readings it is from B to C" in unsure.reason


@pytest.mark.parametrize("other", [TUBE, Excitation(1000, 600), Excitation(1000), Excitation()])
def test_another_excitation_gives_no_class(other):
    assert verdict(PSPA, through(PSPA, "G"), 3600.0, other).verdict == "not comparable"


def test_imo_asks_for_two_values_after_a_dim_light():
    assert verdict(IMO, through(IMO, "pass"), 3600.0, DIM).verdict == "pass"
    assert verdict(IMO, through(IMO, "pass", 0.99), 3600.0, DIM).verdict == "below the lowest class"


def test_the_din_label_names_two_luminances_and_the_end_of_sight():
    def law(t):
        return 200.0 * (600 / t)  # 200 mcd/m² at 10 min, 0.3 at 400,000 s = 6667 min

    assert din_label(Glow(law, 0.0, 3600.0)) == "200/33.3-?"
    assert din_label(Glow(law, 0.0, 5e5)).split("-")[0] == "200/33.3"
    end = din_label(Glow(law, 0.0, 5e5)).split("-")[1]
    assert float(end) == pytest.approx(6667, rel=3e-3)  # 4000 steps a range of e^9
    assert din_label(Glow(law, 0.0, 599.0)) is None
    assert din_label(Glow(law, 1200.0, 3600.0)) == "?/33.3-?"


def test_values_between_measured_ones_follow_a_power_law():
    t = np.geomspace(30, 4000, 30)
    data = DecayData(t, np.zeros(30), (1e5 / t)[:, None], np.ones((30, 1)), channels=("L",))
    glow = measured(data, 0, 1.0, sigma_given=True)
    at = np.array([120.0, 600.0, 3600.0])
    # Lines over log (t + 30 s) instead of log t: curvature between values 17 % apart is below 1e-3.
    assert glow.luminance_mcd(at) == pytest.approx(1e5 / at, rel=1e-3)
    assert glow.share(at) == pytest.approx(at / 1e5, rel=1e-2)
    assert (glow.first_s, glow.last_s) == pytest.approx((30, 4000))


def test_the_command_says_class_and_that_it_is_no_certificate(tmp_path, capsys):
    table = tmp_path / "l.csv"
    t = np.array([10, 60, 120, 600, 1800, 3600.0])
    table.write_text("t_s,lum\n" + "".join(f"{x},{1e5 / x}\n" for x in t))
    arguments = ["classify", str(table), "--unit", "mcd/m2", "--lux", "1000", "--minutes", "5", "--json"]
    assert cli.main(arguments) == 0
    answer = json.loads(capsys.readouterr().out)
    assert {v["standard"]: v["verdict"] for v in answer["verdicts"]}[PSPA] == "C"  # 833, 167, 56, 28
    assert "not certification" in answer["note"]


def test_a_relative_decay_gives_shares_and_no_class(tmp_path, capsys):
    table = tmp_path / "l.csv"
    table.write_text("t_s,lum\n0,100\n60,20\n120,10\n600,1\n")
    assert cli.main(["classify", str(table)]) == 0
    said = capsys.readouterr().out
    assert "no class can be given" in said
    assert "10.00% at 2 min" in said
    assert "shares of the glow at 0 s" in said


def test_a_material_that_does_not_tell_how_bright_full_states_are_is_refused(tmp_path, capsys):
    m = preset("green")
    replace(m, provenance={**m.provenance, "product_only": [0]}).save(tmp_path / "m.json")
    assert cli.main(["classify", str(tmp_path / "m.json")]) == 1
    said = capsys.readouterr().err
    assert "how full state 1 was" in said
    assert "a decay that was measured after the standard's charge" in said


def test_a_materials_shares_are_of_the_first_glow_that_its_data_support(tmp_path, capsys):
    m = replace(preset("green"), valid_s=(2.0, 700.0))
    m.save(tmp_path / "m.json")
    assert cli.main(["classify", str(tmp_path / "m.json"), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)

    def glow(t):
        return luminance(emitted_radiance(m, np.exp(-m.kr_per_s * t)), m.bands)

    assert answer["start_s"] == 2.0
    assert answer["of_the_start"]["10 min"] == pytest.approx(glow(600.0) / glow(2.0), rel=1e-9)


@pytest.mark.parametrize(
    ("charged", "advice", "label"),
    [
        ([], "Say how the sample was charged with --lux and --minutes.", False),
        (["--lux", "50", "--minutes", "5"], "charge as that standard does", False),
        (["--lux", "1000", "--minutes", "5"], "charge as that standard does", True),  # JIS and IMO differ
    ],
)
def test_advice_and_label_go_by_how_the_sample_was_charged(tmp_path, capsys, charged, advice, label):
    table = tmp_path / "l.csv"
    table.write_text("t_s,lum\n" + "".join(f"{x},{1e5 / x}\n" for x in (10, 60, 120, 600, 1800, 3600)))
    assert cli.main(["classify", str(table), "--unit", "mcd/m2", *charged]) == 0
    said = capsys.readouterr().out
    assert advice in said
    assert ("--lux and --minutes" in said) == (not charged)
    din = next(line for line in said.splitlines() if "DIN 67510" in line)
    assert ("167/27.8-?" in din and "xenon" in din) == label
    assert ("not comparable" in din) != label


def test_what_is_lost_in_noise_is_not_read(tmp_path, capsys):
    table = tmp_path / "l.csv"
    t = np.array([10, 60, 120, 600, 1200, 1500, 1800, 3600.0])
    values = [1e4, 1e3, 300, 50, 3, -1, 2, 20]
    table.write_text("t_s,lum\n" + "".join(f"{x},{v}\n" for x, v in zip(t, values, strict=True)))
    arguments = ["classify", str(table), "--unit", "mcd/m2", "--lux", "1000", "--minutes", "5"]
    assert cli.main(arguments) == 0
    said = capsys.readouterr().out
    assert "data reach from 0.167 to 20 min" in said
    assert "in-the-noise: from 1500 s on" in said


def test_what_is_missing_is_said_with_what_there_is(tmp_path, capsys):
    table = tmp_path / "l.csv"
    table.write_text("t_s,lum,red\n0,100,50\n60,20,10\n120,10,5\n600,1,0.5\n")
    assert cli.main(["classify", str(table)]) == 1
    assert "--channel which is the luminance, one of: lum, red" in capsys.readouterr().err
    assert cli.main(["classify", str(table), "--channel", "blue"]) == 1
    assert "no channel 'blue'" in capsys.readouterr().err
    assert cli.main(["classify", str(table), "--channel", "lum", "--unit", "mcd/m2"]) == 0
    assert "--lux and --minutes" in capsys.readouterr().out
