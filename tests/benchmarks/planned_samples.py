"""What a bound saves on the sample scenes: a part of `planner.py`.

Each scene is rendered with everything on (all bands and states, glow followed to its end by as many paths as the
command takes by default), and by plans for some bounds: their time, and their true error against `planned_truth.py`,
whose noise is shown beside it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from planned_case import Case

from phoslab.errors import PhoslabError
from phoslab.render import load_scene
from phoslab.render.device import Device
from phoslab.render.planning.bounds import parse_bound
from phoslab.render.planning.reduced import whole

SCENES = Path(__file__).parent.parent.parent / "sample_data" / "scenes"
NAMES = ("occluder", "fading", "confetti", "cornell", "corridor")
SIDE, BOUNDS = 512, ("5%", "2%", "1%")
EVERYTHING = {"method": "reference", "samples": 256, "full": True}

# Plans that are predicted to take longer are not run.
MOST_S = 1200.0


class Results(Protocol):
    """Where results are kept, by part and name."""

    def done(self, part: str, name: str) -> bool: ...
    def add(self, part: str, name: str, result: dict[str, Any]) -> None: ...


def run(device: Device, folder: Path, results: Results, limit_s: float, trade: Path | None) -> None:
    """Render what is not there yet.

    Args:
        limit_s: as of `planner.py`.
    """
    for name in NAMES:
        scene = load_scene(SCENES / name)
        moment = "off+1s" if scene.schedule.off_s is not None else scene.times[0]
        left = [b for b in ("everything", *BOUNDS) if not results.done("samples", f"{name} {b}")]
        for bound in left:
            finest = bound if bound in BOUNDS else BOUNDS[-1]
            file = folder / f"{name}-{SIDE}.npz"
            case = Case(device, scene, moment, parse_bound(finest), (SIDE, SIDE), file, trade)
            if bound == left[0]:
                case.learn(limit_s)
            about = {"scene": name, "plan": bound, "truth_noise": case.noise}
            result = {**about, **_result(case, bound)}
            results.add("samples", f"{name} {bound}", result)
            print("samples: " + _line(result), flush=True)


def _result(case: Case, bound: str) -> dict[str, Any]:
    if bound == "everything":
        error, took = case.run(replace(whole(case.scene), gi=EVERYTHING))
        return {"gi": EVERYTHING, "error": error, "wall_s": took.wall_s, "cpu_s": took.cpu_s}
    try:
        _, plan, planning = case.plan()
    except PhoslabError as refused:
        return {"refused": str(refused)}
    about = {
        "gi": dict(plan.choices.gi),
        "predicted": plan.predicted_error,
        "predicted_s": plan.predicted_s,
        "planning_cpu_s": planning.cpu_s,
    }
    if plan.predicted_s > MOST_S:
        return about
    error, took = case.run(plan.choices)
    return {**about, "error": error, "wall_s": took.wall_s, "cpu_s": took.cpu_s}


def table(results: list[dict[str, Any]]) -> list[str]:
    """Return the results as a table in Markdown."""
    if not results:
        return []
    return [
        "",
        f"| scene, {SIDE}² | plan | way | error, % | without the truth's own | predicted | truth within "
        "| processors, s | predicted | planning |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        *("| " + _line(result) + " |" for result in results),
    ]


def _line(result: dict[str, Any]) -> str:
    if "refused" in result:
        return f"{result['scene']} | {result['plan']} | refused: {result['refused']}"

    def said(value: float | None) -> str:
        return "-" if value is None else f"{value:.2g}" if value < 100 else f"{value:.0f}"

    error, noise = result.get("error"), result["truth_noise"]
    # Noise of paths in the plan and in the truth is independent: their squares add.
    alone = None if error is None else max(error**2 - noise**2, 0.0) ** 0.5
    way = ", ".join(str(v) for k, v in result["gi"].items() if k != "full")
    rest = (result.get(field) for field in ("cpu_s", "predicted_s", "planning_cpu_s"))
    numbers = (error, alone, result.get("predicted"), noise, *rest)
    return " | ".join([result["scene"], result["plan"], way, *map(said, numbers)])
