"""State formats: their size, their rounding, and what they keep of the smallest increments."""

from __future__ import annotations

import numpy as np
import pytest

from phoslab import solvers
from phoslab.render.bare_state import STEADY, BareState
from phoslab.render.state_formats import FORMATS, StateTexture
from phoslab.solvers import Drive

U = 2.0**-24
DARK = Drive.constant(np.array(0.0))

# Bytes a texel of 1, 2, 3 and 4 states: as docs and `FORMATS` say.
BYTES = {"f32": (4, 8, 16, 16), "f16": (2, 4, 8, 8), "unorm16": (2, 4, 8, 8), "f32c": (8, 16, 32, 32)}


def rounded(r: np.ndarray, state_format: str) -> np.ndarray:
    """What a format makes of numbers in [0, 1], to nearest, ties to even."""
    if state_format == "unorm16":
        return (np.rint(r * 65535) / 65535).astype("f4").astype("f8")
    return r if state_format == "f32c" else r.astype(FORMATS[state_format].dtype).astype("f8")


@pytest.mark.parametrize("state_format", FORMATS)
@pytest.mark.parametrize("n_states", [1, 2, 3, 4])
def test_bytes_per_texel_are_what_is_allocated(device, state_format, n_states):
    state = StateTexture(device, (5, 3), n_states, state_format)
    allocated = sum(len(t.read()) for t in (state.value, state.low) if t is not None)
    said = FORMATS[state_format].bytes_per_texel(n_states)
    assert said == BYTES[state_format][n_states - 1]
    assert allocated == said * 15


@pytest.mark.parametrize("state_format", FORMATS)
def test_what_is_written_is_read_back_to_the_nearest(device, state_format):
    r = np.random.default_rng(0).uniform(0, 1, (7, 9, 3)) * 10.0 ** -np.arange(7)[:, None, None]
    state = StateTexture(device, (9, 7), 3, state_format)
    state.write(r)
    # The compensated format keeps 48 bits.
    np.testing.assert_allclose(state.read(), rounded(r, state_format), rtol=2.0**-47, atol=0)


@pytest.mark.parametrize("state_format", ["f16", "unorm16"])
def test_a_step_rounds_to_the_nearest_number_of_the_format(device, state_format):
    """Fading texels, from 1 down to the smallest numbers of a half: each is what the float32 state rounds to."""
    r = np.geomspace(1e-8, 1, 64 * 64).reshape(64, 64, 1)
    exact = BareState(device, [0.125], np.zeros_like(r), r0=rounded(r, state_format))
    coarse = BareState(device, [0.125], np.zeros_like(r), state_format=state_format, r0=r)
    for state in (exact, coarse):
        state.advance(1.0, DARK)
    np.testing.assert_array_equal(coarse.read(), rounded(exact.read(), state_format))


def test_a_slow_material_keeps_its_glow_over_an_hour_of_display_frames(device):
    """kr = 1e-4 1/s, 216,000 steps of 1/60 s; one state fades in a lit step without light, two charge.

    Compensated, a step errs by some 16 U of its increment (see test_phosphor_step), whatever their number, and what
    is added up is below 1. Plain float32 rounds each step by up to U and a step changes the state by 1.7e-6 at most, so
    the rate may be off by U / 1.7e-6, 3.6 %: it is worse, and beyond 1e-4 in the dark.
    """
    a, r0 = np.array([[[0.0], [1e-4], [1e-3]]]), np.array([[[1.0], [0.0], [0.0]]])
    n, dt = 216_000, float(np.float32(1 / 60))
    want = solvers.exact_step(r0, a, np.array([1e-4]), np.array(n * dt))
    error = {}
    for state_format in ("f32", "f32c"):
        state = BareState(device, [1e-4], a, "exact", state_format, r0)
        state.advance_many(dt, n, STEADY)
        error[state_format] = np.abs(state.read() / want - 1).ravel()
    # 16 U of the increments; the rates themselves are rounded to float32: 2 U.
    assert error["f32c"].max() <= 18 * U
    assert error["f32"][0] > 1e-4
    assert (error["f32"] > 10 * error["f32c"]).all()


@pytest.mark.parametrize("light", [0.0, 1.0])
def test_from_the_anchor_a_slow_material_is_exact_after_an_hour_and_a_day(device, light):
    for hours in (1, 24):
        state = BareState(device, [1e-4], np.full((1, 1, 1), 1e-4), r0=0.5)
        state.advance(hours * 3600.0, Drive.constant(np.array(light)))
        want = solvers.exact_step(
            np.array([0.5]), np.array([light * 1e-4]), np.array([1e-4]), np.array(hours * 3600.0)
        )
        np.testing.assert_allclose(state.read().ravel(), want, rtol=18 * U)


def test_dark_steps_keep_their_smallest_loss_too(device):
    """The step that knows of the dark, 20,000 times, compensated: its share is float64's, rounded once."""
    state = BareState(device, [1e-4], np.zeros((1, 1, 1)), state_format="f32c", r0=1.0)
    state.advance_many(1 / 60, 20_000, DARK)
    np.testing.assert_allclose(state.read().ravel(), np.exp(-1e-4 * 20_000 / 60), rtol=2 * U)


def test_an_unknown_format_names_the_known_ones(device, refuses):
    message = refuses(BareState, device, [1.0], np.ones((2, 2, 1)), "exact", "f8")
    assert "'f8' is unknown" in message
    assert "f32, f16, unorm16, f32c" in message
