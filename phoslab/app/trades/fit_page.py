"""The page of the fit trade: each question with its bar, in words, tables and plots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phoslab.app.trades.fit_charging import Charging
from phoslab.app.trades.fit_draws import COUNTED, USUAL, Case, Recovered
from phoslab.app.trades.fit_peers import Peer
from phoslab.app.trades.page import Plot, Section, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Start = tuple[float, float]

# What has been promised.
DIGITS = {"Lanczos1": 10.4, "Lanczos2": 10.4, "Lanczos3": 10.4, "BoxBOD": 9.0, "MGH17": 8.0}
SCATTER = 1.05
COVERED = (0.94, 0.96)
COUNTED_RIGHT = 0.9
GAIN, AGREEMENT = 29.0, 1e-10


@dataclass(frozen=True)
class Part:
    """One question's answer in a sentence, its section of the page, and its numbers for trade.json."""

    answer: str
    section: Section
    data: dict[str, Any]


@dataclass(frozen=True)
class Digits:
    """One StRD problem from one start: digits of ours, of the standard deviations, and of each peer by name."""

    problem: str
    start: int
    parameters: float
    deviations: float
    certified: bool
    peers: Mapping[str, float | str | None]


def digits(rows: Sequence[Digits]) -> Part:
    """How many digits are right."""
    names = list(rows[0].peers)
    least = {n: min(r.parameters for r in rows if r.problem == n) for n in DIGITS}
    lanczos = min(v for n, v in least.items() if n.startswith("Lanczos"))
    exact = sum(r.certified for r in rows)
    table = Table(
        "digits",
        "Correct digits of the worst parameter, and of the worst standard deviation; whether every parameter, "
        "rounded as the certificate is, is the certificate's to its last digit. -: cannot be stated.",
        (
            "problem",
            "start",
            "phoslab, parameters",
            "to the last digit",
            "phoslab, standard deviations",
            *names,
        ),
        [
            (
                r.problem,
                f"{r.start}",
                f"{r.parameters:.1f}",
                "yes" if r.certified else "no",
                f"{r.deviations:.1f}",
                *(f"{v:.1f}" if isinstance(v, float) else v for v in r.peers.values()),
            )
            for r in rows
        ],
    )
    text = [
        "Problems of the NIST StRD from their certified starts. Certificates have 11 digits: a number just above a "
        "power of ten is certified to 10.3. phoslab searches the rates alone, every sign of amplitudes free; the "
        "peers, with their default tolerances, rates and amplitudes, but for pyglotaran. Negative digits are numbers "
        "off by more than themselves: another minimum. Lanczos1 leaves residuals in the 14th digit, so float64 holds "
        "its standard deviations to 3 digits only."
    ]
    data = [{**vars(r), "peers": dict(r.peers)} for r in rows]
    answer = (
        f"NIST StRD, worst parameter: {lanczos:.1f} digits on Lanczos1 to 3 from both starts, "
        f"{least['BoxBOD']:.1f} on BoxBOD, {least['MGH17']:.1f} on MGH17; "
        f"{exact} of {len(rows)} to the certificate's last digit."
    )
    return Part(answer, Section("How many digits?", text, [table]), {"digits": data})


def success(case: Case, ours: Recovered, peers: Sequence[tuple[Peer, Start, Recovered]]) -> Part:
    """Whether rates are found without a guess, and how they scatter."""
    scatter = ours.rates.std(axis=0) / case.bound
    share = ours.within(case.kr)
    starts = list(dict.fromkeys(s for _, s, _ in peers))
    by_peer = {p: [r for q, _, r in peers if q is p] for p, _, _ in peers}
    n_peer = len(peers[0][2].rates) if peers else 0
    found = Table(
        "success",
        f"Share of draws with both rates within 10 %, by the start that is needed, in 1/s; and the processor time of a "
        f"fit (median), from the best start to the worst. phoslab: {len(ours.rates):,} draws; the others: {n_peer}.",
        ("fit", "no start", *(f"{s[0]:g}, {s[1]:g}" for s in starts), "time [ms]"),
        [
            ("phoslab", f"{share:.1%}", *("-" for _ in starts), f"{1e3 * ours.seconds:.2g}"),
            *(
                (
                    p.name,
                    "-",
                    *(f"{r.within(case.kr):.0%}" for r in found),
                    _range([r.seconds for r in found]),
                )
                for p, found in by_peer.items()
            ),
        ],
    )
    spread = Table(
        "scatter",
        f"Standard deviation of phoslab's rates over the draws, against the least that is possible (promised: "
        f"{SCATTER:g}; so many draws know a ratio to {1 / np.sqrt(2 * len(ours.rates)):.1%}).",
        ("rate [1/s]", "scatter / Cramer-Rao bound"),
        [(f"{k:g}", f"{s:.3f}") for k, s in zip(case.kr, scatter, strict=True)],
    )
    special = " ".join(f"{p.name}: {p.about}." for p in by_peer if p.about)
    means = {p.name: float(np.mean([r.within(case.kr) for r in found])) for p, found in by_peer.items()}
    best = max(means.items(), key=lambda item: item[1], default=None)
    text = [
        f"{case.name}, amplitudes 0.7 and 0.3, 37 values to 180 s, three channels (scales 1, 0.6, 0.25), noise 0.2 % "
        "of the peak. Peers need a start: pairs of rates over the six decades in which a user may guess, amplitudes "
        f"of 1. {special}"
    ]
    data = {
        "draws": len(ours.rates),
        "within_10_percent": share,
        "ms_a_fit": 1e3 * ours.seconds,
        "scatter_over_bound": scatter.tolist(),
        "peers": [
            {
                "peer": p.name,
                "start_per_s": list(s),
                "draws": len(r.rates),
                "within_10_percent": r.within(case.kr),
                "ms_a_fit": 1e3 * r.seconds,
            }
            for p, s, r in peers
        ],
    }
    answer = (
        f"Both rates within 10 % from no guess: {share:.1%} of {len(ours.rates):,} draws"
        + (f" (the best peer, {best[0]}, over all starts: {best[1]:.0%})" if best else "")
        + f"; scatter {scatter.max():.3f} of the Cramer-Rao bound; {1e3 * ours.seconds:.1f} ms a fit."
    )
    return Part(answer, Section("Are rates found without a guess?", text, [found, spread]), {"success": data})


def _range(seconds: Sequence[float]) -> str:
    return f"{1e3 * min(seconds):.2g} to {1e3 * max(seconds):.2g}"


def coverage(cases: Sequence[Case], covered: Sequence[tuple[Array, Array]], n: int) -> Part:
    """Whether intervals hold the truth as often as they say."""
    rows = [
        (f"{c.name}, the {k:g}", float(p), float(q))
        for c, (profile, normal) in zip(cases, covered, strict=True)
        for k, p, q in zip(c.kr, profile, normal, strict=True)
    ]
    profile, normal = [r[1] for r in rows], [r[2] for r in rows]
    table = Table(
        "coverage",
        f"Share of draws whose interval of 95 % holds the true rate (promised: {COVERED[0]:.0%} to {COVERED[1]:.0%}).",
        ("rate [1/s]", "profile likelihood", "covariance alone"),
        [(name, f"{p:.2%}", f"{q:.2%}") for name, p, q in rows],
    )
    figure = _dots(
        [r[0] for r in rows],
        {"profile likelihood": [100 * v for v in profile], "covariance alone": [100 * v for v in normal]},
        "intervals that hold the truth [%]",
        np.sqrt(0.95 * 0.05 / n) * 196,
    )
    axes = figure.axes[0]
    axes.axvspan(100 * COVERED[0], 100 * COVERED[1], color="C2", alpha=0.15, lw=0)
    text = [f"{n:,} draws each; a share of so many is known to {np.sqrt(0.95 * 0.05 / n):.2%}."]
    data = [{"rate": name, "profile": p, "covariance": q} for name, p, q in rows]
    answer = (
        f"Intervals of 95 % hold the truth in {min(profile):.1%} to {max(profile):.1%} of {n:,} draws; by the "
        f"covariance alone in {min(normal):.1%} to {max(normal):.1%}."
    )
    plot = Plot("coverage", "Bars are two standard errors of the share; green is what was promised.", figure)
    return Part(
        answer,
        Section("Do intervals of 95 % hold the truth?", text, [table, plot]),
        {"coverage": data, "coverage_draws": n},
    )


def states(counts: Sequence[Mapping[str, float]], n: int) -> Part:
    """Whether the number of states is right."""
    names = list(counts[0])
    table = Table(
        "states",
        f"Share of draws with the true number (promised for the choice: {COUNTED_RIGHT:.0%}).",
        ("case", *names),
        [
            (case.name, *(f"{c.get(k, 0.0):.1%}" for k in names))
            for case, c in zip(COUNTED, counts, strict=True)
        ],
    )
    figure = _dots(
        [c.name for c in COUNTED],
        {k: [100 * c.get(k, 0.0) for c in counts] for k in names if k != "F-test"},
        "draws with the true number of states [%]",
    )
    figure.axes[0].axvline(100 * COUNTED_RIGHT, color="C2", lw=1)
    text = [
        f"{n} draws each, three channels. Every criterion chooses among 1 to 4 states with and without a constant in "
        "every channel; the F-test is the one that decides. In the last case the light has a constant that no state is."
    ]
    worst = min(c["chosen"] for c in counts)
    rivals = ", ".join(
        f"{k} {min(c.get(k, 0.0) for c in counts):.0%}" for k in names if k not in ("chosen", "F-test")
    )
    answer = f"Right number of states: at least {worst:.1%} of {n} draws in each case (by {rivals})."
    data = {case.name: dict(c) for case, c in zip(COUNTED, counts, strict=True)}
    plot = Plot("states", "The line is what was promised.", figure)
    return Part(
        answer,
        Section("Is the number of states right?", text, [table, plot]),
        {"right_states": data, "states_draws": n},
    )


@dataclass(frozen=True)
class Bias:
    """A situation and who fits it: how many draws, the relative bias of each rate, and its standard error."""

    name: str
    fit: str
    draws: int
    bias: Array
    error: Array


def biases(rows: Sequence[Bias]) -> Part:
    """Whether rates are right in the mean."""
    table = Table(
        "bias",
        "Mean of the rates less the truth, in per cent of it, ± its standard error. Promised: 1 % with the first value "
        "clipped, 0.5 % of the slow rate at 200 electrons.",
        ("situation", "fit", "draws", f"{USUAL.kr[0]:g} 1/s [%]", f"{USUAL.kr[1]:g} 1/s [%]"),
        [
            (
                r.name,
                r.fit,
                r.draws,
                *(f"{100 * b:+.2f} ± {100 * e:.2f}" for b, e in zip(r.bias, r.error, strict=True)),
            )
            for r in rows
        ],
    )
    ours = [r for r in rows if r.fit == "phoslab"]
    answer = "Bias: " + "; ".join(f"{r.name}: {_signed(r)}" for r in ours) + "."
    text = [
        "Two states, 37 values in three channels. What a camera states as the noise of a value comes from the value "
        "itself, and favours those that fluctuated downwards; phoslab takes it from its own model instead. "
        "What of an error answers to noise in the first order has a mean of 0 and is taken off as a control variate."
    ]
    data = [{**vars(r), "bias": r.bias.tolist(), "error": r.error.tolist()} for r in rows]
    return Part(answer, Section("Are rates right in the mean?", text, [table]), {"bias": data})


def _signed(row: Bias) -> str:
    return " and ".join(f"{100 * b:+.2f} ± {100 * e:.2f} %" for b, e in zip(row.bias, row.error, strict=True))


def charging(rows: Sequence[Charging]) -> Part:
    """What the exact steps of the excitation fit gain."""
    table = Table(
        "charging",
        f"{rows[0].frames} frames of {rows[0].steps} steps each, medians (promised: {GAIN:g} times, {AGREEMENT:g}).",
        ("places", "exact, with derivatives [ms]", "DOP853 [ms]", "times as fast", "largest difference"),
        [
            (
                r.places,
                f"{1e3 * r.exact_s:.3g}",
                f"{1e3 * r.general_s:.3g}",
                f"{r.gain:.0f}",
                f"{r.difference:.1e}",
            )
            for r in rows
        ],
    )
    text = [
        "A series of 14 exposures to the lamp, with its rise and fade. scipy's DOP853 at rtol 1e-12 gives the curve; "
        "the exact steps give it with its derivatives by both rates. One process, in turns."
    ]
    answer = (
        f"Excitation: {min(r.gain for r in rows):.0f} to {max(r.gain for r in rows):.0f} times as fast as DOP853, "
        f"curves within {max(r.difference for r in rows):.0e}."
    )
    data = [{**vars(r), "gain": r.gain} for r in rows]
    return Part(answer, Section("Is the excitation model fast and exact?", text, [table]), {"charging": data})


def _dots(names: Sequence[str], series: Mapping[str, Sequence[float]], label: str, bar: float = 0) -> Figure:
    """Dots on one line a name, to compare series at a glance."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 0.9 + 0.45 * len(names)), layout="constrained")
    axes: Axes = figure.subplots()
    places = np.arange(len(names))[::-1]
    for k, (name, values) in enumerate(series.items()):
        shifted = places + 0.12 * (len(series) - 1) / 2 - 0.12 * k
        axes.errorbar(values, shifted, xerr=bar or None, fmt="osDv"[k % 4], ms=5, lw=1, label=name)
    axes.set_yticks(places, names)
    axes.set_xlabel(label)
    axes.grid(axis="x", alpha=0.25)
    axes.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1, 0.5))
    return figure
