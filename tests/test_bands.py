"""Bands and re-binning."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from phoslab.bands import Bands, integral_outside, merge, rebin
from phoslab.errors import PhoslabError

edges = st.lists(st.integers(300, 900), min_size=2, max_size=9, unique=True).map(lambda e: Bands(np.sort(e)))


@given(edges, edges, st.data())
def test_rebinning_keeps_the_integral(source, target, data):
    values = data.draw(arrays(float, source.n, elements=st.floats(0, 1e6)))
    kept = rebin(values, source, target) @ target.widths_nm
    lost = integral_outside(values, source, target)
    total = values @ source.widths_nm
    # A few products and sums of non-negative numbers: each rounds by half an ulp of the total, or of the
    # smallest normal number where the values are denormal.
    float64 = np.finfo(np.float64)
    assert abs(kept + lost - total) <= 40 * float64.eps * total + float64.tiny


@given(edges, edges, st.data())
def test_rebinning_into_merged_bands_loses_nothing_on_the_way_back(a, b, data):
    values = data.draw(arrays(float, a.n, elements=st.floats(0, 1e6)))
    there = rebin(values, a, merge(a, b))
    assert rebin(there, merge(a, b), a) == pytest.approx(values, rel=1e-14, abs=0)


def test_what_was_never_measured_stays_unknown_and_does_not_spread():
    source = Bands(np.array([400.0, 500.0, 600.0]))
    target = Bands(np.array([350.0, 450.0, 550.0, 650.0]))
    out = rebin([1.0, np.nan], source, target)
    assert out[0] == 0.5
    assert np.isnan(out[1:]).all()


@pytest.mark.parametrize("bad", [[400.0], [500.0, 400.0], [400.0, 400.0], [400.0, np.nan], [[400.0, 500.0]]])
def test_edges_must_ascend(bad):
    with pytest.raises(PhoslabError, match="band_edges_nm"):
        Bands(np.array(bad))
