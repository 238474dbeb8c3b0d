"""A scene as a plan models it: fewer bands, fewer states, fewer texels, and glow only where it matters.

**Bands.** Light travels in the plan's bands, but a lamp excites as it does in the scene's own: a state answers to each
lamp with one number, s = Σ_j ke_j E_j Δλ_j, and `ke` in the new bands is chosen so that every lamp gives that number
again. It need not be positive then. This is exact as long as there are no more unlike lamps than bands.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import fields, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from phoslab.bands import Bands, overlap_nm, rebin
from phoslab.errors import PhoslabError
from phoslab.model_plan import Choices, Surface
from phoslab.render.glow_methods import NAMES
from phoslab.render.glow_transport import NONE, TransportParameters
from phoslab.render.optics import Optics
from phoslab.render.scene import Drawable, Light, Scene
from phoslab.render.solvers import find_solver
from phoslab.render.state_formats import find_format

Array = NDArray[np.float64]
Groups = Sequence[Sequence[int]]

# What excites is held to this, of the largest: float32 has no more.
SAME_EXCITATION = 1e-6


def apply(scene: Scene, choices: Choices) -> Scene:
    """Return the scene as `choices` model it.

    Raises:
        PhoslabError: they do not fit the scene.
    """
    check_fit(scene, choices)
    target = Bands(np.array(choices.bands_nm))
    lights = tuple(
        Light(light.place, rebin(light.irradiance_at_1m, scene.transport, target)) for light in scene.lights
    )
    drawables = []
    reflectances: dict[int, NDArray[np.floating]] = {}
    for drawable in scene.drawables:
        key = id(drawable.reflectance)
        if key not in reflectances:
            reflectances[key] = _fewer_bands(drawable.reflectance, scene.transport, target)
        drawables.append(_drawable(scene, drawable, choices, target, lights, reflectances[key]))
    return replace(scene, transport=target, lights=lights, drawables=tuple(drawables))


def transport_parameters(choices: Choices) -> TransportParameters:
    """Return how glow reaches other surfaces.

    Raises:
        PhoslabError: a parameter is unknown or out of range.
    """
    if choices.gi["method"] not in NAMES:
        raise _misfit(
            "choices.gi.method", f"is {choices.gi['method']!r}", remedy=f"Use one of: {', '.join(NAMES)}."
        )
    kinds = {f.name: type(f.default) for f in fields(TransportParameters)}
    for name, value in choices.gi.items():
        if name not in kinds:
            known = ", ".join(k for k in kinds if k != "method")
            raise _misfit(
                f"choices.gi.{name}", "is no parameter of glow transport", remedy=f"Use some of: {known}."
            )
        fitting = (int, float) if kinds[name] is float else (kinds[name],)
        if type(value) not in fitting:
            raise _misfit(
                f"choices.gi.{name}",
                f"is {value!r}",
                remedy=f"Give {_KINDS[kinds[name]]}, such as {json.dumps(getattr(TransportParameters, name))}.",
            )
    return TransportParameters(**choices.gi)


_KINDS = {int: "a whole number", float: "a number", bool: "true or false", str: "a text"}


def check_fit(scene: Scene, choices: Choices, planned_for: str = "") -> None:
    """Refuse choices that belong to another scene, or to none.

    Args:
        planned_for: the scene that a plan names.

    Raises:
        PhoslabError: a name, a state or a band is not there.
    """
    phosphors = {d.name: d for d in scene.phosphors}
    unlike = set(phosphors) ^ set(choices.surfaces)
    if unlike:
        of = f": the plan is of {planned_for}" if planned_for else ""
        raise _misfit("choices.surfaces", f"and the scene's phosphors differ in {sorted(unlike)[0]!r}{of}")
    for name, surface in choices.surfaces.items():
        phosphor = phosphors[name].phosphor
        assert phosphor is not None
        used = [i for group in surface.states for i in group]
        n = phosphor.optics.n_states
        if len(set(used)) != len(used):
            raise _misfit(f"choices.surfaces.{name}.states", "names a state twice")
        if max(used) >= n:
            raise _misfit(
                f"choices.surfaces.{name}.states",
                f"names state {max(used)}, but the material has {'state 0 alone' if n == 1 else f'0 to {n - 1}'}",
            )
    try:
        edges = Bands(np.array(choices.bands_nm)).edges_nm
    except PhoslabError as error:
        raise _misfit("choices.bands_nm", error.problem) from None
    own = scene.transport.edges_nm
    if not np.isin(edges, own).all() or edges[0] != own[0] or edges[-1] != own[-1]:
        raise _misfit("choices.bands_nm", "has other edges than the scene's bands")
    find_solver(choices.solver)
    find_format(choices.state_format)
    transport_parameters(choices)


def _misfit(field: str, problem: str, remedy: str = "") -> PhoslabError:
    anew = "Plan this scene anew: phoslab plan SCENE --max-error BOUND -o plan.json."
    return PhoslabError(problem, field=f"the plan's {field}", remedy=remedy or anew)


def _drawable(
    scene: Scene,
    drawable: Drawable,
    choices: Choices,
    target: Bands,
    lights: Sequence[Light],
    reflectance: NDArray[np.floating],
) -> Drawable:
    phosphor = drawable.phosphor
    if phosphor is None or not choices.surfaces[drawable.name].glows:
        return replace(drawable, reflectance=reflectance, phosphor=None)
    surface = choices.surfaces[drawable.name]
    optics = in_bands(
        in_states(phosphor.optics, surface.states), scene.transport, target, scene.lights, lights
    )
    return replace(
        drawable,
        reflectance=reflectance,
        phosphor=replace(phosphor, optics=optics, atlas_texels=surface.atlas_texels),
    )


def in_states(optics: Optics, groups: Groups) -> Optics:
    """Return a material of one state a group: those left out are dropped, those in one group merged."""
    if [list(g) for g in groups] == [[i] for i in range(optics.n_states)]:
        return optics
    kr, ke, emission = merge_states(optics.kr_per_s, optics.ke_width, optics.emission, groups)
    return replace(optics, kr_per_s=kr, ke_width=ke, emission=emission, n_states=len(groups))


def merge_states(kr: Array, ke: Array, emission: Array, groups: Groups) -> tuple[Array, Array, Array]:
    """Return kr (..., n_g), ke and emission (..., n_g, K) of merged states.

    Each state counts as much as it gives when full; the merged one, when full, gives what they gave together.
    """
    given = (emission * kr[..., None]).sum(axis=-1)
    parts = []
    for group in groups:
        g = list(group)
        w = given[..., g] / np.maximum(given[..., g].sum(axis=-1, keepdims=True), 1e-300)
        merged_kr = (w * kr[..., g]).sum(axis=-1)
        merged_ke = (w[..., None] * ke[..., g, :]).sum(axis=-2)
        full = (emission[..., g, :] * kr[..., g, None]).sum(axis=-2)
        parts.append((merged_kr, merged_ke, full / np.maximum(merged_kr, 1e-300)[..., None]))
    return (
        np.stack([p[0] for p in parts], axis=-1),
        np.stack([p[1] for p in parts], axis=-2),
        np.stack([p[2] for p in parts], axis=-2),
    )


def in_bands(
    optics: Optics, source: Bands, target: Bands, before: Sequence[Light], after: Sequence[Light]
) -> Optics:
    """Return a material whose emission is in other bands, and which the lamps excite as before."""
    if source == target:
        return optics
    return replace(
        optics,
        ke_width=_same_excitation(optics.ke_width, before, after, target.n),
        emission=rebin(optics.emission, source, target),
        albedo=None if optics.albedo is None else rebin(optics.albedo, source, target),
    )


def _same_excitation(ke_width: Array, before: Sequence[Light], after: Sequence[Light], n: int) -> Array:
    if not before:
        return np.zeros((*ke_width.shape[:-1], n))
    E, F = (np.array([light.irradiance_at_1m for light in lights]) for lights in (before, after))
    s = ke_width @ E.T
    return np.asarray(s @ np.linalg.pinv(F, rcond=1e-9).T)


def excites_alike(optics: Optics, before: Sequence[Light], after: Sequence[Light], n: int) -> bool:
    """Whether `n` bands are enough for every lamp to excite as before."""
    if not before:
        return True
    E, F = (np.array([light.irradiance_at_1m for light in lights]) for lights in (before, after))
    s = optics.ke_width @ E.T
    again = _same_excitation(optics.ke_width, before, after, n) @ F.T
    return bool(np.abs(again - s).max(initial=0.0) <= SAME_EXCITATION * np.abs(s).max(initial=0.0))


def _fewer_bands(values: NDArray[np.floating], source: Bands, target: Bands) -> NDArray[np.floating]:
    if source == target:
        return values
    weight = _weights(source, target).astype(np.float32)
    return np.asarray(values.astype(np.float32) @ weight, dtype=values.dtype)


@lru_cache(maxsize=8)
def _weights(source: Bands, target: Bands) -> Array:
    """Return (K, K') the share of each source band in the mean of each target band."""
    return np.asarray((overlap_nm(source, target) / target.widths_nm[:, None]).T)


def whole(scene: Scene) -> Choices:
    """Return the choices that leave nothing out but glow's way to other surfaces."""
    surfaces = {}
    for drawable in scene.phosphors:
        assert drawable.phosphor is not None
        n = drawable.phosphor.optics.n_states
        surfaces[drawable.name] = Surface(True, tuple((i,) for i in range(n)), drawable.phosphor.atlas_texels)
    return Choices(
        bands_nm=tuple(scene.transport.edges_nm.tolist()),
        surfaces=surfaces,
        solver="exact" if scene.schedule.piecewise_constant else "exact2",
        step_s=1 / 60,
        state_format="f32",
        gi={"method": NONE},
    )
