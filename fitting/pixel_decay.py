"""The decay of every pixel: rates shared by its channels, one colour, no guess (Nalbach 2017, 8.4.4, at each pixel).

A pixel's channels share one colour C and become one series before anything is searched. With σ_tc the noise of channel
c in frame t, and ρ the frame's repeatability, which its channels share,

    1/V_t = Σ_c C_c² / σ_tc²,    z_t = V_t Σ_c C_c y_tc / σ_tc²,    var z_t = V_t + (ρ m_t)²

and z is all that the data say of the shape m(t) = Σ_i A_i g_i(t). C follows from m in closed form. σ depends on the
signal: it is taken from m, not from the noisy y (which would favour what fell low), in a few rounds.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import IntFlag
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting import pixel_kernels
from phoslab.fitting.decay import MOST_STATES
from phoslab.fitting.decay_problem import exposed_decay

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]

# Rounds of weights and colour where noise depends on the signal. The second moves rates by up to a third of their
# error, the third by less than a hundredth.
_ROUNDS = 3
_PIXELS_A_TASK = 4096


class Flag(IntFlag):
    """What is to be said of a pixel."""

    MASKED = 1  # does not glow: not fitted
    CLIPPED = pixel_kernels.CLIPPED  # some of its values are saturated, or of hot pixels, and left out
    DARK = pixel_kernels.DARK  # too dark, or with too few values, to be fitted
    UNCONVERGED = pixel_kernels.UNCONVERGED  # the search did not end
    FEWER = pixel_kernels.FEWER  # carries fewer states than the sample; the others have no light
    UNDETERMINED = pixel_kernels.UNDETERMINED  # a rate is beyond what times can tell, or below its error
    MISFIT = pixel_kernels.MISFIT  # the model misses the data by more than noise; errors are widened


@dataclass(frozen=True)
class PixelNoise:
    """The noise of a pixel's value: σ² = floor + gain S, in units of the signal.

    Args:
        floor, gain: (n_frames, n_channels); gain 0 where noise does not depend on the signal.
        repeatability: relative standard deviation of a whole frame, shared by its channels.
    """

    floor: Array
    gain: Array
    repeatability: float = 0.0


@dataclass(frozen=True)
class Grid:
    """Starting rates, and the inverse matrices of all sets of them.

    Args:
        log_kr: (n_grid,).
        columns: (n_grid, n_frames) g.
        weight: (n_frames,) for which the matrices hold.
        index, inverse: (n_sets, 4) which rates a set has, and (n_sets, 4, 4); of those of n states the first n count.
        first: (n_states + 1,) where the sets of 1, 2 ... states begin, and the end.
    """

    log_kr: Array
    columns: Array
    weight: Array
    index: NDArray[np.int64]
    inverse: Array
    first: NDArray[np.int64]


@dataclass(frozen=True)
class PixelFits:
    """n_pixels fits; states fast to slow.

    Args:
        kr_per_s, amplitude: (n_pixels, n_c) rates, and A in the reference channel; 0 for a state that a pixel has not.
        kr_error, amplitude_error: (n_pixels, n_c) standard errors, infinite where nothing tells.
        colour: (n_pixels, n_channels) C, 1 in the reference channel.
        chi2_per_dof: (n_pixels,).
        flags: (n_pixels,) of `Flag`.
    """

    kr_per_s: Pixels
    amplitude: Pixels
    kr_error: Pixels
    amplitude_error: Pixels
    colour: Pixels
    chi2_per_dof: Pixels
    flags: NDArray[np.uint8]

    @classmethod
    def empty(cls, n_pixels: int, n_states: int, n_channels: int) -> PixelFits:
        """Room for fits."""
        kr, amplitude, kr_error, amplitude_error = (
            np.zeros((n_pixels, n_states), np.float32) for _ in range(4)
        )
        return cls(
            kr_per_s=kr,
            amplitude=amplitude,
            kr_error=kr_error,
            amplitude_error=amplitude_error,
            colour=np.zeros((n_pixels, n_channels), np.float32),
            chi2_per_dof=np.zeros(n_pixels, np.float32),
            flags=np.zeros(n_pixels, np.uint8),
        )


@dataclass(frozen=True)
class PixelProblem:
    """What all pixels share.

    Args:
        t_s, exposure_s: (n_frames,) start of each exposure since lamp-off, and how long.
        noise: of a pixel's values.
        typical: (n_frames, n_channels) the decay that pixels resemble: the sample's mean. First weights and the ranking
            of starts rest on it; results do not.
        n_states: 1 to 4.
        limits_per_s: between which starting rates lie.
        near_per_s: (n_states,) one start more: the rates of a coarser level of the image, say the whole sample.
    """

    t_s: Array
    exposure_s: Array
    noise: PixelNoise
    typical: Array
    n_states: int
    limits_per_s: tuple[float, float]
    near_per_s: Array | None = None

    @property
    def reference(self) -> int:
        """The channel in which the colour is 1: the one with the most light."""
        return int(np.argmax(self.typical.sum(axis=0)))

    @cached_property
    def grid(self) -> Grid:
        """Where searches start."""
        low, high = self.limits_per_s
        per_decade = 4 if self.n_states < 4 else 3
        rates = np.geomspace(low, high, max(self.n_states + 2, int(per_decade * np.log10(high / low))))
        n_grid, near = rates.size, np.zeros(0) if self.near_per_s is None else self.near_per_s
        rates = np.concatenate([rates, near])
        g = exposed_decay(rates, self.t_s, self.exposure_s)[0]
        m = self.typical[:, self.reference]
        colour = self.typical.sum(axis=0) / self.typical[:, self.reference].sum()
        variance = self.noise.floor + self.noise.gain * np.maximum(self.typical, 0)
        weight = 1 / (1 / (colour**2 / variance).sum(axis=1) + (self.noise.repeatability * m) ** 2)
        matrix = g.T @ (weight[:, None] * g)
        index, inverse, first = [], [], [0]
        for n in range(1, self.n_states + 1):
            chosen = list(combinations(range(n_grid), n))
            if n == near.size:
                chosen.append(tuple(range(n_grid, rates.size)))
            sets = np.zeros((len(chosen), MOST_STATES), np.int64)
            sets[:, :n] = chosen
            A = matrix[sets[:, :n, None], sets[:, None, :n]]
            # Only the ranking of sets matters here, not digits.
            A = A + 1e-10 * np.eye(n) * np.trace(A, axis1=1, axis2=2)[:, None, None]
            inverses = np.zeros((len(chosen), MOST_STATES, MOST_STATES))
            inverses[:, :n, :n] = np.linalg.inv(A)
            index.append(sets)
            inverse.append(inverses)
            first.append(first[-1] + len(chosen))
        return Grid(
            log_kr=np.log(rates),
            columns=np.ascontiguousarray(g.T),
            weight=weight,
            index=np.concatenate(index),
            inverse=np.concatenate(inverse),
            first=np.array(first, np.int64),
        )


def fit_pixels(problem: PixelProblem, y: Pixels, *, threads: int | None = None) -> PixelFits:
    """Fit every pixel by itself, on all processors.

    Args:
        y: (n_pixels, n_frames, n_channels) linear signal a second; NaN for a value that is left out.
        threads: by default one for each processor that this process may use.
    """
    n_pixels, _, n_channels = y.shape
    fits = PixelFits.empty(n_pixels, problem.n_states, n_channels)
    grid, noise = problem.grid, problem.noise
    varies = bool((noise.gain > 0).any() or noise.repeatability > 0)

    # Compiled code is made for one layout of arrays, and made again for another.
    t_s, exposure_s, floor, gain, typical = (
        np.ascontiguousarray(values, float)
        for values in (problem.t_s, problem.exposure_s, noise.floor, noise.gain, problem.typical)
    )
    y = np.ascontiguousarray(y, np.float32)

    def task(first: int) -> None:
        some = slice(first, min(first + _PIXELS_A_TASK, n_pixels))
        pixel_kernels.fit(
            t_s,
            exposure_s,
            floor,
            gain,
            float(noise.repeatability),
            typical,
            problem.reference,
            problem.n_states,
            np.log(np.array(problem.limits_per_s)) + np.log([0.01, 10.0]),
            _ROUNDS if varies else 1,
            grid.log_kr,
            grid.columns,
            grid.weight,
            grid.index,
            grid.inverse,
            grid.first,
            y[some],
            *(values[some] for values in vars(fits).values()),
        )

    with ThreadPoolExecutor(threads or len(os.sched_getaffinity(0))) as pool:
        list(pool.map(task, range(0, n_pixels, _PIXELS_A_TASK)))
    return fits
