"""The decay of every pixel: rates shared by its channels, one colour, no guess (Nalbach 2017, 8.4.4, at each pixel).

A pixel's channels share one colour C and become one series before anything is searched. With σ_tc the noise of channel
c in frame t, and ρ the frame's repeatability, which its channels share,

    1/V_t = Σ_c C_c² / σ_tc²,    z_t = V_t Σ_c C_c y_tc / σ_tc²,    var z_t = V_t + (ρ m_t)²

and z is all that the data say of the shape m(t) = Σ_i A_i g_i(t). C follows from m in closed form. σ depends on the
signal: it is taken from m, not from the noisy y (which would favour what fell low), in a few rounds.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import IntFlag
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting.compiled import compiled
from phoslab.fitting.decay import exposed_decay
from phoslab.fitting.pixel_kernels import cholesky, column, search, sound, start, substitute

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]

# Rounds of weights and colour where noise depends on the signal: the third moves rates by under 1e-3 of their error.
_ROUNDS = 3
_STARTS = 2
# A series whose light stands less than this many standard errors above nothing is not fitted.
_VISIBLE = 10.0
# χ² beyond this normal deviate is no chance (1 in 1,000): standard errors are widened by its root.
_CHANCE = 3.09
_PIXELS_A_TASK = 4096


class Flag(IntFlag):
    """What is to be said of a pixel."""

    MASKED = 1  # does not glow: not fitted
    CLIPPED = 2  # some of its values are saturated, or of hot pixels, and left out
    DARK = 4  # too dark, or with too few values, to be fitted
    UNCONVERGED = 8  # the search did not end
    FEWER = 16  # carries fewer states than the sample; the others have no light
    UNDETERMINED = (
        32  # a rate lies at the end of what these times can tell, or its error is as large as it is
    )
    MISFIT = 64  # the model misses the data by more than noise; errors are widened


_CLIPPED, _DARK, _UNCONVERGED = int(Flag.CLIPPED), int(Flag.DARK), int(Flag.UNCONVERGED)
_FEWER, _UNDETERMINED, _MISFIT = int(Flag.FEWER), int(Flag.UNDETERMINED), int(Flag.MISFIT)


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
        index, inverse: by number of states: (n_sets, n) and (n_sets, n, n).
    """

    log_kr: Array
    columns: Array
    weight: Array
    index: tuple[NDArray[np.int64], ...]
    inverse: tuple[Array, ...]


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
        wide = [np.zeros((n_pixels, n_states), np.float32) for _ in range(4)]
        return cls(
            *wide,
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
        index, inverse = [], []
        for n in range(1, self.n_states + 1):
            chosen = list(combinations(range(n_grid), n))
            if n == near.size:
                chosen.append(tuple(range(n_grid, rates.size)))
            sets = np.array(chosen, np.int64)
            A = matrix[sets[:, :, None], sets[:, None, :]]
            # Only the ranking of sets matters here, not digits.
            A = A + 1e-10 * np.eye(n) * np.trace(A, axis1=1, axis2=2)[:, None, None]
            index.append(sets)
            inverse.append(np.linalg.inv(A))
        return Grid(np.log(rates), np.ascontiguousarray(g.T), weight, tuple(index), tuple(inverse))


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

    def task(first: int) -> None:
        some = slice(first, min(first + _PIXELS_A_TASK, n_pixels))
        _fit(
            problem.t_s,
            problem.exposure_s,
            noise.floor,
            noise.gain,
            noise.repeatability,
            problem.typical,
            problem.reference,
            problem.n_states,
            np.log(np.array(problem.limits_per_s)) + np.log([0.01, 10.0]),
            _ROUNDS if varies else 1,
            grid.log_kr,
            grid.columns,
            grid.weight,
            grid.index,
            grid.inverse,
            y[some],
            *(values[some] for values in vars(fits).values()),
        )

    with ThreadPoolExecutor(threads or len(os.sched_getaffinity(0))) as pool:
        list(pool.map(task, range(0, n_pixels, _PIXELS_A_TASK)))
    return fits


@compiled
def _fit(
    t_s: Array,
    exposure_s: Array,
    floor: Array,
    gain: Array,
    repeatability: float,
    typical: Array,
    reference: int,
    n_states: int,
    limits: Array,
    rounds: int,
    log_grid: Array,
    columns: Array,
    grid_weight: Array,
    index: tuple[NDArray[np.int64], ...],
    inverse: tuple[Array, ...],
    values: Pixels,
    kr: Pixels,
    amplitude: Pixels,
    kr_error: Pixels,
    amplitude_error: Pixels,
    colour: Pixels,
    chi2_per_dof: Pixels,
    flags: NDArray[np.uint8],
) -> None:
    """Fit the pixels of `values`, and write what `PixelFits` holds."""
    n_pixels, n_frames, n_channels = values.shape
    y, variance = np.empty((n_frames, n_channels)), np.empty((n_frames, n_channels))
    z, weight, m = np.empty(n_frames), np.empty(n_frames), np.empty(n_frames)
    C = np.empty(n_channels)
    work, state, trial = np.zeros((12, n_frames)), np.zeros((14, 4)), np.zeros((14, 4))
    projection, log_kr = np.empty(log_grid.size), np.zeros(4)
    for p in range(n_pixels):
        for k in range(n_frames):
            for c in range(n_channels):
                y[k, c] = values[p, k, c]
                variance[k, c] = floor[k, c] + gain[k, c] * max(typical[k, c], 0.0)
                m[k] = typical[k, reference]
                if math.isnan(y[k, c]):
                    flags[p] |= _CLIPPED
        n, chi2, converged, n_used = n_states, 0.0, False, 0
        if not _recolour(y, variance, m, reference, C, state[0], 0):
            flags[p] |= _DARK
            continue
        for turn in range(rounds):
            n_used, seen = _combine(y, floor, gain, repeatability, C, m, variance, z, weight)
            if n_used < 2 * n_states + 1 or (turn == 0 and not seen > _VISIBLE):
                n = 0
                break
            found = False
            if turn == 0:
                for i in range(log_grid.size):
                    projection[i] = 0.0
                    for k in range(n_frames):
                        projection[i] += columns[i, k] * grid_weight[k] * z[k]
            else:
                chi2, converged = search(t_s, exposure_s, z, weight, log_kr, n, limits, state, trial, work)
                found = sound(log_kr, state[0], n)
            while n > 0 and not found:
                for rank in range(_STARTS):
                    if not start(projection, index[n - 1], inverse[n - 1], n, rank, log_grid, log_kr):
                        break
                    chi2, converged = search(
                        t_s, exposure_s, z, weight, log_kr, n, limits, state, trial, work
                    )
                    found = sound(log_kr, state[0], n)
                    if found:
                        break
                if not found:
                    n -= 1
            if n == 0:
                break
            for k in range(n_frames):
                m[k] = 0.0
            for i in range(n):
                column(t_s, exposure_s, log_kr[i], work[0], work[1])
                for k in range(n_frames):
                    m[k] += state[0, i] * work[0, k]
            if not _recolour(y, variance, m, reference, C, state[0], n):
                n = 0
                break
        if n == 0:
            flags[p] |= _DARK
            continue
        if n < n_states:
            flags[p] |= _FEWER
        if not converged:
            flags[p] |= _UNCONVERGED
        dof = n_used - 2 * n
        chi2_per_dof[p] = chi2 / dof
        spread = 2 / (9 * dof)  # Wilson and Hilferty 1931
        widen = 1.0
        if chi2 > dof * (1 - spread + _CHANCE * math.sqrt(spread)) ** 3:
            flags[p] |= _MISFIT
            widen = math.sqrt(chi2 / dof)
        of_scale = _scale_variance(y, variance, m, C, reference)
        _errors(state, n, of_scale, work)
        for c in range(n_channels):
            colour[p, c] = C[c]
        for i in range(n):
            place = 0
            for j in range(n):
                if log_kr[j] > log_kr[i]:
                    place += 1
            rate, error = math.exp(log_kr[i]), widen * work[0, i]
            kr[p, place], amplitude[p, place] = rate, state[0, i]
            kr_error[p, place], amplitude_error[p, place] = rate * error, widen * work[1, i]
            if not error < 1.0 or log_kr[i] <= limits[0] or log_kr[i] >= limits[1]:
                flags[p] |= _UNDETERMINED


@compiled
def _combine(
    y: Array,
    floor: Array,
    gain: Array,
    repeatability: float,
    C: Array,
    m: Array,
    variance: Array,
    z: Array,
    weight: Array,
) -> tuple[int, float]:
    """Write σ² about the model C m, the common series z and its weights; return used frames and light over noise."""
    used, with_model, of_model = 0, 0.0, 0.0
    for k in range(m.size):
        information, total = 0.0, 0.0
        for c in range(C.size):
            variance[k, c] = floor[k, c] + gain[k, c] * max(C[c] * m[k], 0.0)
            if not math.isnan(y[k, c]):
                information += C[c] * C[c] / variance[k, c]
                total += C[c] * y[k, c] / variance[k, c]
        if information > 0.0:
            used += 1
            z[k] = total / information
            weight[k] = 1 / (1 / information + (repeatability * m[k]) ** 2)
        else:
            z[k], weight[k] = m[k], 0.0
        with_model += weight[k] * z[k] * m[k]
        of_model += weight[k] * m[k] * m[k]
    return used, with_model / math.sqrt(of_model) if of_model > 0.0 else 0.0


@compiled
def _recolour(
    y: Array, variance: Array, m: Array, reference: int, C: Array, amplitude: Array, n: int
) -> bool:
    """Write the colour of least squares for the model m, and bring m and its amplitudes to C = 1 in the reference."""
    for c in range(C.size):
        above, below = 0.0, 0.0
        for k in range(m.size):
            if not math.isnan(y[k, c]):
                above += y[k, c] * m[k] / variance[k, c]
                below += m[k] * m[k] / variance[k, c]
        C[c] = above / below if below > 0.0 else 0.0
    scale = C[reference]
    if not scale > 0.0:
        return False
    for c in range(C.size):
        C[c] /= scale
    for k in range(m.size):
        m[k] *= scale
    for i in range(n):
        amplitude[i] *= scale
    return True


@compiled
def _scale_variance(y: Array, variance: Array, m: Array, C: Array, reference: int) -> float:
    """Return the relative variance that amplitudes have beyond that of the common series.

    All channels tell the shape, but with a free colour only the reference tells the height: 1/I_ref - 1/I_all.
    """
    own, every = 0.0, 0.0
    for k in range(m.size):
        for c in range(C.size):
            if not math.isnan(y[k, c]):
                information = (C[c] * m[k]) ** 2 / variance[k, c]
                every += information
                if c == reference:
                    own += information
    return 1 / own - 1 / every if own > 0.0 else math.inf


@compiled
def _errors(state: Array, n: int, of_scale: float, work: Array) -> None:
    """Write standard errors of log kr to work[0] and of A to work[1], from what `search` left.

    With G = gᵀ W g and X = G⁻¹ gᵀ W d A, the covariance of log kr is the inverse of the projected normal matrix N, and
    that of A is G⁻¹ + X N⁻¹ Xᵀ.
    """
    G, X = np.zeros((4, 4)), np.zeros((4, 4))
    N, inverse = np.zeros((4, 4)), np.zeros((4, 4))
    unit = np.zeros(4)
    N[:] = state[2:6]
    ok = cholesky(N, n)
    for i in range(n):
        unit[:] = 0.0
        unit[i] = 1.0
        substitute(state[6:10], n, unit)
        G[:, i] = unit
        unit[:] = 0.0
        unit[i] = 1.0
        if ok:
            substitute(N, n, unit)
        inverse[:, i] = unit
    for i in range(n):
        for j in range(n):
            for k in range(n):
                X[i, j] += G[i, k] * state[10 + k, j]
    for i in range(n):
        total = G[i, i] + of_scale * state[0, i] ** 2
        for j in range(n):
            for k in range(n):
                total += X[i, j] * inverse[j, k] * X[i, k]
        work[0, i] = math.sqrt(max(inverse[i, i], 0.0)) if ok else math.inf
        work[1, i] = math.sqrt(max(total, 0.0)) if ok else math.inf
