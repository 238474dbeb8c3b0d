"""Bands to colour, colour to bands, and luminance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from phoslab import spectra
from phoslab.bands import Bands
from phoslab.colorimetry import display_bytes, display_srgb, reflectance_from_rgb, xyz_matrix
from phoslab.photometry import luminance

FINE = Bands.uniform(300, 380, 780)


def white(bands: Bands, name: str = "illuminant:D65") -> np.ndarray:
    return spectra.shape(name, bands, file=None, field="test")


def test_daylight_has_the_chromaticity_of_d65():
    X, Y, Z = white(FINE) @ xyz_matrix(FINE)
    # CIE 15 gives four digits; the fourth is rounded, and moves with the interpolation of the 5 nm table.
    assert (X / (X + Y + Z), Y / (X + Y + Z)) == pytest.approx((0.3127, 0.3290), abs=1e-4)


def test_luminance_is_683_lm_per_watt_at_555_nm_by_day_and_by_night():
    at_555 = Bands(np.array([554.5, 555.5]))
    assert luminance([1.0], at_555, "photopic") == pytest.approx(683.0, rel=1e-3)
    assert luminance([1.0], at_555, "scotopic") == pytest.approx(683.0, rel=1e-2)


def test_the_dark_adapted_eye_is_most_sensitive_to_blue_green():
    bands = Bands.uniform(30, 400, 700)
    L = np.array([luminance(e, bands, "scotopic") for e in np.eye(30)])
    assert bands.centres_nm[np.argmax(L)] == pytest.approx(507, abs=5)


def test_y_and_photopic_luminance_agree():
    rng = np.random.default_rng(3)
    L = rng.uniform(size=(5, FINE.n))
    # The CIE 1931 ybar and V(lambda) of 1924 are the same function by definition, tabulated separately.
    assert (L @ xyz_matrix(FINE))[:, 1] == pytest.approx(luminance(L, FINE), rel=1e-5)


def test_white_reflects_all_in_every_band_and_colours_stay_between_0_and_1():
    bands = Bands.uniform()
    # The basis sums to 1 to the digits in which it is published.
    assert reflectance_from_rgb([1, 1, 1], bands) == pytest.approx(np.ones(8), abs=2e-5)
    rgb = np.random.default_rng(1).uniform(size=(50, 3))
    assert ((0 <= reflectance_from_rgb(rgb, bands)) & (reflectance_from_rgb(rgb, bands) <= 1)).all()


def test_a_reflectance_made_from_rgb_looks_like_that_rgb_in_daylight():
    rgb = np.array([[0.8, 0.1, 0.1], [0.2, 0.5, 0.1], [0.1, 0.2, 0.6], [0.5, 0.5, 0.5]])
    E = white(FINE)
    xyz = (reflectance_from_rgb(rgb, FINE) * E) @ xyz_matrix(FINE)
    Y_white = (E @ xyz_matrix(FINE))[1]
    shown = display_srgb(xyz, 1 / Y_white)
    encoded = np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055)
    # The basis is published in 5 nm steps and 4 digits; one step of an 8-bit display is 4e-3.
    assert shown == pytest.approx(encoded, abs=4e-3)


def test_display_keeps_hue_and_luminance_of_what_fits_and_never_leaves_the_cube():
    xyz = np.array([[0.2, 1.0, 0.05], [0.0, 0.0, 0.0], [0.9505, 1.0, 1.0891], [5.0, 20.0, 1.0]])
    shown = display_srgb(xyz, 1.0)
    assert ((shown >= 0) & (shown <= 1)).all()
    assert shown[1] == pytest.approx([0, 0, 0])
    assert shown[2] == pytest.approx([1, 1, 1], abs=1e-3)


def test_a_saturated_glow_in_gamut_range_keeps_its_luminance():
    # A 520 nm glow of luminance 0.5: outside sRGB, moved towards grey of luminance 0.5.
    bands = Bands.uniform(60, 400, 700)
    xyz = spectra.shape("line:520,20", bands, file=None, field="test") @ xyz_matrix(bands)
    shown = display_srgb(xyz * 0.5 / xyz[1], 1.0)
    linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    # Rec. 709 luminance weights of linear sRGB, to their four published digits.
    assert linear @ [0.2126, 0.7152, 0.0722] == pytest.approx(0.5, abs=1e-3)


@settings(max_examples=60, deadline=None)
@given(
    xyz=arrays(np.float32, (7, 3), elements=st.floats(0, 4, width=32)),
    exposure=st.sampled_from([1e-3, 0.5, 1.0, 30.0]),
)
def test_a_films_bytes_are_the_displays_to_a_tenth_of_a_step(xyz, exposure):
    """One of 65,536 steps of light is 1/20 of one of 256 where the curve is steepest; float32 adds less."""
    exact = display_srgb(xyz.astype(float), exposure) * 255
    assert np.abs(display_bytes(xyz, exposure) - exact).max() <= 0.5 + 0.1
