"""Variable projection: least squares in which the linear parameters are eliminated, never searched.

The problem is min over θ and x >= 0 of |y - Φ(θ) x|², with y and Φ already weighted. For each θ the best x is
a non-negative linear problem, so only θ is searched, with the exact Jacobian of the projected residual
(Golub and Pereyra 1973) on the columns that are not held at 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr, solve_triangular
from scipy.optimize import least_squares, nnls

Array = NDArray[np.float64]

# θ (n_θ,) -> Φ (m, n_x) and its derivatives dΦ/dθ (n_θ, m, n_x)
Basis = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True)
class Solution:
    """A minimum: nonlinear θ, linear x >= 0, and the weighted residual y - Φ x there."""

    theta: Array
    linear: Array
    residual: Array

    @property
    def chi2(self) -> float:
        """Sum of squared weighted residuals."""
        return float(self.residual @ self.residual)


def solve(basis: Basis, y: Array, start: Array) -> Solution:
    """Minimise from one start, to the precision of float64.

    Args:
        basis: maps θ to Φ and dΦ/dθ; rows are weighted (divided by σ) like `y`.
        y: (m,) weighted data.
        start: (n_θ,) where the search begins.
    """

    def projected(theta: Array) -> Array:
        phi, _ = basis(theta)
        return y - phi @ linear_part(phi, y)

    def jacobian(theta: Array) -> Array:
        phi, dphi = basis(theta)
        x = linear_part(phi, y)
        free = x > 0
        if not free.any():
            return np.zeros((y.size, theta.size))
        q, r = qr(phi[:, free], mode="economic")
        residual = y - phi[:, free] @ x[free]
        moved = dphi[:, :, free] @ x[free]  # (n_θ, m): dΦ x
        off_range = moved - (moved @ q) @ q.T
        back = solve_triangular(r, dphi[:, :, free].transpose(0, 2, 1) @ residual[:, None], trans=1)
        exact: Array = -(off_range + (q @ back)[..., 0]).T
        return exact

    # Both tolerances at machine precision: a fit costs milliseconds, and digits lost here are lost for good.
    eps = float(np.finfo(np.float64).eps)
    found = least_squares(projected, start, jacobian, method="lm", xtol=eps, ftol=eps, gtol=eps, max_nfev=400)
    theta = _polish(projected, jacobian, found.x)
    phi, _ = basis(theta)
    x = linear_part(phi, y)
    return Solution(theta=theta, linear=x, residual=y - phi @ x)


def _polish(projected: Callable[[Array], Array], jacobian: Callable[[Array], Array], theta: Array) -> Array:
    """Take Gauss-Newton steps for as long as they shrink.

    A search that compares sums of squares stops at the root of the machine precision: nearer to the minimum
    they no longer differ. The steps themselves still do, and lose digits only to the condition of J.
    """
    last = np.inf
    for _ in range(20):
        step = np.linalg.lstsq(jacobian(theta), -projected(theta), rcond=None)[0]
        size = float(np.linalg.norm(step))
        if not size < 0.5 * last or size > 1e-2:
            break
        theta, last = theta + step, size
    return theta


def linear_part(phi: Array, y: Array) -> Array:
    """Return (n_x,) the x >= 0 that minimises |y - Φ x|²."""
    scale = np.linalg.norm(phi, axis=0)
    usable = scale > 0
    x = np.zeros(phi.shape[1])
    if usable.any():
        # Columns of unit length: the active set then does not depend on how a basis function is scaled.
        x[usable] = nnls(phi[:, usable] / scale[usable], y)[0] / scale[usable]
    return x


def covariance(basis: Basis, solution: Solution) -> Array:
    """Return (n_θ + n_x, n_θ + n_x): the covariance of (θ, x) for unit-variance data, by QR.

    A parameter that the data do not determine (a linear one at 0, or one whose column vanishes) gets infinity.
    """
    phi, dphi = basis(solution.theta)
    J = np.concatenate([(dphi @ solution.linear).T, phi], axis=1)
    held = np.concatenate([np.zeros(solution.theta.size, bool), solution.linear == 0])
    scale = np.linalg.norm(J, axis=0)
    free = ~held & (scale > 0)
    cov = np.full((J.shape[1], J.shape[1]), np.inf)
    r = qr(J[:, free] / scale[free], mode="r")[0][: int(free.sum())]
    if np.abs(np.diag(r)).min(initial=1.0) <= np.finfo(float).eps * J.shape[0]:
        return cov
    inverse = solve_triangular(r, np.eye(r.shape[0])) / scale[free, None]
    cov[np.ix_(free, free)] = inverse @ inverse.T
    return cov
