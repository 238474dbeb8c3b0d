"""What a plan decided, decision by decision: the choice, what it adds to the error, and why, in one line each."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from phoslab.bands import Bands
from phoslab.errors import PhoslabError
from phoslab.model_plan import OUTSIDE, Choices, ModelPlan, Term
from phoslab.render.glow_transport import NONE
from phoslab.render.planning import transport_terms
from phoslab.render.planning.notes import notes, recharging
from phoslab.render.planning.planner import BUDGET, Planner
from phoslab.render.solvers import find_solver

# Of what a state loses: less than that may charge it unsaid.
MATTERS = 1e-3


def plan(planner: Planner) -> ModelPlan:
    """Return the cheapest plan that is predicted to hold the bound.

    Raises:
        PhoslabError: none does; the error names the obstacle and the best that can be had.
    """
    choices, holds = planner.choose()
    if not holds:
        raise _out_of_reach(planner, choices)
    return explain(planner, choices)


def explain(planner: Planner, choices: Choices) -> ModelPlan:
    """Return the plan of these choices, which fit the scene: each decision, its error and the reason."""
    request = planner.request
    return ModelPlan(
        scene="/".join(request.scene.file.resolve().parts[-2:]),
        scene_sha256=hashlib.sha256(request.scene.file.read_bytes()).hexdigest(),
        bound=str(request.bound),
        size=request.size,
        times=request.times,
        choices=choices,
        terms=tuple(_decided(planner, choices)),
        predicted_s=planner.predict_s(choices),
        notes=notes(planner.pilot, choices),
    )


def _decided(planner: Planner, choices: Choices) -> Iterator[Term]:
    """Yield every decision of `choices`; their errors are in the unit of the bound."""
    request, took = planner.request, planner.shares_s(choices)
    within = BUDGET * request.bound.value
    surfaces = dict(choices.surfaces)
    dark = [name for name, s in surfaces.items() if not s.glows]
    glowing = [name for name, s in surfaces.items() if s.glows]
    lost = planner.glow_error(surfaces)
    yield Term(
        "glow",
        f"{len(glowing)} of {len(surfaces)} surfaces",
        lost,
        "estimate",
        "all that can glow is seen, or lights what is seen"
        if not dark
        else f"the light of {_names(dark)} is not seen beside the rest"
        if lost <= within
        else f"the light of {_names(dark)} is left out, and would be seen",
    )
    own = {d.name: d.phosphor.optics.n_states for d in request.scene.phosphors if d.phosphor is not None}
    kept, all_states = sum(len(surfaces[n].states) for n in glowing), sum(own[n] for n in glowing)
    lost = planner.state_error(surfaces)
    yield Term(
        "states",
        f"{kept} of {all_states}",
        lost,
        "estimate",
        "nothing glows"
        if not glowing
        else "of the states that fade at rates of their own, each is seen at some time asked for"
        if kept == all_states
        else "the others have died, were never charged, or fade like one that is kept"
        if lost <= within
        else "the others are left out, and would be seen",
    )
    bands = Bands(np.array(choices.bands_nm))
    lost = planner.band_error(bands)
    yield Term(
        "bands",
        f"{bands.n} of {request.scene.transport.n}",
        lost,
        "bound" if request.bound.of_the_whole else "estimate",
        "fewer would be off by more than is left of the bound, or save nothing"
        if bands == request.scene.transport
        else "fewer than the light's colours need"
        if lost > within
        else "enough for the colours of the light"
        + ("; how lamps excite is kept whatever the bands" if glowing and request.scene.lights else ""),
        seconds=took["bands"],
    )
    yield _stepped(planner, choices, took["solver"])
    largest = max((surfaces[n].atlas_texels for n in glowing), default=0)
    fewest = min((surfaces[n].atlas_texels for n in glowing), default=0)
    lost = planner.texel_error(surfaces)
    yield Term(
        "texels",
        "-" if not glowing else f"{fewest}" if fewest == largest else f"{fewest} to {largest}",
        lost,
        "estimate",
        "nothing glows"
        if not glowing
        else "along a side of each surface: as many as the camera can tell apart"
        if lost <= within
        else "along a side of each surface: fewer than the camera can tell apart",
        seconds=took["texels"],
    )
    yield Term(
        "state format",
        choices.state_format,
        planner.glow_changed(_format_error(choices.state_format, planner.stepped(choices).steps)),
        "bound",
        "what is stored at each change of light is rounded to it",
    )
    yield from _transport(planner, choices, took["gi"])
    yield from _outside(planner)


def _stepped(planner: Planner, choices: Choices, seconds: float) -> Term:
    """Return how states go on in time."""
    stepped = planner.stepped(choices)
    jumps = find_solver(choices.solver).closed_form and planner.request.scene.schedule.piecewise_constant
    lost = planner.step_error(stepped)
    return Term(
        "solver",
        choices.solver if jumps else f"{choices.solver}, {choices.step_s:.3g} s",
        lost,
        "bound" if jumps else "estimate",
        "light is constant between its changes, and one step goes to each without error"
        if jumps
        else "steps of that length"
        if planner.request.scene.schedule.piecewise_constant
        else "light varies: the step is as long as halving it allows"
        if lost <= BUDGET * planner.request.bound.value
        else "light varies, and changes too much within a step",
        seconds=seconds,
    )


def _outside(planner: Planner) -> Iterator[Term]:
    """Yield what no plan models, nor the picture that its bound is held against, where it may matter."""
    twice = planner.lamp_twice_error()
    if twice > 0:
        yield Term(
            "lamp bounces",
            "first only",
            twice,
            OUTSIDE,
            "lamps light what they shine on; what walls then send on would change this much: render --lamp-bounces",
        )
    share = recharging(planner.pilot)
    if share > MATTERS:
        regained = "all" if share >= 1 else f"at most {share:.1%}"
        yield Term(
            "glow excites",
            "no",
            None,
            OUTSIDE,
            f"phosphors charging each other could win back {regained} of what they lose: render --glow-excites",
        )


def _transport(planner: Planner, choices: Choices, seconds: float) -> Iterator[Term]:
    request = planner.request
    way = planner.way(choices.gi)
    bounces = planner.pilot.means()[2]
    share = float((bounces.sum(axis=0) / np.maximum(planner.pilot.total.mean(axis=1), 1e-300)).max())
    method = choices.gi["method"]
    endless = method == transport_terms.REFERENCE and choices.gi.get("full", False)
    n = choices.gi.get("bounces", 1)
    said = f"glow that others reflect is {share:.1%} of the light"
    yield Term(
        "reflections",
        "0" if method == NONE else "all" if endless else str(n),
        way.left_out,
        "estimate",
        said if endless or method == NONE else f"{said}; what comes after {n} of them is left out",
    )
    yield Term("gi", _named(choices.gi), way.inexact, "estimate", _reason(planner, choices), seconds=seconds)
    times = len(set(request.moments))
    drawn = planner.drawn if method != NONE else times
    yield Term(
        "fade basis",
        "yes" if drawn < times else "no",
        0.0,
        "bound",
        f"as many pictures as there are rates ({drawn}) serve {times} times"
        if drawn < times
        else "a picture of each rate, to serve all times, would be no fewer than a picture of each time",
    )


# What is said of a way as a number of things, or by another line; and what its options are called.
_SAID = ("method", "full", "bounces", "directions", "samples")
_OPTIONS = {"filter_px": "filter"}


def _named(gi: Mapping[str, Any]) -> str:
    counted = [f"{gi[k]} {k}" for k in ("directions", "samples") if k in gi]
    others = [f"{_OPTIONS.get(k, k)} {v:g}" for k, v in gi.items() if k not in _SAID]
    return ", ".join([gi["method"], *counted, *others])


def _reason(planner: Planner, choices: Choices) -> str:
    """Say where the error of the way to transport glow is from, and what a quicker one would err by."""
    method, bound = choices.gi["method"], planner.request.bound
    if method == NONE:
        return "reflected glow is not modelled"
    measured = (
        "its noise was tried here"
        if method == transport_terms.REFERENCE
        else "tried here, against paths"
        if planner.was_tried(choices.gi)
        else "measured on sample scenes"
    )
    other = planner.rival(choices)
    if other is None:
        return f"{measured}; no other way is quicker"
    return f"{measured}; {_named(other.gi)} would be quicker and add {bound.say(planner.way(other.gi).error)}"


def _out_of_reach(planner: Planner, choices: Choices) -> PhoslabError:
    """Return what to say where even `choices`, the best there are, miss the bound."""
    bound, best = planner.request.bound, explain(planner, choices)
    worst, reached = best.worst, best.predicted_error / BUDGET
    took = "" if best.predicted_s < 60 else f" (in some {best.predicted_s / 60:.2g} min)"
    missing = (
        ""
        if transport_terms.traces_paths()
        else " The path tracer would reach further: pip install 'phoslab[reference]'."
    )
    return PhoslabError(
        f"{bound} is out of reach: {worst.name} ({worst.choice}) alone adds {bound.say(worst.error or 0.0)}",
        field="the bound",
        remedy=f"The best that can be had is {bound.say(reached)}{took}: ask for no less than that.{missing}",
    )


def _format_error(name: str, changes: int) -> float:
    """Return the bound on a format's relative error: one rounding for each change of light."""
    half_unit = {"f32": 2.0**-24, "f32c": 2.0**-45, "f16": 2.0**-11, "unorm16": 2.0**-10}[name]
    return half_unit * max(1, changes)


def _names(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= 3 else f"{', '.join(names[:2])} and {len(names) - 2} more"
