"""The same glow at any frame rate, over hours, and over nine decades."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import OpenEXR
import pytest

import phoslab
from phoslab import kinetics, solvers
from phoslab.programmes import Sine, mean
from phoslab.render import load_scene, render
from phoslab.render.bare_state import BareState
from phoslab.render.images import band_channels
from phoslab.render.phosphor_state import Stepping
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.render.state_formats import FORMATS
from phoslab.solvers import Drive

U = 2.0**-24
UNEVEN = np.cumsum(np.random.default_rng(0).uniform(0.002, 0.09, 200))
RHYTHMS = {
    "24 Hz": np.arange(1, 120) / 24,
    "60 Hz": np.arange(1, 300) / 60,
    "144 Hz": np.arange(1, 720) / 144,
}
RHYTHMS["uneven"] = UNEVEN[UNEVEN < 5]
END_S = 5.0


@pytest.fixture
def glow_after(quad, device, lamp_toml, green_toml):
    """(64, 64, 1) the state at `END_S`, after pictures at the times of a rhythm."""
    quad.lamp((0, 0, 1))

    def run(light: str, times: np.ndarray, **stepping) -> np.ndarray:
        quad.toml = (
            quad.toml.split("[units]")[0] + lamp_toml.replace("schedule = [[0, 10]]", light) + green_toml
        )
        parameters = RenderParameters((4, 4), 1, stepping=Stepping(**stepping))
        renderer = Renderer(device, load_scene(quad.write()), parameters)
        for t in [*times, END_S]:
            renderer.bring_states_to(t)
        return renderer.states[0].shown.read()

    return run


def test_switched_light_gives_the_same_glow_at_any_frame_rate_bit_by_bit(glow_after):
    """Pictures never move the anchor: only the light's changes do."""
    light = "schedule = [[0.4, 1.7], [2.0, 3.1]]"
    states = [glow_after(light, times) for times in ([], *RHYTHMS.values())]
    assert states[0].min() > 0.05
    for state in states[1:]:
        assert (state == states[0]).all()


def test_varying_light_gives_the_same_glow_at_any_frame_rate(glow_after):
    """The steps are the renderer's, not the pictures': the times of 300 of them round in float64, the rest is equal."""
    light = 'schedule = [[0, 10]]\nprogramme = {kind = "sine", period_s = 4.0}'
    states = [glow_after(light, times, solver="exact2") for times in ([], *RHYTHMS.values())]
    assert states[0].min() > 0.05
    for state in states[1:]:
        # Where a step's length rounds to another float32, that step differs by U of its increment.
        np.testing.assert_allclose(state, states[0], rtol=2 * U)


@pytest.mark.parametrize("name", RHYTHMS)
def test_steps_of_any_frame_rate_stay_within_the_stated_error_in_varying_light(device, name):
    """exact2 over 5 s of a full-depth sine, a step a frame.

    In a step light strays from its mean by δ(t) = a' (t - dt/2), which acts on 1 - r, whose slope is at most k. What
    ∫ δ (1 - r) leaves is a' k dt³ / 12; with |a'| <= 2π a / period and Σ dt = 5 s, below (2π / 4) a k dt² 5 / 12.
    Float32 adds (2 + 16 dt k) U a step.
    """
    light, kr, a = Sine(4.0), np.array([0.25, 0.0078125]), np.array([0.5, 0.125])
    state = BareState(device, kr, np.full((1, 1, 2), a), "exact2")
    times = np.array([0.0, *RHYTHMS[name], END_S])
    for begin, end in pairwise(times):
        state.advance(end - begin, Drive(lambda s: light.at(0), lambda b=begin, e=end: mean(light, b, e)))
    truth = solvers.SOLVERS["dop853"](np.zeros(2), Drive(lambda s: a * light.at(5 * s)), kr, np.array(5.0))
    dt, k = np.diff(times).max(), 2 * a + kr
    bound = np.pi / 2 * a * k * dt**2 * 5 / 12 + len(times) * (2 + 16 * dt * k) * U
    assert (np.abs(state.read()[0, 0] - truth) <= bound).all()


def test_default_solver_and_format_keep_their_error_budget_over_hours(device):
    """At most 1e-6, relative, for each change of light and 1e-6 an hour while k t <= 5; 1e-6 of saturation beyond.

    A step gives 16 U = 0.95e-6 of what it adds (see test_phosphor_step), relative to r as r e and r_inf (1 - e) only
    add; in shadow (2 k t + 6) U, the same at k t = 5. Nothing else is rounded: hours cost nothing.
    """
    rng = np.random.default_rng(4)
    kr = np.array([2.0**-12, 2.0**-5])
    a = 10.0 ** rng.uniform(-6, -1, (16, 16, 2))
    a[0] = 0.0
    a = a.astype("f4").astype("f8")
    state = BareState(device, kr, a, r0=1.0)
    want, changes, hours = np.ones_like(a), 0, 0.0
    for dt, factor in (
        (30.0, 1.0),
        (600.0, 0.0),
        (45.5, 1.0),
        (3600.0, 1.0),
        (7200.0, 0.0),
        (0.25, 1.0),
        (1.5, 0.0),
    ):
        state.advance(dt, Drive.constant(np.array(factor)))
        want = solvers.exact_step(want, factor * a, kr, np.array(dt))
        changes, hours = changes + 1, hours + dt / 3600
        error = np.abs(state.read() - want)
        assert error.max() <= 1e-6 * changes
        early = want > np.exp(-5)
        assert (error[early] <= 1e-6 * (changes + hours) * want[early]).all()


@pytest.mark.parametrize("state_format", FORMATS)
def test_radiance_fades_over_nine_decades_into_the_exr(quad, lamp_toml, green_toml, tmp_path, state_format):
    """A saturated quad in the dark: the last picture is 1e9 times darker, and right to the same few roundings.

    Also where the state is kept in 16 bits: they hold the anchor, and the picture is evaluated in float32.
    """
    toml = lamp_toml.replace("[[0, 10]]", "[[200, 201]]") + green_toml + '\n[initial]\nstate = "saturated"\n'
    green = phoslab.preset("green")
    times = [decade * np.log(10) / green.kr_per_s[0] for decade in range(10)]
    frames = render(load_scene(quad.lamp().text(toml).write()), times, size=(4, 4), state_format=state_format)
    files = frames.write(tmp_path / "glow.exr")
    names = band_channels(frames[0].bands)
    for file, t in zip(files, times, strict=True):
        with OpenEXR.File(str(file), separate_channels=True) as exr:
            L = np.stack([np.asarray(exr.channels()[name].pixels) for name in names], axis=-1)
        want = 0.5 * kinetics.emitted_radiance(green, kinetics.decay(green, np.ones(1), np.array(t)))
        np.testing.assert_allclose(L, np.broadcast_to(want, L.shape), rtol=64 * U)
    assert want.max() < 1.01e-9 * 0.5 * kinetics.emitted_radiance(green, [1.0]).max()


@pytest.mark.parametrize("state_format", FORMATS)
def test_a_scene_keeps_its_state_in_any_format(glow_after, state_format):
    """Four changes of light, each rounded to the format once: half a last place each, which later ones only shrink."""
    light = "schedule = [[0.4, 1.7], [2.0, 3.1]]"
    place = {"f16": 2.0**-12, "unorm16": 0.5 / 65535}.get(state_format, 16 * U)
    error = np.abs(glow_after(light, [], state_format=state_format) - glow_after(light, []))
    assert error.max() <= 4 * place + 16 * U


def test_an_unknown_format_is_refused(quad, lamp_toml, green_toml, refuses):
    path = quad.lamp().text(lamp_toml + green_toml).write()
    assert "Use one of: f32, f16, unorm16, f32c" in refuses(render, path, ["0"], state_format="u8")
