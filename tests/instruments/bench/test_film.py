"""The sample at many places: the same physics as at one, and fast."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phoslab.instruments.bench.film import TOLERANCE, Film
from phoslab.instruments.bench.paints import paint
from phoslab.instruments.bench.sample import Sample

SAMPLES = (Sample(), paint("green"), paint("red"))


@pytest.mark.parametrize("sample", SAMPLES, ids=lambda s: s.name)
def test_charge_and_decay_agree_with_a_solver_of_ten_digits(sample: Sample) -> None:
    """A step may miss by a tolerance; some hundred of them, all of one sign, by a hundred tolerances."""
    film, given_off = Film.dark(sample).advance(600.0, lambda _: np.array([0.02]))
    state, known = sample.advance(sample.empty, 600.0, lambda _: 0.02)
    bound = 100 * 5e-6  # the tolerance, as a number: a coarser one is to fail here
    np.testing.assert_allclose(film.state[0].sum(), state.sum(), rtol=bound)
    np.testing.assert_allclose(given_off, known, rtol=bound)
    for duration_s in (0.3, 5.0, 175.0):
        film, given_off = film.advance(duration_s)
        state, known = sample.advance(state, duration_s)
        np.testing.assert_allclose(film.light(sample.temperature_C), sample.light(state), rtol=bound)
        np.testing.assert_allclose(given_off, known, rtol=bound)


def test_each_place_has_its_own_light_as_if_it_were_alone() -> None:
    drives = np.array([0.0, 0.001, 0.05])
    sample = paint("green")
    together, _ = Film.dark(sample).spread(3).advance(60.0, lambda _: drives)
    for k, drive in enumerate(drives):
        alone, _ = Film.dark(sample).advance(60.0, lambda _, drive=drive: np.array([drive]))
        # Steps are common to all places, so not the same: each within its tolerance.
        np.testing.assert_allclose(together.state[k].sum(), alone.state[0].sum(), rtol=200 * TOLERANCE)


def test_a_dark_sample_stays_dark() -> None:
    film, light = Film.dark(Sample()).advance(1e5)
    assert film.state.max() < 1e-25
    assert light.max() < 1e-25


@settings(max_examples=15)  # half a second each
@given(
    drive=st.floats(0, 1e3),
    duration_s=st.floats(1e-3, 1e3),
    temperature_C=st.floats(-20, 60),
)
def test_traps_stay_between_empty_and_full(drive: float, duration_s: float, temperature_C: float) -> None:
    sample = paint("blue")
    film, light = Film.dark(sample).advance(duration_s, lambda _: np.array([drive]), lambda _: temperature_C)
    film, _ = film.advance(duration_s, None, lambda _: temperature_C)
    assert (film.state >= 0).all()
    assert (film.state <= sample.capacity).all()
    assert (light >= 0).all()


def test_warmth_makes_it_brighter_and_shorter() -> None:
    charged, _ = Film.dark(SAMPLES[1]).advance(60.0, lambda _: np.array([0.2]))
    cold, warm = (charged.advance(30.0, None, lambda _, t=t: t)[0] for t in (15.0, 35.0))
    assert charged.light(35.0) > 1.5 * charged.light(15.0)
    assert warm.state.sum() < cold.state.sum()
