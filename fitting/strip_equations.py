"""Light along the strip as linear equations for its spectrum.

Each of the positions k is seen in three channels c, y_kc = ∫ T_k(λ) S_c(λ) L(λ) dλ, with T_k and S_c known: some 93
equations for L at 61 wavelengths, solved without negative values and as smooth as the data say (Nalbach 2017, 8.4.2).
What the errors of T_k make of y goes together in the three channels, and depends on L; so does where L may bend most.
Both are taken from a first solution.
A hand that has put the strip down anew has moved it along itself by some tenth of a millimetre, that is by some tenths
of a nanometre. The three channels see one spectrum only if it is read at the right places, which tells by how much.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.fitting.lvf import POSITIONS_NM, Calibration, positions
from phoslab.fitting.lvf_curves import GRID_NM
from phoslab.fitting.regularised import Normal, Solution, second_differences, solve

Array = NDArray[np.float64]

NM = np.arange(400.0, 701.0, 5.0)
"""Wavelengths of a spectrum."""

BELIEF = 0.004
"""How well a calibration describes another measurement, as a share of the signal: other pixels, stray light."""

BENDS_NM, STRAIGHT = 12.0, 0.1
"""Over so much bends are alike, half the width of what the strip passes; and how much of the strongest is expected
where nothing bends."""

SHIFT_PX = 1.0
"""Standard deviation of a strip's place along itself, before the colours are looked at."""


class StripEquations:
    """The equations of light along a strip that may have moved along itself; what is known of the light sharpens them.

    Args:
        signal, sigma: (n, 3) at the strip's nodes, as if the scene were lit evenly.
    """

    def __init__(self, calibration: Calibration, signal: Array, sigma: Array) -> None:
        assert calibration.curves is not None
        self.calibration, self.curves = calibration, calibration.curves
        self.signal, self.sigma = signal, sigma
        self.hats = np.maximum(0.0, 1 - np.abs(GRID_NM[:, None] - NM) / (NM[1] - NM[0]))
        self.hats[:, 0] = np.where(GRID_NM < NM[0], 1.0, self.hats[:, 0])  # beyond the ends it is as at them
        self.hats[:, -1] = np.where(GRID_NM > NM[-1], 1.0, self.hats[:, -1])
        self.seen = calibration.sensitivities.at(GRID_NM)
        curve = np.nan_to_num(self.curves.curve)
        step = GRID_NM[1] - GRID_NM[0]
        self.response = np.einsum("kn,nc,nj->kcj", curve, self.seen, self.hats) * step
        self.bends = second_differences(NM.size)
        self.penalty = self.bends.T @ self.bends
        self.from_curves: Array | None = None

    def read(self, shift_px: float) -> tuple[Array, Array]:
        """(n_k, 3) the signals at the positions, and their noise, infinite where nothing is seen.

        Raises:
            PhoslabError: fewer than three positions are seen.
        """
        weights = self.calibration.reading(shift_px)
        there = np.asarray(np.isfinite(weights).all(axis=1) & np.isfinite(self.curves.curve).all(axis=1))
        y, noise = (
            np.asarray(v)[:, 0] for v in positions([self.signal], [self.sigma], np.nan_to_num(weights))
        )
        noise = np.where(there[:, None], noise, np.inf)
        if np.isfinite(noise).any(axis=1).sum() < 3:
            raise PhoslabError(
                "shows fewer than three positions that are calibrated and not saturated",
                file="the session",
                field="the strip",
                remedy="Expose it shorter, and calibrate with the strip where it is now.",
            )
        return y, noise

    def measured(self, shift_px: float) -> Array:
        """(n_k, 3) the signals at the positions; NaN where nothing is seen."""
        y, noise = self.read(shift_px)
        return np.where(np.isfinite(noise), y, np.nan)

    def normal(self, shift_px: float) -> Normal:
        """The equations, weighted."""
        y, noise = self.read(shift_px)
        variance = noise**2 + (BELIEF * y) ** 2
        between = self.from_curves
        if between is None:  # no spectrum is known yet to see the curves' errors by
            variance = variance + (self.curves.misfit * y.max(axis=1, keepdims=True)) ** 2
            between = np.zeros((*y.shape, 3))
        covariance = between.copy()
        covariance[:, range(3), range(3)] += variance  # infinite where nothing is seen
        return Normal.correlated(self.response, y, covariance)

    def solve(self, shift_px: float) -> Solution:
        return solve(self.normal(shift_px), self.penalty)

    def adapt(self, solution: Solution) -> None:
        """Expect the spectrum to bend where it was found to, and the errors that the curves make of it.

        As penalties that vary over a curve are found from a first fit (Ruppert and Carroll 2000,
        doi 10.1111/1467-842X.00119).
        """
        at = NM[1:-1]
        near = np.exp(-0.5 * ((at[:, None] - at) / BENDS_NM) ** 2)
        bend = near @ (self.bends @ solution.x) ** 2 / near.sum(axis=1)
        weight = 1 / (bend / max(float(bend.max()), 1e-300) + STRAIGHT**2)
        self.penalty = self.bends.T @ (weight[:, None] * self.bends)
        light = self.seen * (self.hats @ solution.x)[:, None]
        self.from_curves = self.curves.signal_covariance(POSITIONS_NM, light)

    def shift(self, first: Solution) -> float:
        """The shift at which the three colours agree best, as far as they say anything: a parabola through three."""
        tried = np.linspace(-2.0, 2.0, 9)

        def badness(shift: float) -> float:
            normal = self.normal(shift)
            x = np.asarray(
                np.linalg.solve(normal.matrix + first.strength * self.penalty, normal.right), float
            )
            total = normal.misfit(x) + first.strength * float(x @ self.penalty @ x)
            return total / max(1.0, first.scale) + (shift / SHIFT_PX) ** 2

        scores = np.array([badness(s) for s in tried])
        k = int(np.clip(np.argmin(scores), 1, tried.size - 2))
        a, b, c = scores[k - 1 : k + 2]
        bend = a - 2 * b + c
        step = tried[1] - tried[0]
        return float(np.clip(tried[k] + (0.5 * step * (a - c) / bend if bend > 0 else 0.0), -2.5, 2.5))
