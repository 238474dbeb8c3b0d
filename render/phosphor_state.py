"""One phosphor's state: concentrations at an anchor in time, and the excitation since then.

The state is re-anchored only when light changes. A picture evaluates the closed form from the anchor into a
texture of its own, so that rounding does not build up and any time is one step away. A solver that cannot span
any length moves the anchor step by step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phoslab.render.atlas_geometry import AtlasGeometry
from phoslab.render.atlas_irradiance import AtlasIrradiance
from phoslab.render.device import Device
from phoslab.render.excitation import Excitation
from phoslab.render.gpu_scene import GpuDrawable
from phoslab.render.passes import Picture, false_grey
from phoslab.render.phosphor_step import PhosphorStep
from phoslab.render.solvers import SOLVERS, check_step
from phoslab.render.state_formats import StateTexture

# Long enough that the exact step ends at the equilibrium whatever the rates.
FOREVER_S = 1e30

# A remainder of a step below this share of it is rounding, not time.
NEGLIGIBLE_SHARE = 1e-6


@dataclass(frozen=True)
class Stepping:
    """How states advance: a name in `SOLVERS`, and its step in s where it cannot span any length."""

    solver: str = "exact"
    step_s: float = 1 / 60


class PhosphorState:
    """The concentrations of one drawable: n_c channels over its atlas, float32.

    `shown` is the state at the time last asked for.
    """

    def __init__(
        self,
        device: Device,
        drawable: GpuDrawable,
        atlas: AtlasGeometry,
        light: AtlasIrradiance,
        excitation: Excitation,
        stepping: Stepping,
    ) -> None:
        assert drawable.material is not None
        assert drawable.drawable.phosphor is not None
        self.drawable, self.atlas, self.light, self.excitation = drawable, atlas, light, excitation
        self.phosphor = drawable.drawable.phosphor
        n, kr = drawable.material.n_states, drawable.material.uniform_kr
        rates = drawable.material.kr if kr is None else kr
        self.step = PhosphorStep(device, n, rates, stepping.solver)
        self._to_equilibrium = PhosphorStep(device, n, rates, "exact")
        self._stepping = stepping
        # Two to step between; the third is what a picture sees, so that it never moves the anchor.
        self._textures = [StateTexture(device, atlas.size, n, "f32") for _ in range(3)]
        self._anchor = 0
        self._lit: frozenset[str] = frozenset()
        self._excited: frozenset[str] | None = None
        self.shown: StateTexture = self._textures[0]

    @property
    def anchor(self) -> StateTexture:
        """The state at the anchor."""
        return self._textures[self._anchor]

    def reset(self) -> None:
        """Put the state at time 0 in place: empty, saturated, or the equilibrium under given lights."""
        initial = self.phosphor.initial
        self._textures[0].write(np.array(1.0 if initial.state == "saturated" else 0.0))
        self._anchor, self.shown = 0, self._textures[0]
        if initial.state == "equilibrium":
            self.relight(initial.lights)
            self._run(self._to_equilibrium, FOREVER_S, target=1)
            self._anchor, self.shown = 1, self._textures[1]

    def relight(self, lit: frozenset[str]) -> None:
        """Take note that from the anchor on just the lights named in `lit` are on."""
        self._lit = lit
        # A light that flickers comes back to what is already there; darkness needs no excitation at all,
        # except where the rates come from a map and every texel is stepped alike.
        if lit == self._excited or not (lit or not self.step.needs_no_light_in_dark):
            return
        self.light.run(self.atlas, lit)
        self.excitation.run(self.atlas, self.light)
        self._excited = lit

    def advance(self, dt_s: float) -> None:
        """Move the anchor on by `dt_s` under constant light.

        Raises:
            PhoslabError: the solver would overshoot.
        """
        whole, remainder = self._split(dt_s)
        for _ in range(whole):
            self._move_anchor(self._stepping.step_s)
        if remainder:
            self._move_anchor(remainder)
        self.shown = self.anchor

    def show(self, dt_s: float) -> float:
        """Evaluate the state `dt_s` after the anchor into `shown`.

        Returns:
            By how many seconds the anchor itself has moved: 0 for a solver that spans any length.
        """
        whole, remainder = self._split(dt_s)
        for _ in range(whole):
            self._move_anchor(self._stepping.step_s)
        if remainder:
            self._run(self.step, remainder, target=2)
        self.shown = self._textures[2] if remainder else self.anchor
        return whole * self._stepping.step_s

    def _split(self, dt_s: float) -> tuple[int, float]:
        """Return how many whole steps to take, and the rest in s; check that they are stable."""
        if SOLVERS[self._stepping.solver].closed_form:
            return 0, dt_s
        step = self._stepping.step_s
        kr = float(self.phosphor.optics.kr_per_s.max())
        largest = kr + (float(self.excitation.largest_rates().max()) if self._lit else 0.0)
        check_step(self._stepping.solver, largest, min(step, dt_s), repr(self.drawable.drawable.name))
        whole = int(np.floor(dt_s / step + NEGLIGIBLE_SHARE))
        rest = dt_s - whole * step
        return whole, rest if rest > NEGLIGIBLE_SHARE * step else 0.0

    def _move_anchor(self, dt_s: float) -> None:
        self._run(self.step, dt_s, target=1 - self._anchor)
        self._anchor = 1 - self._anchor

    def _run(self, step: PhosphorStep, dt_s: float, target: int) -> None:
        step.run(
            self.anchor,
            self._textures[target],
            dt_s,
            self.excitation.excitation,
            np.array([[1.0 if self._lit else 0.0, 0.0, 0.0]]),
            atlas_uv=self.atlas.uv,
        )

    def debug_views(self) -> dict[str, Picture]:
        """The sum over the states, bright where full."""
        return {"state": false_grey(self.shown.read().sum(axis=-1)[::-1])}
