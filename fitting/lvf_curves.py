"""Transmission curves of the linear variable filter at positions along it, from known lights behind known filters.

A position k passes a band around λ_k (`wavelength_map.py`). Known light L_f, alone and behind each
filter f, is seen there by
channel c as

    y_kfc = ∫ T_k(λ) L_f(λ) S_c(λ) dλ,

which is one linear system a position (Nalbach 2017, 8.4.2, after Kirk and O'Brien 2011). Here all
positions are solved at
once: T_k is a piecewise-linear curve over x = (λ - λ_k) 550 / λ_k, in which the bands of a wedge are
all alike, plus what
it passes of everything. It is smooth over x, and much more so from position to position; how smooth,
the data decide. It is
never below zero.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting.regularised import Normal, second_differences, solve

Array = NDArray[np.float64]

X_NM = np.arange(-55.0, 55.1, 2.5)
"""Where the curves have their nodes, at 550 nm."""

ALIKE = 1000.0
"""How much less bands may bend from position to position than over x, squared. At an edge a band of height 0.6 bends by
some 0.03 from one node to the next but one; heights that change by a few per cent over the strip bend by some 0.001."""

GRID_NM = np.arange(380.0, 721.0, 2.0)
"""Wavelengths at which a calibration holds curves and spectra are computed."""


TOGETHER_NM = 5.0
"""Over so much the errors of a curve go together where its covariance is not known: two nodes. In truth what a curve
has too much at one wavelength it lacks at another, so this overstates what smooth light suffers from it."""


@dataclass(frozen=True, eq=False)
class Curves:
    """Transmission curves.

    Args:
        curve: (n_k, n_nm) at `GRID_NM`.
        standard_error: (n_k, n_nm).
        misfit: root mean square of what the curves miss of the lights, as a share of each position's brightest value.
        scale: misfit squared in units of the noise, a degree of freedom.
        degrees: effective number of parameters.
        strength: μ of the penalty.
        at_end: the data do not say how smooth the curves are.
        covariance: (n_k, n_x + 1, n_x + 1) of each curve's nodes and of what passes everywhere; NaN off the strip. None
            in files that did not keep it.
    """

    curve: Array
    standard_error: Array
    misfit: float
    scale: float
    degrees: float
    strength: float
    at_end: bool
    covariance: Array | None = None

    def times(self, factor: float) -> Curves:
        """In a unit `factor` times as small."""
        covariance = None if self.covariance is None else self.covariance * factor**2
        return replace(
            self,
            curve=self.curve * factor,
            standard_error=self.standard_error * factor,
            covariance=covariance,
        )

    def signal_covariance(self, positions_nm: Array, light: Array) -> Array:
        """(n_k, 3, 3) what the curves' errors make of the signals of a light at the positions.

        Args:
            light: (n_nm, 3) the light as the channels weigh it, at `GRID_NM`.
        """
        step = GRID_NM[1] - GRID_NM[0]
        if self.covariance is None:
            variance = np.nan_to_num(self.standard_error) ** 2
            return np.asarray(np.einsum("kn,na,nb->kab", variance, light, light) * step * TOGETHER_NM)
        seen = np.stack([_hats(GRID_NM, p).T @ light * step for p in positions_nm])
        return np.asarray(np.einsum("kxa,kxy,kyb->kab", seen, np.nan_to_num(self.covariance), seen))

    def shape(self, positions_nm: Array) -> Array:
        """(n_x,) the bands' mean shape over `X_NM`, with a largest value of 1."""
        bands = np.stack(
            [
                np.interp(p * (1 + X_NM / 550), GRID_NM, c)
                for p, c in zip(positions_nm, self.curve, strict=True)
            ]
        )
        # Bands near the ends reach beyond what the camera sees.
        inner = (positions_nm > 440) & (positions_nm < 650)
        mean = np.median(bands[inner] / bands[inner].max(axis=1, keepdims=True), axis=0)
        return np.asarray(mean / mean.max())


def fit_curves(
    positions_nm: Array, signal: Array, sigma: Array, spectra: Array, sensitivities: Array, nm: Array
) -> Curves:
    """Fit the curves.

    Args:
        positions_nm: (n_k,) λ_k, three or more.
        signal: (n_k, n_f, 3) of each light at each position.
        sigma: (n_k, n_f, 3) its standard deviation; infinite where it says nothing.
        spectra: (n_f, n_nm) of the lights at `nm`.
        sensitivities: (n_nm, 3) at `nm`.
        nm: (n_nm,) evenly spaced.
    """
    n_k, n_x = positions_nm.size, X_NM.size
    size = n_x + 1  # and what passes everywhere
    seen = spectra[:, :, None] * sensitivities[None] * (nm[1] - nm[0])  # (n_f, n_nm, 3)
    matrix = np.zeros((n_k * size, n_k * size))
    right = np.zeros(n_k * size)
    squares, n_data = 0.0, 0
    hats = [_hats(nm, position) for position in positions_nm]
    for k, hat in enumerate(hats):
        rows = np.tensordot(seen, hat, (1, 0)).reshape(-1, size)  # (n_f * 3, size)
        block = Normal.of(rows, signal[k].ravel(), sigma[k].ravel())
        at = slice(k * size, (k + 1) * size)
        matrix[at, at], right[at] = block.matrix, block.right
        squares, n_data = squares + block.squares, n_data + block.n_data
    normal = Normal(matrix, right, squares, n_data)
    over_x = np.zeros((size - 3, size))
    over_x[:, :n_x] = second_differences(n_x)
    along = np.kron(np.eye(n_k), over_x.T @ over_x)
    d = second_differences(n_k)
    # Free are what is straight over x and what passes everywhere, each straight over the positions.
    solution = solve(normal, along + ALIKE * np.kron(d.T @ d, np.eye(size)), nullity=3 * 2)
    x = solution.x.reshape(n_k, size)
    on_grid = [_hats(GRID_NM, position) for position in positions_nm]
    curve = np.stack([g @ x[k] for k, g in enumerate(on_grid)])
    blocks = [slice(k * size, (k + 1) * size) for k in range(n_k)]
    covariance = np.stack([solution.covariance[at, at] for at in blocks])
    covariance = (covariance + covariance.swapaxes(1, 2)) / 2
    error = np.empty_like(curve)
    missed = []
    for k, g in enumerate(on_grid):
        error[k] = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", g, covariance[k], g), 0.0))
        predicted = np.tensordot(seen, hats[k], (1, 0)) @ x[k]
        used = np.isfinite(sigma[k])
        if used.any():
            missed.append((predicted - signal[k])[used] / np.abs(signal[k][used]).max())
    return Curves(
        curve=curve,
        standard_error=error,
        misfit=float(np.sqrt(np.mean(np.concatenate(missed) ** 2))) if missed else float("nan"),
        scale=solution.scale,
        degrees=solution.degrees,
        strength=solution.strength,
        at_end=solution.at_end,
        covariance=covariance,
    )


def _hats(nm: Array, position_nm: float) -> Array:
    """(n_nm, n_x + 1) the functions whose sum a curve is: hats over x, and 1."""
    x = (nm - position_nm) * 550 / position_nm
    step = X_NM[1] - X_NM[0]
    hats = np.maximum(0.0, 1 - np.abs(x[:, None] - X_NM[None]) / step)
    return np.concatenate([hats, np.ones((nm.size, 1))], axis=1)
