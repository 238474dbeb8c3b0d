"""The report: one self-contained HTML page with the fit, its residuals and numbers, and pictures."""

from __future__ import annotations

import base64
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from phoslab.app.figures import CHANNEL_COLOURS, missed_percent, svg
from phoslab.app.pages import render
from phoslab.files import write_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from phoslab.fitting import FitResult
    from phoslab.fitting.excitation import ExcitationFit
    from phoslab.fitting.result import MeasuredExcitation


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
    found = result.excitation
    page = render(
        "report.html",
        result=result,
        material=result.material,
        states=_states(result),
        off_by=_off_by(result),
        held_out={h.n_states: h for h in result.held_out},
        decay=svg(_decay_figure(result)),
        emission=svg(_emission_figure(result)),
        n_signals=0 if result.spectrum is None else int(np.isfinite(result.spectrum.measured).sum()),
        rise=None if found is None else svg(_excitation_figure(found)),
        excited=[] if found is None else _excited(found),
        level=None if found is None else f"{np.nanmedian(np.abs(found.fit.level_error)):.1%}",
        loose=[i + 1 for i in result.material.provenance["product_only"]],
        calibration=_calibration(result),
        pictures=[(data_uri(p.path), p.caption) for p in pictures],
        notes=notes,
    )
    write_text(path, page)


def _off_by(result: FitResult) -> str:
    """Where the decay's fit is farthest off, if it is off by more than noise."""
    t_s, share = result.fit.farthest_off()
    return f"{share:.1%} at {t_s:.3g} s" if share else ""


def _states(result: FitResult) -> list[dict[str, Any]]:
    """The numbers of each state, ready to print."""
    from phoslab.fitting.written import with_error

    fit = result.fit
    share = fit.strength / fit.kr_per_s
    share = share / share.sum()
    return [
        {
            "kr": with_error(fit.kr_per_s[i], fit.kr_standard_error[i]),
            "interval": "{:.4g} .. {:.4g}".format(*result.interval95[i]),
            "lifetime": f"{1 / fit.kr_per_s[i]:.3g}",
            "amplitude": with_error(fit.strength[i], fit.strength_standard_error[i]),
            "share": f"{share[i]:.0%}",
        }
        for i in range(fit.n_states)
    ]


def _excited(found: MeasuredExcitation) -> list[dict[str, str]]:
    """What is known of how each state is excited."""
    from phoslab.fitting.excitation_report import excitation_of, initial_of

    fit = found.fit
    return [
        {
            "a": excitation_of(fit, i),
            "initial": initial_of(fit, i),
            "known": "only the product of Λ and ke" if fit.product_only[i] else "ke and Λ",
        }
        for i in range(fit.n_states)
    ]


def _calibration(result: FitResult) -> str:
    """The file or the sessions that the filter's calibration is from."""
    told = result.material.provenance["calibration"]
    if told is None:
        return ""
    parts = told.get("sessions") or [told]
    return ", ".join(f"{part['name']} ({part['sha256'][:16]})" for part in parts)


def _decay_figure(result: FitResult) -> Figure:
    """Signal over time with the fit, and below it what the fit misses."""
    from matplotlib.figure import Figure

    fit, data = result.fit, result.reduced.data
    figure = Figure(figsize=(8, 5.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.4, 1])
    middle = data.middle_s
    t = np.linspace(0, middle[-1], 400)
    curve = fit.predict(t, np.zeros_like(t))
    predicted = fit.predict(data.t_s, data.exposure_s)
    for c, (channel, colour) in enumerate(zip(data.channels, CHANNEL_COLOURS.values(), strict=True)):
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
        miss, spread = missed_percent(data.signal[used, c], predicted[used, c], data.total_sigma[used, c])
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
    if result.spectrum is not None:
        seen = result.spectrum
        scale = base.max() / seen.band_means(m.bands)[0].max()
        low, high = (scale * (seen.value + sign * 2 * seen.standard_error) for sign in (-1, 1))
        axes.plot(seen.nm, scale * seen.value, color="0.15", lw=1.2, label="measured spectrum")
        axes.fill_between(seen.nm, np.maximum(low, 0), high, color="0.3", alpha=0.25, lw=0)
    axes.set_ylim(0, None)
    axes.set_xlabel("wavelength [nm]")
    axes.set_ylabel("radiance, all states full\n[DN/s at ISO 100, f/1]")
    axes.legend(frameon=False)
    return figure


_RISES = 6
"""Places whose rise is drawn."""


def _excitation_figure(found: MeasuredExcitation) -> Figure:
    """The rise of the glow at places under the filter, and the rates by band."""
    from matplotlib.figure import Figure

    from phoslab.fitting.decay_problem import exposed_decay

    fit, data = found.fit, found.series.data
    figure = Figure(figsize=(8, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    lit = data.steps.lit_s
    order = np.argsort(lit)
    # Frames differ in delay and exposure: what these leave of any glow is divided out.
    charge = found.series.charge
    left_over = (
        exposed_decay(charge.kr_per_s, data.steps.delay_s, data.steps.exposure_s)[0] @ charge.amplitude
    )
    glow, model = data.signal / left_over[:, None], fit.model / left_over[:, None]
    spread = np.hypot(data.sigma, data.repeatability * data.signal) / left_over[:, None]
    scale = 1 / np.nanmax(np.where(np.isfinite(data.sigma), glow, np.nan))
    # Photographs of one length of light stand beside each other; the line goes through the mean of what they would be.
    lengths = np.unique(lit)
    aside = lit * 1.06 ** np.array([(lit[:k] == t).sum() for k, t in enumerate(lit)])
    brightest = np.argsort(-data.signal[order[-1]])
    for k, s in enumerate(np.sort(brightest[: 2 * _RISES : 2])):
        used = data.signal[:, s] > 2 * data.sigma[:, s]  # a logarithmic axis has no room for less
        colour = f"C{k}"
        left.errorbar(
            aside[used],
            scale * glow[used, s],
            scale * spread[used, s],
            fmt="o",
            ms=3,
            lw=0.8,
            color=colour,
            label=f"{found.series.positions_nm[s]:.0f} nm",
        )
        line = [scale * model[lit == t, s].mean() for t in lengths]
        left.plot(lengths, line, color=colour, lw=1)
    left.set_xscale("log")
    left.set_yscale("log")
    doubled = 2.0 ** np.arange(np.round(np.log2(lit.min())), np.round(np.log2(lit.max())) + 1)
    left.set_xticks(doubled, [f"{t:g}" for t in doubled])
    left.minorticks_off()
    left.set_xlabel("length of light [s]")
    left.set_ylabel("glow, as a share of the brightest")
    # Above the axes: lines may run anywhere in them.
    left.legend(frameon=False, fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    _draw_rates(right, fit)
    for axes in (left, right):
        axes.grid(alpha=0.25)
    return figure


def _draw_rates(axes: Axes, fit: ExcitationFit) -> None:
    """Excitation rates by band with their errors and limits: once, where all states have one spectrum."""
    centres, shift = fit.bands.centres_nm, fit.bands.widths_nm / (fit.n_states + 2)
    for i in range(1 if fit.common_shape else fit.n_states):
        ke, error, limit = fit.ke_m2_per_J[i], fit.ke_standard_error[i], fit.ke_upper_limit[i]
        x, colour, label = centres, "0.2", "every state"
        if fit.common_shape:
            ke, error, limit = ke / ke.max(), fit.shape_error[i] * ke / ke.max(), limit / ke.max()
        else:
            x = centres + (i - (fit.n_states - 1) / 2) * shift
            colour, label = f"C{i}", f"kr = {fit.kr_per_s[i]:.3g} 1/s"
        seen = ke > 0
        error = np.minimum(error, 0.9 * ke)  # a logarithmic axis has no room for more
        axes.errorbar(x[seen], ke[seen], error[seen], fmt="o", ms=4, color=colour, label=label)
        bound = ~seen & np.isfinite(limit)
        axes.errorbar(
            x[bound], limit[bound], 0.5 * limit[bound], fmt="_", uplims=True, ms=6, lw=0.8, color=colour
        )
    axes.set_yscale("log")
    axes.set_xlabel("wavelength [nm]")
    axes.set_ylabel("ke, as a share of the largest" if fit.common_shape else "ke [m²/J of the lamp's unit]")
    axes.legend(frameon=False, fontsize=8, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def data_uri(path: Path) -> str:
    """Return a PNG file as what an <img> can hold."""
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii")
