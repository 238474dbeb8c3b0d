"""The fewest bands: adjoining ones are merged while no colour in the scene changes by more than is allowed.

A picture is a sum of sources, each with a weight that is never negative: a lamp reflected by a surface, a state's
emission as it is, reflected once, reflected twice. What fewer bands do to each is one difference in XYZ, so what they
do to the picture, |Σ w d| over Σ w s, is at most the largest |d| over s of any source. That is a bound, whatever the
weights. Lamp light and glow are held apart, since their shares of a picture are known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.bands import Bands, rebin
from phoslab.colorimetry import xyz_matrix
from phoslab.render.planning.pilot import Pilot
from phoslab.render.planning.reduced import excites_alike
from phoslab.render.scene import Light, Scene

Array = NDArray[np.float64]

# Of a texture, so many texels stand for all.
TEXELS = 16


@dataclass(frozen=True, eq=False)
class Sources:
    """Spectra in the scene's bands: lamps (n, K), emissions (m, K), reflectances (p, K) of what is seen."""

    lamps: Array
    emissions: Array
    reflectances: Array

    @classmethod
    def of(cls, scene: Scene, pilot: Pilot) -> Sources:
        """Collect them."""
        K = scene.transport.n
        reflectances = [np.zeros((1, K))]
        for k, drawable in enumerate(scene.drawables):
            texels = np.asarray(drawable.reflectance, dtype=np.float64).reshape(-1, K)
            step = max(1, len(texels) // TEXELS)
            if pilot.visible[k] > 0 or pilot.bounces.any():
                reflectances.append(texels[::step][:TEXELS])
        emissions = [np.zeros((1, K))]
        for sampled in pilot.sampled.values():
            optics = sampled.phosphor.optics
            given = (optics.emission * optics.kr_per_s[..., None]).reshape(-1, optics.n_states, K)
            emissions.append(given[:: max(1, len(given) // TEXELS)][:TEXELS].reshape(-1, K))
        lamps = [np.zeros((1, K)), *(light.irradiance_at_1m[None] for light in scene.lights)]
        return cls(*(_distinct(np.concatenate(x)) for x in (lamps, emissions, reflectances)))


def _distinct(spectra: Array) -> Array:
    return np.unique(spectra.astype(np.float32), axis=0).astype(np.float64)


def errors(sources: Sources, source: Bands, target: Bands) -> Array:
    """Return (4,) the largest relative error in XYZ: of lamp light, and of glow after 0, 1, 2 reflections."""
    fine, coarse = xyz_matrix(source), xyz_matrix(target)
    rho, rho_c = sources.reflectances, rebin(sources.reflectances, source, target)
    e, e_c = sources.emissions, rebin(sources.emissions, source, target)
    lamp, lamp_c = sources.lamps, rebin(sources.lamps, source, target)

    def times(a: Array, b: Array) -> Array:
        return (a[:, None] * b[None]).reshape(-1, a.shape[-1])

    pairs = (
        (times(lamp, rho), times(lamp_c, rho_c)),
        (e, e_c),
        (times(e, rho), times(e_c, rho_c)),
        (times(e, times(rho, rho)), times(e_c, times(rho_c, rho_c))),
    )
    return np.array([_largest(a @ fine, b @ coarse) for a, b in pairs])


def _largest(exact: Array, merged: Array) -> float:
    total = exact.sum(axis=-1)
    seen = total > 1e-9 * total.max(initial=0.0)
    if not seen.any():
        return 0.0
    return float((np.abs(merged - exact).sum(axis=-1)[seen] / total[seen]).max())


def changed_share(each: Array, pilot: Pilot) -> Array:
    """Return (T, P) the largest share by which each pixel's light may change, of `errors`."""
    lamp, glow, first = (
        (part @ pilot.to_xyz).sum(axis=-1) for part in (pilot.lamp, pilot.glow, pilot.bounces[0])
    )
    further = pilot.total - lamp - glow - first
    return pilot.share(lamp * each[0] + glow * each[1] + first * each[2] + further * each[3])


def picture_error(each: Array, pilot: Pilot) -> float:
    """Return the bound on a picture's relative error, of `errors` and the shares of light; the worst of the moments."""
    lamp, glow, bounces = pilot.means()
    total = lamp + glow + bounces.sum(axis=0)
    mixed = lamp * each[0] + glow * each[1] + bounces[0] * each[2] + bounces[1:].sum(axis=0) * each[3]
    return float(np.divide(mixed, total, out=np.zeros_like(total), where=total > 0).max(initial=0.0))


def fewest_bands(scene: Scene, pilot: Pilot) -> dict[int, tuple[Bands, Array]]:
    """Return, by the number of bands, the best found and its `errors`: two adjoining ones are merged at a time."""
    sources = Sources.of(scene, pilot)
    found = {scene.transport.n: (scene.transport, np.zeros(4))}
    edges = scene.transport.edges_nm
    while edges.size > 2:
        tries = []
        for k in range(1, edges.size - 1):
            bands = Bands(np.delete(edges, k))
            if _charges_alike(scene, bands):
                off = errors(sources, scene.transport, bands)
                tries.append((picture_error(off, pilot), k, off))
        if not tries:
            break
        _, k, off = min(tries, key=lambda tried: tried[:2])
        edges = np.delete(edges, k)
        found[edges.size - 1] = Bands(edges), off
    return found


def _charges_alike(scene: Scene, bands: Bands) -> bool:
    after = [Light(x.place, rebin(x.irradiance_at_1m, scene.transport, bands)) for x in scene.lights]
    return all(
        excites_alike(d.phosphor.optics, scene.lights, after, bands.n)
        for d in scene.phosphors
        if d.phosphor is not None
    )
