"""The fit of a table as text for people."""

from __future__ import annotations

import numpy as np

from phoslab.fitting import extrapolation, table_doubts
from phoslab.fitting.other_laws import OtherLaw
from phoslab.fitting.selection import SIGNIFICANCE
from phoslab.fitting.table_fit import TableFit
from phoslab.fitting.written import by_chance, criterion, with_error


def report(result: TableFit, name: str) -> str:
    """Return the fit as text: parameters with errors and intervals, how many states, other laws, warnings."""
    fit, data = result.fit, result.fit.data
    plural = "s" if fit.n_states > 1 else ""
    lines = [
        f"[[{name}: decay, {fit.n_states} exponential{plural}]]",
        f"  values used             {data.n_values} of {data.sigma.size}, {data.t_s[0]:.4g} s to {data.end_s:.4g} s",
        f"  σ                       {result.sigma}",
        f"  χ² / dof                {misfit(result)}",
        f"  valid                   {valid(result)}",
        "[[parameters]]",
    ]
    for i in range(fit.n_states):
        lines.append(
            f"  kr[{i + 1}] [1/s]             {rate(result, i)}"
            f"   95 %: {interval(result, i)}   lifetime {lifetime(result, i)}"
        )
        if result.bootstrap95 is not None:
            b = result.bootstrap95[i]
            lines.append(f"                          bootstrap 95 %: {b[0]:.4g} .. {b[1]:.4g}")
    if result.misses:
        lines.append("  (no bounds of true rates, since the model misses the data: of the nearest curve's)")
    lines.append(f"[[amplitudes at t = 0{extrapolated_back(result)}, in the table's unit]]")
    for k, channel in enumerate(data.channels):
        for label, value in linear(result, k).items():
            lines.append(f"  {channel + ' ' + label:24}{value}")
    lines.append("[[number of states; every candidate with the same weights, those of a first fit]]")
    lines.append("  states offset           χ²   dof       AICc        BIC    F-test  cross-validation")
    for c in result.selection.candidates:
        cv = "-" if c.cross_validation is None else f"{c.cross_validation:.4g}"
        marks = ("  <- chosen" if c is result.selection.chosen else "") + (
            "" if c.sound else "  (not distinct)"
        )
        lines.append(
            f"  {c.n_states:>6} {'yes' if c.fit.has_offset else 'no':>6} {c.fit.chi2:>12.5g} {c.fit.dof:>5}"
            f" {criterion(c.fit.aicc):>10} {criterion(c.fit.bic):>10} {by_chance(c.f_test):>9} {cv:>17}{marks}"
        )
    lines.append(f"  {choice(result)}")
    if result.other_laws:
        lines.append("[[other laws, as a diagnosis; they cannot be simulated under changing light]]")
        for o in result.other_laws:
            lines.append(f"  {o.name:22}  {law_parameters(o)}   χ² {o.chi2:.5g}, AICc {o.aicc:.5g}")
        if result.scaled_to_law:
            lines.append(
                "  (σ were scaled to Becquerel's law, so that its χ² equals its dof by construction)"
            )
    lines += extrapolation.lines(result.extrapolated, data.channels)
    for title, flags in (("warnings", result.warnings), ("as usual, and good to know", result.notes)):
        if flags:
            lines.append(f"[[{title}]]")
            lines += [f"  {f}" for f in flags]
    return "\n".join(lines) + "\n"


def misfit(result: TableFit) -> str:
    """Return χ² per degree of freedom, and whether it tells anything."""
    fit = result.fit
    if fit.dof <= 0:
        return f"{fit.chi2:.4g} / {fit.dof}: nothing is left to judge by"
    said = f"{fit.chi2:.4g} / {fit.dof} = {fit.chi2 / fit.dof:.3g}"
    return f"{said} by construction: σ were scaled to what this fit misses" if result.scaled else said


def valid(result: TableFit) -> str:
    """Return the times that the fit describes, and how well."""
    said = "from {:.4g} s to {:.4g} s after lamp-off".format(*result.valid_s)
    worst = result.worst_miss
    if worst is None:
        return said
    return f"{said}; of the well-measured values there the worst is missed by {worst.share:.0%}, at {worst.t_s:.4g} s"


def choice(result: TableFit) -> str:
    """Return what each criterion would choose, or that there was no choice."""
    if len(result.selection.candidates) == 1:
        return "No other was tried: not asked for, or more than so few values can tell."
    return (
        "Chosen: the smallest model that no larger one which contains it beats significantly (F-test, "
        f"p < {SIGNIFICANCE:g}){_rival(result)}. Each criterion alone would choose: "
        f"{table_doubts.votes(result.selection)}."
    )


def _rival(result: TableFit) -> str:
    """Return what comes nearest to beating the choice."""
    if result.selection.rival is None:
        return ""
    candidate, p = result.selection.rival
    name = f"{candidate.n_states} state{'s' * (candidate.n_states > 1)}{' and an offset' * candidate.fit.has_offset}"
    return f"; nearest to that comes {name}, p = {by_chance(p)}"


def extrapolated_back(result: TableFit) -> str:
    """Return from where amplitudes at t = 0 are extrapolated, if they are."""
    first = result.fit.data.begin_s
    return f", extrapolated from the first value, at {first:.4g} s" if first > 0 else ""


def law_parameters(law: OtherLaw) -> str:
    """Return the parameters of another law."""
    return ", ".join(
        f"{k} not determined" if k in law.undetermined else f"{k} = {v:.4g}"
        for k, v in law.parameters.items()
    )


def rate(result: TableFit, i: int) -> str:
    """Return a rate with its standard error, or what the data say of it instead."""
    if _open(result, i):
        return "not determined"
    if np.isinf(result.interval95[i, 1]):
        return f"above {result.interval95[i, 0]:.4g}"
    return with_error(float(result.fit.kr_per_s[i]), float(result.fit.kr_standard_error[i]), share=True)


def _open(result: TableFit, i: int) -> bool:
    """Whether the data exclude no rate of a state."""
    return bool(result.interval95[i, 0] <= 0 and np.isinf(result.interval95[i, 1]))


def _gone(result: TableFit, i: int) -> bool:
    """Whether a state may have faded before the first value, so that it may have had any amplitude."""
    return bool(result.fit.data.begin_s > 0 and np.isinf(result.interval95[i, 1]))


def interval(result: TableFit, i: int) -> str:
    """Return the interval of 95 % of a rate."""
    low, high = result.interval95[i]
    return f"{low:.4g} .. {high:.4g}" if np.isfinite(high) else f"{low:.4g} .. (open)"


def lifetime(result: TableFit, i: int) -> str:
    """Return 1 / kr, or its least or largest value where the rate is open."""
    low, high = result.interval95[i]
    if low > 0:
        return f"{1 / result.fit.kr_per_s[i]:.4g} s" if np.isfinite(high) else f"below {1 / low:.4g} s"
    return f"above {1 / high:.4g} s" if np.isfinite(high) else "not determined"


def linear(result: TableFit, channel: int) -> dict[str, str]:
    """Return the amplitudes of a channel, and its offset, with errors."""
    fit = result.fit
    found = {
        f"A[{i + 1}]": "not determined"
        if _open(result, i) or _gone(result, i)
        else with_error(float(fit.amplitude[i, channel]), float(result.amplitude_standard_error[i, channel]))
        for i in range(fit.n_states)
    }
    error = float(result.offset_standard_error[channel])
    found["offset"] = with_error(float(fit.offset[channel]), error) if fit.has_offset else "none"
    return found
