"""Trades: what is measured, and what is written down."""

import json
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from importlib.resources import as_file, files
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from phoslab.app.trades import (
    extremes,
    fit_bench_page,
    fit_charging,
    fit_draws,
    fit_frames,
    fit_materials,
    fit_peers,
    fit_process,
    fit_spectra,
    hours,
    precision,
    previous,
    rhythm,
    strd,
)
from phoslab.app.trades import fit as trade_fit
from phoslab.app.trades.page import Plot, Section, Table, write_trade
from phoslab.app.trades.precision import Measured, Point
from phoslab.errors import PhoslabError
from phoslab.raw import read_raw
from phoslab.session import Session

NUMPY_SOLVERS = ("euler", "substep", "exact", "exact2", "rk23")


@pytest.fixture(scope="module")
def swelling():
    """The sinusoidal problem on few texels, measured without patience."""
    problem = next(p for p in precision.problems(16, 1.0) if p.name == "sinusoidal")
    return Measured(problem, precision.measure(problem, repeats=1, patience_s=0.05))


def test_finer_steps_are_more_accurate_and_ask_for_more_light(swelling):
    for method in ("euler", "exact", "exact2"):
        own = [p for p in swelling.points if p.method == method]
        assert own[-1].error < own[0].error / 10
        assert own[-1].lights > own[0].lights


def test_the_mean_of_the_light_buys_accuracy_at_equal_steps(swelling):
    first = {m: [p for p in swelling.points if p.method == m][3] for m in ("exact", "exact2")}
    assert first["exact2"].setting == first["exact"].setting
    assert first["exact2"].error < first["exact"].error / 10


def test_the_previous_method_cannot_saturate(swelling):
    strong = next(p for p in swelling.points if p.method == "history, 1024 samples")
    weak_problem = next(p for p in precision.problems(16, 1e-4) if p.name == "sinusoidal")
    weak = next(
        p
        for p in precision.measure(weak_problem, repeats=1, patience_s=0.0)
        if p.method == "history, 1024 samples"
    )
    # 1024 samples: 1/32 of the light's own variation; saturation: of the order of r itself.
    assert weak.error < 0.1 < strong.error


def points(*pairs: tuple[float, float]) -> Measured:
    problem = precision.problems(1, 1.0)[0]
    return Measured(problem, [Point("euler", "", error, ns, 1.0, 1.0) for error, ns in pairs])


def test_time_to_an_error_lies_on_the_line_between_the_points():
    assert points((1e-2, 10.0), (1e-4, 1000.0)).time_to("euler", 1e-3) == pytest.approx(100.0)
    assert points((1e-4, 1000.0), (1e-2, 10.0)).time_to("euler", 1e-3) == pytest.approx(100.0)
    assert points((1e-4, 50.0)).time_to("euler", 1e-3) == 50.0
    assert points((1e-2, 50.0)).time_to("euler", 1e-3) is None


@pytest.mark.parametrize(("dtype", "resolution"), [(np.float64, 2.0**-52), (np.float32, 2.0**-23)])
@pytest.mark.parametrize("solver", NUMPY_SOLVERS)
def test_every_corner_is_refused_or_right(solver, dtype, resolution):
    verdict = extremes.judge(solver, "", extremes.in_numpy(dtype), resolution)
    assert (verdict.not_finite, verdict.outside, verdict.past) == (0, 0, 0)
    assert 0 <= verdict.refused < verdict.n
    assert (verdict.refused > 0) == (solver in extremes.LIMIT)


def test_the_judge_sees_what_is_wrong():
    def careless(solver: str, corners: extremes.Corners) -> np.ndarray:
        out = np.full_like(corners.r, np.nan)
        out[1:], out[2:], out[3:] = 2.0, corners.r[2:], corners.r[3:]
        return out

    verdict = extremes.judge("exact", "", careless, 0.0)
    assert (verdict.not_finite, verdict.outside, verdict.past) == (1, 1, 1)


def test_only_the_mean_makes_the_frame_rate_irrelevant():
    errors = {(e.light, e.solver, e.rhythm): e.error for e in rhythm.measure(n_texels=4)}
    for rhythm_name in ("24 Hz", "60 Hz", "144 Hz", "uneven"):
        # Second order at 24 Hz: (2π/4 s / 24 Hz)² / 12 of the light's depth is 4e-4, and much of it averages out.
        assert errors["sinusoidal", "exact2", rhythm_name] < 1e-4 < errors["sinusoidal", "euler", rhythm_name]


def test_naive_float32_loses_a_slow_material_within_the_hour():
    assert max(e.error for e in hours.naive_float32(1.0)) > 1e-3


def test_the_cost_of_the_past_grows_with_it():
    short, *_, long = previous.measure(64, 3)
    assert long.cache_bytes == 64 * short.cache_bytes


def test_the_trade_of_the_fit_judges_a_fit_that_fails():
    draws = fit_draws.Draws()
    wrong = draws.recover(fit_draws.USUAL, 5, lambda data: np.array([0.132, 0.012]))
    assert wrong.within(fit_draws.USUAL.kr) == 0.0
    assert draws.recover(fit_draws.USUAL, 5).within(fit_draws.USUAL.kr) == 1.0


def test_curve_fit_beside_it_finds_the_same_rates_from_a_start_at_the_truth():
    data = fit_draws.USUAL.draw(3)
    # Both minimise the same chi-square; curve_fit stops at a relative change of 1e-8.
    rates = fit_peers.rates_or_nan("curve_fit", fit_draws.USUAL.kr, data)
    assert rates == pytest.approx(fit_draws.our_rates(data), rel=1e-5)


def test_a_peer_that_diverges_counts_as_failed():
    assert fit_peers.rates_or_nan("curve_fit", (1e6, 1e7), fit_draws.USUAL.draw(0))[1] != pytest.approx(0.009)
    box = fit_peers.digits(fit_peers.PEERS[0], "BoxBOD", 0)
    assert box == "fails" or box < 1


@pytest.mark.parametrize("peer", [p for p in fit_peers.PEERS if p.problem], ids=lambda p: p.name)
def test_peers_that_are_here_solve_the_reference_problems_from_their_nearer_start(peer):
    if not peer.installed:
        pytest.skip(f"{peer.name} is not installed")
    # Their default tolerances leave 4 digits and more; 2 tell a right amplitude from one in other units.
    assert fit_peers.digits(peer, "Lanczos3", 1) > 2


def test_every_parameter_of_the_reference_problems_is_right_to_the_last_digit():
    for name, problem in strd.PROBLEMS.items():
        for start in range(len(problem.starts)):
            assert trade_fit.strd_digits(name, start)[2], name


def test_a_digit_less_is_not_as_certified():
    p = strd.LANCZOS3
    assert p.certified(p.rates, p.linear)
    assert not p.certified(p.rates * (1 + 2e-10), p.linear)


def test_exact_charging_agrees_with_a_general_solver():
    # DOP853 at rtol 1e-12 over 14 exposures of 43 steps: some hundred times its tolerance at most.
    assert fit_charging.measure(3, 1).difference < 1e-10


def test_the_trade_of_the_fit_answers_question_after_question(tmp_path, monkeypatch):
    """But for those of RAW frames, which take a minute; their parts are below."""
    few = replace(
        trade_fit.QUICK, success=6, peer=1, coverage=4, states=1, clipped=2, electrons=2, pixels=200
    )
    of_raw = (trade_fit._materials, trade_fit._spectra, trade_fit._commands, trade_fit._frames)
    questions = trade_fit._questions
    monkeypatch.setattr(trade_fit, "QUICK", few)
    monkeypatch.setattr(
        trade_fit, "_questions", lambda *a: [q for q in questions(*a) if q.ask.func not in of_raw]
    )
    seen, pages = [], []
    write = trade_fit.write_trade
    monkeypatch.setattr(trade_fit, "write_trade", lambda *a: pages.append(a) or write(*a))
    summary, written = trade_fit.measure(
        tmp_path, quick=True, progress=lambda n, total: seen.append((n, total))
    )
    assert [len(p[4]) for p in pages] == [1, 2, 3, 4, 5, 6, 7]  # the page grows, whole all the while
    data = json.loads((tmp_path / "trade.json").read_text())
    assert data["complete"]
    assert {"digits", "success", "coverage", "bias", "right_states", "charging", "pixels"} <= set(data)
    assert all(path.exists() for path in written)
    assert seen[-1][0] == seen[-1][1]
    assert any("digits" in s for s in summary)
    assert not list(tmp_path.glob("recorded-*"))


def judged(name: str, delta_e: float) -> fit_materials.Judged:
    share = np.array([0.6, 0.3, 0.1, 0, 0, 0, 0, 0])
    excited = fit_materials.Excited(0.006, 0.012, 4.0, 1.01, share, share, 0.0, np.array([0.003, -0.001]))
    seen = fit_materials.Seen(2, np.full(3, delta_e), 1.0)
    return fit_materials.Judged(name, {"1": seen, "auto": seen}, excited)


def test_a_sample_that_follows_the_model_is_told_apart_from_paint():
    part = fit_bench_page.materials([judged("two-states", 9.0), judged("green", 1.0), judged("red", 2.0)])
    assert "rates within 0.3%, level missed by 0.6% (worst place 1.2%)" in part.answer
    assert "a mean ΔE00 of 1.5" in part.answer  # of those that hold traps
    json.dumps(part.data, allow_nan=False)


def test_a_material_of_the_photographs_own_colours_is_at_no_distance():
    photographs = np.array([[0.4, 1.0, 0.3], [0.2, 0.5, 0.15], [0.02, 0.05, 0.015]])
    assert fit_materials._delta_e(photographs, photographs, np.eye(3)) == pytest.approx(0.0)
    redder = photographs * [1.1, 1.0, 1.0]
    assert (fit_materials._delta_e(photographs, redder, np.eye(3)) > 1).all()


def test_a_spectrum_is_scaled_to_the_truth_before_it_is_judged():
    truth = np.exp(-(((fit_spectra.NM - 530) / 40) ** 2))
    found = SimpleNamespace(value=3 * truth, standard_error=np.full(truth.size, 0.3))
    assert fit_spectra._missed("x", found, truth).error == pytest.approx(0.0, abs=1e-12)
    bent = SimpleNamespace(value=3 * truth + 0.3, standard_error=np.full(truth.size, 0.3))
    assert fit_spectra._missed("x", bent, truth).off.max() > 0.5


def test_frames_are_made_large_and_the_session_stays_whole(tmp_path):
    with as_file(files("phoslab.sample_data") / "sessions" / "green-decay") as shipped:
        shutil.copytree(shipped, tmp_path / "large")
    fit_frames._enlarge(Session.open(tmp_path / "large"), (160, 240))
    session = Session.open(tmp_path / "large")  # which compares checksums
    assert read_raw(session.frames[0].path).values.shape == (160, 240)
    assert session.complete


def test_a_command_is_timed_with_its_memory_and_one_that_fails_says_why(tmp_path):
    took = fit_process.command("presets", "--json")
    assert "green" in took.printed
    assert took.clock_s > 0
    if Path("/proc/self/smaps_rollup").exists():
        assert took.held_bytes > 1e6
    with pytest.raises(PhoslabError, match="cannot be read"):
        fit_process.command("classify", str(tmp_path / "none.csv"))


def test_a_trade_leaves_a_page_tables_plots_and_data(tmp_path):
    figure = Figure()
    figure.subplots().plot([1, 2])
    table = Table("rows", "A <caption>.", ("name", "value"), [("<b>", 0.12345), ("none", None)])
    hidden = Table("all-rows", "All.", ("n",), [(1,)], in_page=False)
    section = Section("Is 1 < 2?", ["It is."], [table, hidden, Plot("line", "A line.", figure)])
    written = write_trade(tmp_path, "test", "Title", ["Sum & total."], [section], {"costs": [1.5]})
    assert sorted(p.name for p in written) == [
        "all-rows.csv",
        "index.html",
        "line.svg",
        "rows.csv",
        "trade.json",
    ]
    page = written[0].read_text()
    assert "&lt;b&gt;" in page
    assert "<svg" in page
    assert 'href="all-rows.csv"' in page
    assert (tmp_path / "rows.csv").read_text() == "name,value\n<b>,0.12345\nnone,\n"
    data = json.loads((tmp_path / "trade.json").read_text())
    assert data["schema"] == "phoslab-trade/1"
    assert data["costs"] == [1.5]
    assert data["machine"]["cores"] >= 1


def test_what_answers_to_noise_is_taken_off_a_bias_without_moving_it():
    draws = fit_draws.Draws()
    # A weighted fit of exact σ, whose error is the first-order answer and little else: next to nothing is left.
    calm = fit_draws.Situation("calm", fit_draws.USUAL.draw, np.full((37, 3), fit_draws.USUAL.sigma**2))
    bias, error = draws.bias(calm, fit_draws.our_rates, 12)
    assert (error < 0.1 * fit_draws.USUAL.bound / fit_draws.USUAL.kr).all()
    assert (np.abs(bias) < 1e-3).all()
    # Rates that are wrong by a constant stay so.
    bias, _ = draws.bias(calm, lambda d: 1.05 * fit_draws.our_rates(d), 12)
    assert bias == pytest.approx(0.05, abs=2e-3)


def test_a_trade_that_is_asked_to_end_takes_its_workers_along(tmp_path):
    """By SIGTERM, as a shutdown sends it to one process alone."""
    process = subprocess.Popen(
        [sys.executable, "-m", "phoslab", "trade", "fit", "--quick", "-o", str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    end = time.monotonic() + 60
    while len(workers := children.read_text().split()) < 2:
        assert time.monotonic() < end
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGTERM)
    told, _ = process.communicate(timeout=30)
    assert process.returncode == 1
    assert "interrupted; nothing half-written was left" in told
    end = time.monotonic() + 10
    while any(runs(worker) for worker in workers):
        assert time.monotonic() < end
        time.sleep(0.05)


def runs(pid: str) -> bool:
    """Whether a process is there and not only waits for its end to be noticed."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False
