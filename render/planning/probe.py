"""How noisy the path tracer is in one scene: a picture of a few hundred pixels, twice.

Two pictures that differ by their seeds alone differ by their noise alone. With few paths it falls faster than with the
root of their number, since they are stratified; so it is measured for few and for more, and from there on the root is
taken. In three bands and with few texels: what is sought is the noise, not the picture.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phoslab.colorimetry import xyz_matrix
from phoslab.model_plan import Choices
from phoslab.render.device import Device
from phoslab.render.glow_transport import TransportParameters
from phoslab.render.path_tracer import UNLIMITED, find_llvm, trace
from phoslab.render.phosphor_state import Stepping
from phoslab.render.planning.pilot import Pilot
from phoslab.render.planning.reduced import apply
from phoslab.render.reference import Reference
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.render.shadow_map import ShadowMapParameters

Array = NDArray[np.float64]

# Of the probe: paths a pixel, texels along the side of a state, samples along that of a pixel, texels of a shadow map.
FEW, MORE, TEXELS, SUPERSAMPLING, SHADOW_TEXELS = 4, 36, 32, 2, 256

# What the vectorised variant is as noisy as, over the other: it sees a pixel through the same places every time, and
# stratifies better. 0.34 to 0.87 in eight drawn scenes with 4 to 400 paths a pixel.
COMPILED = 0.9


@dataclass(frozen=True)
class PathNoise:
    """Mean relative error of reflected glow with `FEW` and with `MORE` paths a pixel."""

    of_few: float
    of_more: float

    def of(self, samples: int) -> float:
        """Return that of so many paths: a power law between the two, the root outside."""
        power = float(np.clip(np.log(self.of_few / self.of_more) / np.log(MORE / FEW), 0.5, 1.0))
        if samples <= FEW:
            return self.of_few * float(np.sqrt(FEW / samples))
        beyond = float(np.sqrt(MORE / max(samples, MORE)))
        return self.of_few * float((min(samples, MORE) / FEW) ** -power) * beyond

    @classmethod
    def of_independent(cls, of_one: float) -> PathNoise:
        """Return that of paths whose number alone counts."""
        return cls(of_one / float(np.sqrt(FEW)), of_one / float(np.sqrt(MORE)))


def measure_noise(
    pilot: Pilot, choices: Choices, *, compiled: bool = False, device: Device | None = None
) -> PathNoise | None:
    """Return how noisy reflected glow is when it is the most of the light.

    Args:
        choices: what of the scene to trace.
        compiled: in the variant that pictures are traced in; else in that which needs no compiling.

    Returns:
        None where no reflected glow is met.
    """
    if device is None:
        with Device() as own:
            return measure_noise(pilot, choices, compiled=compiled, device=own)
    size = pilot.shape[::-1]
    surfaces = {k: replace(s, atlas_texels=min(s.atlas_texels, TEXELS)) for k, s in choices.surfaces.items()}
    scene = apply(pilot.scene, replace(choices, surfaces=surfaces))
    parameters = RenderParameters(
        size,
        SUPERSAMPLING,
        stepping=Stepping(choices.solver, choices.step_s),
        shadow_map=ShadowMapParameters(SHADOW_TEXELS),
        transport=TransportParameters(Reference.name),
    )
    with device.scope():
        renderer = Renderer(device, scene, parameters)
        if not isinstance(renderer.transport, Reference):
            return None
        renderer.light(float(pilot.moments[most_reflected(pilot)]))
        meshes, camera = renderer.transport.meshes(), renderer.gbuffer.camera

    def traced(samples: int, seed: int) -> Array:
        picture = trace(
            meshes,
            camera,
            size,
            reflections=UNLIMITED,
            samples=samples,
            seed=seed,
            direct=False,
            compiled=compiled,
            grid=scene.supersampling,
        )
        return np.asarray(picture @ xyz_matrix(scene.transport))

    few, more = (traced(FEW, 1), traced(FEW, 2)), (traced(MORE, 3), traced(MORE, 4))
    reflected = float((more[0] + more[1]).mean()) / 2
    if reflected <= 0:
        return None
    # The difference of two has the noise of both.
    over = reflected * np.sqrt(2) * (1.0 if compiled or find_llvm() is None else 1 / COMPILED)
    return PathNoise(*(float(np.abs(a - b).mean() / over) for a, b in (few, more)))


def most_reflected(pilot: Pilot) -> int:
    """Return the number of the moment at which reflected glow is the largest share of the light."""
    lamp, glow, bounces = pilot.means()
    reflected = bounces.sum(axis=0)
    return int(np.argmax(reflected / np.maximum(lamp + glow + reflected, 1e-300)))
