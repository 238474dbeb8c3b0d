"""The fit of a table as text for people."""

from __future__ import annotations

import numpy as np

from phoslab.fitting import extrapolation
from phoslab.fitting.table_fit import TableFit


def report(result: TableFit, name: str) -> str:
    """Return the fit as text: parameters with errors and intervals, how many states, other laws, warnings."""
    fit, data = result.fit, result.fit.data
    plural = "s" if fit.n_states > 1 else ""
    per_dof = f" = {fit.chi2 / fit.dof:.3g}" if fit.dof > 0 else ""
    lines = [
        f"[[{name}: decay, {fit.n_states} exponential{plural}]]",
        f"  values used             {data.n_values} of {data.sigma.size}, {data.t_s[0]:.4g} s to {data.end_s:.4g} s",
        f"  σ                       {result.sigma}",
        f"  chi-square / dof        {fit.chi2:.4g} / {fit.dof}{per_dof}",
        "[[parameters]]",
    ]
    for i, kr in enumerate(fit.kr_per_s):
        low, high = result.interval95[i]
        ends = f"{low:.4g} .. {high:.4g}" if np.isfinite(high) else f"{low:.4g} .. (open)"
        lines.append(
            f"  kr[{i}] [1/s]             {_with_error(float(kr), float(fit.kr_standard_error[i]))}"
            f"   95 %: {ends}   lifetime {1 / kr:.4g} s"
        )
        if result.bootstrap95 is not None:
            b = result.bootstrap95[i]
            lines.append(f"                          bootstrap 95 %: {b[0]:.4g} .. {b[1]:.4g}")
    width = max(12, *(len(c) + 2 for c in data.channels))
    lines.append("[[amplitudes at t = 0]]")
    lines.append("  " + " " * 14 + "".join(f"{c:>{width}}" for c in data.channels))
    for i in range(fit.n_states):
        lines.append(f"  {f'A[{i}]':14}" + "".join(f"{a:>{width}.5g}" for a in fit.amplitude[i]))
    said = "fitted" if fit.has_offset else "none: 0"
    lines.append(f"  {'offset':14}" + "".join(f"{o:>{width}.5g}" for o in fit.offset) + f"   ({said})")
    lines.append(f"  valid from {result.valid_s[0]:.4g} s to {result.valid_s[1]:.4g} s after lamp-off")
    lines.append("[[number of states]]")
    lines.append("  states offset   chi-square   dof       AICc        BIC    F-test  cross-validation")
    for c in result.selection.candidates:
        f_test = "-" if c.f_test is None else f"{c.f_test:.2g}"
        cv = "-" if c.cross_validation is None else f"{c.cross_validation:.4g}"
        marks = ("  <- chosen" if c is result.selection.chosen else "") + (
            "" if c.sound else "  (not distinct)"
        )
        lines.append(
            f"  {c.n_states:>6} {'yes' if c.fit.has_offset else 'no':>6} {c.fit.chi2:>12.5g} {c.fit.dof:>5}"
            f" {c.fit.aicc:>10.5g} {c.fit.bic:>10.5g} {f_test:>9} {cv:>17}{marks}"
        )
    votes = ", ".join(f"{k} {v.n_states}" for k, v in result.selection.votes.items())
    lines.append(f"  would choose: {votes}. The F-test decides.")
    if result.other_laws:
        lines.append("[[other laws, as a diagnosis; they cannot be simulated under changing light]]")
        for o in result.other_laws:
            values = ", ".join(f"{k} = {v:.4g}" for k, v in o.parameters.items())
            lines.append(f"  {o.name:22}  {values}   chi-square {o.chi2:.5g}, AICc {o.aicc:.5g}")
    lines += extrapolation.lines(result.extrapolated, data.channels)
    if result.flags:
        lines.append("[[warnings]]")
        lines += [f"  {f}" for f in result.flags]
    return "\n".join(lines) + "\n"


def _with_error(value: float, error: float) -> str:
    if not 0 < error < 1e3 * value:
        return f"{value:.6g} (error not determined)"
    digits = int(np.clip(np.ceil(np.log10(value / error)) + 2, 2, 12))
    return f"{value:.{digits}g} ± {error:.2g} ({error / value:.1%})"
