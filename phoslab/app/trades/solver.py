"""The trade of the rate equations: solvers under light programmes, state formats, extremes, hours, frame rates."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from phoslab.app.trades import extremes, hours, on_gpu, precision, previous, rhythm, solver_page
from phoslab.app.trades.page import write_trade
from phoslab.app.trades.precision import Measured
from phoslab.render.device import Device
from phoslab.render.solvers import SOLVERS
from phoslab.render.state_formats import FORMATS

Progress = Callable[[int, int], None]


def measure(folder: Path, *, quick: bool, progress: Progress) -> tuple[list[str], list[Path]]:
    """Run every measurement and write the page; return its summary and the files."""
    n_texels, repeats, patience_s = (512, 1, 0.15) if quick else (2048, 3, 0.8)
    work = [p for s in (solver_page.STRONG, solver_page.WEAK) for p in precision.problems(n_texels, s)]
    measured = []
    for k, problem in enumerate(work):
        progress(k, len(work))
        measured.append(Measured(problem, precision.measure(problem, repeats=repeats, patience_s=patience_s)))
    progress(len(work), len(work))

    with Device() as device:
        costs = list(on_gpu.costs(device, 512 if quick else 2048, 5 if quick else 20))
        drawn = [p for p in work if p.strength == solver_page.STRONG and p.name in solver_page.DRAWN_ON_GPU]
        on_textures = [Measured(p, list(on_gpu.work_precision(device, p, 7 if quick else 10))) for p in drawn]
        in_formats = [e for h in (1.0, 24.0) for e in on_gpu.over_hours(device, h, anchored=True)]
        in_formats += on_gpu.over_hours(device, 0.02 if quick else 1.0, anchored=False)
        formats = [
            extremes.judge(name, f, on_gpu.in_texture(device, f), on_gpu.RESOLUTION[f])
            for f in FORMATS
            for name in SOLVERS
        ]
        renderer = device.renderer

    summary = solver_page.summary(measured)
    rhythms, pasts = list(rhythm.measure()), previous.measure(n_texels, 5 * repeats)
    verdicts = [
        extremes.judge(name, arithmetic, extremes.in_numpy(dtype), resolution)
        for dtype, arithmetic, resolution in (
            (np.float64, "float64", 2.0**-52),
            (np.float32, "float32", 2.0**-23),
        )
        for name in SOLVERS
    ] + formats
    slow = in_formats + [e for h in ((1.0,) if quick else (1.0, 24.0)) for e in hours.naive_float32(h)]
    sections = [
        solver_page.precision_section(measured),
        solver_page.equal_section(measured),
        solver_page.texture_section(costs, on_textures),
        solver_page.rhythm_section(rhythms),
        solver_page.previous_section(pasts),
        solver_page.extremes_section(verdicts),
        solver_page.hours_section(slow),
    ]
    data = {
        "quick": quick,
        "points": [
            {"problem": m.problem.name, "strength": m.problem.strength, **vars(p)}
            for m in measured
            for p in m.points
        ],
        "steps": [vars(c) for c in costs],
        "rhythms": [vars(r) for r in rhythms],
        "past": [vars(p) for p in pasts],
        "extremes": [vars(v) for v in verdicts],
        "hours": [vars(h) for h in slow],
    }
    title = "Solvers of the rate equations: speed against accuracy"
    return summary, write_trade(folder, "solver", title, summary, sections, data, gl=renderer)
