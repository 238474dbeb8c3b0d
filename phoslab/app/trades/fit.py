"""The trade of the fit: digits, success from no guess, honest intervals, number of states, bias; spectra, excitation
and pictures from RAW frames of the bench; what pixels, commands and large frames take. Peers run beside.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from phoslab.app.trades import (
    fit_bench,
    fit_bench_page,
    fit_charging,
    fit_draws,
    fit_frames,
    fit_materials,
    fit_page,
    fit_peers,
    fit_pixels,
    fit_process,
    fit_spectra,
    strd,
)
from phoslab.app.trades.fit_bench import Recorded
from phoslab.app.trades.fit_draws import COUNTED, NEAR, USUAL, Draws
from phoslab.app.trades.fit_page import Bias, Digits, Part
from phoslab.app.trades.fit_peers import PEERS, Peer
from phoslab.app.trades.page import write_trade
from phoslab.fitting import varpro

Progress = Callable[[int, int], None]

_STARTS = ((1e-4, 1e-3), (1e-3, 1e-2), (1e-2, 1e-1), (1e-1, 1.0), (1.0, 10.0), (10.0, 100.0))
_PLACES = (1, 31, 256)


@dataclass(frozen=True)
class Sizes:
    """How much each question takes: draws, runs, pixels.

    Args:
        frames: (h, w) of large frames, and how many a decay has of them; reduction is measured for each.
        fit_with: numbers of states that materials are fitted with, "auto" last.
        rig: whether the rig is recorded and calibrated anew, and all samples with it.
    """

    success: int
    peer: int
    coverage: int
    states: int
    clipped: int
    electrons: int
    runs: int
    pixels: int
    frames: tuple[tuple[tuple[int, int], int], ...]
    fit_with: tuple[int | str, ...]
    rig: bool


FULL = Sizes(
    success=1000,
    peer=100,
    coverage=4000,
    states=200,
    clipped=200,
    electrons=400,
    runs=5,
    pixels=200_000,
    frames=(((1872, 2808), 13), ((1872, 2808), 37), ((3744, 5600), 37)),
    fit_with=(1, 2, "auto"),
    rig=True,
)
QUICK = Sizes(
    success=100,
    peer=2,
    coverage=40,
    states=2,
    clipped=10,
    electrons=20,
    runs=1,
    pixels=20_000,
    frames=(((288, 400), 5),),
    fit_with=("auto",),
    rig=False,
)


@dataclass(frozen=True)
class Question:
    """Something to measure.

    Args:
        draws: how many it takes.
        cost: of one of them, in ms, roughly: for the time left.
        ask: measures it.
    """

    draws: int
    cost: int
    ask: Callable[[Draws], Part]


def measure(folder: Path, *, quick: bool, progress: Progress) -> tuple[list[str], list[Path]]:
    """Run every measurement; the page grows with each, and is whole all the while. Return its summary and the files."""
    peers = [p for p in PEERS if p.installed]
    sizes = QUICK if quick else FULL
    done = cost = total = 0

    def tick(n: int) -> None:
        nonlocal done
        done += n * cost
        progress(done, total)

    parts: list[Part] = []
    written: list[Path] = []
    summary: list[str] = []
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        # Beside the page: large frames take some gigabytes, which a temporary folder in memory has not.
        scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="recorded-", dir=folder)))
        ready = fit_bench.whole(scratch) if sizes.rig else None
        recorded = ready or stack.enter_context(fit_bench.rig_that_ships(scratch))
        questions = _questions(sizes, peers, recorded)
        total = sum(q.draws * q.cost for q in questions)
        draws = stack.enter_context(fit_draws.draws_on_every_core(tick))
        for question in questions:
            cost = question.cost
            parts.append(question.ask(draws))
            summary = _summary(parts, len(questions), peers)
            data = {"quick": quick, "complete": len(parts) == len(questions)}
            for part in parts:
                data |= part.data
            title = "The fit: digits, success, honesty, and what it makes of RAW frames"
            written = write_trade(folder, "fit", title, summary, [p.section for p in parts], data)
    return summary, written


def _summary(parts: list[Part], n_questions: int, peers: list[Peer]) -> list[str]:
    sentences = [p.answer for p in parts]
    if len(parts) < n_questions:
        sentences.append(f"Not finished: {len(parts)} of {n_questions} questions are answered.")
    absent = [p.name for p in PEERS if p not in peers]
    if absent:
        sentences.append(
            f"Not installed here, so not compared: {', '.join(absent)} (pip install phoslab[peers])."
        )
    return sentences


def _questions(sizes: Sizes, peers: list[Peer], recorded: Recorded) -> list[Question]:
    """Return all, the quickest first."""
    n_samples, n_rig = len(recorded.samples), fit_bench.RIG_TICKS if sizes.rig else 0
    timed = [p for p in peers if p.name != "curve_fit"]
    return [
        Question(len(strd.PROBLEMS), 500, partial(_digits, peers)),
        Question(sizes.success + sizes.peer * len(_STARTS) * len(peers), 30, partial(_success, sizes, peers)),
        Question(sizes.runs * len(_PLACES), 400, partial(_charging, sizes.runs)),
        Question(1 + 2 * sizes.runs, 2000, partial(_pixels, sizes, timed)),
        Question(2 * sizes.coverage, 20, partial(_coverage, sizes.coverage)),
        Question(2 * (sizes.clipped + sizes.electrons), 100, partial(_biases, sizes)),
        Question(n_rig + n_samples, 25_000, partial(_materials, sizes, recorded)),
        Question(n_samples + (2 if sizes.rig else 0), 8000, partial(_spectra, recorded)),
        Question(2 if sizes.rig else 1, 12_000, partial(_commands, recorded)),
        Question(len(sizes.frames) * (1 + sizes.runs) + 1, 15_000, partial(_frames, sizes, recorded)),
        Question(len(COUNTED) * sizes.states, 700, partial(_states, sizes.states)),
    ]


def _digits(peers: list[Peer], draws: Draws) -> Part:
    rows = []
    for name, problem in strd.PROBLEMS.items():
        for k in range(len(problem.starts)):
            parameters, deviations, certified = strd_digits(name, k)
            beside = {p.name: fit_peers.digits(p, name, k) for p in peers if p.problem is not None}
            rows.append(Digits(name, k + 1, parameters, deviations, certified, beside))
        draws.tick(1)
    return fit_page.digits(rows)


def strd_digits(name: str, start: int) -> tuple[float, float, bool]:
    """Return digits of the worst parameter and standard deviation, and whether all are as certified to the last."""
    p = strd.PROBLEMS[name]
    n, n_x = len(p.rates), len(p.linear)
    found = varpro.solve(
        p.basis,
        p.y[None],
        np.log(p.starts[start]),
        signed=np.ones(n_x, bool),
        find_scale=name in ("MGH17", "BoxBOD"),
    )
    sd = np.sqrt(np.diag(varpro.covariance(p.basis, found)) * found.chi2 / (p.y.size - n - n_x))
    rates, linear = np.exp(found.theta), found.linear[0]
    order, columns = p.matched(rates)
    deviations = min(
        strd.digits(sd[:n][order] * rates[order], p.rate_sd), strd.digits(sd[n:][columns], p.linear_sd)
    )
    return p.digits(rates, linear), deviations, p.certified(rates, linear)


def _success(sizes: Sizes, peers: list[Peer], draws: Draws) -> Part:
    ours = draws.recover(USUAL, sizes.success)
    beside = [
        (p, s, draws.recover(USUAL, sizes.peer, partial(fit_peers.rates_or_nan, p.name, s)))
        for p in peers
        for s in _STARTS
    ]
    return fit_page.success(USUAL, ours, beside)


def _charging(runs: int, draws: Draws) -> Part:
    return fit_page.charging([fit_charging.measure(places, runs, draws.tick) for places in _PLACES])


def _pixels(sizes: Sizes, peers: list[Peer], draws: Draws) -> Part:
    rows = fit_pixels.measure(sizes.pixels, sizes.runs, draws.tick)
    return fit_bench_page.pixels(rows, [fit_pixels.beside(p, sizes.pixels // 10) for p in peers])


def _coverage(n: int, draws: Draws) -> Part:
    cases = (USUAL, NEAR)
    return fit_page.coverage(cases, [draws.coverage(c, n) for c in cases], n)


def _biases(sizes: Sizes, draws: Draws) -> Part:
    ours, plain = fit_draws.whole_rates, fit_draws.our_rates
    return fit_page.biases(
        [
            Bias(situation.name, words, n, *draws.bias(situation, fit, n))
            for situation, rival, n in (
                (fit_draws.CLIPPED, "first value kept", sizes.clipped),
                (fit_draws.ELECTRONS, "weights from the data", sizes.electrons),
            )
            for words, fit in (("phoslab", ours), (rival, plain))
        ]
    )


def _materials(sizes: Sizes, recorded: Recorded, draws: Draws) -> Part:
    recorded.record_rig(draws.tick)
    judge = partial(fit_materials.judge, recorded, sizes.fit_with)
    return fit_bench_page.materials(list(draws.each(judge, len(recorded.samples))))


def _spectra(recorded: Recorded, draws: Draws) -> Part:
    paints = [s for s in recorded.samples if s in fit_bench.PAINTS] or recorded.samples
    return fit_bench_page.spectra(fit_spectra.measure(recorded, paints, draws.tick))


def _commands(recorded: Recorded, draws: Draws) -> Part:
    """Run what a person types on one sample's sessions."""
    rig, rows = recorded.rig, []
    used = [rig / "lamp", recorded.record(recorded.samples[0])]
    with tempfile.TemporaryDirectory() as scratch:
        lvf, out = recorded.lvf, Path(scratch)
        if recorded.has_rig:
            used += [rig / "flats", rig / "lvf"]
            lvf = out / "lvf.json"
            words = ["calibrate", str(rig / "lvf"), str(rig / "flats"), "-o", str(lvf)]
            rows.append(("calibrate", fit_process.command(*words)))
            draws.tick(1)
        words = ["fit", *map(str, used), "--lvf", str(lvf)]
        words += ["-o", str(out / "material.json"), "--report", str(out / "report.html")]
        rows.append(("fit", fit_process.command(*words)))
        draws.tick(1)
    frames = [f for folder in used for f in folder.rglob("frames/*")]
    return fit_bench_page.commands(len(frames), sum(f.stat().st_size for f in frames), rows)


def _frames(sizes: Sizes, recorded: Recorded, draws: Draws) -> Part:
    """Reduction at every size, and every pixel of the last, each size's session no longer on disk than needed."""
    reduced = []
    for shape, n_frames in sizes.frames:
        with tempfile.TemporaryDirectory(dir=recorded.folder) as scratch:
            session = fit_frames.record(Path(scratch) / "large", shape, n_frames)
            draws.tick(1)
            reduced.append(fit_frames.reduction(session, sizes.runs, draws.tick))
            if (shape, n_frames) == sizes.frames[-1]:
                every = fit_frames.every_pixel(session)
                draws.tick(1)
    return fit_bench_page.frames(reduced, every, fit_frames.compressed())


def _states(n: int, draws: Draws) -> Part:
    return fit_page.states([draws.counted(c, n) for c in COUNTED], n)
