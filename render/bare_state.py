"""A state on its own, without a scene: what tests and trades drive the GPU's solvers with.

with Device() as device:
    state = BareState(device, kr=[0.2, 0.01], a=np.full((64, 64, 2), 0.1), solver="rk23", state_format="f16")
    state.advance(1 / 60)
    r = state.read()                                   # (64, 64, 2) float64
"""

from __future__ import annotations

from functools import cached_property

import moderngl
import numpy as np
from numpy.typing import ArrayLike, NDArray

from phoslab.errors import PhoslabError
from phoslab.render.device import Device, set_uniforms
from phoslab.render.phosphor_step import PhosphorStep
from phoslab.render.solvers import check_step, find_solver
from phoslab.render.state_formats import (
    StateTexture,
    bind_states,
    find_format,
    state_defines,
    texels_of_group,
)
from phoslab.solvers import Drive

Array = NDArray[np.float64]

STEADY = Drive.constant(np.array(1.0))


class BareState:
    """Concentrations of n_c states on (h, w) texels, stepped by one solver in one format.

    Args:
        kr: (n_c,) re-radiation rates in 1/s; or (h, w, n_c) of every texel.
        a: (h, w, n_c) excitation in 1/s.
        solver: a name in `phoslab.render.solvers.SOLVERS`.
        state_format: a name in `phoslab.render.state_formats.FORMATS`.
        r0: concentrations at first, broadcast to (h, w, n_c).

    Raises:
        PhoslabError: a rate is negative or not finite, or a name is unknown.
    """

    def __init__(
        self,
        device: Device,
        kr: ArrayLike,
        a: ArrayLike,
        solver: str = "exact",
        state_format: str = "f32",
        r0: ArrayLike = 0.0,
    ) -> None:
        self._device, self._solver_name, self.solver = device, solver, find_solver(solver)
        first, rates = _checked(a, "a"), _checked(kr, "kr")
        h, w, self.n_states = first.shape
        self.size = (w, h)
        self._kr = rates
        self._largest_a = self._largest(first)
        kr_map = None if rates.ndim == 1 else device.texture(self.size, self.n_states, rates)
        self._step = PhosphorStep(device, self.n_states, rates if kr_map is None else kr_map, solver)
        self._texel_uv = None if kr_map is None else device.texture(self.size, 2, _centres(w, h))
        self.format = find_format(state_format)
        self._now, self._next = (
            StateTexture(device, self.size, self.n_states, state_format) for _ in range(2)
        )
        self._now.write(np.asarray(r0, dtype=np.float64))
        self._a = device.texture_array(self.size, 1, first[None], components=self.n_states)

    @property
    def bytes_per_texel(self) -> int:
        """What one texel of one such state takes."""
        return self.format.bytes_per_texel(self.n_states)

    def advance(self, dt_s: float, light: Drive = STEADY) -> None:
        """Take one step.

        Args:
            dt_s: 0 or more.
            light: over the step, as the solvers of `phoslab.solvers` take it: of scalars, which are factors on `a`;
                or of (h, w, n_c) excitations in 1/s that replace `a` in this step, which have to be uploaded.

        Raises:
            PhoslabError: dt or the light is negative or not finite, or the solver does not bear the step.
        """
        self.advance_many(dt_s, 1, light)

    def advance_many(self, dt_s: float, n: int, light: Drive = STEADY) -> None:
        """Take `n` steps, each under the same light; otherwise as `advance`."""
        excitation, course, largest = self._excite(light)
        rate = float((largest + self._kr).max())
        check_step(self._solver_name, rate, dt_s, "a texel")
        newest = self._step.run(
            self._now,
            self._next,
            dt_s,
            excitation,
            course,
            atlas_uv=self._texel_uv,
            times=n,
            largest_rate_per_s=rate,
        )
        if newest is not self._now:
            self._now, self._next = self._next, self._now

    def copy(self) -> None:
        """Read and write what a step does, without arithmetic: the yardstick of its time. The state stays."""
        shader = self._device.compute("bare_copy", state_defines(self._now, self._next))
        bind_states(shader, self._now, self._next)
        self._a.use(2)
        set_uniforms(shader, excitation=2)
        self._device.dispatch(shader, self.size, group=texels_of_group(self.n_states))

    def read(self) -> Array:
        """Return (h, w, n_c) the concentrations."""
        return self._now.read()

    @cached_property
    def _own_a(self) -> moderngl.TextureArray:
        """For steps that bring excitations of their own: a layer for each that the solver takes."""
        return self._device.texture_array(self.size, len(self.solver.basis), components=self.n_states)

    def _excite(self, light: Drive) -> tuple[moderngl.TextureArray, Array, Array]:
        """Return the excitation, its course over the step, and what a does not exceed, of the shape of kr."""
        values = np.array([_checked(value, "light") for value in self.solver.light(light)])
        if values.ndim == 1:
            return self._a, values[None] @ self.solver.basis, self._largest_a * values.max()
        texels = np.zeros((len(values), self.size[1], self.size[0], self._own_a.components), dtype=np.float32)
        texels[..., : self.n_states] = values
        self._own_a.write(texels.tobytes())
        return self._own_a, self.solver.basis, self._largest(values.max(axis=0))

    def _largest(self, a: Array) -> Array:
        """Return (n_c,) the largest over the texels; or all, where every texel has rates of its own to add."""
        largest: Array = a.max(axis=(0, 1)) if self._kr.ndim == 1 else a
        return largest


def _checked(values: ArrayLike, field: str) -> Array:
    array = np.asarray(values, dtype=np.float64)
    if not (np.isfinite(array).all() and (array >= 0).all()):
        raise PhoslabError(
            "holds a negative or non-finite value", field=field, remedy="Rates and light are 0 or more."
        )
    return array


def _centres(width: int, height: int) -> Array:
    """Return (height, width, 2) the texture coordinates of the texels' centres."""
    u, v = ((np.arange(n) + 0.5) / n for n in (width, height))
    return np.stack(np.meshgrid(u, v), axis=-1)
