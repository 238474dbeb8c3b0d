"""What a bound on the model does not cover, said beside it: how well the material itself is known, and for how long."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from phoslab.colorimetry import xyz_matrix
from phoslab.material import Material
from phoslab.model_plan import Choices
from phoslab.render.planning.pilot import Pilot, Sampled


def notes(pilot: Pilot, choices: Choices) -> tuple[str, ...]:
    """Return what to know of a plan besides its bound."""
    glowing = [
        (pilot.scene.drawables[k].name, sampled)
        for k, sampled in pilot.sampled.items()
        if choices.surfaces[pilot.scene.drawables[k].name].glows
    ]
    return (*_known(pilot, glowing), *_beyond(pilot, glowing))


Glowing = Sequence[tuple[str, Sampled]]


def _known(pilot: Pilot, glowing: Glowing) -> Iterator[str]:
    """Say how well the material of each surface that glows is known, at the moment at which that is worst."""
    known, unknown = [], []
    for name, sampled in glowing:
        errors = [e for t in range(len(pilot.moments)) if (e := glow_error(pilot, sampled, t)) is not None]
        if errors:
            known.append(f"{_of(name, sampled)} to {max(errors):.1%}")
        else:
            unknown.append(_of(name, sampled))
    if known:
        yield (
            f"how bright the materials themselves are is known, as one standard error, of {', '.join(known)}: "
            "to model them better gains nothing"
        )
    if unknown:
        yield f"how well the materials themselves are known is not stated (no standard errors) of {', '.join(unknown)}"


def _beyond(pilot: Pilot, glowing: Glowing) -> Iterator[str]:
    """Say which surfaces are asked for later than the data of their materials support."""
    dark = [d for t in pilot.moments if (d := pilot.scene.schedule.dark_for_s(float(t))) is not None]
    late = [
        f"{_of(name, sampled)} {valid[1]:g} s"
        for name, sampled in glowing
        if (valid := sampled.phosphor.material.valid_s) is not None and dark and max(dark) > valid[1]
    ]
    if late:
        yield (
            f"{max(dark):g} s after the light is later than the data of some materials support: {', '.join(late)}; "
            "from then on the bound holds for the model, not for the material"
        )


def _of(name: str, sampled: Sampled) -> str:
    return f"{name} ({sampled.phosphor.material.name})"


def glow_error(pilot: Pilot, sampled: Sampled, t: int) -> float | None:
    """Return the relative standard error of a surface's luminance at the moment of number `t`; None: not stated.

    Two errors, independent of each other: of the emission of each state, unless it is known only as a product with how
    it charges; and of the rates at which it has faded since the lamps went off, from their covariance.
    """
    material = sampled.phosphor.material
    stated = material.standard_error or {}
    errors = np.asarray(stated.get("emission", ()), dtype=np.float64)
    if errors.shape != material.emission.shape:
        return None
    Y = xyz_matrix(material.bands)[:, 1]
    given = material.emission @ Y
    light = material.kr_per_s * given * sampled.r[t].mean(axis=0)
    if light.sum() <= 0:
        return None
    share = light / light.sum()
    emission = np.sqrt(np.nansum((errors * Y) ** 2, axis=1)) / np.maximum(given, 1e-300)
    products = material.provenance.get("product_only")
    if isinstance(products, list):
        emission[[i for i in range(len(emission)) if i in products]] = 0.0
    dark_s = pilot.scene.schedule.dark_for_s(float(pilot.moments[t])) or 0.0
    faded = share * material.kr_per_s * dark_s
    return float(np.sqrt(((share * emission) ** 2).sum() + faded @ _log_rates(material) @ faded))


def _log_rates(material: Material) -> NDArray[np.float64]:
    """Return (n_c, n_c) the covariance of the logarithms of a material's rates; 0 if it is not stated."""
    n = len(material.kr_per_s)
    stated = material.covariance or {}
    names = [f"log kr_per_s[{i}]" for i in range(n)]
    if not set(names) <= set(stated.get("parameters", ())):
        return np.zeros((n, n))
    at = [stated["parameters"].index(name) for name in names]
    return np.asarray(stated["matrix"], dtype=np.float64)[np.ix_(at, at)]


def recharging(pilot: Pilot) -> float:
    """Return what no state's excitation over kr exceeds under the brightest glow from all around."""
    if not pilot.sampled:
        return 0.0
    brightest = np.zeros(pilot.scene.transport.n)
    for s in pilot.sampled.values():
        brightest = np.maximum(brightest, np.einsum("nc,nck->nk", s.kr, s.emission).max(axis=0))
    ratios = [
        (s.ke_width.max(axis=0) @ (np.pi * brightest) / np.maximum(s.kr.min(axis=0), 1e-300)).max()
        for s in pilot.sampled.values()
    ]
    return float(max(ratios))
