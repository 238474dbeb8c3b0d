"""The cheapest way to stay within a bound: every decision has its error and its cost, and errors add up.

The triangle inequality is what allows that: a picture with several things left out is off by no more than the sum of
what each does alone, in relative radiance to first order. The few ways that each decision has are tried in all
combinations, the cheapest first, against a budget for the sum.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.bands import Bands
from phoslab.errors import PhoslabError
from phoslab.model_plan import Choices, Surface
from phoslab.render.device import Device
from phoslab.render.glow_transport import NONE
from phoslab.render.path_tracer import LLVM, SCALAR, usual_variant
from phoslab.render.planning import spectrum_terms, state_terms, texel_terms, transport_terms
from phoslab.render.planning.bounds import Bound
from phoslab.render.planning.costs import Costs, Work, pictures
from phoslab.render.planning.pilot import Pilot, look
from phoslab.render.planning.probe import PATHS, SUPERSAMPLING, PathNoise, measure_noise
from phoslab.render.planning.reduced import whole
from phoslab.render.planning.sensitivity import Sensitivity
from phoslab.render.planning.step_terms import Stepped, judged, steps
from phoslab.render.planning.trial import MIDDLE, ROUNDS, SIDE, Trial, can_try, trial_size
from phoslab.render.scene import Scene

Array = NDArray[np.float64]

# Moments that are looked at, of those asked for: the first, the last and some between.
MOMENTS = 6

# Of the bound: what a plan may predict. The rest is for what a prediction is off by; docs/planning.md has how often.
BUDGET = 0.9

# Of the bound: what leaving out states and surfaces may take; each is tried.
TOLERANCES = (0.0, 0.01, 0.03, 0.1, 0.3, 0.6)

# From so many s on, a picture of paths is worth a closer look at how noisy they are: that takes a tenth of it.
CLOSER_S = 20.0

# Of a picture of paths: what may be spent on trying what is quicker. And what four times the paths should leave of a
# trial's spread at most, if more are to follow: noise would fall to 0.25, and what windows differ by stays as it is.
TRIAL, NO_SURER = 0.03, 0.67

_Key = tuple[tuple[str, Any], ...]


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
        steps: ways to step, the longest first.
    """

    def __init__(self, request: Request, costs: Costs, device: Device | None = None) -> None:
        self.request, self.costs, self._device = request, costs, device
        scene = request.scene
        if scene.motion is not None:
            raise PhoslabError(
                "moves, and plans are for scenes in which all is at rest",
                file=scene.file,
                field="what its glTF file animates",
                remedy="Render it with options of your own, such as --gi tiles, or take the animations out.",
            )
        self.pilot: Pilot = look(scene, _some(request.moments), request.size)
        if not self.pilot.pictures.any():
            raise PhoslabError(
                "is dark at every time asked for, so no error is relative to anything",
                field="the picture",
                remedy="Ask for a time at which a lamp is on or something glows.",
            )
        self.drawn = pictures(scene, list(request.moments))
        self.steps = steps(self.pilot)
        self._stepped = {(s.solver, s.step_s): s for s in self.steps}
        self._sensitivity = Sensitivity(self.pilot, request.bound)
        self._noise: PathNoise | None = None
        self._closest_look = False
        self._ways: dict[_Key, transport_terms.Way] = {}
        self._tried: dict[_Key, float] = {}
        self._known: dict[int, dict[int, tuple[state_terms.Groups, Array]]] = {}
        self._lost: dict[int, float] = {}
        self._fewer: dict[tuple[int, int], float] = {}
        self._errors: dict[tuple[tuple[str, Surface], ...], tuple[float, float, float]] = {}

    def choose(self) -> tuple[Choices, bool]:
        """Return the cheapest choices that are predicted to hold the bound; or those that err least, and False."""
        choices = self._cheapest()
        if choices is None and self.look_closer():
            choices = self._cheapest()
        if choices is not None and self.try_quicker(choices):
            choices = self._cheapest()
        long = choices is not None and _traces(choices) and self.predict_s(choices) > CLOSER_S
        if long and self.look_closer():
            choices = self._cheapest()
        return (self._closest(), False) if choices is None else (choices, True)

    def try_quicker(self, choices: Choices) -> bool:
        """Try here what would be quicker than paths, if they take long; return whether there is more to know."""
        quick = self._quicker(choices) if _traces(choices) else []
        left = BUDGET * self.request.bound.value - min(error for _, error in self._rest)
        return self._try(quick, choices, left)

    def try_out(self, choices: Choices) -> bool:
        """Try a way here that stands for paths which would take long; return whether there is more to know."""
        if _traces(choices) or choices.gi["method"] == NONE:
            return False
        instead = self._cheapest(transport_terms.REFERENCE)
        own = self.band_error(Bands(np.array(choices.bands_nm))) + self.step_error(self.stepped(choices))
        left = self.request.bound.value - own - sum(self._surface_errors(choices.surfaces))
        return instead is not None and can_try(choices.gi) and self._try([choices], instead, left)

    def _quicker(self, choices: Choices) -> list[Choices]:
        """Return the ways that err least, of those that can be tried and are quicker than paths: the quicker first.

        Two, since the finest may be finer than this scene needs.
        """
        best = self.rival(choices, can_try)
        if best is None:
            return []
        alike = [
            replace(choices, gi=gi)
            for gi in self._settings
            if all(gi.get(k) == best.gi.get(k) for k in ("method", "bounces")) and can_try(gi)
        ]
        own_s = self.predict_s(choices)
        finest = sorted(alike, key=lambda each: self.way(each.gi).error)[:2]
        return sorted((each for each in finest if self.predict_s(each) < own_s), key=self.predict_s)

    def _try(self, quick: Sequence[Choices], instead: Choices, left: float) -> bool:
        """Try ways for no longer than it takes to tell whether one of them adds less than is left of the bound.

        Args:
            quick: of as many reflections each. Another is drawn only where those before it do not do.
            instead: paths, of whose time a little may be spent.

        Returns:
            Whether there is more to know.
        """
        quick = [replace(each, bands_nm=self._few_bands) for each in quick if not self.was_tried(each.gi)]
        glows = any(surface.glows for each in quick for surface in each.surfaces.values())
        allowed_s = TRIAL * self.predict_s(instead)
        if not glows or self._trial_s(quick[:1], ROUNDS[0]) > allowed_s:
            return False
        with nullcontext(self._device) if self._device is not None else Device() as device:
            trial = Trial(self.pilot, self.request.size, quick[0], device)
            drawn: list[Array] = []
            spreads = np.full(len(quick), np.inf)
            for samples in ROUNDS:
                if self._trial_s(quick[: max(1, len(drawn))], trial.paths + samples) > allowed_s:
                    break
                trial.follow(samples)
                may_do = surer = False
                for k, each in enumerate(quick):
                    if k == len(drawn):
                        if self._trial_s(quick[: k + 1], trial.paths) > allowed_s:
                            break
                        drawn.append(trial.draw(each))
                    found = trial.found(drawn[k])
                    if found is None:
                        return False
                    self._tried[_key(each.gi)] = found.at_most
                    self._ways.pop(_key(each.gi), None)
                    if self.way(each.gi).error <= left:
                        return True
                    may_do |= self._judge(each.gi, found.at_least).error <= left
                    surer |= found.spread <= NO_SURER * spreads[k]
                    spreads[k] = found.spread
                if not (may_do and surer):
                    break
        return True

    def _trial_s(self, quick: Sequence[Choices], paths: int) -> float:
        """Return the predicted time in s of a trial of some ways, beside so many paths a pixel twice."""
        gi = {"method": transport_terms.REFERENCE, "samples": 2 * paths, "full": True}
        windows_s = sum(self._window_s(each, SIDE) for each in quick)
        return windows_s + self._window_s(replace(quick[0], gi=gi), MIDDLE)

    def _window_s(self, choices: Choices, side: int) -> float:
        """Return the time in s of all windows of so many pixels along a side."""
        work = replace(self._work(choices), supersampling=SUPERSAMPLING, times=1, drawn=1)
        return self.costs.predict_s(choices, replace(work, size=trial_size(self.request.size, side)))

    def was_tried(self, gi: Mapping[str, Any]) -> bool:
        """Whether what it errs by was found in this scene."""
        return _key(gi) in self._tried

    def _cheapest(self, method: str | None = None) -> Choices | None:
        """Return the cheapest choices within the budget, of those that transport glow by a method if one is named."""
        budget = BUDGET * self.request.bound.value
        tried = [
            (self.predict_s(choices), k, error, choices)
            for k, (error, choices) in enumerate(
                (error, replace(rest, gi=gi))
                for rest, error in self._rest
                for gi in self._settings
                if method in (None, gi["method"])
            )
        ]
        for _, _, error, choices in sorted(tried, key=lambda t: t[:2]):
            if error <= budget and error + self.way(choices.gi).error <= budget:
                return choices
        return None

    def _closest(self) -> Choices:
        """Return the choices of the least error."""
        gi = min(self._settings, key=lambda gi: self.way(gi).error)
        return replace(min(self._rest, key=lambda each: each[1])[0], gi=gi)

    @cached_property
    def _settings(self) -> list[dict[str, Any]]:
        return list(transport_terms.settings(self.pilot, self.costs))

    def way(self, gi: Mapping[str, Any]) -> transport_terms.Way:
        """Return what parameters of `--gi` err by here. How noisy paths are is looked at when it is first asked for."""
        key = _key(gi)
        if key not in self._ways:
            self._ways[key] = self._judge(gi, self._tried.get(key))
        return self._ways[key]

    def _judge(self, gi: Mapping[str, Any], tried: float | None) -> transport_terms.Way:
        told = gi["method"] == NONE or tried is not None or not transport_terms.traces_paths()
        noise = PathNoise(0.0) if told else self.path_noise
        return transport_terms.judge(self.pilot, self.request.bound, self.costs, noise, gi, tried)

    @cached_property
    def bands(self) -> dict[int, tuple[Bands, float]]:
        """By their number: the best bands found, and what they err by."""
        found = spectrum_terms.fewest_bands(self.request.scene, self.pilot)
        return {n: (bands, self._band_error(each)) for n, (bands, each) in found.items()}

    @cached_property
    def _few_bands(self) -> tuple[float, ...]:
        """The edges of the bands in which light is looked at: three, which are traced at once, if there are as many."""
        few, _ = self.bands[min(n for n in self.bands if n >= min(3, max(self.bands)))]
        return tuple(few.edges_nm.tolist())

    def band_error(self, bands: Bands) -> float:
        """Return what is lost by other bands than the scene's."""
        source = self.request.scene.transport
        sources = spectrum_terms.Sources.of(self.request.scene, self.pilot)
        return self._band_error(spectrum_terms.errors(sources, source, bands))

    def _band_error(self, each: Array) -> float:
        return self._sensitivity.of(spectrum_terms.changed_share(each, self.pilot))

    @property
    def path_noise(self) -> PathNoise:
        """How noisy paths are in this scene."""
        if self._noise is None:
            self._noise = self._look_at_noise(SCALAR)
        return self._noise

    def look_closer(self) -> bool:
        """Look at the noise of just those paths that pictures take, if there is more to know; return whether it was."""
        if self._noise is None or self._closest_look or usual_variant() != LLVM:
            return False
        self._noise, self._closest_look = self._look_at_noise(LLVM), True
        self._ways.clear()
        return True

    def _look_at_noise(self, variant: str) -> PathNoise:
        elsewhere = PathNoise(self.costs.path_noise / math.sqrt(PATHS))
        if not transport_terms.traces_paths():
            return elsewhere
        plain = replace(whole(self.request.scene), bands_nm=self._few_bands)
        stepped = self.steps[0]
        choices = replace(plain, solver=stepped.solver, step_s=stepped.step_s)
        return measure_noise(self.pilot, choices, variant, device=self._device) or elsewhere

    def predict_s(self, choices: Choices) -> float:
        """Return the predicted time of all pictures in s."""
        return self.costs.predict_s(choices, self._work(choices))

    def shares_s(self, choices: Choices) -> dict[str, float]:
        """Return the predicted time in s by the decision that it follows from."""
        return self.costs.shares_s(choices, self._work(choices))

    def _work(self, choices: Choices) -> Work:
        request, steps = self.request, self.stepped(choices).steps
        return Work(request.size, request.scene.supersampling, len(request.moments), self.drawn, steps)

    def rival(
        self, choices: Choices, fits: Callable[[Mapping[str, Any]], bool] = lambda gi: True
    ) -> Choices | None:
        """Return the same with the way to transport glow that errs least, of others that take less time; or None.

        Args:
            fits: which parameters of `--gi` are asked about.
        """
        method, own_s = choices.gi["method"], self.predict_s(choices)
        others = [
            replace(choices, gi=gi)
            for gi in self._settings
            if gi["method"] not in (method, NONE) and fits(gi)
        ]
        quicker = [other for other in others if self.predict_s(other) < own_s]
        return min(quicker, key=lambda other: self.way(other.gi).error, default=None)

    @cached_property
    def _rest(self) -> list[tuple[Choices, float]]:
        """Choices of all but glow transport that leave some of the budget, with their errors; none beats another."""
        found = list(self._without_transport(BUDGET * self.request.bound.value)) or [self._finest()]
        # What they cost with any transport grows with these two.
        costs = [(self.predict_s(choices), len(choices.bands_nm)) for choices, _ in found]
        kept: list[int] = []
        for k in sorted(range(len(found)), key=lambda k: (found[k][1], costs[k])):
            if not any(costs[j][0] <= costs[k][0] and costs[j][1] <= costs[k][1] for j in kept):
                kept.append(k)
        return [found[k] for k in kept]

    def _without_transport(self, budget: float) -> Iterator[tuple[Choices, float]]:
        details = dict.fromkeys(self._details(budget * t) for t in TOLERANCES)
        for (bands, band_error), stepped in itertools.product(self.bands.values(), self.steps):
            error = band_error + self.step_error(stepped)
            if error > budget:
                continue
            for width, detail in itertools.product((0.0, *texel_terms.WIDTHS), details):
                surfaces = self._sized(dict(detail), width)
                more = sum(self._surface_errors(surfaces))
                if error + more <= budget:
                    yield self._choices(bands, stepped, surfaces), error + more

    def _finest(self) -> tuple[Choices, float]:
        """Return the choices of all but glow transport that err least, with their error."""
        surfaces, stepped = dict(self._details(0.0)), self.steps[-1]
        error = self.step_error(stepped) + sum(self._surface_errors(surfaces))
        return self._choices(self.request.scene.transport, stepped, surfaces), error

    @staticmethod
    def _choices(bands: Bands, stepped: Stepped, surfaces: Mapping[str, Surface]) -> Choices:
        return Choices(
            bands_nm=tuple(bands.edges_nm.tolist()),
            surfaces=surfaces,
            solver=stepped.solver,
            step_s=stepped.step_s,
            state_format="f32",
            gi={"method": NONE},
        )

    def _surface_errors(self, surfaces: Mapping[str, Surface]) -> tuple[float, float, float]:
        key = tuple(surfaces.items())
        if key not in self._errors:
            self._errors[key] = (
                self.glow_error(surfaces),
                self.state_error(surfaces),
                self.texel_error(surfaces),
            )
        return self._errors[key]

    def _details(self, tolerance: float) -> tuple[tuple[str, Surface], ...]:
        """Return the fewest surfaces and states whose error, all together, is within `tolerance`."""
        allowed = tolerance / max(1, 2 * len(self.request.scene.phosphors))
        surfaces = dict(whole(self.request.scene).surfaces)
        for k, drawable in self._phosphors():
            full = surfaces[drawable]
            if self._alone(k) <= allowed:
                surfaces[drawable] = replace(full, glows=False)
                continue
            if k in self.pilot.sampled:
                options = self._groupings(k)
                fewest = min(n for n in options if self._reduced(k, n) <= allowed)
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

    def _light(self, k: int) -> Array:
        """Return (T, P, 3) the XYZ of a surface's glow, straight and reflected."""
        return self.pilot.from_each.get(k, np.zeros((*self.pilot.total.shape, 3)))

    def _without(self, surfaces: Sequence[int]) -> float:
        """Return what is lost if surfaces do not glow."""
        if not surfaces:
            return 0.0
        light = sum((self._light(k) for k in surfaces), start=np.zeros(3))
        pictures = self.pilot.pictures
        return self._sensitivity.between(pictures - light.reshape(pictures.shape))

    def _changed(self, changes: Mapping[int, Array | float]) -> float:
        """Return what it adds if the glow of surfaces changes by (T,) shares of itself."""
        changed = np.zeros_like(self.pilot.total)
        for k, change in changes.items():
            changed += np.broadcast_to(change, len(changed))[:, None] * self._light(k).sum(axis=-1)
        return self._sensitivity.of(self.pilot.share(changed))

    def _alone(self, k: int) -> float:
        if k not in self._lost:
            self._lost[k] = self._without([k])
        return self._lost[k]

    def _reduced(self, k: int, n: int) -> float:
        """Return what is lost by the best n states of a surface."""
        if (k, n) not in self._fewer:
            self._fewer[k, n] = self._changed({k: self._groupings(k)[n][1]})
        return self._fewer[k, n]

    def glow_error(self, surfaces: Mapping[str, Surface]) -> float:
        """Return what is lost by surfaces that do not glow."""
        return self._without([k for k, name in self._phosphors() if not surfaces[name].glows])

    def state_error(self, surfaces: Mapping[str, Surface]) -> float:
        """Return what is lost by fewer states."""
        return self._changed(
            {
                k: self._change(k, surfaces[name].states)
                for k, name in self._phosphors()
                if surfaces[name].glows and k in self.pilot.sampled
            }
        )

    def _change(self, k: int, groups: state_terms.Groups) -> Array:
        for known, error in self._groupings(k).values():
            if known == groups:
                return error
        return state_terms.change(self.pilot, self.pilot.sampled[k], groups)

    def texel_error(self, surfaces: Mapping[str, Surface]) -> float:
        """Return what is lost by fewer texels."""
        return self._changed(
            {
                k: texel_terms.texel_error(self.pilot, self.costs, k, surfaces[name].atlas_texels)
                for k, name in self._phosphors()
                if surfaces[name].glows
            }
        )

    def step_error(self, stepped: Stepped) -> float:
        """Return what is lost by a step."""
        return self.glow_changed(stepped.error)

    def glow_changed(self, share: float) -> float:
        """Return what it adds if all glow changes by a share of itself."""
        return self._changed(dict.fromkeys(self.pilot.from_each, share))

    def lamp_twice_error(self) -> float:
        """Return what the second reflection of lamp light, which no plan models, would change."""
        pictures = self.pilot.pictures
        return self._sensitivity.between(pictures + self.pilot.lamp_twice.reshape(pictures.shape))

    def stepped(self, choices: Choices) -> Stepped:
        """Return the way of stepping that the choices say."""
        key = choices.solver, choices.step_s
        if key not in self._stepped:
            self._stepped[key] = judged(self.pilot, self.steps, *key)
        return self._stepped[key]


def _some(moments: Sequence[float]) -> list[float]:
    distinct = sorted(set(moments))
    at = np.unique(np.linspace(0, len(distinct) - 1, MOMENTS).astype(int))
    return [distinct[k] for k in at]


def _traces(choices: Choices) -> bool:
    """Whether glow is transported by paths."""
    return bool(choices.gi["method"] == transport_terms.REFERENCE)


def _key(gi: Mapping[str, Any]) -> _Key:
    return tuple(sorted(gi.items()))
