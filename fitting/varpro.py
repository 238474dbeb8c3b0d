"""Variable projection: least squares in which the linear parameters are eliminated, never searched.

The problem is min over θ and x of Σ_b |y_b - Φ_b(θ) x_b|², with y and Φ already weighted. A block b (a channel
with amplitudes of its own) shares only θ with the others. For each θ the best x is a linear problem, with x >= 0
where a sign is known, so only θ is searched, with the exact Jacobian of the projected residual (Golub and Pereyra
1973) on the columns that are not held at 0.
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

# θ (n_θ,) -> Φ (n_blocks, m, n_x) and its derivatives dΦ/dθ (n_θ, n_blocks, m, n_x)
Basis = Callable[[Array], tuple[Array, Array]]

_EPS = float(np.finfo(np.float64).eps)
_MOST_STEPS = 300
# Of a unit vector along which nothing is determined: what is less of a parameter is rounding.
_NO_PART = 1e-6
# θ are logarithms and ratios: a step beyond this leaves the region where the linear model means anything.
_LONGEST_STEP = 2.0
# Relative decrease of chi² below which the search hands over to the polish.
_SETTLED = 1e-9


@dataclass(frozen=True)
class Solution:
    """A minimum: nonlinear θ (n_θ,), linear x (n_blocks, n_x), and the weighted residual y - Φ x (n_blocks, m)."""

    theta: Array
    linear: Array
    residual: Array

    @property
    def chi2(self) -> float:
        """Sum of squared weighted residuals."""
        return float(np.sum(self.residual**2))


@dataclass(frozen=True)
class _Point:
    """The projected problem at one θ: x, what is left, the Jacobian of what is left, and which x are free."""

    linear: Array
    residual: Array
    jacobian: Array  # (n_blocks m, n_θ)
    free: Mask
    q: Array
    r: Array

    @property
    def chi2(self) -> float:
        return float(np.sum(self.residual**2))

    @property
    def gradient(self) -> Array:
        """(n_θ,) half the gradient of chi²."""
        g: Array = self.jacobian.T @ self.residual.ravel()
        return g


def solve(
    basis: Basis,
    y: Array,
    start: Array,
    *,
    signed: Mask | None = None,
    held: Mask | None = None,
    polish: bool = True,
    find_scale: bool = False,
) -> Solution:
    """Minimise from one start.

    Args:
        basis: maps θ to Φ and dΦ/dθ; rows are weighted (divided by σ) like `y`.
        y: (n_blocks, m) weighted data.
        start: (n_θ,) where the search begins.
        signed: (n_x,) which linear parameters may be negative; by default none.
        held: (n_θ,) which nonlinear parameters stay as they start; by default none.
        polish: go on to the precision of float64; without, chi² is good to nine digits.
        find_scale: θ are log rates whose common factor may be far off: try factors first.
    """
    moving = ~held if held is not None else np.ones(start.size, bool)
    theta = start.astype(np.float64)
    here = _project(basis, y, theta, signed)
    if find_scale:
        # Where all rates are far too fast or too slow, chi² is flat: no derivative tells the way back.
        for shift in np.arange(-12, 13) * np.log(2.0):
            there = _project(basis, y, start + shift, signed)
            if there.chi2 < here.chi2:
                theta, here = start + shift, there
    damping, growth = 1e-3, 2.0
    scale = np.zeros(start.size)
    for _ in range(_MOST_STEPS):
        if not moving.any():
            break
        normal = here.jacobian.T @ here.jacobian
        # Marquardt's scale, never shrinking (Moré 1978): a parameter that has lost its influence does not run away.
        scale = np.maximum(scale, np.diag(normal))
        damped = normal + damping * np.diag(scale + _EPS * (scale.max() or 1.0))
        step = np.zeros(start.size)
        step[moving] = -np.linalg.solve(damped[np.ix_(moving, moving)], here.gradient[moving])
        step *= min(1.0, _LONGEST_STEP / (float(np.abs(step).max()) or 1.0))
        foreseen = -float(step @ (2 * here.gradient + normal @ step))
        if not foreseen > _SETTLED * here.chi2 * 1e-3:
            break
        there = _project(basis, y, theta + step, signed)
        gained = here.chi2 - there.chi2
        if gained > 0:
            ratio = gained / foreseen
            damping = max(damping * max(1 / 5, 1 - (2 * ratio - 1) ** 3), 1e-12)  # Nielsen 1999
            theta, here, growth = theta + step, there, 2.0
            if gained < _SETTLED * here.chi2 and ratio > 0.1:
                break
        else:
            damping, growth = damping * growth, growth * 2
            if damping > 1e12:
                break
    if polish and moving.any():
        theta, here = _polish(basis, y, theta, here, signed, moving)
    return Solution(theta=theta, linear=here.linear, residual=here.residual)


def _polish(
    basis: Basis, y: Array, theta: Array, here: _Point, signed: Mask | None, moving: Mask
) -> tuple[Array, _Point]:
    """Take Newton steps for as long as they shrink.

    A search that compares sums of squares stops at the root of the machine precision: nearer to the minimum they no
    longer differ. The gradient still does. Gauss-Newton's steps shrink slowly where residuals are large; then the
    Hessian comes from differences of the exact gradient, once, which makes the steps shrink a thousandfold each.
    """
    index = np.flatnonzero(moving)
    hessian: Array | None = None
    last = np.inf
    for _ in range(40):
        if hessian is None:
            J = here.jacobian[:, index]
            step = np.linalg.lstsq(J, -here.residual.ravel(), rcond=None)[0]
        else:
            step = np.linalg.lstsq(hessian, -here.gradient[index], rcond=None)[0]
        size = float(np.abs(step).max())
        if hessian is None and size > 0.05 * last:
            hessian = _hessian(basis, y, theta, signed, index, here.free)
            if hessian is None:
                break
            last = np.inf
            continue
        if not size < 0.5 * last or size > 0.05:
            break
        moved = theta.copy()
        moved[index] += step
        there = _project(basis, y, moved, signed)
        # Beyond rounding, a step of the polish must not climb, nor change which amplitudes are held at 0.
        if there.chi2 > here.chi2 * (1 + 1e-6) + 1e-300 and there.chi2 > here.chi2 + _EPS * np.sum(y**2):
            break
        if (there.free != here.free).any():
            break
        theta, here, last = moved, there, size
        if size < _EPS:
            break
    return _refine(basis, y, theta, here, signed, index, hessian)


def _refine(
    basis: Basis,
    y: Array,
    theta: Array,
    here: _Point,
    signed: Mask | None,
    index: NDArray[np.intp],
    hessian: Array | None,
) -> tuple[Array, _Point]:
    """Take two more steps with Φ and residuals in the machine's long double, where it has one.

    The solutions of float64 are refined like those of a linear system: only what is left needs the longer numbers.
    """
    J = here.jacobian[:, index]
    moved, x = theta.astype(np.longdouble), here.linear.astype(np.longdouble)
    for _ in range(2):
        phi, _ = basis(moved)  # type: ignore[arg-type]  # a basis computes in whatever precision θ has
        for _ in range(2):
            left = y - (phi * x[:, None, :]).sum(axis=2)
            short = here.q.swapaxes(1, 2) @ left.astype(np.float64)[:, :, None]
            x = x + np.where(here.free, np.linalg.solve(here.r, short)[:, :, 0], 0.0)
        left = y - (phi * x[:, None, :]).sum(axis=2)
        # By QR and not by the gradient, whose rounding the square of the condition would multiply.
        step = np.linalg.lstsq(J, -left.astype(np.float64).ravel(), rcond=None)[0]
        if hessian is not None:
            step = np.linalg.lstsq(hessian, J.T @ (J @ step), rcond=None)[0]  # Newton's, from Gauss-Newton's
        if not np.abs(step).max(initial=0.0) < 1e-6:
            return theta, here
        moved[index] += step
    refined = moved.astype(np.float64)
    there = _project(basis, y, refined, signed)
    return (refined, there) if (there.free == here.free).all() else (theta, here)


def _hessian(
    basis: Basis, y: Array, theta: Array, signed: Mask | None, index: NDArray[np.intp], free: Mask
) -> Array | None:
    """Return half the Hessian of chi² by central differences of its exact gradient; None at an edge of x >= 0."""
    h = 1e-5
    columns = []
    for i in index:
        shifted = []
        for sign in (1, -1):
            moved = theta.copy()
            moved[i] += sign * h
            point = _project(basis, y, moved, signed)
            if (point.free != free).any():
                return None
            shifted.append(point.gradient[index])
        columns.append((shifted[0] - shifted[1]) / (2 * h))
    hessian = np.array(columns)
    return (hessian + hessian.T) / 2 if np.isfinite(hessian).all() else None


def _project(basis: Basis, y: Array, theta: Array, signed: Mask | None) -> _Point:
    """Eliminate x at θ, by QR of Φ on the columns that are free."""
    phi, dphi = basis(theta)
    x, free, q, r = _linear(phi, y, signed)
    residual = y - (phi @ x[:, :, None])[:, :, 0]
    moved = (dphi @ x[None, :, :, None])[..., 0]  # (n_θ, n_blocks, m): dΦ x
    qt = q.swapaxes(1, 2)
    off_range = moved - (q @ (qt @ moved[..., None]))[..., 0]
    turned = np.where(free, (dphi.swapaxes(2, 3) @ residual[None, :, :, None])[..., 0], 0.0)
    back = np.linalg.solve(np.broadcast_to(r.swapaxes(1, 2), (len(theta), *r.shape)), turned[..., None])
    jacobian = -(off_range + (q @ back)[..., 0])
    return _Point(x, residual, jacobian.reshape(len(theta), -1).T, free, q, r)


def linear_part(phi: Array, y: Array, signed: Mask | None = None) -> Array:
    """Return (n_x,) the x, >= 0 where not `signed`, that minimises |y - Φ x|²; Φ is (m, n_x)."""
    x: Array = _linear(phi[None], y[None], signed)[0][0]
    return x


def _linear(phi: Array, y: Array, signed: Mask | None) -> tuple[Array, Mask, Array, Array]:
    """Return x (n_blocks, n_x), which are free, and Q, R of the free columns.

    Held columns are 0 in Q and rows of the identity in R, so that blocks with other sets of free columns share
    their arithmetic.
    """
    n_x = phi.shape[2]
    may_be_negative = np.zeros(n_x, bool) if signed is None else signed
    # Columns of unit length: the free set then does not depend on how a basis function is scaled.
    length = np.sqrt(np.einsum("bmk,bmk->bk", phi, phi))
    usable = length > 0
    unit = phi / np.where(usable, length, 1.0)[:, None, :]
    if unit.shape[1] >= n_x and usable.all():
        q, r = np.linalg.qr(unit)
        depth = np.abs(np.diagonal(r, axis1=1, axis2=2))
        if (depth > _EPS * phi.shape[1]).all():
            x = np.linalg.solve(r, (q.swapaxes(1, 2) @ y[:, :, None]))[:, :, 0]
            # The best of all x is the best of x >= 0 where it is itself >= 0.
            if (may_be_negative | (x > 0)).all():
                return x / length, np.ones_like(usable), q, r * length[:, None, :]
    n_blocks = len(phi)
    x, free = np.zeros((n_blocks, n_x)), np.zeros((n_blocks, n_x), bool)
    q, r = np.zeros(phi.shape), np.tile(np.eye(n_x), (n_blocks, 1, 1))
    for b in range(n_blocks):
        if not usable[b].any():  # scipy's nnls crashes on a matrix without columns
            continue
        columns = unit[b][:, usable[b]]
        sign_free = np.flatnonzero(may_be_negative[usable[b]])
        found = nnls(np.concatenate([columns, -columns[:, sign_free]], axis=1), y[b])[0]
        solved = found[: columns.shape[1]].copy()
        solved[sign_free] -= found[columns.shape[1] :]
        free[b, usable[b]] = solved != 0
        index = np.flatnonzero(free[b])
        if index.size:
            q_b, r_b = np.linalg.qr(unit[b][:, index])
            if np.abs(np.diag(r_b)).min() > _EPS * phi.shape[1]:
                x[b, index] = np.linalg.solve(r_b, q_b.T @ y[b]) / length[b, index]
                q[b][:, index] = q_b
                r[b][np.ix_(index, index)] = r_b * length[b, index]
            else:
                x[b, usable[b]] = solved / length[b, usable[b]]
    return x, free, q, r


def covariance(basis: Basis, solution: Solution) -> Array:
    """Return the covariance of (θ, x of block 0, x of block 1, ...) for unit-variance data, by QR.

    A parameter that the data do not determine (a linear one at 0, one whose column vanishes, or one that others can
    make up for) gets infinity.
    """
    phi, dphi = basis(solution.theta)
    n_blocks, m, n_x = phi.shape
    n_theta = solution.theta.size
    J = np.zeros((n_blocks, m, n_theta + n_blocks * n_x))
    J[:, :, :n_theta] = (dphi @ solution.linear[None, :, :, None])[..., 0].transpose(1, 2, 0)
    for b in range(n_blocks):
        J[b, :, n_theta + b * n_x : n_theta + (b + 1) * n_x] = phi[b]
    J = J.reshape(n_blocks * m, -1)
    held = np.concatenate([np.zeros(n_theta, bool), solution.linear.ravel() == 0])
    scale = np.linalg.norm(J, axis=0)
    free = ~held & (scale > 0)
    cov = np.full((J.shape[1], J.shape[1]), np.inf)
    r = qr(J[:, free] / scale[free], mode="r")[0][: int(free.sum())]
    if np.abs(np.diag(r)).min(initial=1.0) <= _EPS * J.shape[0]:
        return _covariance_of_some(J, free, cov)
    inverse = solve_triangular(r, np.eye(r.shape[0])) / scale[free, None]
    with np.errstate(over="ignore"):  # a parameter that nothing determines
        cov[np.ix_(free, free)] = inverse @ inverse.T
    return cov


def _covariance_of_some(J: Array, free: Mask, cov: Array) -> Array:
    """Return the covariance where some directions are not determined: of the parameters that have no part in these."""
    columns = np.flatnonzero(free)
    scale = np.linalg.norm(J[:, columns], axis=0)
    _, s, vt = np.linalg.svd(J[:, columns] / scale, full_matrices=False)
    told = s > _EPS * J.shape[0] * s[0]
    known = np.abs(vt[~told]).max(axis=0, initial=0.0) < _NO_PART
    inverse = (vt[told].T / s[told])[known] / scale[known, None]
    cov[np.ix_(columns[known], columns[known])] = inverse @ inverse.T
    return cov
