"""One step of the rate equations on every texel of a state texture (Nalbach 2017, eq. 8.1 and 8.5)."""

from __future__ import annotations

from typing import ClassVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.render.device import Device, set_uniforms
from phoslab.render.passes import Picture
from phoslab.render.solvers import find_solver, share_in_dark
from phoslab.render.state_formats import StateTexture, bind_states, state_defines, texels_of_group
from phoslab.solvers import EXPLICIT_LIMIT

Array = NDArray[np.float64]

# A kr dt that is not 0 and decays nothing, so that a / (a + kr) is defined without a test on every texel.
SLOWEST = 1e-37


class PhosphorStep:
    """Steps states of one material, by one solver.

    A compute shader over rows of texels: measured on a CPU rasterizer, a fifth faster than a fragment shader.

    Args:
        n_states: n_c.
        kr: (n_c,) the rates in 1/s; or a texture of them over the material's texture space.
        solver: a name in `SOLVERS`.
    """

    name: ClassVar[str] = "phosphor_step"
    reads: ClassVar[tuple[str, ...]] = ("state", "atlas.excitation", "atlas.uv", "material.kr")
    writes: ClassVar[tuple[str, ...]] = ("state",)

    def __init__(self, device: Device, n_states: int, kr: Array | moderngl.Texture, solver: str) -> None:
        self._device, self._n_states, self._kr = device, n_states, kr
        self.solver = find_solver(solver)

    @property
    def needs_no_light_in_dark(self) -> bool:
        """Whether a step without light has a closed form that is the same for every texel."""
        return self.solver.closed_form and not isinstance(self._kr, moderngl.Texture)

    def run(
        self,
        r: StateTexture,
        target: StateTexture,
        dt_s: float,
        excitation: moderngl.TextureArray,
        course: Array,
        *,
        atlas_uv: moderngl.Texture | None = None,
        times: int = 1,
        largest_rate_per_s: float = np.inf,
    ) -> StateTexture:
        """Write into `target` the state `dt_s` after `r`; return the one that holds the newest state.

        Args:
            r: concentrations.
            target: another state of the same size and number, in any format.
            dt_s: 0 or more.
            excitation: a_i in 1/s at factor 1, a layer for each row of `course` or more.
            course: (n_layers, 3) each layer's factor over the step, as `Solver.course` gives it.
            atlas_uv: texture coordinates of the texels; needed where kr is a map.
            times: how many such steps to take, to and fro between the two (which then have one format).
            largest_rate_per_s: what no texel's a + kr exceeds, where that is known: a short step then costs less.
        """
        shader = self._program(r, target, course, largest_rate_per_s * dt_s if dt_s else 0.0)
        if self._is_dark(course):
            assert isinstance(self._kr, np.ndarray)
            stay, move = share_in_dark(self._kr, dt_s)
            set_uniforms(shader, stay=_four(stay), move=_four(move))
        else:
            excitation.use(2)
            set_uniforms(shader, excitation=2, course_dt=(course * dt_s).astype("f4").tobytes())
            if isinstance(self._kr, np.ndarray):
                set_uniforms(shader, kr_dt=tuple(np.maximum(_four(self._kr * dt_s), SLOWEST).tolist()))
            else:
                assert atlas_uv is not None
                atlas_uv.use(3)
                self._kr.use(4)
                set_uniforms(shader, atlas_uv=3, kr_map=4, dt=dt_s)
        for _ in range(times):
            bind_states(shader, r, target)
            self._device.dispatch(shader, target.value.size, group=texels_of_group(r.n_states))
            r, target = target, r
        return r

    def _is_dark(self, course: Array) -> bool:
        return self.needs_no_light_in_dark and not course.any()

    def _program(
        self, r: StateTexture, target: StateTexture, course: Array, largest_step: float
    ) -> moderngl.ComputeShader:
        states = state_defines(r, target)
        if self._is_dark(course):
            return self._device.compute("phosphor_dark", states)
        defines: dict[str, int | str] = {
            "SOLVER": self.solver.include_for(largest_step),
            "EXPLICIT_LIMIT": f"{EXPLICIT_LIMIT:.1f}",
            "LIGHTS": len(course),
        }
        if isinstance(self._kr, moderngl.Texture):
            defines |= {"KR_MAP": 1, "SLOWEST": f"{SLOWEST:e}"}
        return self._device.compute(self.name, {**states, **defines})

    def debug_views(self) -> dict[str, Picture]:
        """Nothing of its own: `PhosphorState` shows the state."""
        return {}


def _four(values: Array) -> tuple[float, ...]:
    return tuple(np.pad(values, (0, 4 - values.size)).tolist())
