"""The trade of the decay fit: digits, success from no guess, honest intervals, number of states, bias; peers beside."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from phoslab.app.trades import fit_charging, fit_draws, fit_page, fit_peers, strd
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
    """How many draws each question takes."""

    success: int
    peer: int
    coverage: int
    states: int
    clipped: int
    electrons: int
    runs: int


FULL = Sizes(success=1000, peer=100, coverage=4000, states=200, clipped=200, electrons=400, runs=5)
QUICK = Sizes(success=100, peer=4, coverage=60, states=3, clipped=10, electrons=30, runs=1)


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
    questions = _questions(QUICK if quick else FULL, peers)
    total = sum(q.draws * q.cost for q in questions)
    done = cost = 0

    def tick(n: int) -> None:
        nonlocal done
        done += n * cost
        progress(done, total)

    parts: list[Part] = []
    written: list[Path] = []
    summary: list[str] = []
    with fit_draws.draws_on_every_core(tick) as draws:
        for question in questions:
            cost = question.cost
            parts.append(question.ask(draws))
            summary = _summary(parts, len(questions), peers)
            data = {"quick": quick, "complete": len(parts) == len(questions)}
            for part in parts:
                data |= part.data
            title = "The decay fit: digits, success, honesty"
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


def _questions(sizes: Sizes, peers: list[Peer]) -> list[Question]:
    """Return all, the quickest first."""
    return [
        Question(len(strd.PROBLEMS), 500, partial(_digits, peers)),
        Question(sizes.success + sizes.peer * len(_STARTS) * len(peers), 30, partial(_success, sizes, peers)),
        Question(sizes.runs * len(_PLACES), 400, partial(_charging, sizes.runs)),
        Question(2 * sizes.coverage, 20, partial(_coverage, sizes.coverage)),
        Question(2 * (sizes.clipped + sizes.electrons), 100, partial(_biases, sizes)),
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


def _states(n: int, draws: Draws) -> Part:
    return fit_page.states([draws.counted(c, n) for c in COUNTED], n)
