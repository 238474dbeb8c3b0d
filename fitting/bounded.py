"""Least squares with lower bounds, and how far a quantity can go before the data object.

The search is Levenberg and Marquardt's; each step is itself a least-squares problem with the same bounds, solved
exactly (Lawson and Hanson 1974), so that a parameter ends on its bound or off it, never close to it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr, solve_triangular
from scipy.optimize import nnls

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# θ (n,) -> residuals (m,) and their Jacobian (m, n)
Residual = Callable[[Array], tuple[Array, Array]]

_EPS = float(np.finfo(np.float64).eps)
_MOST_STEPS = 200
# A foreseen decrease of chi² by this, in units of chi² per residual if that is above 1, ends the search: the step that
# is left is a ten-thousandth of a standard error.
_SETTLED = 1e-8
_MOST_LOOKS = 400
_OUTSIDE = 1e6


@dataclass(frozen=True, eq=False)
class Search:
    """A minimum: θ (n,), residuals (m,) and Jacobian (m, n) there."""

    theta: Array
    residual: Array
    jacobian: Array

    @property
    def chi2(self) -> float:
        """Sum of squared residuals."""
        return float(self.residual @ self.residual)


def search(residual: Residual, start: Array, lower: Array, held: Mask | None = None) -> Search:
    """Minimise the sum of squares from one start.

    Args:
        lower: (n,) θ is not below it; -inf for no bound.
        held: (n,) which of θ stay as they start; by default none.
    """
    moving = np.ones(start.size, bool) if held is None else ~held
    theta = np.maximum(start, lower)
    here = Search(theta, *residual(theta))
    damping, growth = 1e-3, 2.0
    scale = np.zeros(theta.size)
    for _ in range(_MOST_STEPS):
        # Marquardt's scale, never shrinking (Moré 1978).
        scale = np.maximum(scale, np.linalg.norm(here.jacobian, axis=0))
        step = _step(here, lower, damping, np.where(scale > 0, scale, 1.0), moving)
        moved = here.jacobian @ step
        foreseen = -float(moved @ (2 * here.residual + moved))
        if not foreseen > _SETTLED * max(1.0, here.chi2 / here.residual.size):
            break
        theta = np.maximum(here.theta + step, lower)
        there = Search(theta, *residual(theta))
        gained = here.chi2 - there.chi2
        # Where the model or its slope is no number, the step was too long.
        if gained > 0 and np.isfinite(there.jacobian).all():
            ratio = gained / foreseen
            damping = max(damping * max(1 / 5, 1 - (2 * ratio - 1) ** 3), 1e-14)  # Nielsen 1999
            here, growth = there, 2.0
        else:
            damping, growth = damping * growth, growth * 2
            if damping > 1e14:
                break
    return here


def _step(here: Search, lower: Array, damping: float, scale: Array, moving: Mask) -> Array:
    """Minimise |r + J step|² + damping |scale step|² with θ + step >= lower, in units of `scale`."""
    free = np.flatnonzero(moving & ~np.isfinite(lower))
    tied = np.flatnonzero(moving & np.isfinite(lower))
    order = np.concatenate([free, tied])
    q, r = np.linalg.qr(here.jacobian[:, order] / scale[order])
    stacked = np.concatenate([r, np.sqrt(damping) * np.eye(order.size)])
    q2, r = np.linalg.qr(stacked)
    right = q2.T @ np.concatenate([-q.T @ here.residual, np.zeros(order.size)])
    # Free parameters come first, so that the last rows of R hold the others alone: those are a problem of x >= 0.
    n = free.size
    low = (lower - here.theta)[tied] * scale[tied]
    found = np.zeros(order.size)
    if tied.size:  # scipy's nnls crashes on a matrix without columns
        found[n:] = low + nnls(r[n:, n:], right[n:] - r[n:, n:] @ low)[0]
    if free.size:
        found[:n] = solve_triangular(r[:n, :n], right[:n] - r[:n, n:] @ found[n:])
    step = np.zeros(scale.size)
    step[order] = found / scale[order]
    return step


def covariance_of(jacobian: Array) -> Array:
    """Return (n, n) the covariance of parameters for unit-variance residuals, by QR.

    As if there were no bounds: the error of an estimate that may fall on either side of the truth. A parameter without
    influence gets infinity; so do all if the rest cannot be told apart to the precision of float64.
    """
    scale = np.linalg.norm(jacobian, axis=0)
    known = scale > 0
    covariance = np.diag(np.where(known, 0.0, np.inf))
    r = qr(jacobian[:, known] / scale[known], mode="r")[0][: int(known.sum())]
    if np.abs(np.diag(r)).min(initial=1.0) <= _EPS * len(jacobian):
        return np.full((scale.size, scale.size), np.inf)
    inverse = solve_triangular(r, np.eye(len(r))) / scale[known, None]
    covariance[np.ix_(known, known)] = inverse @ inverse.T
    return covariance


def reach(
    quantity: Callable[[Array], tuple[float, Array]],
    residual: Residual,
    found: Search,
    lower: Array,
    chi2: float,
) -> float:
    """Return the largest value of a quantity over all θ >= `lower` whose sum of squares is at most `chi2`.

    That is the end of its profile-likelihood interval (Venzon and Moolgavkar 1988), found as one constrained maximum
    instead of many constrained fits: nlopt's SLSQP, which takes the bounds and the curved constraint exactly.
    Infinity if it has no end that could be found.

    Args:
        quantity: maps θ to the value and its gradient (n,).
        found: the minimum, where the way begins.
    """
    import nlopt

    # In units in which chi² is about round: a step of 1 is one standard error, the parameter's alone.
    unit = np.linalg.norm(found.jacobian, axis=0)
    unit = np.where(unit > 0, 1 / np.where(unit > 0, unit, 1.0), 1.0)
    first, slope = quantity(found.theta)
    size = float(np.linalg.norm(slope * unit)) or 1.0

    # Where the model has no number a look counts as far outside, which makes the search turn back.
    def value(x: Array, gradient: Array) -> float:
        at, by = quantity(x * unit)
        if gradient.size:
            gradient[:] = np.nan_to_num(by * unit / size, posinf=0.0, neginf=0.0)
        return (at - first) / size if np.isfinite(at) else 0.0

    def excess(x: Array, gradient: Array) -> float:
        left, J = residual(x * unit)
        if gradient.size:
            gradient[:] = np.nan_to_num(2 * (J.T @ left) * unit / chi2, posinf=0.0, neginf=0.0)
        found = float(left @ left) / chi2 - 1
        return found if np.isfinite(found) else _OUTSIDE

    solver = nlopt.opt(nlopt.LD_SLSQP, found.theta.size)
    solver.set_lower_bounds(lower / unit)
    solver.set_max_objective(value)
    solver.add_inequality_constraint(excess, 1e-9)
    solver.set_xtol_rel(1e-8)
    solver.set_ftol_rel(1e-8)
    solver.set_maxeval(_MOST_LOOKS)
    try:
        with np.errstate(all="ignore"):
            x = solver.optimize(np.maximum(found.theta, lower) / unit)
    except (nlopt.exception, nlopt.RoundoffLimited, ValueError):
        return np.inf
    if excess(x, np.zeros(0)) > 1e-3:
        return np.inf
    return quantity(x * unit)[0]
