"""A sample of exact states: what it does under constant light is known, and the bench takes it as any other."""

import numpy as np
import pytest

from phoslab.errors import PhoslabError
from phoslab.instruments.bench import samples
from phoslab.instruments.bench.darkroom import Darkroom, Stage
from phoslab.instruments.bench.states import StateFilm, StatePaint

KR, WEIGHTS = np.array([0.2, 0.02]), np.array([0.4, 0.6])


def test_under_constant_light_each_state_rises_as_an_exponential() -> None:
    film = StateFilm.rested(StatePaint()).spread(3)
    s = np.array([0.0, 0.3, 1.5])
    after, light = film.advance(7.0, lambda t: s)
    rate = KR * (1 + s[:, None])
    end = s[:, None] / (1 + s[:, None])
    # The integrator's tolerance is 1e-8 of a step; some tens of steps.
    np.testing.assert_allclose(after.state, end * -np.expm1(-rate * 7.0), rtol=1e-6, atol=1e-12)
    shone = end * (7.0 + np.expm1(-rate * 7.0) / rate) * KR * WEIGHTS
    np.testing.assert_allclose(light, shone.sum(axis=1), rtol=1e-6, atol=1e-12)


def test_in_the_dark_each_state_falls_as_an_exponential_whatever_the_temperature() -> None:
    film = StateFilm(StatePaint(), np.array([[0.5, 0.8]]))
    after, _ = film.advance(30.0, None, lambda t: 60.0)
    np.testing.assert_allclose(after.state, film.state * np.exp(-KR * 30), rtol=1e-6)
    assert after.light(60.0) == after.light(0.0) == pytest.approx(after.state @ (KR * WEIGHTS))


def test_the_lamp_of_the_bench_saturates_it_as_it_says() -> None:
    room = Darkroom(1, samples.sample("two-states"))
    room.place(0.0, Stage("sample"))
    room.lamp.switch(10.0, True)
    room.lamp.switch(5410.0, False)
    # 1.5 of kr, a little less behind glass that ends at 396 nm; 5,400 s are long enough for both states.
    s = 1.5 * _behind_glass(room)
    faded = 5.0
    expected = s / (1 + s) * (KR * WEIGHTS) @ np.exp(-KR * faded)
    # The fade, of 0.32 s, still excites: a third of it as light of full strength, at most a tenth of a state's rate.
    assert room.afterglow(1, [5410.0 + faded])[0] == pytest.approx(expected, rel=0.1)


def _behind_glass(room: Darkroom) -> float:
    from phoslab.instruments.bench.darkroom import NM
    from phoslab.instruments.bench.lights import halogen

    excitation = room.sample.excitation(NM)
    return float((room.light(Stage()) @ excitation) / (halogen(3000.0)(NM) @ excitation))


@pytest.mark.parametrize("name", samples.names())
def test_every_sample_of_the_bench_has_its_own_physics(name: str) -> None:
    sample = samples.sample(name)
    assert sample.name == name
    assert isinstance(samples.rested(sample), StateFilm) == isinstance(sample, StatePaint)


def test_an_unknown_sample_is_refused_with_all_names() -> None:
    with pytest.raises(PhoslabError, match="two-states"):
        samples.sample("mauve")
