"""How many steps a render may take, and the step that an explicit solver is advised to take."""

from __future__ import annotations

import re

import numpy as np
import pytest

from phoslab.render import render


@pytest.fixture
def two(build, lamp_toml, green_toml):
    """Two phosphors of unlike rates, and a second lamp that comes on later and is brighter."""
    other = np.eye(4)
    other[:3, 3] = 0, 0, 1
    build.mesh("quad").mesh("slow", translation=[0, 0, 0.5]).camera().lamp().light("late", "point", other)
    late = lamp_toml.split("[lights.lamp]")[1].replace("2.0", "40.0").replace("[0, 10]", "[20, 30]")
    slow = green_toml.replace("quad", "slow").replace("preset:green", "preset:blue")
    return build.text(lamp_toml + f"[lights.late]{late}" + green_toml + slow)


def test_an_absurd_number_of_steps_is_refused_at_once(quad, lamp_toml, green_toml, refuses):
    path = quad.lamp().text(lamp_toml + green_toml).write()
    message = refuses(render, path, ["9"], solver="euler", step_s=1e-9)
    assert "the step (--step) of 1e-09 s makes 9e+09 steps until 9 s" in message
    assert render(path, ["9"], solver="exact", step_s=1e-9, size=(4, 4))


def test_a_light_that_flashes_beyond_counting_is_refused_at_once(quad, lamp_toml, green_toml, refuses):
    strobe = 'programme = {kind = "strobe", period_s = 0.001, duty = 0.5}'
    path = quad.lamp().text(lamp_toml.replace("schedule = [[0, 10]]", strobe) + green_toml).write()
    assert "the lights change 2e+12 times until 1e+09 s" in refuses(render, path, [1e9])


def test_the_step_that_is_advised_then_works(two, refuses):
    """For every material and to the end of the schedule, not only where the first step failed."""
    path = two.write()
    message = refuses(render, path, ["40"], solver="euler", step_s=1e6, size=(4, 4))
    advised = float(re.search(r"Step by (\S+) s or less", message)[1])
    assert render(path, ["40"], solver="euler", step_s=advised, size=(4, 4))


def test_a_step_of_an_age_swallows_no_time(quad, lamp_toml, green_toml, refuses):
    """What is left of a stretch counts, however small a share of the step it is."""
    path = quad.lamp().text(lamp_toml + green_toml).write()
    assert "overshoots" in refuses(render, path, ["9"], solver="euler", step_s=1e12)
    exact, rk23 = (render(path, ["9"], solver=s, step_s=1e12, size=(4, 4))[0] for s in ("exact", "rk23"))
    np.testing.assert_allclose(rk23.radiance, exact.radiance, rtol=1e-3)
