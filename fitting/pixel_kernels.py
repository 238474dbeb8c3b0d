"""The search for rates in one short series, compiled for millions of them.

    z_k ≈ Σ_i A_i g_i(t_k),    g_i = exp(-kr_i t) averaged over the exposure

Amplitudes are eliminated at each step (variable projection, with the Jacobian of Kaufman 1975); log rates are searched
by Levenberg's and Marquardt's steps on normal equations of at most 4 x 4, whose columns g_i and ∂g_i/∂log kr_i are
exact. Starts come from a grid of rates and need no guess.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting.compiled import compiled

Array = NDArray[np.float64]

_MOST_STEPS = 60
_LONGEST_STEP = 2.0
# χ² that a step may still gain: its square root is the step in standard errors.
_SETTLED = 1e-6
_SAME_RATE = math.log(1.05)
# Below this kr τ, differences of exponentials lose digits and a series does not.
_SHORT = 1e-3


@compiled
def column(t_s: Array, exposure_s: Array, log_kr: float, g: Array, d: Array) -> None:
    """Write exp(-kr t) averaged over exposures to g (n,), and its derivative by log kr to d."""
    kr = math.exp(log_kr)
    for k in range(t_s.size):
        start = math.exp(-kr * t_s[k])
        x = kr * exposure_s[k]
        if x == 0.0:
            phi, slope = 1.0, 0.0
        elif x < _SHORT:
            phi = 1 - x / 2 * (1 - x / 3 * (1 - x / 4))
            slope = -x / 2 * (1 - 2 * x / 3 * (1 - 3 * x / 8))
        else:
            end = math.exp(-x)
            phi = (1 - end) / x
            slope = end - phi
        g[k] = start * phi
        d[k] = start * (slope - kr * t_s[k] * phi)


@compiled
def _dot(a: Array, b: Array) -> float:
    total = 0.0
    for k in range(a.size):
        total += a[k] * b[k]
    return total


@compiled
def cholesky(a: Array, n: int) -> bool:
    """Replace the lower triangle of a[:n, :n] by its root; False if it is not positive to ten digits."""
    for i in range(n):
        whole = a[i, i]
        for j in range(i + 1):
            total = a[i, j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            if i == j:
                if not total > 1e-13 * whole:
                    return False
                a[i, i] = math.sqrt(total)
            else:
                a[i, j] = total / a[j, j]
    return True


@compiled
def substitute(root: Array, n: int, x: Array) -> None:
    """Solve with the root of `cholesky`, in place."""
    for i in range(n):
        for k in range(i):
            x[i] -= root[i, k] * x[k]
        x[i] /= root[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= root[k, i] * x[k]
        x[i] /= root[i, i]


@compiled
def _project(
    t_s: Array,
    exposure_s: Array,
    z: Array,
    weight: Array,
    log_kr: Array,
    n: int,
    amplitude: Array,
    gradient: Array,
    normal: Array,
    root: Array,
    cross: Array,
    work: Array,
) -> float:
    """Eliminate the amplitudes at log rates; return χ².

    Args:
        amplitude, gradient, normal: written: A (n,), half the gradient of χ² by log kr (n,), and the normal matrix of
            the projected problem (n, n).
        root, cross: written: the root of the matrix of gᵀ W g, and gᵀ W d A (n, n).
        work: (12, n_frames).
    """
    for i in range(n):
        column(t_s, exposure_s, log_kr[i], work[i], work[4 + i])
    for i in range(n):
        for k in range(z.size):
            work[8 + i, k] = work[i, k] * weight[k]
        for j in range(i + 1):
            root[i, j] = _dot(work[8 + i], work[j])
        amplitude[i] = _dot(work[8 + i], z)
        for j in range(n):
            cross[i, j] = _dot(work[8 + i], work[4 + j])
    if not cholesky(root, n):
        return math.inf
    substitute(root, n, amplitude)
    chi2 = 0.0
    # The residual, and not a difference of sums: it keeps its digits when the fit is good.
    for i in range(n):
        gradient[i] = 0.0
    for k in range(z.size):
        left = z[k]
        for i in range(n):
            left -= amplitude[i] * work[i, k]
        weighted = weight[k] * left
        chi2 += weighted * left
        for i in range(n):
            gradient[i] -= weighted * amplitude[i] * work[4 + i, k]
    for i in range(n):
        for k in range(z.size):
            work[8 + i, k] = work[4 + i, k] * weight[k]
        for j in range(i + 1):
            normal[i, j] = _dot(work[8 + i], work[4 + j]) * amplitude[i] * amplitude[j]
    for j in range(n):
        for i in range(n):
            cross[i, j] *= amplitude[j]
    # normal -= crossᵀ (gᵀ W g)⁻¹ cross, by half the substitution.
    for j in range(n):
        for i in range(n):
            total = cross[i, j]
            for k in range(i):
                total -= root[i, k] * work[8 + j, k]
            work[8 + j, i] = total / root[i, i]
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += work[8 + i, k] * work[8 + j, k]
            normal[i, j] -= total
            normal[j, i] = normal[i, j]
    return chi2


@compiled
def search(
    t_s: Array,
    exposure_s: Array,
    z: Array,
    weight: Array,
    log_kr: Array,
    n: int,
    limits: Array,
    state: Array,
    trial: Array,
    work: Array,
) -> tuple[float, bool]:
    """Move log kr (n,) to the minimum of χ²; return it and whether it was reached.

    Args:
        limits: lowest and highest log kr.
        state, trial: (14, 4) each; rows 0: A, 1: gradient, 2..5: normal matrix, 6..9: root, 10..13: cross.
    """
    chi2 = _project(
        t_s, exposure_s, z, weight, log_kr, n, state[0], state[1], state[2:6], state[6:10], state[10:14], work
    )
    damping, growth = 1e-4, 2.0
    step = np.empty(4)
    moved = np.empty(4)
    damped = np.empty((4, 4))
    for _ in range(_MOST_STEPS):
        if not chi2 < math.inf:
            return chi2, False
        largest = 0.0
        for i in range(n):
            largest = max(largest, state[2 + i, i])
        for i in range(n):
            # What is at an edge and pulled beyond it stays.
            held = (log_kr[i] <= limits[0] and state[1, i] > 0) or (
                log_kr[i] >= limits[1] and state[1, i] < 0
            )
            for j in range(n):
                damped[i, j] = state[2 + i, j]
            step[i] = -state[1, i]
            if held:
                damped[i, i] = 1e12 * largest
                step[i] = 0.0
            damped[i, i] += damping * damped[i, i] + 1e-12 * largest
        if not cholesky(damped, n):
            damping *= 10
            if damping > 1e10:
                return chi2, False
            continue
        substitute(damped, n, step)
        longest = 0.0
        for i in range(n):
            longest = max(longest, abs(step[i]))
        shrink = min(1.0, _LONGEST_STEP / longest) if longest > 0 else 1.0
        foreseen = 0.0
        for i in range(n):
            moved[i] = min(max(log_kr[i] + shrink * step[i], limits[0]), limits[1])
            step[i] = moved[i] - log_kr[i]
        for i in range(n):
            foreseen -= 2 * step[i] * state[1, i]
            for j in range(n):
                foreseen -= step[i] * state[2 + i, j] * step[j]
        if foreseen < _SETTLED and (damping < 1.0 or foreseen < 1e-3 * _SETTLED):
            return chi2, True
        there = _project(
            t_s,
            exposure_s,
            z,
            weight,
            moved,
            n,
            trial[0],
            trial[1],
            trial[2:6],
            trial[6:10],
            trial[10:14],
            work,
        )
        if there < chi2:
            ratio = (chi2 - there) / foreseen
            damping = max(damping * max(0.1, 1 - (2 * ratio - 1) ** 3), 1e-9)
            growth = 2.0
            chi2 = there
            for i in range(n):
                log_kr[i] = moved[i]
            state[:] = trial
        else:
            damping, growth = damping * growth, growth * 2
            if damping > 1e10:
                return chi2, True
    return chi2, False


@compiled
def start(
    projection: Array,
    index: NDArray[np.int64],
    inverse: Array,
    n: int,
    rank: int,
    log_grid: Array,
    log_kr: Array,
) -> bool:
    """Write the `rank`-th best set of rates of a grid; False if there is none with positive amplitudes.

    Args:
        projection: (n_grid,) gᵀ W z at the grid's rates.
        index, inverse: (n_sets, n) which rates a set has, and (n_sets, n, n) the inverse of its matrix gᵀ W g.
    """
    taken = -1
    for turn in range(rank + 1):
        best, chosen = 0.0, -1
        for s in range(index.shape[0]):
            if turn > 0:
                # Neighbours on the grid lead to the same minimum.
                apart = 0
                for i in range(n):
                    apart += abs(index[s, i] - index[taken, i])
                if apart < 2:
                    continue
            explained, positive = 0.0, True
            for i in range(n):
                a = 0.0
                for j in range(n):
                    a += inverse[s, i, j] * projection[index[s, j]]
                if a <= 0.0:
                    positive = False
                    break
                explained += a * projection[index[s, i]]
            if positive and explained > best:
                best, chosen = explained, s
        taken = chosen
        if chosen < 0:
            return False
    for i in range(n):
        log_kr[i] = log_grid[index[taken, i]]
    return True


@compiled
def sound(log_kr: Array, amplitude: Array, n: int) -> bool:
    """Whether every state has light and a rate of its own."""
    for i in range(n):
        if not amplitude[i] > 0.0:
            return False
        for j in range(i):
            if abs(log_kr[i] - log_kr[j]) < _SAME_RATE:
                return False
    return True
