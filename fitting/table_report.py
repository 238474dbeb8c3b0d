"""The fit of a table as text for people."""

from __future__ import annotations

import numpy as np

from phoslab.fitting import extrapolation
from phoslab.fitting.table_fit import TableFit


def report(result: TableFit, name: str) -> str:
    """Return the fit as text: parameters with errors and intervals, how many states, other laws, warnings."""
    fit, data = result.fit, result.fit.data
    plural = "s" if fit.n_states > 1 else ""
    lines = [
        f"[[{name}: decay, {fit.n_states} exponential{plural}]]",
        f"  values used             {data.n_values} of {data.sigma.size}, {data.t_s[0]:.4g} s to {data.end_s:.4g} s",
        f"  σ                       {result.sigma}",
        f"  χ² / dof                {misfit(result)}",
        f"  valid                   from {result.valid_s[0]:.4g} s to {result.valid_s[1]:.4g} s after lamp-off",
        "[[parameters]]",
    ]
    for i, kr in enumerate(fit.kr_per_s):
        error = float(fit.kr_standard_error[i])
        lines.append(
            f"  kr[{i}] [1/s]             {with_error(float(kr), error, share=True)}"
            f"   95 %: {interval(result, i)}   lifetime {lifetime(result, i)}"
        )
        if result.bootstrap95 is not None:
            b = result.bootstrap95[i]
            lines.append(f"                          bootstrap 95 %: {b[0]:.4g} .. {b[1]:.4g}")
    lines.append("[[amplitudes at t = 0, in the table's unit]]")
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
            f" {c.fit.aicc:>10.5g} {c.fit.bic:>10.5g} {by_chance(c.f_test):>9} {cv:>17}{marks}"
        )
    votes = ", ".join(f"{k} {v.n_states}" for k, v in result.selection.votes.items())
    lines.append(f"  would choose: {votes}. The F-test decides.")
    if result.other_laws:
        lines.append("[[other laws, as a diagnosis; they cannot be simulated under changing light]]")
        for o in result.other_laws:
            values = ", ".join(f"{k} = {v:.4g}" for k, v in o.parameters.items())
            lines.append(f"  {o.name:22}  {values}   χ² {o.chi2:.5g}, AICc {o.aicc:.5g}")
    lines += extrapolation.lines(result.extrapolated, data.channels)
    if result.flags:
        lines.append("[[warnings]]")
        lines += [f"  {f}" for f in result.flags]
    return "\n".join(lines) + "\n"


def misfit(result: TableFit) -> str:
    """Return χ² per degree of freedom, and whether it tells anything."""
    fit = result.fit
    if fit.dof <= 0:
        return f"{fit.chi2:.4g} / {fit.dof}: nothing is left to judge by"
    said = f"{fit.chi2:.4g} / {fit.dof} = {fit.chi2 / fit.dof:.3g}"
    return f"{said} by construction: σ were scaled to what this fit misses" if result.scaled else said


def interval(result: TableFit, i: int) -> str:
    """Return the interval of 95 % of a rate."""
    low, high = result.interval95[i]
    return f"{low:.4g} .. {high:.4g}" if np.isfinite(high) else f"{low:.4g} .. (open)"


def lifetime(result: TableFit, i: int) -> str:
    """Return 1 / kr, or its least value where the rate may be 0."""
    low, high = result.interval95[i]
    if low > 0:
        return f"{1 / result.fit.kr_per_s[i]:.4g} s"
    return f"above {1 / high:.4g} s" if np.isfinite(high) else "not determined"


def linear(result: TableFit, channel: int) -> dict[str, str]:
    """Return the amplitudes of a channel, and its offset, with errors."""
    fit = result.fit
    found = {
        f"A[{i}]": with_error(
            float(fit.amplitude[i, channel]), float(result.amplitude_standard_error[i, channel])
        )
        for i in range(fit.n_states)
    }
    error = float(result.offset_standard_error[channel])
    found["offset"] = with_error(float(fit.offset[channel]), error) if fit.has_offset else "none"
    return found


def with_error(value: float, error: float, *, share: bool = False) -> str:
    """Write a value to the second digit of its error; `share` adds that error as a share of it."""
    if value == 0:
        return "0"
    if not 0 < error < 1e3 * abs(value):
        return f"{value:.4g} (error not determined)"
    if 1e-4 <= abs(value) < 1e6:
        decimals = int(np.clip(1 - np.floor(np.log10(error)), 0, 12))
        text = f"{value:.{decimals}f} ± {error:.{decimals}f}"
    else:
        digits = int(np.clip(np.ceil(np.log10(abs(value) / error)) + 2, 2, 12))
        text = f"{value:.{digits}g} ± {error:.2g}"
    return text + (f" ({error / abs(value):.1%})" if share else "")


def number(value: float) -> str:
    """Write a number of statistics shortly, without an exponent where it is merely large."""
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e7 else f"{value:.4g}"


def by_chance(p: float | None) -> str:
    """Write a probability, or that there is none."""
    if p is None:
        return "-"
    return f"{p:.2g}" if p >= 1e-9 else "< 1e-9"
