"""Just enough model: say how wrong a picture may be, and get the cheapest one that is not worse.

>>> from phoslab.render.planning import make_plan, render_plan     # doctest: +SKIP
>>> plan = make_plan("sample_data/scenes/cornell", "2%", ["off+1s"])           # doctest: +SKIP
>>> render_plan("sample_data/scenes/cornell", plan).write("glow.png")          # doctest: +SKIP
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from os import PathLike

from phoslab.errors import PhoslabError
from phoslab.model_plan import ModelPlan
from phoslab.render import Frames
from phoslab.render.device import Device
from phoslab.render.planning import decisions
from phoslab.render.planning.bounds import parse_bound
from phoslab.render.planning.costs import load_costs
from phoslab.render.planning.drawn import render_choices
from phoslab.render.planning.planner import Planner, Request
from phoslab.render.planning.reduced import check_fit
from phoslab.render.scene import Scene, load_scene
from phoslab.render.schedule import check_time

Place = Scene | str | PathLike[str]


def make_plan(
    scene: Place,
    bound: str,
    times: Sequence[str | float] | None = None,
    *,
    size: tuple[int, int] | None = None,
    trade: str | PathLike[str] | None = None,
    device: Device | None = None,
) -> ModelPlan:
    """Return the cheapest plan that is predicted to hold a bound.

    Args:
        bound: `2%`, `1dE` or `0.05flip`; see `bounds.py`.
        times, size: as for `phoslab.render.render`.
        trade: a trade.json of `phoslab trade model`; None: the one that ships.
        device: that on which to look how noisy paths are; None: one of its own.

    Raises:
        PhoslabError: no plan holds the bound, or the scene, a time or the bound is wrong.
    """
    return decisions.plan(_planner(_scene(scene), bound, times, size, trade, device))


def check_plan(
    scene: Place,
    plan: ModelPlan,
    *,
    trade: str | PathLike[str] | None = None,
    device: Device | None = None,
) -> tuple[ModelPlan, PhoslabError | None]:
    """Return a plan with its errors and cost predicted anew, and what is wrong with it, if anything is.

    What is wrong is not raised: such a plan can be followed all the same.

    Raises:
        PhoslabError: the plan does not fit the scene.
    """
    loaded = _scene(scene)
    # First, since what does not fit may be of another scene, whose times mean nothing here either.
    check_fit(loaded, plan.choices, plan.scene)
    planner = _planner(loaded, plan.bound, plan.times, plan.size, trade, device)
    again = decisions.explain(planner, plan.choices)
    bound = parse_bound(plan.bound)
    if again.predicted_error > bound.value and planner.look_closer():
        again = decisions.explain(planner, plan.choices)
    if again.predicted_error > bound.value and planner.try_out(plan.choices):
        again = decisions.explain(planner, plan.choices)
    wrong, remedies = [], []
    if plan.scene_sha256 and plan.scene_sha256 != again.scene_sha256:
        wrong.append("the scene has changed since it was planned")
        remedies.append(
            "Take scene_sha256 out of the plan to follow it all the same, or plan anew with --max-error."
        )
    if again.predicted_error > bound.value:
        worst = again.worst
        wrong.append(
            f"the plan breaks its bound of {bound}: {bound.say(again.predicted_error)} is predicted, "
            f"{bound.say(worst.error or 0.0)} of it by {worst.name} ({worst.choice})"
        )
        remedies.append("Give it back what it left out there, or plan anew with --max-error.")
    return again, PhoslabError("; ".join(wrong), remedy=" ".join(remedies)) if wrong else None


def render_plan(
    scene: Place,
    plan: ModelPlan,
    *,
    progress: Callable[[int, int], None] | None = None,
    device: Device | None = None,
    warnings: Sequence[str] = (),
) -> Frames:
    """Render by a plan; the bound and what is predicted stand in the metadata of every file.

    Args:
        warnings: more to say with every picture.
    """
    frames = render_choices(
        _scene(scene), plan.choices, plan.times, plan.size, progress=progress, device=device
    )
    bound = parse_bound(plan.bound)
    about = {
        "phoslab:max_error": plan.bound,
        "phoslab:predicted_error": bound.say(plan.predicted_error),
        "phoslab:model": "; ".join(f"{term.name}: {term.choice}" for term in plan.terms),
        "phoslab:notes": "; ".join(plan.notes),
    }
    said = tuple(replace(f, warnings=(*f.warnings, *warnings)) for f in frames.frames)
    return replace(frames, frames=said, about=about)


def _planner(
    scene: Scene,
    bound: str,
    times: Sequence[str | float] | None,
    size: tuple[int, int] | None,
    trade: str | PathLike[str] | None,
    device: Device | None,
) -> Planner:
    wanted = scene.times if times is None else times
    if not wanted:
        raise PhoslabError("is empty", field="the list of times", remedy="Give one time or more.")
    labels = tuple(t if isinstance(t, str) else f"{t:.12g}" for t in wanted)
    moments = tuple(
        scene.schedule.parse_time(t) if isinstance(t, str) else check_time(float(t), f"{t:g}") for t in wanted
    )
    request = Request(scene, size or scene.size, labels, moments, parse_bound(bound))
    return Planner(request, load_costs(trade), device)


def _scene(scene: Place) -> Scene:
    return scene if isinstance(scene, Scene) else load_scene(scene)
