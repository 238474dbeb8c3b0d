"""What a bound on the model does not cover, said beside it: the material itself, and what the renderer never models."""

from __future__ import annotations

import numpy as np

from phoslab.material import Material
from phoslab.model_plan import Choices
from phoslab.render.planning.pilot import Pilot


def notes(pilot: Pilot, choices: Choices) -> tuple[str, ...]:
    """Return what to know of a plan besides its bound."""
    return tuple(dict.fromkeys([*_materials(pilot, choices), *_beyond(pilot), *_other_light(pilot)]))


def _materials(pilot: Pilot, choices: Choices) -> list[str]:
    """Say how well each material that glows is known."""
    said = []
    for k, sampled in pilot.sampled.items():
        if not choices.surfaces[pilot.scene.drawables[k].name].glows:
            continue
        material = sampled.phosphor.material
        known = emission_error(material)
        said.append(
            f"{material.name!r} comes without standard errors: nobody knows how well it is known"
            if known is None
            else f"{material.name!r} itself is known to {known:.1%} (one standard error of its emission); "
            "no model of it is better"
        )
    return said


def emission_error(material: Material) -> float | None:
    """Return the standard error of a material's emission over itself, over all states and bands; None: not stated."""
    stated = (material.standard_error or {}).get("emission")
    if stated is None:
        return None
    errors = np.asarray(stated, dtype=np.float64)
    if errors.shape != material.emission.shape or not material.emission.any():
        return None
    return float(np.sqrt(np.nansum(errors**2)) / np.sqrt((material.emission**2).sum()))


def _beyond(pilot: Pilot) -> list[str]:
    said = []
    for sampled in pilot.sampled.values():
        material = sampled.phosphor.material
        dark = [d for t in pilot.moments if (d := pilot.scene.schedule.dark_for_s(float(t))) is not None]
        if material.valid_s is not None and dark and max(dark) > material.valid_s[1]:
            said.append(
                f"{max(dark):g} s after the light is beyond the {material.valid_s[1]:g} s that the data of "
                f"{material.name!r} support: the bound holds for the model, not for the material there"
            )
    return said


def _other_light(pilot: Pilot) -> list[str]:
    """Say what no plan models, nor the picture that its bound is held against: `render` has options for it."""
    said = []
    lamp, glow, bounces = pilot.means()
    twice = float((pilot.lamp_twice / np.maximum(lamp + glow + bounces.sum(axis=0), 1e-300)).max())
    if pilot.scene.lights:
        seen = f"; its second reflection would add {twice:.1%} to the light that is seen" if twice > 0 else ""
        said = [
            "lamp light that walls reflect, and charge others with, is in no plan (render --lamp-bounces has it)"
            + seen
        ]
    share = _recharging(pilot)
    if share is not None and share > 1e-3:
        said.append(
            f"glow that charges other phosphors is in no plan (render --glow-excites has it); under full glow from all "
            f"sides it would give them {share:.1g} of what they lose"
        )
    return said


def _recharging(pilot: Pilot) -> float | None:
    """Return what no state's excitation over kr exceeds under the brightest glow from all around."""
    if not pilot.sampled:
        return None
    brightest = np.zeros(pilot.scene.transport.n)
    for s in pilot.sampled.values():
        brightest = np.maximum(brightest, np.einsum("nc,nck->nk", s.kr, s.emission).max(axis=0))
    ratios = [
        (s.ke_width.max(axis=0) @ (np.pi * brightest) / np.maximum(s.kr.min(axis=0), 1e-300)).max()
        for s in pilot.sampled.values()
    ]
    return float(max(ratios))
