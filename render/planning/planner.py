"""The cheapest way to stay within a bound: every decision has its error and its cost, and errors add up.

The triangle inequality is what allows that: a picture with several things left out is off by no more than the sum of
what each does alone, in relative radiance to first order. The few ways that each decision has are tried in all
combinations, against a budget for the sum.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phoslab.bands import Bands
from phoslab.errors import PhoslabError
from phoslab.model_plan import Choices, Surface
from phoslab.render.device import Device
from phoslab.render.glow_transport import NONE
from phoslab.render.planning import spectrum_terms, state_terms, texel_terms, transport_terms
from phoslab.render.planning.bounds import Bound
from phoslab.render.planning.costs import Costs, Work, pictures
from phoslab.render.planning.pilot import Pilot, look
from phoslab.render.planning.probe import PATHS, PathNoise, measure_noise
from phoslab.render.planning.reduced import whole
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
    """Predicts the error and the cost of choices, and finds the cheapest within a bound.

    Attributes:
        drawn: how many pictures are drawn where glow is transported.
        slope: how much a small relative error of the radiance is in the unit of the bound.
        steps: ways to step, the longest first.
        total: (T,) mean X + Y + Z of the picture.
    """

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
        self.drawn = pictures(scene, list(request.moments))
        self.slope = transport_terms.slope(self.pilot, request.bound)
        self.steps = steps(self.pilot)
        lamp, glow, bounces = self.pilot.means()
        self.total: Array = lamp + glow + bounces.sum(axis=0)
        self._elsewhere = PathNoise(costs.path_noise / math.sqrt(PATHS))
        self._known: dict[int, dict[int, tuple[state_terms.Groups, Array]]] = {}

    def choose(self) -> tuple[Choices, bool]:
        """Return the cheapest choices that are predicted to hold the bound; or those that err least, and False."""
        best, closest = self._cheapest(self._elsewhere)
        # How noisy paths are is not worth knowing where no way but one that needs none is in question.
        if best is None or best[1].gi["method"] != NONE:
            best, closest = self._cheapest(self.path_noise)
        return (closest, False) if best is None else (best[1], True)

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
        return spectrum_terms.fewest_bands(self.request.scene, self.pilot, self.request.bound.of_the_whole)

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

    def predict_s(self, choices: Choices) -> float:
        """Return the predicted time of all pictures in s."""
        request = self.request
        work = Work(
            request.size,
            request.scene.supersampling,
            len(request.moments),
            self.drawn,
            self.stepped(choices).steps,
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
                self.glow_error(surfaces) + self.state_error(surfaces) + self.texel_error(surfaces)
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

    def noise_of(self, choices: Choices) -> PathNoise:
        """Return how noisy paths are in this scene, if the choices have any."""
        return self.path_noise if choices.gi["method"] == transport_terms.REFERENCE else self._elsewhere

    def _share(self, k: int) -> Array:
        """Return (T,) the share of the light in the picture that is a surface's glow, straight and reflected."""
        given = self.pilot.by_source[:, :, k].sum(axis=0)
        share: Array = np.divide(given, self.total, out=np.zeros_like(given), where=self.total > 0)
        # Where dark pixels count as much as bright ones, a dim surface may be all there is in many.
        return share if self.request.bound.of_the_whole else np.where(share > 0, 1.0, 0.0)

    def glow_error(self, surfaces: dict[str, Surface]) -> float:
        """Return what is lost by surfaces that do not glow, relative to the picture."""
        shares = [self._share(k) for k, name in self._phosphors() if not surfaces[name].glows]
        return float(np.sum(shares, axis=0).max()) if shares else 0.0

    def state_error(self, surfaces: dict[str, Surface]) -> float:
        """Return what is lost by fewer states, relative to the picture."""
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

    def texel_error(self, surfaces: dict[str, Surface]) -> float:
        """Return what is lost by fewer texels, relative to the picture."""
        errors = [
            self._share(k) * texel_terms.texel_error(self.pilot, self.costs, k, surfaces[name].atlas_texels)
            for k, name in self._phosphors()
            if surfaces[name].glows
        ]
        return float(np.sum(errors, axis=0).max()) if errors else 0.0

    def stepped(self, choices: Choices) -> Stepped:
        """Return the way of stepping that is nearest to what the choices say."""
        if len(self.steps) == 1:
            return self.steps[0]
        return min(self.steps, key=lambda s: abs(math.log(s.step_s / choices.step_s)))


def _some(moments: Sequence[float]) -> list[float]:
    distinct = sorted(set(moments))
    at = np.unique(np.linspace(0, len(distinct) - 1, MOMENTS).astype(int))
    return [distinct[k] for k in at]
