"""A sample that follows the model that is fitted to it: states that fill and empty each by itself.

    dr_i/dt = kr_i (s (1 - r_i) - r_i)        light = Σ w_i kr_i r_i

with the excitation s in units of kr_i, alike for all states, and rates that know no temperature. What is fitted to such
a sample can be compared with a truth in every number. The equations are integrated by LSODA, under light that changes
as it likes: none of the closed forms of a fit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from phoslab.instruments.bench.film import Film
from phoslab.instruments.bench.lights import halogen
from phoslab.instruments.bench.paints import Paint, paint

Array = NDArray[np.float64]

RELATIVE_TOLERANCE = 1e-8

_NM = np.arange(360.0, 761.0)


@dataclass(frozen=True)
class StatePaint(Paint):
    """A paint of exact states; `excitation_per_s` is s under unit irradiance at the best wavelength.

    Args:
        kr_per_s: (n_c,) re-radiation rates.
        weights: (n_c,) w_i.
    """

    kr_per_s: tuple[float, ...] = (0.2, 0.02)
    weights: tuple[float, ...] = (0.4, 0.6)


def state_paint(name: str, looks_like: str, saturation: float) -> StatePaint:
    """Return one with the colours of a preset, whose states a halogen lamp of 3000 K excites by `saturation` kr_i."""
    plain = paint(looks_like)
    told = {f.name: getattr(plain, f.name) for f in fields(plain)}
    full = float((plain.excitation(_NM) * halogen(3000.0)(_NM)).sum() / _NM.size)
    return StatePaint(**told | {"name": name, "excitation_per_s": saturation / full})


@dataclass(frozen=True, eq=False)
class StateFilm(Film):
    """A piece of a `StatePaint`; `state` is (places, n_c) r_i."""

    sample: StatePaint

    @classmethod
    def rested(cls, sample: StatePaint) -> StateFilm:
        """A piece that was kept dark for long; one place stands for all."""
        return cls(sample, np.zeros((1, len(sample.kr_per_s))))

    def spread(self, n: int) -> StateFilm:
        """The same with `n` places, if it has one."""
        return StateFilm(self.sample, np.repeat(self.state, n, axis=0)) if len(self.state) == 1 else self

    def light(self, temperature_C: float) -> Array:
        """(places,) light in the dark, whatever the temperature."""
        return self.state @ (np.array(self.sample.weights) * self.sample.kr_per_s)

    def advance(
        self,
        duration_s: float,
        drive: Callable[[float], Array] | None = None,
        temperature_C: Callable[[float], float] | None = None,
    ) -> tuple[StateFilm, Array]:
        """Let time pass; see `Film.advance`."""
        kr = np.array(self.sample.kr_per_s)
        power, n_c = np.array(self.sample.weights) * kr, kr.size
        places = len(self.state)

        def flow(t: float, y: Array) -> Array:
            r = y.reshape(places, n_c + 1)[:, :n_c]
            s = np.zeros(1) if drive is None else np.asarray(drive(t))
            change = kr * (s[:, None] * (1 - r) - r)
            return np.column_stack([change, r @ power]).ravel()

        # Last in each place's row: its light so far. Rows know nothing of one another, so the Jacobian is a band.
        y = np.column_stack([self.state, np.zeros(places)]).ravel()
        solution = solve_ivp(
            flow,
            (0.0, duration_s),
            y,
            method="LSODA",
            rtol=RELATIVE_TOLERANCE,
            atol=1e-13,
            lband=n_c,
            uband=0,
        )
        if not solution.success:
            raise RuntimeError(f"the sample's equations could not be solved: {solution.message}")
        after = solution.y[:, -1].reshape(places, n_c + 1)
        return StateFilm(self.sample, after[:, :n_c]), after[:, n_c]
