"""The report: one self-contained HTML page with the fit, its residuals and numbers, and pictures."""

from __future__ import annotations

import base64
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from phoslab.app.figures import svg
from phoslab.files import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from phoslab.fitting import FitResult

_CHANNEL_COLOURS = ("#c0392b", "#1e8449", "#2455a4")


@dataclass(frozen=True)
class Picture:
    """A PNG file and what it shows."""

    path: Path
    caption: str


def write_report(
    path: str | os.PathLike[str],
    result: FitResult,
    pictures: Sequence[Picture] = (),
    notes: Sequence[str] = (),
) -> None:
    """Write the report of a fit, whole or not at all.

    Args:
        pictures: shown at the top, in order.
        notes: sentences about the pictures (warnings of the renderer).
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    # Names and notes come from files that anyone may have written: everything is escaped.
    environment = Environment(
        loader=PackageLoader("phoslab.app", "."), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    page = environment.get_template("report.html").render(
        result=result,
        material=result.material,
        states=_states(result),
        held_out={h.n_states: h for h in result.held_out},
        decay=svg(_decay_figure(result)),
        emission=svg(_emission_figure(result)),
        pictures=[(data_uri(p.path), p.caption) for p in pictures],
        notes=notes,
    )
    write_text(path, page)


def _states(result: FitResult) -> list[dict[str, Any]]:
    """The numbers of each state, ready to print."""
    fit = result.fit
    share = fit.strength / fit.kr_per_s
    share = share / share.sum()
    return [
        {
            "kr": _value(fit.kr_per_s[i], fit.kr_standard_error[i]),
            "lifetime": f"{1 / fit.kr_per_s[i]:.3g}",
            "amplitude": _value(fit.strength[i], fit.strength_standard_error[i]),
            "share": f"{share[i]:.0%}",
        }
        for i in range(fit.n_states)
    ]


def _value(value: float, error: float) -> str:
    """Write a value to the second digit of its error, in thousands where it is large: `176.2 ± 4.9 thousand`."""
    if not np.isfinite(error) or error <= 0:
        return f"{value:.4g} (not determined)"
    thousands = " thousand" if abs(value) >= 1e4 else ""
    scale = 1e3 if thousands else 1.0
    decimals = max(0, 1 - int(np.floor(np.log10(error / scale))))
    return f"{value / scale:.{decimals}f} ± {error / scale:.{decimals}f}{thousands}"


def _decay_figure(result: FitResult) -> Figure:
    """Signal over time with the fit, and below it what the fit misses."""
    from matplotlib.figure import Figure

    fit, data = result.fit, result.reduced.data
    figure = Figure(figsize=(8, 5.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.4, 1])
    middle = data.t_s + data.exposure_s / 2
    t = np.linspace(0, middle[-1], 400)
    curve = fit.predict(t, np.zeros_like(t))
    predicted = fit.predict(data.t_s, data.exposure_s)
    for c, (channel, colour) in enumerate(zip(data.channels, _CHANNEL_COLOURS, strict=True)):
        used = data.used[:, c]
        upper.errorbar(
            middle[used],
            data.signal[used, c],
            data.total_sigma[used, c],
            fmt="o",
            ms=3,
            color=colour,
            label=channel,
        )
        upper.plot(t, curve[:, c], color=colour, lw=1)
        miss = 100 * (data.signal[used, c] / predicted[used, c] - 1)
        spread = 100 * data.total_sigma[used, c] / np.abs(predicted[used, c])
        lower.errorbar(middle[used], miss, spread, fmt="o", ms=3, lw=0.8, color=colour)
    upper.set_yscale("log")
    upper.set_ylabel("signal [DN/s at ISO 100, f/1]")
    upper.legend(title="measured (points), fitted (lines)", ncols=3, frameon=False)
    lower.axhline(0, color="0.4", lw=0.8)
    lower.set_ylabel("misfit [%]")
    lower.set_xlabel("time since lamp-off [s]")
    for axes in (upper, lower):
        axes.grid(alpha=0.25)
    return figure


def _emission_figure(result: FitResult) -> Figure:
    """Radiance by band when the lamp has just gone off, stacked by state."""
    from matplotlib.figure import Figure

    m = result.material
    figure = Figure(figsize=(8, 2.8), layout="constrained")
    axes = figure.subplots()
    base = np.zeros(m.bands.n)
    for i, kr in enumerate(m.kr_per_s):
        height = m.emission[i] * kr
        axes.bar(
            m.bands.centres_nm,
            height,
            width=m.bands.widths_nm,
            bottom=base,
            edgecolor="white",
            color=f"C{i}",
            label=f"kr = {kr:.3g} 1/s",
        )
        base = base + height
    axes.set_xlabel("wavelength [nm]")
    axes.set_ylabel("radiance at t = 0\n[material's unit]")
    axes.legend(frameon=False)
    return figure


def data_uri(path: Path) -> str:
    """Return a PNG file as what an <img> can hold."""
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii")
