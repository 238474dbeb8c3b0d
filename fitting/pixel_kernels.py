"""What is done to each pixel, compiled: one series of its channels, the search for its rates, and their errors.

    z_k ≈ Σ_i A_i g_i(t_k),    g_i = exp(-kr_i t) averaged over the exposure

`fit` and what follows it make the series and its weights (see `pixel_decay`); what comes before searches. Amplitudes
are eliminated at each step (variable projection, with the Jacobian of Kaufman 1975); log rates are searched by
Levenberg's and Marquardt's steps on normal equations of at most 4 x 4, whose columns g_i and ∂g_i/∂log kr_i are exact.
Starts come from a grid of rates and need no guess.

All of it lies in one file, because numba looks only there whether what it has kept is still of today.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting.compiled import compiled

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]

# Bits of `pixel_decay.Flag`, as compiled code sees them.
CLIPPED, DARK, UNCONVERGED, FEWER, UNDETERMINED, MISFIT = 2, 4, 8, 16, 32, 64

_MOST_STEPS = 60
_LONGEST_STEP = 2.0
# χ² that a step may still gain: its square root is the step in standard errors.
_SETTLED = 1e-6
_SAME_RATE = math.log(1.05)
# Below this kr τ, differences of exponentials lose digits and a series does not.
_SHORT = 1e-3
_STARTS = 2
# A series whose light stands less than this many standard errors above nothing is not fitted.
_VISIBLE = 10.0
# χ² beyond this normal deviate is no chance (1 in 1,000): standard errors are widened by its root.
_CHANCE = 3.09


@compiled
def _column(t_s: Array, exposure_s: Array, log_kr: float, g: Array, d: Array) -> None:
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
def _cholesky(a: Array, n: int) -> bool:
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
def _substitute(root: Array, n: int, x: Array) -> None:
    """Solve with the root of `_cholesky`, in place."""
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
        _column(t_s, exposure_s, log_kr[i], work[i], work[4 + i])
    for i in range(n):
        for k in range(z.size):
            work[8 + i, k] = work[i, k] * weight[k]
        for j in range(i + 1):
            root[i, j] = _dot(work[8 + i], work[j])
        amplitude[i] = _dot(work[8 + i], z)
        for j in range(n):
            cross[i, j] = _dot(work[8 + i], work[4 + j])
    if not _cholesky(root, n):
        return math.inf
    _substitute(root, n, amplitude)
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
def _search(
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
        if not _cholesky(damped, n):
            damping *= 10
            if damping > 1e10:
                return chi2, False
            continue
        _substitute(damped, n, step)
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
def _start(
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
        index, inverse: (n_sets, 4) which rates a set has, and (n_sets, 4, 4) the inverse of its matrix gᵀ W g.
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
def _sound(log_kr: Array, amplitude: Array, n: int) -> bool:
    """Whether every state has light and a rate of its own."""
    for i in range(n):
        if not amplitude[i] > 0.0:
            return False
        for j in range(i):
            if abs(log_kr[i] - log_kr[j]) < _SAME_RATE:
                return False
    return True


@compiled
def fit(
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
    index: NDArray[np.int64],
    inverse: Array,
    first: NDArray[np.int64],
    values: Pixels,
    kr: Pixels,
    amplitude: Pixels,
    kr_error: Pixels,
    amplitude_error: Pixels,
    colour: Pixels,
    chi2_per_dof: Pixels,
    flags: NDArray[np.uint8],
) -> None:
    """Fit the pixels of `values`, and write what `pixel_decay.PixelFits` holds."""
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
                    flags[p] |= CLIPPED
        n, chi2, converged, n_used = n_states, 0.0, False, 0
        if not _recolour(y, variance, m, reference, C, state[0], 0):
            flags[p] |= DARK
            continue
        for turn in range(rounds):
            n_used, seen = _combine(y, floor, gain, repeatability, C, m, variance, z, weight)
            if n_used < 2 * n_states + 1 or (turn == 0 and not seen > _VISIBLE):
                n = 0
                break
            # The first turn tries starts from the grid; later ones go on from what was found (rank -1).
            found, rank = False, -1
            if turn == 0:
                rank = 0
                for i in range(log_grid.size):
                    projection[i] = 0.0
                    for k in range(n_frames):
                        projection[i] += columns[i, k] * grid_weight[k] * z[k]
            while n > 0 and not found:
                some = slice(first[n - 1], first[n])
                if rank == _STARTS or (
                    rank >= 0
                    and not _start(projection, index[some], inverse[some], n, rank, log_grid, log_kr)
                ):
                    n, rank = n - 1, 0
                    continue
                chi2, converged = _search(t_s, exposure_s, z, weight, log_kr, n, limits, state, trial, work)
                found = _sound(log_kr, state[0], n)
                rank += 1
            if n == 0:
                break
            for k in range(n_frames):
                m[k] = 0.0
            for i in range(n):
                _column(t_s, exposure_s, log_kr[i], work[0], work[1])
                for k in range(n_frames):
                    m[k] += state[0, i] * work[0, k]
            if not _recolour(y, variance, m, reference, C, state[0], n):
                n = 0
                break
        if n == 0:
            flags[p] |= DARK
            continue
        if n < n_states:
            flags[p] |= FEWER
        if not converged:
            flags[p] |= UNCONVERGED
        dof = n_used - 2 * n
        chi2_per_dof[p] = chi2 / dof
        spread = 2 / (9 * dof)  # Wilson and Hilferty 1931
        widen = 1.0
        if chi2 > dof * (1 - spread + _CHANCE * math.sqrt(spread)) ** 3:
            flags[p] |= MISFIT
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
                flags[p] |= UNDETERMINED


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
    """Write standard errors of log kr to work[0] and of A to work[1], from what `_search` left.

    With G = gᵀ W g and X = G⁻¹ gᵀ W d A, the covariance of log kr is the inverse of the projected normal matrix N, and
    that of A is G⁻¹ + X N⁻¹ Xᵀ.
    """
    G, X = np.zeros((4, 4)), np.zeros((4, 4))
    N, inverse = np.zeros((4, 4)), np.zeros((4, 4))
    unit = np.zeros(4)
    N[:] = state[2:6]
    ok = _cholesky(N, n)
    for i in range(n):
        unit[:] = 0.0
        unit[i] = 1.0
        _substitute(state[6:10], n, unit)
        G[:, i] = unit
        unit[:] = 0.0
        unit[i] = 1.0
        if ok:
            _substitute(N, n, unit)
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
