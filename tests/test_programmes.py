"""Light programmes and their exact means."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from phoslab.programmes import ALWAYS_ON, Sine, Strobe, Sweep, Switched, mains_flicker, mean

PROGRAMMES = {
    "always": ALWAYS_ON,
    "switched": Switched(((0.5, 1.25), (3.0, 4.0))),
    "sine": Sine(2.0, 0.7),
    "flicker": mains_flicker(0.8),
    "strobe": Strobe(0.9, 0.2),
    "sweep": Sweep(np.array(1.7), 0.3),
}


@pytest.mark.parametrize("name", PROGRAMMES)
@pytest.mark.parametrize(("start", "stop"), [(0.0, 0.3), (0.4, 3.7), (1.1, 10.0)])
def test_the_mean_is_the_integral_of_the_values(name, start, stop):
    programme = PROGRAMMES[name]
    # Each piece is smooth, so that quadrature reaches its tolerance.
    pieces = np.concatenate([[start], programme.changes(start, stop), [stop]])
    cut = np.unique(np.concatenate([np.linspace(a, b, 9) for a, b in pairwise(pieces)]))
    total = sum(quad(lambda t: float(programme.at(t)), a, b, epsabs=1e-13)[0] for a, b in pairwise(cut))
    assert mean(programme, start, stop) == pytest.approx(total / (stop - start), rel=1e-9)


@pytest.mark.parametrize("name", [n for n, p in PROGRAMMES.items() if p.piecewise_constant])
def test_a_piecewise_constant_programme_jumps_only_at_its_changes(name):
    programme = PROGRAMMES[name]
    edges = programme.changes(0.0, 10.0)
    assert (np.diff(edges) > 0).all()
    for a, b in zip(np.r_[0.0, edges], np.r_[edges, 10.0], strict=True):
        inside = np.linspace(a, b, 12)[1:-1]
        assert len(set(programme.at(inside).tolist())) == 1


def test_flicker_runs_at_twice_the_mains_frequency_and_is_never_negative():
    light = mains_flicker(50.0)
    assert light.period_s == 0.01
    assert light.at(np.linspace(0, 1, 9999)).min() >= 0


def test_a_strobe_gives_as_much_light_as_a_steady_lamp():
    assert mean(Strobe(0.04, 0.05), 0.0, 0.4) == pytest.approx(1.0, rel=1e-14)


def test_a_sweep_passes_each_place_at_its_own_time():
    sweep = Sweep(np.array([1.0, 2.0]), 0.1)
    assert sweep.at(1.0) == pytest.approx([1.0, 0.0], abs=1e-12)
    assert sweep.integral(10.0) == pytest.approx(0.1 * np.sqrt(2 * np.pi) * np.ones(2), rel=1e-12)
