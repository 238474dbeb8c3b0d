"""Re-radiation functions from decay amplitudes and the glow's spectrum (Nalbach 2017, eq. 8.5 and 8.6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting.decay import DecayFit

Array = NDArray[np.float64]


def match_colour(colour: Array, response: Array) -> tuple[float, float]:
    """Scale a spectrum to a measured colour.

    Args:
        colour: (n_channels,) the measured colour C.
        response: (n_channels,) the camera's response to the spectrum Λ*.

    Returns:
        The factor β of least squares in C ≈ β response, and the misfit |C - β response| / |C|.
    """
    beta = float(colour @ response / (response @ response))
    return beta, float(np.linalg.norm(colour - beta * response) / np.linalg.norm(colour))


def re_radiation(fit: DecayFit, spectrum: Array, beta: float) -> tuple[Array, Array]:
    """Return (n_c, n_λ) Λ_ij = β A_i Λ*_j / kr_i and its standard error, with r_i(0) = 1 (eq. 8.6).

    The spectrum counts as exact: the error is that of A_i and kr_i with their correlation.

    Args:
        spectrum: (n_λ,) the relative spectrum Λ*, largest value 1.
        beta: spectrum to signal, from `match_colour`.
    """
    per_state = beta * fit.strength / fit.kr_per_s
    emission = per_state[:, None] * spectrum
    n = fit.n_states
    i = np.arange(n)
    log_kr, amplitude = i, fit.n_parameters - n + i
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = (
            fit.covariance[amplitude, amplitude] / fit.strength**2
            + fit.covariance[log_kr, log_kr]
            - 2 * fit.covariance[log_kr, amplitude] / fit.strength
        )
        error = emission * np.sqrt(relative)[:, None]
    return emission, error
