"""Non-negative, smooth solutions of linear equations, as smooth as the data say.

    minimise  Σ ((A x - y) / σ)² + μ |D x|²   over x >= 0

The penalty says that D x is normal noise of variance s² / μ. So μ and s² are those under which the data are most
likely, x itself integrated out (restricted maximum likelihood; Wood 2011, doi 10.1111/j.1467-9868.2010.00749.x); s, by
how much σ understates the noise, is never below 1. Generalised cross-validation, which does not believe σ, now and then
hardly smooths at all, and its bands are too narrow where x bends. The band is that of the posterior of which x is the
mean, s² (AᵀA + μ DᵀD)⁻¹: over all of a curve it covers as often as it says (Wahba 1983) where D weighs bends by what is
expected there; it is too wide where x is smoother than that.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import bandwidth, cho_factor, cho_solve, cho_solve_banded, cholesky_banded
from scipy.optimize import minimize_scalar
from scipy.sparse import csr_array

Array = NDArray[np.float64]

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

    @classmethod
    def correlated(cls, A: Array, y: Array, covariance: Array) -> Normal:
        """From groups of rows A (k, m, n), y (k, m) whose errors go together within a group, covariance (k, m, m).

        Rows of infinite variance say nothing.
        """
        rows, right = [], []
        for a, b, c in zip(A, y, covariance, strict=True):
            used = np.isfinite(np.diag(c))
            root = np.linalg.cholesky(c[np.ix_(used, used)])
            rows.append(np.linalg.solve(root, a[used]))
            right.append(np.linalg.solve(root, b[used]))
        all_rows, all_right = np.concatenate(rows), np.concatenate(right)
        return cls.of(all_rows, all_right, np.ones(all_right.size))

    def misfit(self, x: Array) -> float:
        """Σ ((A x - y) / σ)²."""
        return max(float(x @ self.matrix @ x - 2 * self.right @ x + self.squares), 0.0)


@dataclass(frozen=True, eq=False)
class Solution:
    """A regularised solution.

    Args:
        x: (n,).
        covariance: (n, n) of the posterior; of what is held at 0, as if it were free.
        strength: μ.
        misfit: Σ ((A x - y) / σ)².
        degrees: effective number of parameters, t.
        n_data: number of data.
        at_end: the data were still more likely at the end of the range of μ that was searched.
    """

    x: Array
    covariance: Array
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


def solve(
    normal: Normal, penalty: Array, nullity: int = 2, span: tuple[float, float] = (1e-7, 1e5)
) -> Solution:
    """Solve with the strength of the penalty under which the data are most likely.

    The likelihood is that of solutions of either sign, for which it has a closed form.

    Args:
        penalty: (n, n), DᵀD.
        nullity: in how many dimensions it leaves x free; of second differences two, a straight line.
        span: of μ, relative to what makes the penalty weigh as much as the data.

    Returns:
        The solution of the best strength; `Solution.at_end` where the best lies at an end of `span`.
    """
    unit = float(np.trace(normal.matrix)) / max(float(np.trace(penalty)), 1e-300)
    rank = normal.right.size - nullity
    n_free = max(normal.n_data - nullity, 1)

    def weighed(log_strength: float) -> tuple[Array, _Factor, float]:
        """The matrix, its factor, and what is left of the data, in units of their noise."""
        M = normal.matrix + unit * np.exp(log_strength) * penalty
        M = M + _jitter(M)
        factor = _factors(M)(np.ones(normal.right.size, dtype=bool))
        return M, factor, normal.squares - float(normal.right @ factor.solve(normal.right))

    def unlikely(log_strength: float) -> float:
        """-2 log of the likelihood, but for a constant."""
        _, factor, left = weighed(log_strength)
        s2 = max(1.0, left / n_free)
        return left / s2 + n_free * float(np.log(s2)) + factor.log_determinant - rank * log_strength

    grid = np.log(np.geomspace(*span, 13))
    k = int(np.argmin([unlikely(g) for g in grid]))
    at_end = k in (0, grid.size - 1)
    best = float(grid[k])
    if not at_end:
        best = float(minimize_scalar(unlikely, bounds=(grid[k - 1], grid[k + 1]), options={"xatol": 0.05}).x)
    M, factor, left = weighed(best)
    x, free = non_negative(M, normal.right)
    return Solution(
        x=x,
        covariance=max(1.0, left / n_free) * factor.solve(np.eye(x.size)),
        strength=float(unit * np.exp(best)),
        misfit=normal.misfit(x),
        degrees=_degrees(normal, M, free),
        n_data=normal.n_data,
        at_end=at_end,
    )


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
    factors, product = _factors(M), csr_array(M)
    for _ in range(_ROUNDS):
        x = factors(free).solve(right) if free.any() else np.zeros(n)
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


def _degrees(normal: Normal, M: Array, free: NDArray[np.bool_]) -> float:
    """Trace of the matrix that maps y to A x, with what is held at 0 left out."""
    if not free.any():
        return 0.0
    solve_free = _factors(M)(free).solve
    if free.sum() <= _EXACT:
        return float(np.trace(solve_free(normal.matrix)[np.ix_(free, free)]))
    # The trace of a large matrix from products with random signs (Girard 1989), the same at every strength.
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (free.size, _SIGNS)) * free[:, None]
    return float(np.sum(solve_free(signs) * (normal.matrix @ signs)) / _SIGNS)


@dataclass(frozen=True, eq=False)
class _Factor:
    """A factored matrix: what solves M x = b with some unknowns held at 0, and log |M| of the others."""

    solve: Callable[[Array], Array]
    log_determinant: float


def _factors(M: Array) -> Callable[[NDArray[np.bool_]], _Factor]:
    """Return what factors M, positive definite, for the unknowns that are free.

    What is held at 0 has its rows and columns replaced by those of the unit matrix: so a narrow band stays one, and
    nothing is sorted out of it.
    """
    n = M.shape[0]
    width = int(bandwidth(M)[0])
    if width > n // 4:

        def dense(free: NDArray[np.bool_]) -> _Factor:
            factor = cho_factor(M[np.ix_(free, free)])

            def solve(b: Array) -> Array:
                x = np.zeros_like(b)
                x[free] = cho_solve(factor, b[free])
                return x

            return _Factor(solve, 2 * float(np.log(np.diag(factor[0])).sum()))

        return dense

    band = np.zeros((width + 1, n))
    for k in range(width + 1):
        band[k, : n - k] = np.diagonal(M, k)

    def banded(free: NDArray[np.bool_]) -> _Factor:
        both = np.zeros(band.shape, dtype=bool)
        for k in range(width + 1):
            both[k, : n - k] = free[: n - k] & free[k:]
        held = np.where(both, band, 0.0)
        held[0, ~free] = 1.0
        lower = cholesky_banded(held, lower=True)
        return _Factor(
            lambda b: np.asarray(cho_solve_banded((lower, True), (b.T * free).T)),
            2 * float(np.log(lower[0]).sum()),
        )

    return banded


def _jitter(M: Array) -> Array:
    """Keeps a matrix positive definite that rounding has made a little less."""
    return np.asarray(np.eye(M.shape[0]) * 1e-12 * float(np.trace(M)) / M.shape[0])
