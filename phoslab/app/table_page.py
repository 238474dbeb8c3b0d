"""The fit of a table as one self-contained HTML page: the curve, what it misses, the numbers, and why to doubt them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from phoslab.app.figures import CHANNEL_COLOURS, missed_percent, svg
from phoslab.app.pages import render
from phoslab.files import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from phoslab.fitting.table_fit import TableFit

# Half of the times lie before such a part of the last.
_LOPSIDED = 5.0
# Of the axis, above and below all values.
_MARGIN = 2.0
# Values of more noise, in per cent, do not set the scale of what is missed.
_NOISY = 50.0


def write_page(path: str | os.PathLike[str], result: TableFit, name: str) -> None:
    """Write the page, whole or not at all."""
    from phoslab.fitting import table_report as text
    from phoslab.fitting.written import by_chance, number

    fit = result.fit
    page = render(
        "table.html",
        name=name,
        result=result,
        fit=fit,
        decay=svg(_figure(result)),
        misfit=text.misfit(result),
        sigma_given=result.sigma == "given",
        number=number,
        by_chance=by_chance,
        rates=[
            {
                "kr": text.rate(result, i),
                "interval": text.interval(result, i),
                "lifetime": text.lifetime(result, i),
            }
            for i in range(fit.n_states)
        ],
        amplitudes=[(channel, text.linear(result, c)) for c, channel in enumerate(fit.data.channels)],
        valid=text.valid(result),
        choice=text.choice(result),
        back=text.extrapolated_back(result),
        law_parameters=text.law_parameters,
        warnings=[_sentence(flag, fit.data.channels) for flag in result.warnings],
        notes=[_sentence(flag, fit.data.channels) for flag in result.notes],
    )
    write_text(path, page)


def _sentence(flag: str, channels: Sequence[str]) -> str:
    """The sentence of a "code: sentence", with a capital unless it begins with the name of a channel."""
    text = flag.partition(": ")[2]
    return text if text.startswith(tuple(channels)) else text[0].upper() + text[1:]


def _figure(result: TableFit) -> Figure:
    """Signal over time with the fit, and below it what the fit misses, in per cent of each value."""
    from matplotlib.figure import Figure

    fit, data = result.fit, result.fit.data
    figure = Figure(figsize=(8, 5.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.4, 1])
    middle = data.middle_s
    # Times that were spaced evenly in their logarithm are drawn so.
    first = data.begin_s
    by_decades = first > 0 and np.median(middle) < middle[-1] / _LOPSIDED
    t = np.geomspace(first, middle[-1], 500) if by_decades else np.linspace(first, middle[-1], 500)
    curve, predicted = fit.predict(t, np.zeros_like(t)), fit.predict(data.t_s, data.exposure_s)
    widest = 0.0
    for c, channel in enumerate(data.channels):
        used, colour = data.used[:, c], CHANNEL_COLOURS.get(channel, f"C{c}")
        sigma = data.total_sigma[used, c]
        upper.errorbar(
            middle[used], data.signal[used, c], sigma, fmt="o", ms=3, lw=0.8, color=colour, label=channel
        )
        upper.plot(t, curve[:, c], color=colour, lw=1)
        miss, spread = missed_percent(data.signal[used, c], predicted[used, c], sigma)
        lower.errorbar(middle[used], miss, spread, fmt="o", ms=3, lw=0.8, color=colour)
        clear = spread < _NOISY
        frames = np.flatnonzero(used)
        for run in (run for run in result.missed if run.channel == c):
            of = (run.first <= frames) & (frames <= run.last)
            widest = max(widest, float(np.abs(miss[of]).max()))
        widest = max(widest, float((np.abs(miss) + spread)[clear].max(initial=0.0)))
    shown = data.signal[data.used]
    if (shown > 0).all():
        # What a fit says far below all values is nothing to look at.
        upper.set_yscale("log")
        upper.set_ylim(shown.min() / _MARGIN, shown.max() * _MARGIN)
    if by_decades:
        upper.set_xscale("log")
    upper.set_ylabel("value [the table's unit]")
    figure.legend(
        title="measured (points), fitted (lines)", ncols=4, frameon=False, loc="outside upper center"
    )
    lower.axhline(0, color="0.4", lw=0.8)
    lower.set_ylabel("misfit [%]")
    if widest > 0:
        lower.set_ylim(-1.1 * widest, 1.1 * widest)
    lower.set_xlabel("time since lamp-off [s]")
    for axes in (upper, lower):
        axes.grid(alpha=0.25)
    return figure
