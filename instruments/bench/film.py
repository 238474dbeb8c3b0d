"""The sample's state at many places at once, each excited by its own light.

The equations are those of sample.py. There they are solved to ten digits for one place; here for all columns under
the filter together, to four or five, fast enough that an hour takes a tenth of a second.

With c = free R / (h + R Σ (N - n)), the rate at which an empty trap is filled, every depth of a place obeys

    dn_i/dt = -(p_i + c) n_i + c N_i

so that for a constant c the step is an exponential: exact, whatever its length, and always between 0 and N_i. What
remains is one number a place. c is taken from the middle of the step, where it must agree with the state that it
leads to (an implicit midpoint rule: shallow traps exchange electrons hundreds of times a second, and an explicit c
would oscillate); a secant finds it. Steps are doubled and halved by comparing one with two of half the length.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from phoslab.instruments.bench.sample import Sample

Array = NDArray[np.float64]

TOLERANCE = 5e-6
"""Of a step, relative to the filled centres and to the light."""

_SHORTEST_S = 1e-4


@dataclass(frozen=True, eq=False)
class Film:
    """A piece of the sample.

    Args:
        sample: what it is made of.
        state: (places, n_depths) n_i.
    """

    sample: Sample
    state: Array

    @classmethod
    def dark(cls, sample: Sample) -> Film:
        """A piece that was kept dark for long; one place stands for all."""
        return cls(sample, sample.empty[None, :])

    def spread(self, n: int) -> Film:
        """The same with `n` places, if it has one."""
        return Film(self.sample, np.repeat(self.state, n, axis=0)) if len(self.state) == 1 else self

    def light(self, temperature_C: float) -> Array:
        """(places,) light in the dark, in recombinations per second as a share of the traps."""
        return _Rates(self.sample, temperature_C).light(self.state, np.zeros(len(self.state)))

    def advance(
        self,
        duration_s: float,
        drive: Callable[[float], Array] | None = None,
        temperature_C: Callable[[float], float] | None = None,
    ) -> tuple[Film, Array]:
        """Let time pass; return the piece afterwards and the light that came out of each place.

        Args:
            duration_s: how long.
            drive: (places,) or (1,) g in 1/s, as a function of seconds from now; None: dark.
            temperature_C: as a function of seconds from now; None: the sample's own.
        """
        places = len(self.state)
        state, total = self.state, np.zeros(places)
        dark = np.zeros(places)

        def rates(t: float) -> _Rates:
            warm = self.sample.temperature_C if temperature_C is None else temperature_C(t)
            return _Rates(self.sample, warm)

        def driven(t: float) -> Array:
            return dark if drive is None else np.broadcast_to(drive(t), (places,))

        t, dt = 0.0, min(duration_s, 0.01)
        while t < duration_s:
            dt = min(dt, duration_s - t)
            middle = rates(t + dt / 2)
            once, _ = middle.step(state, dt, driven(t + dt / 2))
            half, light_a = rates(t + dt / 4).step(state, dt / 2, driven(t + dt / 4))
            twice, light_b = rates(t + 3 * dt / 4).step(half, dt / 2, driven(t + 3 * dt / 4))
            error = _difference(middle, once, twice, driven(t + dt))
            if error > TOLERANCE and dt > _SHORTEST_S:
                dt *= max(0.2, 0.8 * (TOLERANCE / error) ** (1 / 3))
                continue
            t += dt
            # Both are of second order: the difference says how far off the better one is.
            state = np.clip(twice + (twice - once) / 3, 0.0, middle.capacity)
            total += light_a + light_b
            dt *= min(4.0, 0.8 * (TOLERANCE / max(error, 1e-12)) ** (1 / 3))
        return Film(self.sample, state), total


@dataclass(frozen=True, eq=False)
class _Rates:
    """The sample's constants at one temperature."""

    sample: Sample
    temperature_C: float

    @cached_property
    def capacity(self) -> Array:
        """(n_depths,) N_i."""
        return _capacity(self.sample)

    @cached_property
    def release(self) -> Array:
        """(n_depths,) p_i."""
        return self.sample.release_at(self.temperature_C)

    def filling(self, state: Array, drive: Array) -> Array:
        """(places,) c."""
        holes, free = self._free(state, drive)
        retrapping = self.sample.retrapping
        return np.asarray(free * retrapping / (holes + retrapping * (1 - holes)))

    def light(self, state: Array, drive: Array) -> Array:
        """(places,) recombinations per second."""
        holes, free = self._free(state, drive)
        return np.asarray(free * holes / (holes + self.sample.retrapping * (1 - holes)))

    def _free(self, state: Array, drive: Array) -> tuple[Array, Array]:
        # Without a single electron there is nothing to recombine; 1e-30 keeps 0/0 away.
        holes = np.maximum(state.sum(axis=1), 1e-30)
        return holes, drive * (1 - holes) + state @ self.release

    def step(self, state: Array, dt: float, drive: Array) -> tuple[Array, Array]:
        """One step; the state after it, and the light during it."""
        c = self._midway(state, dt, drive)
        after = self._relaxed(state, dt, c)
        middle = self._relaxed(state, dt / 2, c)
        return after, dt * self.light(middle, drive)

    def _midway(self, state: Array, dt: float, drive: Array) -> Array:
        """(places,) the c that agrees with the state half a step later."""
        c0 = self.filling(state, drive)
        c1 = self.filling(self._relaxed(state, dt / 2, c0), drive)
        miss0, c = c1 - c0, c1
        for _ in range(8):
            miss = self.filling(self._relaxed(state, dt / 2, c), drive) - c
            if (np.abs(miss) <= 1e-9 * (c + 1e-12)).all():
                break
            slope = np.where(
                np.abs(c - c0) > 1e-14 * c, (miss - miss0) / np.where(c == c0, 1.0, c - c0), -1.0
            )
            # The miss falls with c, by less than c itself rises: between -1 and 0 the secant cannot go astray.
            slope = np.clip(slope, -2.0, -1e-3)
            c0, miss0, c = c, miss, np.maximum(c - miss / slope, 0.0)
        return c

    def _relaxed(self, state: Array, dt: float, c: Array) -> Array:
        rate = self.release + c[:, None]
        limit = c[:, None] * self.capacity / rate
        return np.asarray(limit + (state - limit) * np.exp(-rate * dt))


def _difference(rates: _Rates, once: Array, twice: Array, drive: Array) -> float:
    """How far two results are apart, relative to filled centres and to light, at the worst place."""
    filled = np.abs((once - twice).sum(axis=1)) / (twice.sum(axis=1) + 1e-9)
    a, b = rates.light(once, drive), rates.light(twice, drive)
    return float(max(filled.max(), (np.abs(a - b) / (b + 1e-9)).max() / 10))


@cache
def _capacity(sample: Sample) -> Array:
    return sample.capacity
