"""One step of the rate equations on every texel of a state texture (Nalbach 2017, eq. 8.1 and 8.5)."""

from __future__ import annotations

from typing import ClassVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.render.device import Device, set_uniforms
from phoslab.render.gpu_scene import MaterialTextures
from phoslab.render.optics import SLOWEST_PER_S
from phoslab.render.passes import Picture
from phoslab.render.solvers import find_solver

GROUP = (64, 1)  # the local size in the shaders


class PhosphorStep:
    """Steps the states of one material, by one solver.

    A compute shader over rows of texels: measured on a CPU rasterizer, a fifth faster than a fragment shader.
    """

    name: ClassVar[str] = "phosphor_step"
    reads: ClassVar[tuple[str, ...]] = ("state", "atlas.excitation", "atlas.uv", "material.kr")
    writes: ClassVar[tuple[str, ...]] = ("state",)

    def __init__(self, device: Device, material: MaterialTextures, solver: str) -> None:
        self._device, self._material = device, material
        self._solver = find_solver(solver)
        defines: dict[str, int | str] = {"SOLVER": self._solver.include, "STATES": material.n_states}
        if material.uniform_kr is None:
            defines["KR_MAP"] = 1
        self._lit = device.compute(self.name, defines)
        self._dark = device.compute("phosphor_dark", {"STATES": material.n_states})

    def run(
        self,
        r: moderngl.Texture,
        target: moderngl.Texture,
        dt_s: float,
        excitation: moderngl.Texture,
        *,
        dark: bool,
        atlas_uv: moderngl.Texture | None = None,
    ) -> None:
        """Write into `target` the state `dt_s` after `r`.

        Args:
            r: concentrations, n_c channels.
            target: another texture of the same size and format.
            dt_s: 0 or more.
            excitation: a_i in 1/s, constant over the step; all 0 where `dark`.
            dark: that there is no light: with uniform rates the factors are then computed in float64.
            atlas_uv: texture coordinates of the texels; needed where kr is a map.
        """
        r.use(0)
        target.bind_to_image(0, read=False, write=True)
        kr = self._material.uniform_kr
        if dark and kr is not None:
            set_uniforms(self._dark, r_in=0, keep=_four(self._solver.keep_in_dark(kr, dt_s)))
            self._device.dispatch(self._dark, target.size, group=GROUP)
            return
        excitation.use(1)
        set_uniforms(self._lit, r_in=0, excitation=1, dt=dt_s)
        if kr is not None:
            set_uniforms(self._lit, kr=tuple(np.maximum(_four(kr), SLOWEST_PER_S).tolist()))
        else:
            assert atlas_uv is not None
            atlas_uv.use(2)
            self._material.kr.use(3)
            set_uniforms(self._lit, atlas_uv=2, kr_map=3)
        self._device.dispatch(self._lit, target.size, group=GROUP)

    def debug_views(self) -> dict[str, Picture]:
        """Nothing of its own: `PhosphorState` shows the state."""
        return {}


def _four(values: NDArray[np.float64]) -> tuple[float, ...]:
    return tuple(np.pad(values, (0, 4 - values.size)).tolist())
