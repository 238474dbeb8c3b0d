"""What a plan decided, decision by decision: the choice, what it adds to the error, and why, in one line each."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence

import numpy as np

from phoslab.bands import Bands
from phoslab.errors import PhoslabError
from phoslab.model_plan import OUTSIDE, Choices, ModelPlan, Term
from phoslab.render.glow_transport import NONE
from phoslab.render.planning import transport_terms
from phoslab.render.planning.notes import notes, recharging
from phoslab.render.planning.planner import BUDGET, Planner

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
    request = planner.request
    surfaces = dict(choices.surfaces)
    dark = [name for name, s in surfaces.items() if not s.glows]
    glowing = [name for name, s in surfaces.items() if s.glows]
    yield Term(
        "glow",
        f"{len(glowing)} of {len(surfaces)} surfaces",
        planner.glow_error(surfaces),
        "estimate",
        f"the light of {_names(dark)} is not seen beside the rest" if dark else "all that can glow is seen",
    )
    own = {d.name: d.phosphor.optics.n_states for d in request.scene.phosphors if d.phosphor is not None}
    kept, all_states = sum(len(surfaces[n].states) for n in glowing), sum(own[n] for n in glowing)
    yield Term(
        "states",
        f"{kept} of {all_states}",
        planner.state_error(surfaces),
        "estimate",
        "nothing glows"
        if not glowing
        else "the others have died, were never charged, or fade like one that is kept"
        if kept < all_states
        else "each is seen at some time asked for",
    )
    bands = Bands(np.array(choices.bands_nm))
    yield Term(
        "bands",
        f"{bands.n} of {request.scene.transport.n}",
        planner.band_error(bands),
        "bound" if request.bound.of_the_whole else "estimate",
        "each lamp excites each state by one number; light needs no more bands for its colour"
        if bands != request.scene.transport
        else "fewer would change a colour by more, or cost the same",
    )
    stepped = planner.stepped(choices)
    yield Term(
        "solver",
        choices.solver if len(planner.steps) == 1 else f"{choices.solver}, {choices.step_s:.3g} s",
        planner.step_error(stepped),
        "bound" if len(planner.steps) == 1 else "estimate",
        "light is constant between its changes: one step to each"
        if len(planner.steps) == 1
        else "light varies: the step is as long as halving it allows",
    )
    largest = max((surfaces[n].atlas_texels for n in glowing), default=0)
    fewest = min((surfaces[n].atlas_texels for n in glowing), default=0)
    yield Term(
        "texels",
        "-" if not glowing else f"{fewest}" if fewest == largest else f"{fewest} to {largest}",
        planner.texel_error(surfaces),
        "estimate",
        "as many as the camera can tell apart" if glowing else "nothing glows",
    )
    yield Term(
        "state format",
        choices.state_format,
        planner.glow_changed(_format_error(choices.state_format, stepped.steps)),
        "bound",
        "what is stored at each change of light is rounded to it",
    )
    yield from _transport(planner, choices)
    yield from _outside(planner)


def _outside(planner: Planner) -> Iterator[Term]:
    """Yield what no plan models, nor the picture that its bound is held against, where it may matter."""
    twice = planner.lamp_twice_error()
    if twice > 0:
        yield Term(
            "lamp bounces",
            "1",
            twice,
            OUTSIDE,
            "lamp light that walls send on, of which this is the second reflection: render --lamp-bounces has it",
        )
    share = recharging(planner.pilot)
    if share > MATTERS:
        yield Term(
            "glow excites",
            "no",
            0.0,
            OUTSIDE,
            f"glow all around would give phosphors {share:.1%} of what they lose: render --glow-excites has it",
        )


def _transport(planner: Planner, choices: Choices) -> Iterator[Term]:
    request = planner.request
    way = planner.way(choices.gi)
    bounces = planner.pilot.means()[2]
    share = float((bounces.sum(axis=0) / np.maximum(planner.pilot.total.mean(axis=1), 1e-300)).max())
    method = choices.gi["method"]
    said = f"glow that others reflect is {share:.1%} of the light"
    endless = method == transport_terms.REFERENCE and choices.gi.get("full", False)
    parameters = ", ".join(
        f"{v} {k}" for k, v in choices.gi.items() if k not in ("method", "full", "bounces")
    )
    yield Term(
        "reflections",
        "0" if method == NONE else "all" if endless else str(choices.gi.get("bounces", 1)),
        way.left_out,
        "estimate",
        said,
    )
    yield Term(
        "gi",
        method + (f", {parameters}" if parameters else ""),
        way.inexact,
        "estimate",
        "nothing to transport"
        if method == NONE
        else "noise measured in this scene"
        if method == transport_terms.REFERENCE
        else "measured on scenes of the trade",
    )
    n = len(set(request.moments))
    drawn = planner.drawn if method != NONE else n
    yield Term(
        "fade basis",
        "yes" if drawn < n else "no",
        0.0,
        "bound",
        f"{drawn} pictures serve {n} times"
        if drawn < n
        else "it would take as many pictures as there are times",
    )


def _out_of_reach(planner: Planner, choices: Choices) -> PhoslabError:
    """Return what to say where even `choices`, the best there are, miss the bound."""
    bound, best = planner.request.bound, explain(planner, choices)
    worst, reached = best.worst, best.predicted_error / BUDGET
    missing = (
        ""
        if transport_terms.traces_paths()
        else " The path tracer would reach further: pip install 'phoslab[reference]'."
    )
    return PhoslabError(
        f"{bound} is out of reach: {worst.name} ({worst.choice}) alone adds {bound.say(worst.error)}",
        field="the bound",
        remedy=f"The best that can be had is {bound.say(reached)}.{missing}",
    )


def _format_error(name: str, changes: int) -> float:
    """Return the bound on a format's relative error: one rounding for each change of light."""
    half_unit = {"f32": 2.0**-24, "f32c": 2.0**-45, "f16": 2.0**-11, "unorm16": 2.0**-10}[name]
    return half_unit * max(1, changes)


def _names(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= 3 else f"{', '.join(names[:2])} and {len(names) - 2} more"
