"""How noisy the path tracer is in one scene: a picture of a few hundred pixels, twice.

Two pictures that differ by their seeds alone differ by their noise alone. It falls with the root of the paths, or
faster, whatever the size of the picture. In three bands, with few texels: what is sought is the noise, not the picture.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phoslab.colorimetry import xyz_matrix
from phoslab.model_plan import Choices
from phoslab.render.device import Device
from phoslab.render.glow_transport import TransportParameters
from phoslab.render.path_tracer import UNLIMITED, trace
from phoslab.render.phosphor_state import Stepping
from phoslab.render.planning.pilot import Pilot
from phoslab.render.planning.reduced import apply
from phoslab.render.reference import Reference
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.render.shadow_map import ShadowMapParameters

# Of the probe: paths a pixel, texels along the side of a state, samples along that of a pixel, texels of a shadow map.
PATHS, TEXELS, SUPERSAMPLING, SHADOW_TEXELS = 16, 32, 2, 256


def measure_noise(pilot: Pilot, choices: Choices, *, device: Device | None = None) -> float | None:
    """Return the mean relative error of reflected glow with one path a pixel, when it is the most of the light.

    Args:
        choices: what of the scene to trace.

    Returns:
        None where no reflected glow is met.
    """
    if device is None:
        with Device() as own:
            return measure_noise(pilot, choices, device=own)
    size = pilot.shape[::-1]
    surfaces = {k: replace(s, atlas_texels=min(s.atlas_texels, TEXELS)) for k, s in choices.surfaces.items()}
    scene = apply(pilot.scene, replace(choices, surfaces=surfaces))
    parameters = RenderParameters(
        size,
        SUPERSAMPLING,
        stepping=Stepping(choices.solver, choices.step_s),
        shadow_map=ShadowMapParameters(SHADOW_TEXELS),
        transport=TransportParameters(Reference.name, samples=PATHS, seed=1, full=True),
    )
    with device.scope():
        renderer = Renderer(device, scene, parameters)
        if not isinstance(renderer.transport, Reference):
            return None
        renderer.frame(float(pilot.moments[most_reflected(pilot)]))
        one = renderer.transport.reflected
        assert one is not None
        other = trace(
            renderer.transport.meshes(),
            renderer.gbuffer.camera,
            size,
            reflections=UNLIMITED,
            samples=PATHS,
            seed=2,
            direct=False,
        )
    one, other = (picture @ xyz_matrix(scene.transport) for picture in (one, other))
    reflected = float((one + other).mean()) / 2
    if reflected <= 0:
        return None
    # The difference of two has the noise of both.
    return float(np.abs(one - other).mean() / reflected * np.sqrt(PATHS / 2))


def most_reflected(pilot: Pilot) -> int:
    """Return the number of the moment at which reflected glow is the largest share of the light."""
    lamp, glow, bounces = pilot.means()
    reflected = bounces.sum(axis=0)
    return int(np.argmax(reflected / np.maximum(lamp + glow + reflected, 1e-300)))
