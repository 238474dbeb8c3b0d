"""The trade of the decay fit: digits, success from no guess, honest intervals, number of states, bias; peers beside."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable
from pathlib import Path

# Before numpy is loaded: matrices of a hundred rows gain nothing from threads and lose by them.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from phoslab.app.trades import fit_draws, strd
from phoslab.app.trades.page import Section, Table, write_trade
from phoslab.fitting import varpro

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

_PEER_STARTS = ((1e-4, 1e-3), (1e-2, 1e-1), (1.0, 10.0), (10.0, 100.0))


def measure(folder: Path, *, quick: bool, progress: Progress) -> tuple[list[str], list[Path]]:
    """Run every measurement and write the page; return its summary and the files."""
    n_success, n_coverage, n_counted, n_bias = (100, 100, 5, 40) if quick else (1000, 4000, 200, 2000)
    steps = iter(range(1, 9))
    total = 8

    def tick() -> None:
        progress(next(steps), total)

    digits = [_strd_row(name, k) for name, p in strd.PROBLEMS.items() for k in range(len(p.starts))]
    tick()
    case = fit_draws.USUAL
    ours = fit_draws.recover(case, n_success)
    tick()
    peers = [
        (start, fit_draws.recover(case, max(20, n_success // 10), fit_draws.curve_fit_rates(start)))
        for start in _PEER_STARTS
    ]
    tick()
    scatter = ours.rates.std(axis=0) / case.bound
    covered = {c.name: fit_draws.coverage(c, n_coverage) for c in (fit_draws.USUAL, fit_draws.NEAR)}
    tick()
    counts = {c.name: fit_draws.counted(c, n_counted) for c in fit_draws.COUNTED}
    tick()
    biases = list(fit_draws.biases(n_bias))
    tick()

    lanczos = min(float(row[2]) for row in digits if str(row[0]).startswith("Lanczos"))
    worst_count = min(c["chosen"] for c in counts.values())
    profile = np.concatenate([p for p, _ in covered.values()])
    normal = np.concatenate([c for _, c in covered.values()])
    summary = [
        f"NIST Lanczos1 to 3, both starts, worst parameter: {lanczos:.2f} digits.",
        f"Both rates within 10 % from no guess: {ours.within(case.kr):.1%} of {n_success} draws; "
        f"scatter {scatter.max():.3f} of the Cramer-Rao bound; {1e3 * ours.seconds:.1f} ms a fit.",
        f"Intervals of 95 % hold the truth in {profile.min():.1%} to {profile.max():.1%} of {n_coverage} draws; "
        f"by the covariance alone in {normal.min():.1%} to {normal.max():.1%}.",
        f"Right number of states: at least {worst_count:.0%} of {n_counted} draws in each case.",
    ]
    absent = [name for name in ("lmfit", "glotaran") if importlib.util.find_spec(name) is None]
    if absent:
        summary.append(f"Not installed here, so not compared: {', '.join(absent)}.")
    sections = [
        Section(
            "How many digits?",
            [
                "Problems of the NIST StRD, whose certificates have 11 digits; a rate near 1 is certified to 10.3. "
                "Digits of the worst parameter, and of the worst standard deviation. Lanczos1 leaves residuals in the "
                "14th digit, so float64 holds its standard deviations to 3 digits only."
            ],
            [
                Table(
                    "digits",
                    "Variable projection with every sign free, and scipy's curve_fit from the same start.",
                    (
                        "problem",
                        "start",
                        "phoslab, parameters",
                        "phoslab, standard deviations",
                        "curve_fit, parameters",
                    ),
                    digits,
                )
            ],
        ),
        Section(
            "Are rates found without a guess?",
            [
                f"{case.name}, amplitudes 0.7 and 0.3, 37 values to 180 s, three channels, noise 0.2 % of the peak."
            ],
            [
                Table(
                    "success",
                    "Share of draws with both rates within 10 %. curve_fit needs a start, the same 8 parameters.",
                    ("fit", "draws", "both within 10 %", "ms a fit"),
                    [
                        (
                            "phoslab, no guess",
                            float(len(ours.rates)),
                            ours.within(case.kr),
                            1e3 * ours.seconds,
                        ),
                        *(
                            (
                                f"curve_fit from {s[0]:g}, {s[1]:g}",
                                float(len(p.rates)),
                                p.within(case.kr),
                                1e3 * p.seconds,
                            )
                            for s, p in peers
                        ),
                    ],
                ),
                Table(
                    "scatter",
                    "Standard deviation of the rates over the draws, against the least that is possible.",
                    ("rate [1/s]", "scatter / Cramer-Rao bound"),
                    [(f"{k:g}", float(s)) for k, s in zip(case.kr, scatter, strict=True)],
                ),
            ],
        ),
        Section(
            "Do intervals of 95 % hold the truth?",
            [
                f"{n_coverage} draws each; a share of so many is known to {np.sqrt(0.95 * 0.05 / n_coverage):.2%}."
            ],
            [
                Table(
                    "coverage",
                    "Share of draws whose interval holds the true rate.",
                    ("case", "rate [1/s]", "profile likelihood", "covariance alone"),
                    [
                        (c.name, f"{k:g}", float(p), float(q))
                        for c in (fit_draws.USUAL, fit_draws.NEAR)
                        for k, p, q in zip(c.kr, *covered[c.name], strict=True)
                    ],
                )
            ],
        ),
        Section(
            "Is the number of states right?",
            [f"{n_counted} draws each. Every criterion chooses among 1 to 4 states with and without offset."],
            [
                Table(
                    "states",
                    "Share of draws with the true number.",
                    ("case", "chosen", "AICc", "BIC", "cross-validation"),
                    [
                        (name, c["chosen"], c["AICc"], c["BIC"], c.get("cross-validation"))
                        for name, c in counts.items()
                    ],
                )
            ],
        ),
        Section(
            "Are rates biased?",
            [f"{n_bias} draws each, two states."],
            [
                Table(
                    "bias",
                    "Mean of the rates less the truth, in per cent of it, ± standard error.",
                    ("situation", "fast [%]", "± [%]", "slow [%]", "± [%]"),
                    [
                        (name, 100 * float(b[0]), 100 * float(e[0]), 100 * float(b[1]), 100 * float(e[1]))
                        for name, b, e in biases
                    ],
                )
            ],
        ),
    ]
    data = {
        "quick": quick,
        "digits": [
            dict(zip(("problem", "start", "parameters", "sd", "curve_fit"), row, strict=True))
            for row in digits
        ],
        "within_10_percent": ours.within(case.kr),
        "scatter_over_bound": scatter.tolist(),
        "coverage": {k: {"profile": p.tolist(), "covariance": c.tolist()} for k, (p, c) in covered.items()},
        "right_states": counts,
        "bias": {name: b.tolist() for name, b, _ in biases},
    }
    progress(total, total)
    return summary, write_trade(
        folder, "fit", "The decay fit: digits, success, honesty", summary, sections, data
    )


def _strd_row(name: str, k: int) -> tuple[str, str, float, float, float | str]:
    """Return digits of the worst parameter and standard deviation, and of curve_fit's worst parameter."""
    p = strd.PROBLEMS[name]
    n, n_x = len(p.rates), len(p.linear)
    found = varpro.solve(
        p.basis,
        p.y[None],
        np.log(p.starts[k]),
        signed=np.ones(n_x, bool),
        find_scale=name in ("MGH17", "BoxBOD"),
    )
    sd = np.sqrt(np.diag(varpro.covariance(p.basis, found)) * found.chi2 / (p.y.size - n - n_x))
    order = np.argsort(found.theta)[np.argsort(np.argsort(p.rates))]
    columns = np.concatenate([np.arange(int(p.constant)), order + int(p.constant)])
    rates = np.exp(found.theta[order])
    parameters = min(strd.digits(rates, p.rates), strd.digits(found.linear[0][columns], p.linear))
    deviations = min(strd.digits(sd[:n][order] * rates, p.rate_sd), strd.digits(sd[n:][columns], p.linear_sd))
    return name, f"{k + 1}", parameters, deviations, _curve_fit_digits(p, k)


def _curve_fit_digits(p: strd.Problem, k: int) -> float | str:
    """Return the digits of scipy's curve_fit from the same rates, linear parameters at the best for those."""
    from scipy.optimize import curve_fit

    n = len(p.rates)

    def model(_: Array, *parameters: float) -> Array:
        with np.errstate(all="ignore"):
            signal: Array = p.basis(np.log(np.abs(parameters[:n])))[0][0] @ np.array(parameters[n:])
        return signal

    start = np.array(p.starts[k])
    linear = varpro.linear_part(p.basis(np.log(start))[0][0], p.y, np.ones(len(p.linear), bool))
    try:
        with np.errstate(all="ignore"):
            found, _ = curve_fit(model, p.x, p.y, [*start, *linear], maxfev=20000)
    except (RuntimeError, ValueError):
        return "fails"
    order = np.argsort(np.abs(found[:n]))[np.argsort(np.argsort(p.rates))]
    columns = n + np.concatenate([np.arange(int(p.constant)), order + int(p.constant)])
    return min(strd.digits(np.abs(found[order]), p.rates), strd.digits(found[columns], p.linear))
