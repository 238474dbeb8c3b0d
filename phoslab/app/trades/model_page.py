"""The page of the trade of the model: a table and a figure of every point, the Pareto front marked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from phoslab.app.trades.page import Plot, Section, Table


@dataclass(frozen=True)
class Point:
    """One rendering: what was changed, the relative error in XYZ, and the time in s."""

    scene: str
    dimension: str
    setting: str
    error: float
    seconds: float


def front(points: Sequence[Point]) -> list[Point]:
    """Return those that nothing beats in both error and time, by time."""
    best: list[Point] = []
    for point in sorted(points, key=lambda p: (p.seconds, p.error)):
        if not best or point.error < best[-1].error:
            best.append(point)
    return best


def summary(points: Sequence[Point]) -> list[str]:
    """Say for each scene what no reflections, one, and the path tracer give."""
    lines = []
    for scene in dict.fromkeys(p.scene for p in points):
        of = {(p.dimension, p.setting): p for p in points if p.scene == scene}
        none, one = of["reflections", "0"], of["reflections", "1"]
        lines.append(
            f"{scene}: without reflected glow the picture is off by {none.error:.1%} and takes {none.seconds:.2f} s; "
            f"with one reflection, by {one.error:.1%}."
        )
    return lines


def sections(points: Sequence[Point], data: dict[str, Any]) -> list[Section]:
    """Return the sections of the page."""
    scenes = list(dict.fromkeys(p.scene for p in points))
    transport = [p for p in points if p.dimension in ("reflections", "gi")]
    rest = [p for p in points if p.dimension not in ("reflections", "gi")]
    fronts = [p for s in scenes for p in front([q for q in transport if q.scene == s])]
    return [
        Section(
            "How far should glow be followed?",
            ["Error against glow followed to its end by the path tracer, whose own noise is part of it."],
            [
                Plot("transport", "Each line is the Pareto front of a scene.", _figure(transport, scenes)),
                _table("transport", transport, fronts),
            ],
        ),
        Section(
            "What else can be left out?",
            ["Error against the same picture with everything on, no glow being reflected in either."],
            [
                _table(
                    "reductions", rest, [p for s in scenes for p in front([q for q in rest if q.scene == s])]
                )
            ],
        ),
        Section(
            "What the planner reads",
            [
                f"A texel of x pixels blurs glow by {data['texels']['error']:.2g} x^{data['texels']['power']:.2g}; "
                f"one path a pixel errs by {data['path_noise']:.2g} of the reflected light."
            ],
            [
                Table(
                    "costs",
                    "Time of each part, fitted to all runs without transport.",
                    ("part", "s"),
                    [(k, v) for k, v in data["costs_s"].items()],
                ),
                Table(
                    "path-costs",
                    "Time of paths, by the variant of Mitsuba.",
                    ("variant", "part", "s"),
                    [(name, k, v) for name, each in data["paths_s"].items() for k, v in each.items()],
                ),
            ],
        ),
    ]


def _table(name: str, points: Sequence[Point], fronts: Sequence[Point]) -> Table:
    return Table(
        name,
        "A star marks what nothing beats in both error and time.",
        ("scene", "what", "setting", "error, %", "time, s", "front"),
        [
            (p.scene, p.dimension, p.setting, 100 * p.error, p.seconds, "*" if p in fronts else "")
            for p in points
        ],
    )


def _figure(points: Sequence[Point], scenes: Sequence[str]) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.add_subplot()
    for k, scene in enumerate(scenes):
        own = [p for p in points if p.scene == scene and p.error > 0]
        axes.scatter([p.seconds for p in own], [100 * p.error for p in own], s=18, color=f"C{k}", label=scene)
        best = front(own)
        axes.plot([p.seconds for p in best], [100 * p.error for p in best], color=f"C{k}", lw=1)
    axes.set(xscale="log", yscale="log", xlabel="time of a picture, s", ylabel="mean |a - b| / mean b, %")
    axes.grid(True, which="both", alpha=0.2)
    axes.legend(frameon=False)
    return figure
