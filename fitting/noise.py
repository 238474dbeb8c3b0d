"""What the noise of a value depends on, so that weights come from the model and not from the noisy value itself.

    σ² = floor² + photon S + (relative S)²

Weights taken from the measured S favour values that fluctuated downwards: with 200 electrons at the peak, a slow
rate comes out wrong by several per cent. Taken from the fitted S and iterated, they do not (Nelder and Wedderburn
1972: the quasi-likelihood equations are unbiased whatever the variance).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

Array = NDArray[np.float64]

# A column of σ follows a law of its signal if the law explains all but this much of σ.
_FOLLOWS = 0.05


@dataclass(frozen=True)
class NoiseLaw:
    """σ² of each channel as a polynomial of its signal.

    Args:
        coefficients: (3, n_channels) of 1, S and S².
    """

    coefficients: Array

    def sigma(self, signal: Array) -> Array:
        """Return (n, n_channels) σ for a signal without noise, of that shape."""
        S = np.maximum(signal, 0.0)
        a, b, c = self.coefficients
        variance = a + b * S + c * S**2
        # A signal modelled as nothing has at least the noise of a thousandth of the peak.
        least = a + b * 1e-3 * S.max(axis=0) + c * (1e-3 * S.max(axis=0)) ** 2
        sigma: Array = np.sqrt(np.maximum(variance, np.maximum(least, 1e-300)))
        return sigma

    def scaled(self, factor: Array) -> NoiseLaw:
        """Return the law with σ of each channel multiplied by `factor` (n_channels,)."""
        return NoiseLaw(self.coefficients * factor**2)


def law_of(signal: Array, sigma: Array) -> NoiseLaw | None:
    """Return the law that given σ follow in every channel, or None where they follow none.

    Constant σ need none: there is nothing to iterate.
    """
    used = np.isfinite(sigma) & (signal > 0)
    coefficients = np.zeros((3, signal.shape[1]))
    for c in range(signal.shape[1]):
        S, variance = signal[used[:, c], c], sigma[used[:, c], c] ** 2
        if S.size < 4:
            return None
        # Rows relative to the variance, so that small σ count as much as large ones.
        powers = np.stack([np.ones_like(S), S, S**2], axis=1) / variance[:, None]
        length = np.linalg.norm(powers, axis=0)
        x = nnls(powers / length, np.ones_like(S))[0] / length
        if np.abs(np.sqrt(powers @ x) - 1).max() > _FOLLOWS:
            return None
        coefficients[:, c] = x
    return NoiseLaw(coefficients) if (coefficients[1:] > 0).any() else None


LAWS = {"constant": 0, "photon": 1, "relative": 2}  # σ² goes as the signal to this power


def unscaled(power: int, n_channels: int) -> NoiseLaw:
    """Return the law of one power with coefficient 1: what is known before anything is fitted."""
    coefficients = np.zeros((3, n_channels))
    coefficients[power] = 1.0
    return NoiseLaw(coefficients)
