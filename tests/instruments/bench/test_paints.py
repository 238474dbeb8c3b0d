"""Samples with a preset's colours and time scale."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phoslab.errors import PhoslabError
from phoslab.instruments.bench.film import Film
from phoslab.instruments.bench.lights import halogen
from phoslab.instruments.bench.paints import DIMNESS, paint, smooth
from phoslab.presets import preset

NM = np.arange(360.0, 761.0)
MEASURED = ("blue", "green", "orange", "pink", "purple", "red", "white", "yellow")


@given(st.lists(st.just(0.0) | st.floats(1e-6, 100), min_size=2, max_size=12))
def test_a_smooth_spectrum_has_the_band_means_that_it_was_made_of(means: list[float]) -> None:
    edges = tuple(400.0 + 25.0 * k for k in range(len(means) + 1))
    spectrum = smooth(edges, tuple(means))
    for k, mean in enumerate(means):
        nm = edges[k] + (np.arange(500) + 0.5) * 0.05
        values = spectrum(nm)
        assert (values >= 0).all()
        # The midpoint rule on a parabola: its second derivative is at most 12 (mean / width²) at either side.
        assert values.mean() == pytest.approx(mean, abs=1e-6 + 1e-5 * max(means))


@pytest.mark.parametrize("name", MEASURED)
def test_a_paint_has_the_presets_colour(name: str) -> None:
    sample, material = paint(name), preset(name)
    for k, (low, high) in enumerate(
        zip(material.bands.edges_nm[:-1], material.bands.edges_nm[1:], strict=True)
    ):
        nm = low + (np.arange(1000) + 0.5) / 1000 * (high - low)
        assert sample.emission(nm).mean() * DIMNESS == pytest.approx(
            material.emission[0, k], rel=1e-3, abs=1e-4
        )
        if k:  # below 437.5 nm excitation goes on into the violet as it is there
            relative = material.ke_m2_per_J[0, k] / material.ke_m2_per_J.max()
            assert sample.excitation(nm).mean() == pytest.approx(relative, rel=1e-3, abs=1e-4)


@pytest.mark.parametrize("name", MEASURED)
def test_a_paint_lasts_as_long_as_the_preset_but_is_no_exponential(name: str) -> None:
    """1/e after 1/kr to within a factor of two in time, a tail that no exponential has, and a lamp that fills it."""
    sample, kr = paint(name), float(preset(name).kr_per_s[0])
    full = sample.excitation_per_s * (sample.excitation(NM) * halogen(3000.0)(NM)).sum() / 400.0
    charged, _ = Film.dark(sample).advance(5400.0, lambda _: np.array([full]))
    light = [float(charged.advance(x / kr)[0].light(21.0)[0]) for x in (1e-6, 0.5, 2.0, 10.0)]
    fresh, early, late, tail = np.array(light) / light[0]
    assert early > np.exp(-1) > late
    assert tail > 20 * np.exp(-10)
    assert 0.4 < charged.state.sum() < 0.95
    assert fresh == 1.0


@pytest.mark.parametrize("name", ["stickers", "no-such-paint"])
def test_what_was_not_measured_cannot_be_simulated(name: str) -> None:
    with pytest.raises(PhoslabError, match=f"'{name}' is no sample.*blue, green"):
        paint(name)
