"""The cheapest way to stay within a bound: every decision has its error and its cost, and errors add up.

The triangle inequality is what allows that: a picture with several things left out is off by no more than the sum of
what each does alone, in relative radiance to first order. The few ways that each decision has are tried in all
combinations, against a budget for the sum.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phoslab.bands import Bands
from phoslab.errors import PhoslabError
from phoslab.model_plan import Choices, ModelPlan, Surface, Term
from phoslab.render.device import Device
from phoslab.render.glow_transport import NONE
from phoslab.render.planning import spectrum_terms, state_terms, texel_terms, transport_terms
from phoslab.render.planning.bounds import Bound
from phoslab.render.planning.costs import Costs, Work, pictures
from phoslab.render.planning.notes import notes
from phoslab.render.planning.pilot import Pilot, look
from phoslab.render.planning.probe import PathNoise, measure_noise
from phoslab.render.planning.reduced import check_fit, whole
from phoslab.render.planning.step_terms import Stepped, steps
from phoslab.render.scene import Scene

Array = NDArray[np.float64]

# Moments that are looked at, of those asked for: the first, the last and some between.
MOMENTS = 6

# Of the bound: what a plan may predict. The rest is for what a prediction is off by; docs/planning.md has how often.
BUDGET = 0.9

# Of the bound: what leaving out states and surfaces may take; each is tried.
TOLERANCES = (0.0, 0.01, 0.03, 0.1, 0.3, 0.6)


@dataclass(frozen=True)
class Request:
    """What is asked for: a scene, (width, height), times as text and in s, and a bound."""

    scene: Scene
    size: tuple[int, int]
    times: tuple[str, ...]
    moments: tuple[float, ...]
    bound: Bound


class Planner:
    """Predicts the error and the cost of choices, and finds the cheapest within a bound."""

    def __init__(self, request: Request, costs: Costs, device: Device | None = None) -> None:
        self.request, self.costs, self._device = request, costs, device
        scene = request.scene
        self.pilot: Pilot = look(scene, _some(request.moments), request.size)
        if not self.pilot.pictures.any():
            raise PhoslabError(
                "is dark at every time asked for, so no error is relative to anything",
                field="the picture",
                remedy="Ask for a time at which a lamp is on or something glows.",
            )
        self._drawn = pictures(scene, list(request.moments))
        self.slope = transport_terms.slope(self.pilot, request.bound)
        self.steps = steps(self.pilot)
        lamp, glow, bounces = self.pilot.means()
        self._total: Array = lamp + glow + bounces.sum(axis=0)
        self._elsewhere = PathNoise.of_independent(costs.path_noise)
        self._known: dict[int, dict[int, tuple[state_terms.Groups, Array]]] = {}

    def plan(self) -> ModelPlan:
        """Return the cheapest plan that is predicted to hold the bound.

        Raises:
            PhoslabError: none does; the error names the obstacle and the best that can be had.
        """
        best, closest = self._cheapest(self._elsewhere)
        # How noisy paths are is not worth knowing where no way but one that needs none is in question.
        if best is None or best[1].gi["method"] != NONE:
            best, closest = self._cheapest(self.path_noise)
        if best is None:
            raise self._out_of_reach(closest)
        return self.explain(best[1])

    def _cheapest(self, path_noise: PathNoise) -> tuple[tuple[float, Choices] | None, Choices]:
        """Return the cheapest choices within the budget with their cost in s, and those of the least error."""
        budget = BUDGET * self.request.bound.value
        best: tuple[float, Choices] | None = None
        closest: tuple[float, Choices] | None = None
        ways = list(transport_terms.ways(self.pilot, self.request.bound, self.costs, path_noise))
        for choices, error in self._rest:
            for way in ways:
                tried = replace(choices, gi=way.gi)
                total = error + way.error
                if closest is None or total < closest[0]:
                    closest = total, tried
                if total <= budget:
                    cost = self.predict_s(tried)
                    if best is None or cost < best[0]:
                        best = cost, tried
        assert closest is not None
        return best, closest[1]

    @cached_property
    def bands(self) -> dict[int, tuple[Bands, float]]:
        """By their number: the best bands found, and what they err by."""
        return spectrum_terms.fewest_bands(self.request.scene, self.pilot)

    @cached_property
    def path_noise(self) -> PathNoise:
        """How noisy paths are in this scene."""
        if not transport_terms.traces_paths() or not self.pilot.bounces.any():
            return self._elsewhere
        few, _ = self.bands[min(n for n in self.bands if n >= min(3, max(self.bands)))]
        plain = replace(whole(self.request.scene), bands_nm=tuple(few.edges_nm.tolist()))
        stepped = self.steps[0]
        choices = replace(plain, solver=stepped.solver, step_s=stepped.step_s)
        noise = measure_noise(self.pilot, choices, device=self._device)
        return self._elsewhere if noise is None else noise

    def explain(self, choices: Choices) -> ModelPlan:
        """Return the plan of these choices: each decision, its error and the reason.

        Raises:
            PhoslabError: the choices do not fit the scene.
        """
        scene, bound = self.request.scene, self.request.bound
        check_fit(scene, choices)
        return ModelPlan(
            scene="/".join(scene.file.resolve().parts[-2:]),
            scene_sha256=hashlib.sha256(scene.file.read_bytes()).hexdigest(),
            bound=str(bound),
            size=self.request.size,
            times=self.request.times,
            choices=choices,
            terms=tuple(self._terms(choices)),
            predicted_s=self.predict_s(choices),
            notes=notes(self.pilot, choices),
        )

    def predict_s(self, choices: Choices) -> float:
        """Return the predicted time of all pictures in s."""
        request = self.request
        work = Work(
            request.size,
            request.scene.supersampling,
            len(request.moments),
            self._drawn,
            self._stepped(choices).steps,
        )
        return self.costs.predict_s(choices, work)

    @cached_property
    def _rest(self) -> list[tuple[Choices, float]]:
        """Choices of all but glow transport that leave some of the budget, with their errors."""
        return list(self._without_transport(BUDGET * self.request.bound.value))

    def _without_transport(self, budget: float) -> Iterator[tuple[Choices, float]]:
        details = list(dict.fromkeys(self._details(budget * t) for t in TOLERANCES))
        for (colours, colour_error), stepped, width, detail in itertools.product(
            self.bands.values(), self.steps, (0.0, *texel_terms.WIDTHS), details
        ):
            error = self.slope * (colour_error + stepped.error)
            if error > budget:
                continue
            surfaces = self._sized(dict(detail), width)
            choices = Choices(
                bands_nm=tuple(colours.edges_nm.tolist()),
                surfaces=surfaces,
                solver=stepped.solver,
                step_s=stepped.step_s,
                state_format="f32",
                gi={"method": NONE},
            )
            error += self.slope * (
                self._glow_error(surfaces) + self._state_error(surfaces) + self._texel_error(surfaces)
            )
            if error <= budget or not any(TOLERANCES[: details.index(detail)]):
                yield choices, error

    def _details(self, tolerance: float) -> tuple[tuple[str, Surface], ...]:
        """Return the fewest surfaces and states whose error, all together, is within `tolerance`."""
        allowed = tolerance / self.slope / max(1, 2 * len(self.request.scene.phosphors))
        surfaces = dict(whole(self.request.scene).surfaces)
        for k, drawable in self._phosphors():
            full = surfaces[drawable]
            if self._share(k).max() <= allowed:
                surfaces[drawable] = replace(full, glows=False)
                continue
            if k in self.pilot.sampled:
                options = self._groupings(k)
                fewest = min(
                    n for n, (_, e) in options.items() if float((e * self._share(k)).max()) <= allowed
                )
                surfaces[drawable] = replace(full, states=options[fewest][0])
        return tuple(surfaces.items())

    def _groupings(self, k: int) -> dict[int, tuple[state_terms.Groups, Array]]:
        if k not in self._known:
            self._known[k] = state_terms.fewer_states(self.pilot, self.pilot.sampled[k])
        return self._known[k]

    def _sized(self, surfaces: dict[str, Surface], width_px: float) -> dict[str, Surface]:
        """Return surfaces with as many texels as texels of that width take; 0: as many as the scene gives them."""
        if width_px == 0:
            return surfaces
        sized = dict(surfaces)
        for k, name in self._phosphors():
            texels = texel_terms.texels_for(self.pilot, k, width_px)
            known = sized[name].atlas_texels if name in sized else texels
            sized[name] = replace(sized[name], atlas_texels=min(texels, known))
        return sized

    def _phosphors(self) -> Iterator[tuple[int, str]]:
        for k, drawable in enumerate(self.request.scene.drawables):
            if drawable.phosphor is not None:
                yield k, drawable.name

    def _share(self, k: int) -> Array:
        """Return (T,) the share of the light in the picture that is a surface's glow, straight and reflected."""
        given = self.pilot.by_source[:, :, k].sum(axis=0)
        share: Array = np.divide(given, self._total, out=np.zeros_like(given), where=self._total > 0)
        return share

    def _glow_error(self, surfaces: dict[str, Surface]) -> float:
        shares = [self._share(k) for k, name in self._phosphors() if not surfaces[name].glows]
        return float(np.sum(shares, axis=0).max()) if shares else 0.0

    def _state_error(self, surfaces: dict[str, Surface]) -> float:
        errors = [
            self._share(k) * self._change(k, surfaces[name].states)
            for k, name in self._phosphors()
            if surfaces[name].glows and k in self.pilot.sampled
        ]
        return float(np.sum(errors, axis=0).max()) if errors else 0.0

    def _change(self, k: int, groups: state_terms.Groups) -> Array:
        for known, error in self._groupings(k).values():
            if known == groups:
                return error
        return state_terms.change(self.pilot, self.pilot.sampled[k], groups)

    def _texel_error(self, surfaces: dict[str, Surface]) -> float:
        errors = [
            self._share(k) * texel_terms.texel_error(self.pilot, self.costs, k, surfaces[name].atlas_texels)
            for k, name in self._phosphors()
            if surfaces[name].glows
        ]
        return float(np.sum(errors, axis=0).max()) if errors else 0.0

    def _stepped(self, choices: Choices) -> Stepped:
        """Return the way of stepping that is nearest to what the choices say."""
        if len(self.steps) == 1:
            return self.steps[0]
        return min(self.steps, key=lambda s: abs(math.log(s.step_s / choices.step_s)))

    def _terms(self, choices: Choices) -> Iterator[Term]:
        request, pilot, scale = self.request, self.pilot, self.slope
        surfaces = dict(choices.surfaces)
        dark = [name for name, s in surfaces.items() if not s.glows]
        glowing = [name for name, s in surfaces.items() if s.glows]
        yield Term(
            "glow",
            f"{len(glowing)} of {len(surfaces)} surfaces",
            scale * self._glow_error(surfaces),
            "estimate",
            f"the light of {_names(dark)} is not seen beside the rest"
            if dark
            else "all that can glow is seen",
        )
        own = {d.name: d.phosphor.optics.n_states for d in request.scene.phosphors if d.phosphor is not None}
        kept, all_states = sum(len(surfaces[n].states) for n in glowing), sum(own[n] for n in glowing)
        yield Term(
            "states",
            f"{kept} of {all_states}",
            scale * self._state_error(surfaces),
            "estimate",
            "the others have died, were never charged, or fade like one that is kept"
            if kept < all_states
            else "each is seen at some time asked for",
        )
        bands = Bands(np.array(choices.bands_nm))
        colours = spectrum_terms.errors(
            spectrum_terms.Sources.of(request.scene, pilot), request.scene.transport, bands
        )
        yield Term(
            "bands",
            f"{bands.n} of {request.scene.transport.n}",
            scale * spectrum_terms.picture_error(colours, pilot),
            "bound",
            "each lamp excites each state by one number; light needs no more bands for its colour"
            if bands != request.scene.transport
            else "fewer would change a colour by more, or cost the same",
        )
        stepped = self._stepped(choices)
        yield Term(
            "solver",
            choices.solver if len(self.steps) == 1 else f"{choices.solver}, {choices.step_s:.3g} s",
            scale * stepped.error,
            "bound" if len(self.steps) == 1 else "estimate",
            "light is constant between its changes: one step to each"
            if len(self.steps) == 1
            else "light varies: the step is as long as halving it allows",
        )
        largest = max((surfaces[n].atlas_texels for n in glowing), default=0)
        fewest = min((surfaces[n].atlas_texels for n in glowing), default=0)
        yield Term(
            "texels",
            "-" if not glowing else f"{fewest}" if fewest == largest else f"{fewest} to {largest}",
            scale * self._texel_error(surfaces),
            "estimate",
            "as many as the camera can tell apart" if glowing else "nothing glows",
        )
        yield Term(
            "state format",
            choices.state_format,
            scale * _format_error(choices.state_format, stepped.steps),
            "bound",
            "what is stored at each change of light is rounded to it",
        )
        yield from self._transport_terms(choices)

    def _transport_terms(self, choices: Choices) -> Iterator[Term]:
        request = self.request
        way = transport_terms.inexactness(
            self.pilot,
            request.bound,
            self.costs,
            self.path_noise if choices.gi["method"] == transport_terms.REFERENCE else self._elsewhere,
            dict(choices.gi),
        )
        bounces = self.pilot.means()[2]
        share = float((bounces.sum(axis=0) / np.maximum(self._total, 1e-300)).max())
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
        drawn = self._drawn if method != NONE else n
        yield Term(
            "fade basis",
            "yes" if drawn < n else "no",
            0.0,
            "bound",
            f"{drawn} pictures serve {n} times"
            if drawn < n
            else "it would take as many pictures as there are times",
        )

    def _out_of_reach(self, choices: Choices) -> PhoslabError:
        bound = self.request.bound
        terms = list(self._terms(choices))
        worst = max(terms, key=lambda term: term.error)
        reached = sum(t.error for t in terms) / BUDGET
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


def _some(moments: Sequence[float]) -> list[float]:
    distinct = sorted(set(moments))
    at = np.unique(np.linspace(0, len(distinct) - 1, MOMENTS).astype(int))
    return [distinct[k] for k in at]


def _names(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= 3 else f"{', '.join(names[:2])} and {len(names) - 2} more"
