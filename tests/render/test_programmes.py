"""Light programmes in scenes: read, refused, and stepped as the float64 solvers step them."""

from __future__ import annotations

import numpy as np
import pytest

import phoslab
from phoslab import kinetics, solvers
from phoslab.programmes import Sine, Strobe, mains_flicker, mean
from phoslab.render import load_scene, render
from phoslab.render.phosphor_state import PhosphorState, Stepping
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.render.solvers import SOLVERS

U = 2.0**-24
SINE = 'programme = {kind = "sine", period_s = 4.0, depth = 0.8}'
STROBE = 'programme = {kind = "strobe", period_s = 0.5, duty = 0.1}'


@pytest.fixture
def lit_by(quad, lamp_toml, green_toml):
    """The path of a scene: a quad under a lamp at 1 m, on from 0 to 10 s, with a programme."""

    def make(programme: str):
        quad.lamp((0, 0, 1))
        return quad.text(lamp_toml + programme + "\n" + green_toml).write()

    return make


@pytest.fixture
def state_at(device):
    """The scene and (64, 64, 1) the state on the quad, after frames at the given times."""

    def run(path, *times: float, **stepping):
        scene = load_scene(path)
        parameters = RenderParameters((8, 8), 1, stepping=Stepping(**stepping))
        renderer = Renderer(device, scene, parameters)
        for t in times:
            renderer.frame(t)
        return scene, renderer.states[0].shown.read()

    return run


def irradiance(scene) -> np.ndarray:
    """(64, 64, 8) of the lamp at factor 1 on the quad's texels."""
    centre = (np.arange(64) + 0.5) / 64 - 0.5
    x, y = np.meshgrid(centre, centre)
    return (x**2 + y**2 + 1.0)[..., None] ** -1.5 * scene.lights[0].irradiance_at_1m


def reference(scene, programme, solver: str, steps: int, duration_s: float) -> np.ndarray:
    """The float64 solver, in equal steps of a light that stays on."""
    green = phoslab.preset("green")
    a, r, dt = kinetics.excitation(green, irradiance(scene)), np.zeros((64, 64, 1)), duration_s / steps
    for k in range(steps):
        drive = solvers.Drive(
            lambda s, k=k: a * programme.at((k + s) * dt),
            lambda k=k: a * mean(programme, k * dt, (k + 1) * dt),
        )
        r = solvers.SOLVERS[solver](r, drive, green.kr_per_s, np.array(dt))
    return r


@pytest.mark.parametrize(
    ("text", "programme"),
    [
        (SINE, Sine(4.0, 0.8)),
        ('programme = {kind = "sine", period_s = 4.0}', Sine(4.0)),
        ('programme = {kind = "flicker", mains_hz = 60, depth = 0.3}', mains_flicker(60, 0.3)),
        (STROBE, Strobe(0.5, 0.1)),
    ],
)
def test_a_programme_is_read_as_it_is_written(lit_by, text, programme):
    assert load_scene(lit_by(text)).schedule.courses["lamp"].programme == programme


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{kind = "sine", period_s = 4.0, depth = 1.5}', "depth does not fit"),
        ('{kind = "sine", period_s = 4.0, depth = -0.1}', "It must be: the amplitude over the mean, 0 to 1"),
        ('{kind = "sine", period_s = -4.0}', "period_s does not fit"),
        ('{kind = "sine", period_s = nan}', "programme.period_s is nan"),
        ('{kind = "sine"}', "'period_s' is a required property"),
        ('{kind = "sine", period_s = 4.0, duty = 0.5}', "kind, period_s and depth of a sine"),
        ('{kind = "flicker", period_s = 4.0}', "flicker"),
        ('{kind = "flicker", mains_hz = 0}', "mains_hz does not fit"),
        ('{kind = "strobe", period_s = 1.0}', "'duty' is a required property"),
        ('{kind = "strobe", period_s = 1.0, duty = 0.0}', "the share of the period that a flash lasts"),
        ('{kind = "strobe", period_s = 1.0, duty = 1.1}', "duty does not fit"),
        ('{kind = "strobe", period_s = 1e-9, duty = 0.5}', "the period in s, 0.001 or more"),
        ('{kind = "disco"}', "programme.kind does not fit"),
        ("{period_s = 1.0}", "'kind' is a required property"),
    ],
)
def test_a_wrong_programme_is_refused(lit_by, refuses, text, says):
    message = refuses(load_scene, lit_by(f"programme = {text}"))
    assert says in message
    assert "lights.lamp.programme" in message


@pytest.mark.parametrize("solver", SOLVERS)
def test_every_solver_steps_a_varying_light_as_its_float64_namesake(lit_by, state_at, solver):
    """Five seconds of a swelling light in steps of 1/16 s, which both take exactly.

    Errors of one step in float32: U of the sum, and some 32 U of an increment that is at most 1/16 of what is left (as
    derived in test_phosphor_step, with the factors, their quadratic, and the irradiance); 80 steps. The adaptive solver
    keeps, in each step, its tolerance of 1e-3 of r at most, and so does its namesake.
    """
    scene, r = state_at(lit_by(SINE), 5.0, solver=solver, step_s=1 / 16)
    want = reference(scene, Sine(4.0, 0.8), solver, 80, 5.0)
    tolerance = 2e-3 if solver == "rk23" else 80 * U + 64 * U
    assert np.abs(r - want).max() <= tolerance


def test_a_step_never_reaches_over_the_end_of_the_light(lit_by, state_at):
    """A sine that ends at 10 s in the middle of its steps, and darkness after it: as if it had been stepped apart."""
    path = lit_by(SINE)
    scene, r = state_at(path, 13.0, solver="exact2", step_s=0.3)
    lit = np.zeros((64, 64, 1))
    a = kinetics.excitation(phoslab.preset("green"), irradiance(scene))
    kr = phoslab.preset("green").kr_per_s
    for begin in np.arange(0, 10, 0.3):
        end = min(begin + 0.3, 10.0)
        lit = solvers.exact_step(lit, a * mean(Sine(4.0, 0.8), begin, end), kr, np.array(end - begin))
    # 34 steps of the increments' 16 U, and the decay.
    np.testing.assert_allclose(r, lit * np.exp(-3 * kr), rtol=64 * U)


def test_a_strobe_is_stepped_from_jump_to_jump_in_closed_form(lit_by, state_at, monkeypatch):
    """2.25 s of two flashes a second: 5 flashes and 4 gaps and a last gap, each one step, as in float64."""
    steps = []
    run = PhosphorState._run
    monkeypatch.setattr(PhosphorState, "_run", lambda *a, **k: (steps.append(1), run(*a, **k))[1])
    scene, r = state_at(lit_by(STROBE), 2.25)
    assert len(steps) == 10
    green = phoslab.preset("green")
    E, want = irradiance(scene), np.zeros((64, 64, 1))
    for k in range(5):
        want = kinetics.advance(green, want, E / 0.1, 0.05)
        want = kinetics.advance(green, want, 0 * E, 0.45 if k < 4 else 0.2)
    # Ten steps of some 16 roundings each, and the irradiance.
    np.testing.assert_allclose(r, want, rtol=(160 + 64) * U)


def test_a_sine_that_is_off_is_stepped_in_closed_form(lit_by, state_at, monkeypatch):
    path = lit_by(SINE)
    state_at(path, 10.0, solver="exact2")
    steps = []
    run = PhosphorState._run
    monkeypatch.setattr(PhosphorState, "_run", lambda *a, **k: (steps.append(1), run(*a, **k))[1])
    state_at(path, 10.0, 6 * 3600.0, solver="exact2", step_s=1.0)
    assert len(steps) == 10 + 1


@pytest.mark.parametrize(("programme", "solver"), [("", "exact"), (STROBE, "exact"), (SINE, "exact2")])
def test_the_default_solver_is_the_one_that_the_light_asks_for(lit_by, programme, solver):
    assert render(lit_by(programme), ["0"], size=(8, 8)).solver == solver


def test_reflected_light_follows_the_programme(lit_by):
    """At 1 s of a sine of 4 s the lamp is at 1.8, at 3 s at 0.2; a strobe between its flashes gives nothing."""
    path = lit_by(SINE)
    frames = render(path, ["0", "1", "3"], size=(8, 8))
    red = [f.radiance[4, 4, 7] for f in frames.frames]  # 662-700 nm: no glow there
    np.testing.assert_allclose(red, np.array([1.0, 1.8, 0.2]) * red[0], rtol=64 * U)


def test_a_strobe_between_its_flashes_gives_nothing(lit_by):
    frames = render(lit_by(STROBE), ["0", "0.25"], size=(8, 8))
    assert frames[0].radiance[4, 4, 7] > 0
    assert frames[1].radiance[4, 4, 7] == 0


def test_off_is_when_the_schedule_ends_whatever_the_programme(lit_by):
    schedule = load_scene(lit_by(STROBE)).schedule
    assert schedule.off_s == 10.0
    assert schedule.dark_for_s(5.25) is None
    assert schedule.dark_for_s(12.0) == 2.0


def test_lights_that_run_alike_share_one_layer_of_excitation(quad, device, lamp_toml, green_toml):
    quad.lamp((0, 0, 1))
    right = np.eye(4)
    right[:3, 3] = [0.4, 0, 0.5]
    quad.light("right", "point", right).light("swelling", "point", right)
    toml = lamp_toml.split("[lights.lamp]")[1]
    text = lamp_toml + "[lights.right]" + toml + "[lights.swelling]" + toml + SINE + green_toml
    renderer = Renderer(device, load_scene(quad.text(text).write()), RenderParameters((8, 8), 1))
    assert renderer.states[0].excitation.layers == 2
