"""Named spectra and spectrum files."""

from itertools import pairwise

import numpy as np
import pytest

from phoslab import spectra
from phoslab.bands import Bands
from phoslab.errors import PhoslabError

BANDS = Bands.uniform()


def named(name, tmp_path):
    return spectra.shape(
        name, BANDS, folder=tmp_path, file=tmp_path / "scene.toml", field="lights.A.spectrum"
    )


def test_a_blackbody_follows_planck(tmp_path):
    from scipy.integrate import quad

    E = named("blackbody:3000", tmp_path)
    c2 = 0.014388e9  # hc/k in nm K, as colour-science has it (ITS-90); the SI's own value is 1.6e-5 smaller
    edges = BANDS.edges_nm
    planck = np.array(
        [quad(lambda nm: nm**-5.0 / np.expm1(c2 / (nm * 3000)), a, b)[0] for a, b in pairwise(edges)]
    )
    # The midpoint rule errs by h²/24 f''/f: h = 0.5 nm and f''/f < 2e-3 / nm² at 400 nm.
    assert E / E[-1] == pytest.approx(planck / planck[-1], rel=2.1e-5)


def test_a_line_keeps_its_integral_over_the_bands(tmp_path):
    # Area of a Gaussian of full width at half maximum w: w sqrt(pi / (4 ln 2)); tails beyond 400..700 nm are 0.
    area = 20 * np.sqrt(np.pi / (4 * np.log(2)))
    assert named("line:550,20", tmp_path) @ BANDS.widths_nm == pytest.approx(area, rel=1e-6)


def test_a_csv_file_is_interpolated_and_zero_outside(tmp_path):
    (tmp_path / "led.csv").write_text("wavelength_nm,value\n450,1\n500,1\n")
    E = named("led.csv", tmp_path)
    assert E @ BANDS.widths_nm == pytest.approx(50, rel=0.02)
    assert E[4:] == pytest.approx(np.zeros(4))


@pytest.mark.parametrize(
    "bad",
    [
        "candle",
        "blackbody:hot",
        "blackbody:-3",
        "line:500",
        "illuminant:Q",
        "../x.csv",
        "/etc/x.csv",
        "none.csv",
    ],
)
def test_an_unknown_spectrum_is_refused_with_its_name(tmp_path, bad):
    with pytest.raises(PhoslabError, match=bad.replace("/", ".").split(":")[0]):
        named(bad, tmp_path)


@pytest.mark.parametrize(
    "text", ["500,1\n450,1\n", "450,1\n500,-1\n", "450,1\n", "450,nan\n500,1\n", "450,a\n"]
)
def test_a_malformed_spectrum_file_is_refused(tmp_path, text):
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(PhoslabError, match=r"bad\.csv"):
        named("bad.csv", tmp_path)


def test_camera_response_is_linear_and_sees_green_light_as_green():
    glow = spectra.shape("line:525,40", BANDS, file=None, field="test")
    rgb = spectra.camera_response(glow, BANDS, "Nikon 5100 (NPL)")
    assert np.argmax(rgb) == 1
    assert spectra.camera_response(3 * glow, BANDS, "Nikon 5100 (NPL)") == pytest.approx(3 * rgb)


def test_an_unknown_camera_names_the_known_ones():
    with pytest.raises(PhoslabError, match=r"Box Brownie.*Nikon"):
        spectra.camera_response(np.ones(8), BANDS, "Box Brownie")
