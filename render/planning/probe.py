"""How noisy the path tracer is in one scene: a picture of a few hundred pixels, twice.

Two pictures that differ by their seeds alone differ by their noise alone. It falls with the root of the paths; while
they are few, faster, since they are stratified. In three bands and with few texels: what is sought is the noise, not
the picture.

The scalar variant takes a tenth of a second, and begins paths anywhere in a pixel: where pictures are traced by the
vectorised one, its noise is too large, by 1.1 to 1.5 in eight of nine drawn scenes. That one takes 1 to 2 s to compile,
and sees a pixel through the same places each time: what comes straight is the same in both, and need not be subtracted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phoslab.bands import rebin
from phoslab.colorimetry import xyz_matrix
from phoslab.model_plan import Choices
from phoslab.render.device import Device
from phoslab.render.glow_transport import TransportParameters
from phoslab.render.path_tracer import LLVM, UNLIMITED, TracedMesh, trace
from phoslab.render.phosphor_state import Stepping
from phoslab.render.planning.pilot import Pilot
from phoslab.render.planning.reduced import apply
from phoslab.render.reference import Reference
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.render.scene import Scene
from phoslab.render.shadow_map import ShadowMapParameters

Array = NDArray[np.float64]

# Of the probe: paths a pixel, texels along the side of a state, samples along that of a pixel, texels of a shadow map.
PATHS, TEXELS, SUPERSAMPLING, SHADOW_TEXELS = 16, 32, 2, 256

# What a sample's mean may be off by, in standard errors: one in 40 is worse.
SIGMAS = 2.0

# With fewer paths than the probe's: the power at which noise falls. In eight drawn scenes 0.63 to 0.75 from 4 to 16.
STRATIFIED = 0.75


@dataclass(frozen=True, eq=False)
class PathNoise:
    """How noisy reflected glow is.

    Args:
        of_probe: mean relative error with `PATHS` paths a pixel, at most: where a few pixels have most of it, it is
            less well known.
        spread: of the mean over the probe's pixels, the standard error, as a share.
        pattern: (h, w, 3) noise of the pilot's picture, its mean absolute value being 1; None: not known.
    """

    of_probe: float
    spread: float = 0.0
    pattern: Array | None = None

    def of(self, samples: int) -> float:
        """Return that of so many paths."""
        few = (PATHS / min(samples, PATHS)) ** STRATIFIED
        return float(self.of_probe * few * np.sqrt(PATHS / max(samples, PATHS)))


def measure_noise(
    pilot: Pilot, choices: Choices, variant: str, *, device: Device | None = None
) -> PathNoise | None:
    """Return how noisy reflected glow is at the noisiest moment of first, last, and when it is most of the light.

    Args:
        choices: what of the scene to trace.
        variant: of Mitsuba.

    Returns:
        None where no reflected glow is met.
    """
    if device is None:
        with Device() as own:
            return measure_noise(pilot, choices, variant, device=own)
    surfaces = {k: replace(s, atlas_texels=min(s.atlas_texels, TEXELS)) for k, s in choices.surfaces.items()}
    scene = apply(pilot.scene, replace(choices, surfaces=surfaces))
    parameters = RenderParameters(
        pilot.shape[::-1],
        SUPERSAMPLING,
        stepping=Stepping(choices.solver, choices.step_s),
        shadow_map=ShadowMapParameters(SHADOW_TEXELS),
        transport=TransportParameters(Reference.name),
    )
    found = []
    with device.scope():
        renderer = Renderer(device, scene, parameters)
        if not isinstance(renderer.transport, Reference):
            return None
        for at in sorted({0, most_reflected(pilot), len(pilot.moments) - 1}):
            renderer.light(float(pilot.moments[at]))
            noise = _noise_at(pilot, at, renderer.transport.meshes(), scene, variant)
            if noise is not None:
                found.append(noise)
    return max(found, key=lambda noise: noise.of_probe, default=None)


def _noise_at(
    pilot: Pilot, at: int, meshes: Sequence[TracedMesh], scene: Scene, variant: str
) -> PathNoise | None:
    """Return how noisy the light of meshes is at the pilot's moment of number `at`; None: no reflected glow is met."""
    to_xyz = xyz_matrix(scene.transport)
    # Of the pilot, by which the noise is multiplied again.
    reflected = rebin(pilot.bounces[:, at].sum(axis=0).mean(axis=0), pilot.scene.transport, scene.transport)
    brightness = float((reflected @ to_xyz).mean())
    if brightness <= 0:
        return None
    one, other = (
        trace(
            meshes,
            [scene.camera],
            pilot.shape[::-1],
            reflections=UNLIMITED,
            samples=PATHS,
            seed=seed,
            direct=variant == LLVM,
            grid=SUPERSAMPLING,
            variant=variant,
        )
        @ to_xyz
        for seed in (1, 2)
    )
    # The difference of two has the noise of both.
    noise = np.asarray(one - other, dtype=np.float64)
    each = np.abs(noise).mean(axis=-1)
    mean, spread = float(each.mean()), float(each.std() / np.sqrt(each.size))
    return PathNoise(
        (mean + SIGMAS * spread) / np.sqrt(2) / brightness,
        spread / max(mean, 1e-300),
        noise / max(mean, 1e-300),
    )


def most_reflected(pilot: Pilot) -> int:
    """Return the number of the moment at which reflected glow is the largest share of the light."""
    lamp, glow, bounces = pilot.means()
    reflected = bounces.sum(axis=0)
    return int(np.argmax(reflected / np.maximum(lamp + glow + reflected, 1e-300)))
