"""The page of the solver trade: what was measured, in words, tables and plots."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from phoslab.app.trades import hours
from phoslab.app.trades.extremes import Verdict
from phoslab.app.trades.hours import HoursError
from phoslab.app.trades.on_gpu import StepCost
from phoslab.app.trades.page import Plot, Section, Table
from phoslab.app.trades.precision import EQUAL_ERROR, Measured
from phoslab.app.trades.previous import PastCost
from phoslab.app.trades.rhythm import RhythmError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Light that saturates the material, and light too weak to: there the previous method is valid.
STRONG, WEAK = 1.0, 1e-4

# Lights under which the renderer's own solvers are measured as well.
DRAWN_ON_GPU = ("switched", "sinusoidal", "mains flicker")

STYLE = {
    "euler": ("C3", "o"),
    "substep": ("C1", "v"),
    "exact": ("C0", "s"),
    "exact2": ("C2", "D"),
    "closed form": ("k", "*"),
    "rk23": ("C4", "^"),
    "history, 1 sample": ("0.6", "x"),
    "history, 1024 samples": ("0.35", "+"),
}


def summary(measured: Sequence[Measured]) -> list[str]:
    """Say what to take, and where the paper's method wins."""
    strong = [m for m in measured if m.problem.strength == STRONG]
    sentences = []
    for rival, name in (("euler", "forward Euler"), ("rk23", "Runge-Kutta 2(3)")):
        gains = ", ".join(f"{m.problem.name} {_gain(m, rival)}x" for m in strong)
        sentences.append(
            f"To an error of {EQUAL_ERROR:g}, the best exact step is faster than {name} by: {gains}."
        )
    winners = [m.problem.name for m in strong if (gain := m.gain("euler")) is not None and gain[0] < 1]
    plain = [
        m.problem.name
        for m in strong
        if (euler := m.time_to("euler")) is not None and euler < (m.time_to("exact") or float("inf"))
    ]
    sentences.append(
        f"Forward Euler wins {'under ' + ', '.join(winners) if winners else 'under no light'} against the best exact "
        f"step, and {'under ' + ', '.join(plain) if plain else 'under no light'} against the one that takes the light "
        "at its start."
    )
    return sentences


def precision_section(measured: Sequence[Measured]) -> Section:
    columns = (
        "light",
        "strength",
        "method",
        "setting",
        "error",
        "ns per texel and s",
        "slowest / fastest run",
        "lights per s",
    )
    rows = [
        (m.problem.name, m.problem.strength, p.method, p.setting, p.error, p.ns, p.spread, p.lights)
        for m in measured
        for p in m.points
    ]
    strong = [m for m in measured if m.problem.strength == STRONG]
    weak = [m for m in measured if m.problem.strength == WEAK]
    return Section(
        "Which solver for which light?",
        [
            "Every method solves the same problem: a material of two states (rates 0.132 and 0.009 1/s) on many texels "
            "whose light spans two decades. Further down is more accurate, further left is faster; each point is one "
            "step length or tolerance. The error is that of the glow, relative, the root mean square over the texels "
            "at the worst of eight times, against a Runge-Kutta method of order 8 at a tolerance of 1e-12.",
            "“exact” takes the light at the start of a step, “exact2” its mean over the step, “closed form” one step "
            "from each change of light to the next, which is possible where light is constant in between. “history” "
            "is the previous method, Monte Carlo over past light (Glassner 1995): it knows no saturation, so in strong "
            "light its error is that of the model and does not fall with more samples.",
        ],
        [
            Plot(
                "work-precision-strong",
                "Light that saturates the material: excitation up to 0.3 1/s, the laser sheet's up to 6 1/s.",
                _grid(strong),
            ),
            Plot(
                "work-precision-weak",
                "Light 10,000 times weaker, which saturates nothing: here the previous method is valid.",
                _grid(weak),
            ),
            Table("work-precision", "Every point of the plots.", columns, rows, in_page=False),
        ],
    )


def equal_section(measured: Sequence[Measured]) -> Section:
    rows: list[Sequence[str | float | None]] = []
    for m in measured:
        times = [m.time_to(method) for method in STYLE]
        rows.append((m.problem.name, m.problem.strength, *times, _gain(m, "euler"), _gain(m, "rk23")))
    columns = ("light", "strength", *STYLE, "gain over euler", "gain over rk23")
    return Section(
        f"What does an error of {EQUAL_ERROR:g} cost?",
        [
            "Time in ns a texel and simulated second, between the points of the plots; “-”: the method does not get "
            "there with the settings tried. The gain is that of the fastest of exact, exact2 and closed form.",
        ],
        [Table("equal-error", "Time to equal error.", columns, rows)],
    )


def texture_section(costs: Sequence[StepCost], measured: Sequence[Measured]) -> Section:
    columns = (
        "solver",
        "format",
        "bytes a texel",
        "ns a texel",
        "over a copy",
        "jump over a copy",
        "dark over a copy",
        "error, switched light, 60 Hz",
    )
    rows = [
        (
            c.solver,
            c.state_format,
            c.bytes_per_texel,
            c.ns,
            c.over_copy,
            c.jump_over_copy,
            c.dark_over_copy,
            c.error,
        )
        for c in costs
    ]
    return Section(
        "What does a step cost on textures?",
        [
            "The renderer's solvers in GLSL, on textures of two states in each format: float32, float16, 16-bit "
            "normalised, and float32 that keeps what its rounding lost (f32c). “Over a copy” is the time of a step "
            "of 1/60 s over that of a pass that reads and writes the same and computes nothing; a “jump” is a step of "
            "a minute in closed form, “dark” one of 1/60 s without light. The error is that of 60 Hz steps "
            "over 20 s of switched light: 16-bit formats round away what a frame changes.",
        ],
        [
            Table("steps", "One step of 1/60 s.", columns, rows),
            Plot(
                "work-precision-textures",
                "Work and precision in GLSL and float32, on 512 texels or more: mostly the cost of a dispatch.",
                _grid(measured, columns=len(measured)),
            ),
        ],
    )


def rhythm_section(errors: Sequence[RhythmError]) -> Section:
    rhythms = list(dict.fromkeys(e.rhythm for e in errors))
    found = {(e.light, e.solver, e.rhythm): e.error for e in errors}
    pairs = dict.fromkeys((e.light, e.solver) for e in errors)
    rows: list[Sequence[str | float]] = [
        (light, solver, *(found[light, solver, r] for r in rhythms)) for light, solver in pairs
    ]
    return Section(
        "Does the glow depend on the frame rate?",
        [
            "The same light, stepped once a displayed frame; the error of the glow as above. “uneven” stutters: each "
            "frame lasts between 0.2 and 1.8 times 1/60 s. The switched light changes at whole seconds, which even "
            "rates meet and an uneven one does not. A renderer that steps from change to change of the light, as "
            "phoslab does where light is piecewise constant, does not depend on the rate at all.",
        ],
        [Table("frame-rates", "Relative error of the glow.", ("light", "solver", *rhythms), rows)],
    )


def previous_section(costs: Sequence[PastCost]) -> Section:
    columns = (
        "past light [s]",
        "cache a texel [bytes]",
        "sum over the cache [ns a texel]",
        "one exact step [ns a texel]",
    )
    rows = [(c.past_s, c.cache_bytes, c.history_ns, c.step_ns) for c in costs]
    return Section(
        "What does the past cost?",
        [
            "The previous method has no state: each frame needs the light of all frames before it, kept or computed "
            "again. Its cost and its memory grow with the time since the start; a step of the rate equations keeps "
            "one number a state (8 bytes a texel here).",
        ],
        [Table("past", "One frame at 60 Hz after a past of so many seconds, two states.", columns, rows)],
    )


def extremes_section(verdicts: Sequence[Verdict]) -> Section:
    columns = (
        "solver",
        "arithmetic",
        "cases",
        "refused",
        "not finite",
        "outside [0, 1]",
        "past the equilibrium",
    )
    rows = [(v.solver, v.arithmetic, v.n, v.refused, v.not_finite, v.outside, v.past) for v in verdicts]
    return Section(
        "What happens at the extremes?",
        [
            "Every combination of steps of 1e-6 to 1e6 s, irradiances of 0 to 1e12, ke of 0 to 1e3, kr of 0 to 1e6 1/s "
            "and concentrations of 0 to 1, with denormal numbers among them. A solver may refuse a step, and says so; "
            "what it takes must be finite and inside [0, 1]. “Past the equilibrium” counts what overshoots by more "
            "than the format's rounding: exact and exact2 promise that none does, rk23 may within its tolerance.",
        ],
        [
            Table(
                "extremes",
                "One step from each corner of the ranges; every count but the refusals should be 0.",
                columns,
                rows,
            )
        ],
    )


def hours_section(errors: Sequence[HoursError]) -> Section:
    rows = [(e.method, e.hours, "charging" if e.lit else "dark", e.error) for e in errors]
    return Section(
        "Does a slow material survive hours of frames?",
        [
            f"kr = {hours.KR:g} 1/s, stepped at 60 Hz: each frame changes the state by less than 30 roundings of a "
            "float32.",
        ],
        [
            Table(
                "hours",
                "Relative error of the state against the closed form.",
                ("method", "hours", "light", "error"),
                rows,
            )
        ],
    )


def _gain(measured: Measured, rival: str) -> str:
    """The gain over a rival as text, `> 12` where it is a lower bound."""
    gain = measured.gain(rival)
    return "-" if gain is None else f"{'> ' if gain[1] else ''}{gain[0]:.3g}"


def _grid(measured: Sequence[Measured], columns: int = 3) -> Figure:
    """Work-precision diagrams on one sheet."""
    from matplotlib.figure import Figure

    rows = -(-len(measured) // columns)
    figure = Figure(figsize=(11, 0.8 + 3 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, sharey=True).ravel()
    for ax, m in zip(axes, measured, strict=True):
        for method, (colour, marker) in STYLE.items():
            points = sorted((p for p in m.points if p.method == method), key=lambda p: p.ns)
            # What agrees with the yardstick to its last digits is drawn at its tolerance.
            errors = [max(p.error, 1e-12) for p in points]
            if points:
                ax.plot(
                    [p.ns for p in points], errors, color=colour, marker=marker, ms=4, lw=0.9, label=method
                )
        ax.axhline(EQUAL_ERROR, color="0.7", lw=0.8, zorder=0)
        ax.set(xscale="log", yscale="log", title=f"{m.problem.name}: {m.problem.description}")
        ax.title.set_fontsize(9)
        ax.grid(alpha=0.25)
    for ax in axes[-columns:]:
        ax.set_xlabel("time [ns per texel and simulated second]")
    for ax in axes[::columns]:
        ax.set_ylabel("relative error of the glow")
    shown = dict(zip(*reversed(axes[0].get_legend_handles_labels()), strict=True))
    shown |= dict(zip(*reversed(axes[1].get_legend_handles_labels()), strict=True))
    figure.legend(
        list(shown.values()),
        list(shown),
        loc="outside lower center",
        ncols=len(STYLE),
        frameon=False,
        fontsize=9,
    )
    return figure
