"""One phosphor's state: concentrations at an anchor in time, and the excitation since then.

While every light is constant, the state is re-anchored only when light changes: a picture evaluates the closed form
from the anchor into a texture of its own, so that rounding does not build up and any time is one step away. Where
light varies, or a solver has no closed form, the anchor moves step by step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, pairwise

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.render.atlas_geometry import AtlasGeometry
from phoslab.render.atlas_irradiance import AtlasIrradiance
from phoslab.render.device import Device
from phoslab.render.excitation import Excitation
from phoslab.render.gpu_scene import GpuDrawable
from phoslab.render.light_course import Segment
from phoslab.render.passes import Picture, false_grey
from phoslab.render.phosphor_step import PhosphorStep
from phoslab.render.schedule import Schedule
from phoslab.render.solvers import check_step, find_solver
from phoslab.render.state_formats import StateTexture
from phoslab.solvers import Drive

Array = NDArray[np.float64]

# Long enough that the exact step ends at the equilibrium, short enough that no rate times it overflows float32.
FOREVER_S = 1e20

# A remainder of a step below this share of it is rounding, not time.
NEGLIGIBLE_SHARE = 1e-6

# A day of them at 60 a second and twice that; on most machines an hour's work.
MOST_STEPS = 10_000_000


@dataclass(frozen=True)
class Stepping:
    """How states advance.

    Args:
        solver: a name in `SOLVERS`.
        step_s: its step in s, where it does not span a whole stretch of constant light.
        state_format: a name in `FORMATS`: what holds the state at the anchor.
    """

    solver: str = "exact"
    step_s: float = 1 / 60
    state_format: str = "f32"


def check_work(schedule: Schedule, until_s: float, stepping: Stepping) -> None:
    """Refuse more steps until a time than anybody would wait for.

    Raises:
        PhoslabError: there are more than `MOST_STEPS`; the remedy says what is too short or too long.
    """
    courses = schedule.alike
    changes = sum(course.most_changes(until_s) for course in courses)
    if changes > MOST_STEPS:
        raise PhoslabError(
            f"change {changes:.2g} times until {until_s:g} s",
            field="the lights",
            remedy="Ask for an earlier time, or give them a programme of a longer period.",
        )
    stepped_s = until_s
    if find_solver(stepping.solver).closed_form:
        varying = [course for course in courses if not course.programme.piecewise_constant]
        stepped_s = sum(float(course.on.integral(until_s)) for course in varying)
    if stepped_s / stepping.step_s > MOST_STEPS:
        raise PhoslabError(
            f"of {stepping.step_s:g} s makes {stepped_s / stepping.step_s:.2g} steps until {until_s:g} s",
            field="the step (--step)",
            remedy=f"Use at least {stepped_s / MOST_STEPS:.2g} s, an earlier time, or --solver exact.",
        )


class PhosphorState:
    """The concentrations of one drawable: n_c channels over its atlas.

    `shown` is the state at the time last asked for.
    """

    def __init__(
        self,
        device: Device,
        drawable: GpuDrawable,
        atlas: AtlasGeometry,
        light: AtlasIrradiance,
        n_bands: int,
        schedule: Schedule,
        stepping: Stepping,
        *,
        lit_by_glow: bool = False,
    ) -> None:
        material, phosphor = drawable.material, drawable.drawable.phosphor
        assert material is not None
        assert phosphor is not None
        self._device = device
        self.drawable, self.atlas, self.light, self.phosphor = drawable, atlas, light, phosphor
        # The lights of each layer of excitation; the last is for an initial equilibrium, if there is one, and before
        # it that of other glow.
        self._lights = list(schedule.alike.values())
        self._glow_layer = len(self._lights) if lit_by_glow else None
        if lit_by_glow:
            self._lights.append(frozenset())
        if phosphor.initial.lights:
            self._lights.append(phosphor.initial.lights)
        self.excitation = Excitation(device, material, atlas.size, n_bands, len(self._lights))
        rates = material.kr if material.uniform_kr is None else material.uniform_kr
        self.step = PhosphorStep(device, material.n_states, rates, stepping.solver)
        self._to_equilibrium = PhosphorStep(device, material.n_states, rates, "exact")
        self._stepping = stepping
        self._anchor, self._spare = (
            StateTexture(device, atlas.size, material.n_states, stepping.state_format) for _ in range(2)
        )
        # A picture's state is float32 whatever the format, and never moves the anchor.
        self._picture = StateTexture(device, atlas.size, material.n_states, "f32")
        self.shown = self._anchor
        self._largest = np.array([course.largest for course in schedule.alike])
        self._largest_a: Array | None = None
        # What a + kr of any phosphor never exceeds.
        self.strictest_per_s = 0.0

    def excite(self, reflected: Callable[[PhosphorState, Mapping[str, float]], None] | None = None) -> None:
        """Find the excitation of every texel under each course's lights. Once is enough while nothing moves.

        The last layer, that of an initial equilibrium, is then where things are at 0 s.

        Args:
            reflected: adds to `light` what surfaces reflect of these lights.
        """
        for layer, names in enumerate(self._lights):
            if layer == self._glow_layer:
                continue
            factors = dict.fromkeys(names, 1.0)
            self.light.run(self.atlas, factors)
            if reflected is not None:
                reflected(self, factors)
            self.excitation.run(self.atlas, self.light, layer)
        self._largest_a = None

    def excite_by_glow(self, shine: Callable[[PhosphorState], None]) -> None:
        """Find the excitation by the light of surfaces: `shine` adds it to `light`."""
        assert self._glow_layer is not None
        self.light.run(self.atlas, {})
        shine(self)
        self.excitation.run(self.atlas, self.light, self._glow_layer)
        self._largest_a = None

    @property
    def largest_rate_per_s(self) -> float:
        """What a + kr of this phosphor never exceeds; 0 where its solver bears any."""
        return self._rate_under(self._largest) if np.isfinite(self.step.solver.largest_step) else 0.0

    def _rate_under(self, factors: Array) -> float:
        """Return the largest a + kr of any texel, in 1/s, under lights of such factors."""
        if self._largest_a is None:  # it is read back from the GPU: once, and only where somebody asks
            self._largest_a = self.excitation.largest_rates()
        if self._glow_layer is not None and len(factors) == self._glow_layer:
            factors = np.append(factors, 1.0)
        return float(factors @ self._largest_a[: len(factors)]) + float(self.phosphor.optics.kr_per_s.max())

    def reset(self) -> None:
        """Put the state at time 0 in place: empty, saturated, or the equilibrium under given lights."""
        initial = self.phosphor.initial
        self._anchor.write(np.array(1.0 if initial.state == "saturated" else 0.0))
        if initial.lights:
            only_last = np.zeros((len(self._lights), 3))
            only_last[-1, 0] = 1.0
            self._run(self._to_equilibrium, self._spare, FOREVER_S, only_last)
            self._anchor, self._spare = self._spare, self._anchor
        self.shown = self._anchor

    @property
    def anchor(self) -> StateTexture:
        """The state at the anchor."""
        return self._anchor

    def show_anchor(self) -> None:
        """Let `shown` be the state at the anchor: that of its very time, whatever was shown before."""
        self.shown = self._anchor

    def advance(self, segment: Segment) -> None:
        """Move the anchor to the end of a segment that begins at it.

        Raises:
            PhoslabError: the solver does not bear its step.
        """
        whole, rest = self._steps(segment)
        for begin_s, end_s in chain(whole, rest):
            self._move_anchor(segment, begin_s, end_s)
        self.shown = self._anchor

    def show(self, segment: Segment) -> float:
        """Evaluate the state at the end of a segment that begins at the anchor into `shown`.

        Returns:
            The anchor's time in s: the segment's start where one step spans it.
        """
        whole, rest = self._steps(segment)
        for begin_s, end_s in whole:
            self._move_anchor(segment, begin_s, end_s)
        self.shown = self._anchor
        for begin_s, end_s in rest:
            self._take(segment, begin_s, end_s, self._picture)
            self.shown = self._picture
        return rest[0][0] if rest else segment.end_s

    def only_at_rate(self, kr_per_s: float) -> StateTexture:
        """Return a copy of `shown` in which only those states are left that fade at this rate."""
        rates = self.phosphor.optics.uniform_kr
        assert rates is not None
        copy = StateTexture(self._device, self.atlas.size, len(rates), "f32")
        copy.write(self.shown.read() * (rates == kr_per_s))
        return copy

    def _steps(self, segment: Segment) -> tuple[Iterator[tuple[float, float]], list[tuple[float, float]]]:
        """Return the whole steps that span a segment, and what is left: one (begin_s, end_s) or none."""
        if self.step.solver.closed_form and segment.constant:
            return iter(()), [(segment.start_s, segment.end_s)]
        step = self._stepping.step_s
        n = int(np.floor((segment.end_s - segment.start_s) / step + NEGLIGIBLE_SHARE))
        edges = [segment.start_s + k * step for k in range(n + 1)]
        # A share of the segment where that is shorter: a step of an age must not swallow it.
        if segment.end_s - edges[-1] > NEGLIGIBLE_SHARE * min(step, segment.end_s - segment.start_s):
            return pairwise(edges), [(edges[-1], segment.end_s)]
        return pairwise([*edges[:-1], segment.end_s]), []

    def _move_anchor(self, segment: Segment, begin_s: float, end_s: float) -> None:
        self._take(segment, begin_s, end_s, self._spare)
        self._anchor, self._spare = self._spare, self._anchor

    def _take(self, segment: Segment, begin_s: float, end_s: float, target: StateTexture) -> None:
        """Take one step from the anchor, if the solver bears it."""
        solver, drives, dt_s = self.step.solver, segment.drives(begin_s, end_s), end_s - begin_s
        if self._glow_layer is not None:
            drives.append(Drive.constant(np.asarray(1.0)))
        largest = np.inf
        if np.isfinite(solver.largest_step) or not segment.constant:
            largest = self._rate_under(np.array([max(solver.light(drive)) for drive in drives]))
            where = repr(self.drawable.drawable.name)
            check_step(self._stepping.solver, largest, dt_s, where, self.strictest_per_s)
        self._run(self.step, target, dt_s, solver.course(drives), largest)

    def _run(
        self, step: PhosphorStep, target: StateTexture, dt_s: float, course: Array, largest: float = np.inf
    ) -> None:
        step.run(
            self._anchor,
            target,
            dt_s,
            self.excitation.excitation,
            course,
            atlas_uv=self.atlas.uv,
            largest_rate_per_s=largest,
        )

    def debug_views(self) -> dict[str, Picture]:
        """The sum over the states, bright where full."""
        return {"state": false_grey(self.shown.read().sum(axis=-1)[::-1])}
