"""What a camera sees of a place that was lit for a while: charge, fade of the lamp, dark delay, exposure.

The light is constant in steps; within one, with k = a + kr and x = k dt, the rate equation (Nalbach 2017, eq. 8.1) and
the light of the step are exact:

    r(dt)    = r e^-x + a dt φ1          ∫ r dt = dt (r φ1 + a dt φ2)
    φ1 = (1 - e^-x) / x                  φ2 = (1 - φ1) / x                 φ3 = (1/2 - φ2) / x

No quotient by k appears, so that nothing is special where neither light nor decay is there. Derivatives go along with
the steps, by φ1' = φ2 - φ1 and φ2' = 2 φ3 - φ2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError

Array = NDArray[np.float64]

FADE_STEPS = 32
"""Steps of a fade that is given as a formula. Each has the mean light of its stretch, so that the error is of second
order in its length h, k h² / 12 of full light times time: for 0.32 s and k = 1/s, 5e-5 of what the fade brings."""

# φ3 as a series for x <= 1: the first term that is left out is 1 / 20!, far below the last bit of the sum.
_SERIES = [(-1) ** n / math.factorial(n + 3) for n in range(17)][::-1]


@dataclass(frozen=True, eq=False)
class Table:
    """Light in steps.

    Args:
        edges_s: (n + 1,) ascending, from 0 on.
        level: (n,) share of full light in each step.
    """

    edges_s: Array
    level: Array

    def __post_init__(self) -> None:
        edges, level = np.asarray(self.edges_s, float), np.asarray(self.level, float)
        good = edges.ndim == level.ndim == 1 and edges.size == level.size + 1 and edges[0] == 0
        if not (good and (np.diff(edges) > 0).all() and np.isfinite(level).all() and (level >= 0).all()):
            raise PhoslabError(
                "must be steps of light: n + 1 ascending times from 0 on, and n levels of 0 or more",
                field="the lamp's course",
                remedy="Give seconds and shares of full light.",
            )

    @classmethod
    def of(cls, level: Callable[[Array], Array], duration_s: float, n: int = FADE_STEPS) -> Table:
        """Cut a curve into `n` equal steps with its mean in each (Gauss-Legendre, exact to degree 7)."""
        if duration_s <= 0:
            return cls(np.zeros(1), np.zeros(0))
        edges = np.linspace(0.0, duration_s, n + 1)
        nodes, weights = np.polynomial.legendre.leggauss(4)
        at = edges[:-1, None] + (1 + nodes) / 2 * (duration_s / n)
        return cls(edges, np.asarray(level(at) @ (weights / 2)))

    @classmethod
    def fade(cls, duration_s: float) -> Table:
        """Return light that falls in a straight line to 0: what to take where only the duration is known."""
        return cls.of(lambda t: 1 - t / duration_s, duration_s)

    @property
    def light_s(self) -> float:
        """Its integral: seconds of full light."""
        return float(np.diff(self.edges_s) @ self.level)

    def at(self, t_s: Array, beyond: float) -> Array:
        """Return (n,) the level at times `t_s`; `beyond` after its end."""
        k = np.searchsorted(self.edges_s, t_s, side="right") - 1
        return np.append(self.level, beyond)[np.minimum(k, self.level.size)]


def _nothing() -> Table:
    return Table(np.zeros(1), np.zeros(0))


@dataclass(frozen=True, eq=False)
class LampCourse:
    """How a lamp comes and goes.

    Args:
        rise: its light since it was switched on; 1 afterwards.
        fade: its light since it was switched off, as a share of what it was; 0 afterwards.
    """

    rise: Table = field(default_factory=_nothing)
    fade: Table = field(default_factory=lambda: Table.fade(0.32))


@dataclass(frozen=True, eq=False)
class Steps:
    """What happened to a sample up to the end of each frame.

    Args:
        duration_s: (n_frames, n_steps).
        level: (n_frames, n_steps) share of the lamp's full light.
        open: (n_frames, n_steps) whether the shutter was open.
        lit_s: (n_frames,) how long the lamp had current.
        delay_s: (n_frames,) from switching it off to opening the shutter.
    """

    duration_s: Array
    level: Array
    open: NDArray[np.bool_]
    lit_s: Array
    delay_s: Array

    @property
    def exposure_s(self) -> Array:
        """(n_frames,) how long the shutter was open."""
        total: Array = (self.duration_s * self.open).sum(axis=1)
        return total

    @property
    def light_s(self) -> Array:
        """(n_frames,) seconds of full light before the end of the frame."""
        total: Array = (self.duration_s * self.level).sum(axis=1)
        return total

    @classmethod
    def of(cls, lit_s: Array, delay_s: Array, exposure_s: Array, lamp: LampCourse) -> Steps:
        """Return the steps of frames, each of a sample that was lit once.

        Args:
            lit_s: (n_frames,) how long the lamp had current.
            delay_s: (n_frames,) from switching off to opening the shutter: fade, door and shutter lag.
            exposure_s: (n_frames,) how long the shutter was open.
            lamp: how its light comes and goes.

        Raises:
            PhoslabError: a time is negative or not finite, or an exposure is 0.
        """
        times = np.stack(np.broadcast_arrays(lit_s, delay_s, exposure_s)).astype(np.float64)
        if not np.isfinite(times).all() or (times < 0).any() or (times[2] == 0).any():
            raise PhoslabError(
                "is negative, not finite, or an exposure of 0 s",
                field="a time of the excitation series",
                remedy="Give seconds: lit, from lamp-off to shutter, exposure.",
            )
        rows = [_row(float(lit), float(delay), float(exposure), lamp) for lit, delay, exposure in times.T]
        n = max(len(durations) for durations, _, _ in rows)

        def padded(k: int) -> Array:
            # Steps of 0 s go first, so that delays and exposures of all frames stand in the same columns.
            return np.stack([np.pad(row[k], (n - len(row[k]), 0)) for row in rows])

        return cls(padded(0), padded(1), padded(2) > 0, times[0], times[1])


def _row(lit_s: float, delay_s: float, exposure_s: float, lamp: LampCourse) -> tuple[Array, Array, Array]:
    """Return one frame's durations, levels and shutter, from switching on to the end of the exposure."""
    open_s, end_s = lit_s + delay_s, lit_s + delay_s + exposure_s
    rising = lamp.rise.edges_s[lamp.rise.edges_s < lit_s]
    edges = np.unique(np.concatenate([[0.0, lit_s, open_s, end_s], rising, lit_s + lamp.fade.edges_s]))
    edges = edges[edges <= end_s]
    middle = (edges[:-1] + edges[1:]) / 2
    before = lamp.rise.at(middle, 1.0)
    # What it had when it was switched off: the step that ends there.
    reached = float(lamp.rise.at(np.array([lit_s * (1 - 1e-12)]), 1.0)[0]) if lit_s > 0 else 0.0
    after = reached * lamp.fade.at(np.maximum(middle - lit_s, 0.0), 0.0)
    level = np.where(middle < lit_s, before, after)
    return np.diff(edges), level, (middle > open_s).astype(np.float64)


@dataclass(frozen=True, eq=False)
class Glow:
    """Mean of kr r over each exposure in 1/s, and how it depends on the rates of its own state.

    Args:
        value: (n_frames, n_places, n_c).
        by_a, by_kr: the same shape; dimensionless.
    """

    value: Array
    by_a: Array
    by_kr: Array


def glow(a: Array, kr: Array, steps: Steps, initial: Array | float = 0.0) -> Glow:
    """Return what each frame sees of each place, per state: exact, with exact derivatives.

    Args:
        a: (n_places, n_c) excitation under the lamp's full light, in 1/s.
        kr: (n_c,) re-radiation rates in 1/s.
        steps: of `n_frames` frames.
        initial: concentrations before the first step, broadcast to (n_frames, n_places, n_c).
    """
    shape = (len(steps.duration_s), *a.shape)
    r = np.broadcast_to(np.asarray(initial, float), shape)
    r_a, r_kr = np.zeros(shape), np.zeros(shape)
    total, total_a, total_kr = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for dt, level, is_open in zip(
        steps.duration_s.T[:, :, None, None],
        steps.level.T[:, :, None, None],
        steps.open.T[:, :, None, None],
        strict=True,
    ):
        light = level * dt
        lit, seen = bool(light.any()), bool(is_open.any())
        if not lit and not seen:
            e = np.exp(-kr * dt)
            r_a, r_kr = r_a * e, (r_kr - dt * r) * e
            r = r * e
            continue
        gain = a * light if lit else np.zeros(())
        e, phi1, phi2, phi3 = phi(gain + kr * dt)
        if seen:
            window = is_open * dt
            by_x = r * (phi2 - phi1) + gain * (2 * phi3 - phi2)
            total = total + window * (r * phi1 + gain * phi2)
            total_kr = total_kr + window * (r_kr * phi1 + by_x * dt)
            total_a = total_a + window * (r_a * phi1 + (by_x + phi2) * light)
        by_x = gain * (phi2 - phi1) - r * e
        r_kr = r_kr * e + by_x * dt
        r_a = r_a * e + (by_x + phi1) * light
        r = r * e + gain * phi1
    scale = kr / steps.exposure_s[:, None, None]
    return Glow(scale * total, scale * total_a, scale * total_kr + total / steps.exposure_s[:, None, None])


def phi(x: Array) -> tuple[Array, Array, Array, Array]:
    """Return e^-x, φ1, φ2 and φ3 for x >= 0, to some ulp."""
    near = np.minimum(x, 1.0)
    small3 = np.full(x.shape, _SERIES[0])
    for coefficient in _SERIES[1:]:
        small3 *= near
        small3 += coefficient
    far = np.maximum(x, 1.0)
    e = np.exp(-x)
    large1 = -np.expm1(-far) / far
    large2 = (1 - large1) / far
    small2 = 0.5 - near * small3
    is_near = x <= 1
    return (
        e,
        np.where(is_near, 1 - near * small2, large1),
        np.where(is_near, small2, large2),
        np.where(is_near, small3, (0.5 - large2) / far),
    )
