"""Non-negative, smooth solutions of linear equations, as smooth as the data say.

    minimise  Σ ((A x - y) / σ)² + μ |D x|²   over x >= 0

μ minimises the generalised cross-validation score (Golub, Heath and Wahba 1979)

    GCV(μ) = n RSS / (n - γ t)²,     t = trace of the matrix that maps y to A x,

with γ = 1.4, which keeps it from following noise when data are few (Kim and Gu 2004). The score is flat around its
minimum: of what it cannot tell apart, or what fits within the noise, the smoothest is taken. The band is that of the
posterior of which x is the mean, s² (AᵀA + μ DᵀD)⁻¹: over all of a curve it covers as often as it says (Wahba 1983),
too wide where the curve is smooth and too narrow where it bends most. There smoothing has pulled x away from what the
data say; how far it moves when smoothed ten times less tells by how much (`Solution.pull`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import bandwidth, cho_factor, cho_solve, cho_solve_banded, cholesky_banded
from scipy.sparse import csr_array

Array = NDArray[np.float64]

_GAMMA = 1.4
_ROUNDS = 100
_EXACT, _SIGNS = 300, 40


@dataclass(frozen=True, eq=False)
class Normal:
    """Weighted equations as normal equations; they add up over data.

    Args:
        matrix: (n, n) Aᵀ A, rows divided by σ.
        right: (n,) Aᵀ y.
        squares: y · y.
        n_data: how many rows.
    """

    matrix: Array
    right: Array
    squares: float
    n_data: int

    @classmethod
    def of(cls, A: Array, y: Array, sigma: Array) -> Normal:
        """From rows A (m, n), y (m,) with standard deviations sigma (m,); rows with an infinite one say nothing."""
        used = np.isfinite(sigma) & np.isfinite(y)
        weighted, right = A[used] / sigma[used, None], y[used] / sigma[used]
        return cls(weighted.T @ weighted, weighted.T @ right, float(right @ right), int(used.sum()))

    def misfit(self, x: Array) -> float:
        """Σ ((A x - y) / σ)²."""
        return max(float(x @ self.matrix @ x - 2 * self.right @ x + self.squares), 0.0)


@dataclass(frozen=True, eq=False)
class Solution:
    """A regularised solution.

    Args:
        x: (n,).
        covariance: (n, n) of the posterior; of what is held at 0, as if it were free.
        pull: (n,) x less what it is at a tenth of the strength: what smoothing has done to it, to first order in μ
            (there the bias is μ M⁻¹ DᵀD x, of which nine tenths are seen), and some noise.
        strength: μ.
        misfit: Σ ((A x - y) / σ)².
        degrees: effective number of parameters, t.
        n_data: number of data.
        at_end: the score still fell at the end of the range of μ that was searched.
    """

    x: Array
    covariance: Array
    pull: Array
    strength: float
    misfit: float
    degrees: float
    n_data: int
    at_end: bool

    @property
    def standard_error(self) -> Array:
        """(n,) of x."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def scale(self) -> float:
        """Misfit per degree of freedom, 1 where σ describes the noise."""
        return self.misfit / max(self.n_data - self.degrees, 1.0)


def second_differences(n: int) -> Array:
    """(n - 2, n) the second difference of neighbours."""
    return np.diff(np.eye(n), 2, axis=0)


def solve(normal: Normal, penalty: Array, span: tuple[float, float] = (1e-7, 1e5)) -> Solution:
    """Solve with the strength of the penalty chosen by generalised cross-validation of the non-negative solution.

    Args:
        penalty: (n, n), DᵀD.
        span: of μ, relative to what makes the penalty weigh as much as the data.

    Returns:
        The solution of the best strength; `Solution.at_end` where the best lies at an end of `span`.
    """
    unit = float(np.trace(normal.matrix)) / max(float(np.trace(penalty)), 1e-300)
    free = np.ones(normal.right.size, dtype=bool)
    tried: dict[float, tuple[float, NDArray[np.bool_], bool]] = {}

    def score(mu: float) -> float:
        nonlocal free
        if mu not in tried:
            tried[mu] = _score(normal, normal.matrix + mu * penalty, free)
        free = tried[mu][1]
        return tried[mu][0]

    # From smooth to rough, each from what was free before: the sets change little.
    grid = unit * np.geomspace(*span, 13)[::-1]
    scores = np.array([score(float(mu)) for mu in grid])
    # The smoothest that is no worse than the best by more than the score's own standard error (Breiman et al. 1984).
    # So is what misses the data by no more than their noise.
    limit = float(scores.min()) * (1 + np.sqrt(2 / max(normal.n_data, 1)))

    def serves(mu: float) -> bool:
        return score(mu) <= limit or tried[mu][2]

    k = next(k for k, mu in enumerate(grid) if serves(float(mu)))
    at_end = k in (0, grid.size - 1)
    best = float(grid[k])
    for factor in (10**0.5, 10**0.25):
        if serves(best * factor):
            best *= factor
    free = tried[best][1]
    M = normal.matrix + best * penalty
    M = M + _jitter(M)
    x, _ = non_negative(M, normal.right, free)
    inverse = _solver(M)(np.ones(x.size, dtype=bool))(np.eye(x.size))
    degrees = _degrees(normal, M, x > 0)
    misfit = normal.misfit(x)
    # Noise is not made smaller than σ says: a lucky fit is no better camera.
    scale = max(1.0, misfit / max(normal.n_data - degrees, 1.0))
    less = normal.matrix + best / 10 * penalty
    rougher, _ = non_negative(less + _jitter(less), normal.right, free)
    return Solution(x, scale * inverse, x - rougher, float(best), misfit, degrees, normal.n_data, at_end)


def non_negative(
    M: Array, right: Array, free: NDArray[np.bool_] | None = None
) -> tuple[Array, NDArray[np.bool_]]:
    """Return x >= 0 that minimises x·M x / 2 - right·x, M positive definite; and which of it is not held at 0.

    By block principal pivoting (Portugal, Judice and Vicente 1994): whole sets of unknowns change between
    "free" and "0", which takes a few factorisations however many there are.

    Args:
        free: where to begin; all.
    """
    n = right.size
    free = np.ones(n, dtype=bool) if free is None else free.copy()
    fewest, patience = n + 1, 3
    x = np.zeros(n)
    tolerance = 1e-12 * max(float(np.abs(right).max()), 1e-300)
    solver, product = _solver(M), csr_array(M)
    for _ in range(_ROUNDS):
        x = solver(free)(right) if free.any() else np.zeros(n)
        gradient = product @ x - right
        wrong = (free & (x < 0)) | (~free & (gradient < -tolerance))
        if not wrong.any():
            break
        if wrong.sum() < fewest:
            fewest, patience = int(wrong.sum()), 3
        elif patience:
            patience -= 1
        else:
            # Murty's rule: one at a time, the last; slow, but it ends.
            only = np.zeros(n, dtype=bool)
            only[np.flatnonzero(wrong)[-1]] = True
            wrong = only
        free ^= wrong
    return np.maximum(x, 0.0), free


def _score(normal: Normal, M: Array, free: NDArray[np.bool_]) -> tuple[float, NDArray[np.bool_], bool]:
    """The score of the solution with matrix M, what is free in it, and whether it fits within the noise."""
    M = M + _jitter(M)
    x, free = non_negative(M, normal.right, free)
    degrees, misfit = _degrees(normal, M, free), normal.misfit(x)
    rest = normal.n_data - _GAMMA * degrees
    score = float("inf") if rest <= 0 else normal.n_data * misfit / rest**2
    return score, free, misfit <= normal.n_data - degrees


def _degrees(normal: Normal, M: Array, free: NDArray[np.bool_]) -> float:
    """Trace of the matrix that maps y to A x, with what is held at 0 left out."""
    if not free.any():
        return 0.0
    solve_free = _solver(M)(free)
    if free.sum() <= _EXACT:
        return float(np.trace(solve_free(normal.matrix)[np.ix_(free, free)]))
    # The trace of a large matrix from products with random signs (Girard 1989), the same at every strength.
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (free.size, _SIGNS)) * free[:, None]
    return float(np.sum(solve_free(signs) * (normal.matrix @ signs)) / _SIGNS)


def _solver(M: Array) -> Callable[[NDArray[np.bool_]], Callable[[Array], Array]]:
    """Return what takes which unknowns are free, and returns what solves M x = b for these, with the others at 0.

    M is positive definite. What is held at 0 has its rows and columns replaced by those of the unit matrix: so a
    narrow band stays one, and nothing is sorted out of it.
    """
    n = M.shape[0]
    width = int(bandwidth(M)[0])
    if width > n // 4:

        def dense(free: NDArray[np.bool_]) -> Callable[[Array], Array]:
            both = np.ix_(free, free)
            factor = cho_factor(M[both])

            def solve(b: Array) -> Array:
                x = np.zeros_like(b)
                x[free] = cho_solve(factor, b[free])
                return x

            return solve

        return dense

    band = np.zeros((width + 1, n))
    for k in range(width + 1):
        band[k, : n - k] = np.diagonal(M, k)

    def banded(free: NDArray[np.bool_]) -> Callable[[Array], Array]:
        both = np.zeros(band.shape, dtype=bool)
        for k in range(width + 1):
            both[k, : n - k] = free[: n - k] & free[k:]
        held = np.where(both, band, 0.0)
        held[0, ~free] = 1.0
        lower = cholesky_banded(held, lower=True)
        return lambda b: np.asarray(cho_solve_banded((lower, True), (b.T * free).T))

    return banded


def _jitter(M: Array) -> Array:
    """Keeps a matrix positive definite that rounding has made a little less."""
    return np.asarray(np.eye(M.shape[0]) * 1e-12 * float(np.trace(M)) / M.shape[0])
