"""From bands to what a display shows, and from RGB to bands: the only two places where colour is not spectral."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phoslab.bands import Bands
from phoslab.spectra import band_means

Array = NDArray[np.float64]

# Luminous efficacy of the photopic observer: 683.002 lm/W (CIE 18:2019), from the definition of the candela.
EFFICACY_LM_PER_W = 683.002


@cache
def xyz_matrix(bands: Bands) -> Array:
    """Return (n_λ, 3): `radiance @ matrix` is CIE 1931 XYZ, Y in cd/m² for radiance in W m⁻² sr⁻¹ nm⁻¹.

    The 2° colour matching functions of colour-science, integrated over each band.
    """
    import colour

    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    nm, values = np.asarray(cmfs.wavelengths, float), np.asarray(cmfs.values, float)
    means = band_means(
        lambda at: np.stack([np.interp(at, nm, v, left=0.0, right=0.0) for v in values.T]), bands
    )
    matrix: Array = EFFICACY_LM_PER_W * (means * bands.widths_nm).T
    return matrix


@cache
def xyz_to_linear_srgb() -> Array:
    """Return (3, 3): `xyz @ matrix` is linear sRGB (IEC 61966-2-1)."""
    import colour

    return np.asarray(colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB, float).T


def display_srgb(xyz: ArrayLike, exposure: float) -> Array:
    """Return (..., 3) sRGB in [0, 1] as a display takes it.

    Args:
        xyz: (..., 3) CIE XYZ.
        exposure: the factor that brings Y to display white, 1 / (cd/m²).

    Colours outside the display's gamut are moved towards grey of the same luminance until they fit, so that
    a saturated glow keeps its hue instead of clipping channel by channel.
    """
    from colour.models import eotf_inverse_sRGB

    rgb = np.asarray(xyz, dtype=np.float64) @ xyz_to_linear_srgb() * exposure
    grey = np.clip(np.asarray(xyz, dtype=np.float64)[..., 1:2] * exposure, 0.0, 1.0)
    low, high = rgb.min(axis=-1, keepdims=True), rgb.max(axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        keep = np.fmin(
            np.where(low < 0, grey / (grey - low), 1.0), np.where(high > 1, (1 - grey) / (high - grey), 1.0)
        )
    return np.asarray(eotf_inverse_sRGB(np.clip(grey + np.clip(keep, 0, 1) * (rgb - grey), 0.0, 1.0)))


def display_bytes(xyz: NDArray[np.float32], exposure: float) -> NDArray[np.uint8]:
    """Return `display_srgb` of (..., 3) XYZ in 256 steps, a tenth of a step off at most before it is rounded.

    In float32 and with the display's curve from a table: a film has no time for powers.
    """
    x, y, z = (xyz[..., k] * np.float32(exposure) for k in range(3))
    m = xyz_to_linear_srgb().astype(np.float32)
    r, g, b = (x * m[0, k] + y * m[1, k] + z * m[2, k] for k in range(3))
    grey = np.clip(y, 0.0, 1.0)
    low, high = np.minimum(np.minimum(r, g), b), np.maximum(np.maximum(r, g), b)
    keep = np.ones_like(grey)
    np.divide(grey, grey - low, out=keep, where=low < 0)
    bright = high > 1
    if bright.any():
        keep = np.minimum(keep, np.divide(1 - grey, high - grey, out=np.ones_like(grey), where=bright))
    shown = np.empty(xyz.shape, np.uint8)
    table = _display_table()
    for k, channel in enumerate((r, g, b)):
        linear = np.clip(grey + keep * (channel - grey), 0.0, 1.0)
        shown[..., k] = table[(linear * _LAST + np.float32(0.5)).astype(np.uint16)]
    return shown


_LAST = np.float32(65535)


@cache
def _display_table() -> NDArray[np.uint8]:
    """The display's curve at 65,536 values of light: where it is steepest, in the dark, 20 of them make a step."""
    from colour.models import eotf_inverse_sRGB

    return np.asarray(np.round(eotf_inverse_sRGB(np.linspace(0.0, 1.0, 65536)) * 255), dtype=np.uint8)


@cache
def _reflectance_basis(bands: Bands) -> Array:
    import colour

    basis = colour.recovery.MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019
    nm, values = np.asarray(basis.wavelengths, float), np.asarray(basis.values, float)
    # Beyond the basis' own range its end values go on: a white surface stays white.
    return band_means(lambda at: np.stack([np.interp(at, nm, v) for v in values.T]), bands)


def reflectance_from_rgb(rgb: ArrayLike, bands: Bands) -> Array:
    """Return (..., n_λ) reflectances in [0, 1] for (..., 3) linear sRGB in [0, 1].

    The named place where RGB becomes bands: the basis of Mallett and Yuksel 2019, by colour-science, whose
    three spectra are non-negative and sum to 1, so that white is 1 in every band.
    """
    reflectance: Array = np.clip(np.asarray(rgb, dtype=np.float64), 0, 1) @ _reflectance_basis(bands)
    return np.clip(reflectance, 0.0, 1.0)
