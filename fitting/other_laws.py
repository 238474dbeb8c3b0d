"""Other laws of decay, as a diagnosis beside the exponentials: they cannot be simulated under changing light.

stretched exponential    S(t) = A exp(-(k t)^β)           (Kohlrausch 1854)
Becquerel                S(t) = A (1 + t/τ)^-p            (Becquerel 1861; p = 2 for traps emptied by pairs)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting import varpro
from phoslab.fitting.decay_data import DecayData

Array = NDArray[np.float64]

# Mean over an exposure: smooth laws over a short time, to 1e-9.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True)
class OtherLaw:
    """A fitted law.

    Args:
        name: of the law.
        parameters: by name.
        undetermined: names of those that the values do not tell to within a factor of e.
        chi2, aicc: to compare with the exponentials'.
        n_parameters: of its shape and of all channels' amplitudes.
        course: (n, n_channels) the modelled signal.
    """

    name: str
    parameters: dict[str, float]
    undetermined: frozenset[str]
    chi2: float
    aicc: float
    n_parameters: int
    course: Array

    @property
    def aic(self) -> float:
        """Akaike's information criterion, not corrected for few values."""
        return self.chi2 + 2 * self.n_parameters


def _stretched(theta: Array, t: Array) -> tuple[Array, Array]:
    k, beta = np.exp(theta)
    u = (k * t) ** beta
    f = np.exp(-u)
    log_u = np.log(u, out=np.zeros_like(u), where=u > 0)
    return f, np.stack([-beta * u * f, -u * log_u * f])


def _becquerel(theta: Array, t: Array) -> tuple[Array, Array]:
    tau, p = np.exp(theta)
    x = t / tau
    f = (1 + x) ** -p
    return f, np.stack([p * x / (1 + x) * f, -p * np.log1p(x) * f])


_Law = Callable[[Array, Array], tuple[Array, Array]]
_LAWS: dict[str, tuple[_Law, tuple[str, str]]] = {
    "stretched exponential": (_stretched, ("k_per_s", "beta")),
    "Becquerel": (_becquerel, ("tau_s", "p")),
}


def fit_other_laws(data: DecayData) -> list[OtherLaw]:
    """Fit each law; none if there are too few values."""
    return [fit_law(data, name) for name in _LAWS if enough_values(data)]


def enough_values(data: DecayData) -> bool:
    """Whether there are more values than a law has parameters, and one to spare."""
    return data.n_values > 3 + len(data.channels)


def fit_law(data: DecayData, name: str, near: OtherLaw | None = None) -> OtherLaw:
    """Fit one law with its shape shared by the channels, and an amplitude a channel.

    Args:
        name: of the law.
        near: begin where this fit ended.
    """
    law, names = _LAWS[name]
    weight = np.where(data.used, 1 / data.total_sigma, 0.0).T  # (n_channels, n)
    y = weight * np.where(data.used, data.signal, 0.0).T
    inside = data.t_s[:, None] + data.exposure_s[:, None] * (1 + _NODES) / 2  # (n, nodes)

    def basis(theta: Array) -> tuple[Array, Array]:
        f, df = law(theta, inside)
        mean, d_mean = f @ _WEIGHTS / 2, df @ _WEIGHTS / 2
        return (weight * mean)[:, :, None], (weight * d_mean[:, None, :])[..., None]

    starts = [
        [np.log(scale * data.end_s if name == "Becquerel" else 1 / (scale * data.end_s)), np.log(shape)]
        for scale in (0.01, 0.1, 0.5)
        for shape in ((1.0, 2.0) if name == "Becquerel" else (0.4, 0.8))
    ]
    if near is not None:
        starts = [[float(np.log(near.parameters[n])) for n in names]]
    best = min(
        (varpro.solve(basis, y, np.array(s), polish=False) for s in starts),
        key=lambda s: s.chi2,
    )
    p, n = 2 + len(y), data.n_values
    aicc = best.chi2 + 2 * p + 2 * p * (p + 1) / (n - p - 1)
    values = dict(zip(names, np.exp(best.theta).tolist(), strict=True))
    course = (law(best.theta, inside)[0] @ _WEIGHTS / 2)[:, None] * best.linear[:, 0]
    error = np.sqrt(np.diag(varpro.covariance(basis, best))[: len(names)] * max(1.0, best.chi2 / (n - p)))
    unknown = frozenset(n for n, e in zip(names, error, strict=True) if not e < 1)
    return OtherLaw(name, values, unknown, best.chi2, aicc, p, course)
