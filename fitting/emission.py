"""Re-radiation functions from decay amplitudes and the glow's spectrum (Nalbach 2017, eq. 8.5 and 8.6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

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


def re_radiation(
    fit: DecayFit, spectrum: Array, beta: float, initial: Array | None = None
) -> tuple[Array, Array]:
    """Return (n_c, n_λ) Λ_ij = β A_i Λ*_j / (kr_i r_i(0)) and its standard error (eq. 8.6, where r_i(0) is 1).

    Spectrum and r(0) count as exact: the error is that of A_i and kr_i with their correlation.

    Args:
        spectrum: (n_λ,) the relative spectrum Λ*, largest value 1.
        beta: spectrum to signal, from `match_colour`.
        initial: (n_c,) r(0), how full each state was when the lamp went off; None: full.
    """
    per_state = beta * fit.strength / fit.kr_per_s
    if initial is not None:
        per_state = per_state / initial
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


def smoothest(colour: Array, response: Array) -> Array:
    """Return (n_λ,) the smoothest spectrum that is not negative and has a colour; its largest value is 1.

    A guess for rendering where no spectrum was measured: three numbers do not tell eight.

    Args:
        colour: (n_channels,) as a camera sees it.
        response: (n_channels, n_λ) the camera's response to each band.
    """
    n = response.shape[1]
    bend = np.diff(np.eye(n), 2, axis=0)
    # The colour a thousand times as strictly as the bend, relative to its size.
    scale = 1e3 / np.linalg.norm(response) * np.sqrt(n)
    matrix = np.concatenate([bend, scale * response])
    wanted = colour / np.linalg.norm(colour) * np.linalg.norm(response) / np.sqrt(n)
    found = nnls(matrix, np.concatenate([np.zeros(len(bend)), scale * wanted]))[0]
    return np.asarray(found / found.max())
