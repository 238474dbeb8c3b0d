"""The rate equations in float64: the reference for everything that charges, glows and fades.

Per state i (Nalbach 2017, eq. 8.1), with the excitation a_i = Σ_j ke_ij E_j Δλ_j:

    dr_i/dt = (1 - r_i) a_i - kr_i r_i

While a_i is constant the equation is linear in r_i, and a step of any length is exact; `phoslab.solvers` has that and
the others.

Arrays: r, a, kr are (..., n_c), irradiance is (..., n_λ) in W m⁻² nm⁻¹, times are in s, rates in 1/s.
Leading shapes broadcast.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phoslab import solvers
from phoslab.errors import PhoslabError

if TYPE_CHECKING:
    from phoslab.material import Material

Array = NDArray[np.float64]
Irradiance = ArrayLike | Callable[[float], ArrayLike]


def excitation(material: Material, irradiance: ArrayLike) -> Array:
    """Return (..., n_c) the excitation a_i = Σ_j ke_ij E_j Δλ_j in 1/s (Nalbach 2017, eq. 8.1).

    Raises:
        PhoslabError: the irradiance is negative, not finite or of the wrong length, or there is light in a
            band in which `ke` was never measured.
    """
    E = np.asarray(irradiance, dtype=np.float64)
    if E.ndim == 0 or E.shape[-1] != material.bands.n:
        raise PhoslabError(
            f"has shape {E.shape}, but material {material.name!r} has {material.bands.n} bands",
            field="irradiance",
            remedy="Give one value a band in the last dimension, re-binned to the material's bands.",
        )
    if not np.isfinite(E).all() or (E < 0).any():
        raise PhoslabError(
            "holds a negative or non-finite value", field="irradiance", remedy="Irradiance is 0 or more."
        )
    ke = material.ke_m2_per_J
    unmeasured = np.isnan(ke).any(axis=0)
    lit = np.flatnonzero(unmeasured & (E > 0).reshape(-1, E.shape[-1]).any(axis=0))
    if lit.size:
        raise PhoslabError(
            f"of {material.name!r} was never measured at {material.bands.label(int(lit[0]))}, where there is light",
            field="ke_m2_per_J",
            remedy="Measure it, set it to 0, or keep light out of that band.",
        )
    a: Array = (E * material.bands.widths_nm) @ np.where(unmeasured, 0.0, ke).T
    return a


def rate(material: Material, r: ArrayLike, irradiance: ArrayLike) -> Array:
    """Return (..., n_c) dr/dt in 1/s (Nalbach 2017, eq. 8.1)."""
    r = np.asarray(r, dtype=np.float64)
    change: Array = (1 - r) * excitation(material, irradiance) - material.kr_per_s * r
    return change


def equilibrium(material: Material, irradiance: ArrayLike) -> Array:
    """Return (..., n_c) the concentration a / (a + kr) at which excitation and re-radiation balance.

    A state with neither excitation nor re-radiation keeps what it has; its equilibrium is given as 0.
    """
    return solvers.equilibrium(excitation(material, irradiance), material.kr_per_s)


def decay(material: Material, r: ArrayLike, t: ArrayLike) -> Array:
    """Return (..., n_c) the concentrations after `t` (...) seconds of darkness (Nalbach 2017, eq. 8.4)."""
    faded: Array = np.asarray(r, dtype=np.float64) * np.exp(-material.kr_per_s * np.asarray(t)[..., None])
    return faded


def emitted_radiance(material: Material, r: ArrayLike) -> Array:
    """Return (..., n_λ) the radiance Σ_i Λ_ij kr_i r_i in W m⁻² sr⁻¹ nm⁻¹ (Nalbach 2017, eq. 8.3)."""
    L: Array = (np.asarray(r, dtype=np.float64) * material.kr_per_s) @ material.emission
    return L


def advance(
    material: Material, r: ArrayLike, irradiance: Irradiance, dt: ArrayLike, solver: str = "exact"
) -> Array:
    """Advance the concentrations by one step.

    Args:
        r: (..., n_c) concentrations in [0, 1].
        irradiance: (..., n_λ) in W m⁻² nm⁻¹, constant over the step; or a callable of the time in [0, dt]
            since the step's start.
        dt: step length in s, a scalar or (...); a scalar where the irradiance is a callable.
        solver: a name in `phoslab.solvers.SOLVERS`, which says what each makes of light that changes.

    Returns:
        (..., n_c) concentrations after `dt`.

    Raises:
        PhoslabError: an argument is out of range, or the solver would not be stable.

    >>> import phoslab
    >>> green = phoslab.preset("green")
    >>> advance(green, [1.0], [0.0] * 8, 1 / green.kr_per_s[0]).round(4).tolist()
    [0.3679]
    """
    step = solvers.find(solver)
    r = np.asarray(r, dtype=np.float64)
    dt = np.asarray(dt, dtype=np.float64)
    if not (np.isfinite(dt).all() and (dt >= 0).all()):
        raise PhoslabError(
            "is negative or not finite", field="dt", remedy="Time runs forwards; give seconds."
        )
    if r.ndim == 0 or r.shape[-1] != material.n_states or not ((r >= 0) & (r <= 1)).all():
        raise PhoslabError(
            f"must be in [0, 1] with {material.n_states} states in the last dimension",
            field="r",
            remedy="Start from zeros, ones, or an equilibrium.",
        )
    if callable(irradiance):
        if dt.ndim:
            raise PhoslabError(
                "has many values",
                field="dt",
                remedy="Where the irradiance is a callable, give one step length.",
            )
        light = irradiance
        drive = solvers.Drive(lambda s: excitation(material, light(float(s * dt))))
    else:
        drive = solvers.Drive.constant(excitation(material, irradiance))
    return step(r, drive, material.kr_per_s, dt[..., None])
