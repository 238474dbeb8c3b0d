"""A material in the scene's bands and units: what the shaders take.

K-vectors travel as ceil(K / 4) RGBA layers. Re-binning is exact both ways: with the scene's irradiance constant
in each transport band, `ke_width @ E` is the excitation that the material's own bands would give, and the
emission keeps its integral over every transport band.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phoslab.bands import Bands, rebin
from phoslab.errors import PhoslabError
from phoslab.maps import load_maps
from phoslab.material import Material

Array = NDArray[np.float64]
Texels = NDArray[np.float32] | NDArray[np.float16]

# What the shaders' float32 holds with all products of it: beyond, a picture would be of infinities.
LARGEST_KR_PER_S = 1e6
LARGEST_KE_M2_PER_J = 1e3
LARGEST_PRODUCT = 1e15


def layer_count(n_bands: int) -> int:
    """Return how many RGBA layers hold `n_bands` values."""
    return -(-n_bands // 4)


def to_layers(values: ArrayLike) -> Texels:
    """Return (layers, h, w, 4) of (h, w, K): the layout of every spectral array texture, padded with 0.

    float16 stays; all else becomes float32.
    """
    texels = np.asarray(values)
    texels = texels if texels.dtype == np.float16 else texels.astype(np.float32, copy=False)
    h, w, n = texels.shape
    padded = texels
    if n % 4:
        padded = np.zeros((h, w, 4 * layer_count(n)), dtype=texels.dtype)
        padded[..., :n] = texels
    return np.ascontiguousarray(padded.reshape(h, w, -1, 4).transpose(2, 0, 1, 3))


@dataclass(frozen=True, eq=False)
class Optics:
    """One material's fields over its texture space, in K transport bands and the scene's units.

    Every field is (h, w, ...) with h = w = 1 where it does not vary.

    Args:
        kr_per_s: (h, w, n_c) re-radiation rates.
        ke_width: (h, w, n_c, K) ke_ik Δλ_k times the scene's irradiance unit in the material's: 1/s per unit
            of scene irradiance.
        emission: (h, w, n_c, K) Λ in scene radiance times s.
        albedo: (h, w, K), or None for the scene's reflectance.
        n_states: n_c.
    """

    kr_per_s: Array
    ke_width: Array
    emission: Array
    albedo: Array | None
    n_states: int

    @property
    def uniform_kr(self) -> Array | None:
        """(n_c,) the rates in float64 where no map varies them."""
        return self.kr_per_s[0, 0] if self.kr_per_s.shape[:2] == (1, 1) else None


def load_optics(
    material: Material, transport: Bands, irradiance_factor: float, radiance_factor: float
) -> Optics:
    """Bring a material and its maps into the transport bands and the scene's units.

    Args:
        transport: the scene's K bands.
        irradiance_factor: the material's irradiance units in one of the scene's.
        radiance_factor: the scene's radiance units in one of the material's.

    Raises:
        PhoslabError: a map is missing or malformed, or a value is beyond what float32 holds in all products.
    """
    maps = load_maps(material)

    def field(name: str) -> Array | None:
        value = maps.get(name)
        if value is not None:
            return value.astype(np.float64)
        plain = getattr(material, name)
        return None if plain is None else np.asarray(plain)[None, None]

    kr, ke, emission, albedo = map(field, ("kr_per_s", "ke_m2_per_J", "emission", "albedo"))
    assert kr is not None
    assert ke is not None
    assert emission is not None
    for name, values, largest in (
        ("kr_per_s", kr, LARGEST_KR_PER_S),
        ("ke_m2_per_J", ke, LARGEST_KE_M2_PER_J),
    ):
        _check_range(name, values, largest, "Use a unit in which it is smaller.")
    _check_range("ke_m2_per_J", ke, LARGEST_PRODUCT / irradiance_factor, "Lower irradiance_factor.")
    _check_range(
        "emission", emission, LARGEST_PRODUCT / radiance_factor, "Lower radiance_factor, or emission."
    )
    # A band that was never measured has no light in it: the scene's loader has checked that.
    ke_bands = rebin(np.nan_to_num(ke), material.bands, transport)
    return Optics(
        kr_per_s=kr,
        ke_width=ke_bands * transport.widths_nm * irradiance_factor,
        emission=rebin(emission, material.bands, transport) * radiance_factor,
        albedo=None if albedo is None else rebin(albedo, material.bands, transport),
        n_states=material.n_states,
    )


def _check_range(name: str, values: Array, largest: float, remedy: str) -> None:
    """Refuse a field with a value above `largest`; NaN, what was never measured, is none."""
    top = float(np.max(values, initial=0.0, where=~np.isnan(values)))
    if top > largest:
        raise PhoslabError(
            f"reaches {top:.3g}, and the renderer holds {largest:.3g} here", field=name, remedy=remedy
        )
