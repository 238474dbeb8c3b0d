"""Excitation rates from the glow after exposures of growing length through the LVF (Nalbach 2017, 8.4.6).

A rate over wavelength is a sum of shapes j with coefficients ke_ij (`fitting.light`). Place s under the filter gets the
light M_sj in shape j (lamp times transmission, W/m²), and so is excited by a_is = Σ_j ke_ij M_sj. A frame f sees there

    S_fs = g_s Σ_i G_i <kr_i r_is>_f        G_i = A_i / q_i

<kr r> is the mean over the exposure, through rise and fade of the lamp, delay and decay (`fitting.charging`); g_s is
the paint's brightness there. G_i is Λ_i seen by the camera. The decay says how bright a state was, A_i, after the whole
lamp had charged it to r_i(0): q_i = kr_i r_i(0) is computed by the same steps, with r(0) < 1. So decay and excitation
share kr_i, A_i and ke_ij, and are fitted jointly: the decay enters by its own fit's values with their covariance.

Where a state stays far from saturation (a << kr) in all of both, scaling its ke up and its Λ down changes nothing: only
the product is determined, and is what is reported.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.bands import Bands
from phoslab.fitting.charging import Steps, glow, phi
from phoslab.fitting.decay import DecayFit

Array = NDArray[np.float64]

# A lamp that takes a state to less than this share of saturation takes it there linearly, as far as any camera tells.
_LINEAR = 1e-3

# No rate, amplitude or ratio of them is beyond e to this, 1e43. A search steps there where a state holds no light at
# all and its logarithms are free; exp would overflow.
_LARGEST_LOG = 100.0


@dataclass(frozen=True, eq=False)
class Charge:
    """The decay's own fit, and how its sample had been charged.

    Args:
        kr_per_s: (n_c,).
        amplitude: (n_c,) A_i at lamp-off, in the signal's unit of the strongest channel.
        covariance: (2 n_c, 2 n_c) of (log kr, log A).
        steps: one frame, to whose shutter nothing but the lamp's course matters: `Steps.of` with the charge's length
            and a delay beyond the fade.
        light: (n_shapes,) the whole lamp in each of `ExcitationData.shapes`, in W/m² of the lamp's own unit.
    """

    kr_per_s: Array
    amplitude: Array
    covariance: Array
    steps: Steps
    light: Array

    @classmethod
    def from_decay(cls, fit: DecayFit, steps: Steps, light: Array) -> Charge:
        """Return what a decay of one colour says; `steps` and `light` as above."""
        if not fit.rank_one:
            raise ValueError("channels with amplitudes of their own have no one brightness")
        n = fit.n_states
        first = n + fit.amplitude.shape[1] - 1
        index = np.concatenate([np.arange(n), first + np.arange(n)])
        # From (log kr, A) to (log kr, log A).
        with np.errstate(divide="ignore"):
            scale = np.concatenate([np.ones(n), 1 / fit.strength])
        covariance = fit.covariance[np.ix_(index, index)] * np.outer(scale, scale)
        return cls(fit.kr_per_s, fit.strength, covariance, steps, light)


@dataclass(frozen=True, eq=False)
class ExcitationData:
    """A measured excitation series.

    Args:
        steps: of the n_frames frames.
        signal: (n_frames, n_places) linear signal a second, of the channel that `Charge.amplitude` refers to.
        sigma: (n_frames, n_places) standard deviation of its noise; infinite for a value that is left out.
        light: (n_places, n_shapes) what the filter lets through at each place, in the unit of `Charge.light`.
        bands: in which the rates are wanted.
        band_means: (n_bands, n_shapes) from the coefficients of the rate's shapes to its means in the bands; see
            `fitting.light.Shapes`, which computes all three.
        response: (n_places,) g_s, relative to the region in which the decay was measured.
        repeatability: relative standard deviation of a whole frame (shutter, gain), shared by its places.
    """

    steps: Steps
    signal: Array
    sigma: Array
    light: Array
    bands: Bands
    band_means: Array
    response: Array
    repeatability: float = 0.0

    def __post_init__(self) -> None:
        shape = (len(self.steps.duration_s), len(self.light))
        good = self.signal.shape == self.sigma.shape == shape and self.response.shape == shape[1:]
        if not good or self.band_means.shape != (self.bands.n, self.n_shapes):
            raise ValueError("frames, places and bands of an excitation series do not fit together")
        used = np.isfinite(self.sigma)
        if not np.isfinite(self.signal[used]).all() or not (self.sigma > 0).all():
            raise ValueError("signal must be finite and sigma positive wherever a value is used")

    @property
    def n_shapes(self) -> int:
        """How many coefficients make a state's rate over wavelength."""
        return int(self.light.shape[1])

    @property
    def n_values(self) -> int:
        """How many values take part."""
        return int(np.isfinite(self.sigma).sum())

    def whiten(self, values: Array) -> Array:
        """Turn errors (n_frames, n_places, ...) into unit, unrelated ones; 0 where a value is left out.

        A frame's covariance is D (1 + u uᵀ) D, with D = diag(σ) and u = repeatability * signal / σ.
        """
        sigma = self.sigma.reshape(*self.sigma.shape, *([1] * (values.ndim - 2)))
        scaled = values / sigma
        u = np.where(np.isfinite(self.sigma), self.repeatability * self.signal / self.sigma, 0.0)
        u2 = (u**2).sum(axis=1)
        shrink = np.divide(1 - 1 / np.sqrt(1 + u2), u2, out=np.zeros_like(u2), where=u2 > 0)
        along = np.einsum("fs,fs...->f...", u, scaled)
        whitened: Array = scaled - np.einsum("f,fs,f...->fs...", shrink, u, along)
        return whitened


@dataclass(frozen=True, eq=False)
class Problem:
    """The joint problem; θ = (log kr, log A, rates), the rates being ke_ij or, with one shape, (log ρ_i, s_j)."""

    data: ExcitationData
    charge: Charge
    common: bool

    @property
    def n_c(self) -> int:
        return self.charge.kr_per_s.size

    @property
    def lower(self) -> Array:
        """(n_θ,) rates are not negative, logarithms are free."""
        n = self.data.n_shapes
        return np.concatenate([np.full(self.n_logs, -np.inf), np.zeros(n if self.common else self.n_c * n)])

    @property
    def n_logs(self) -> int:
        return 2 * self.n_c + (self.n_c - 1 if self.common else 0)

    @property
    def fresh(self) -> Array:
        """(n_frames,) the decay's signal at the delay of each frame, averaged over its exposure."""
        kr, steps = self.charge.kr_per_s, self.data.steps
        faded = np.exp(-kr * steps.delay_s[:, None]) * phi(kr * steps.exposure_s[:, None])[1]
        total: Array = faded @ self.charge.amplitude
        return total

    def ke(self, theta: Array) -> tuple[Array, Array]:
        """Return (n_c, n_shapes) ke and its derivatives (n_c, n_shapes, n_θ)."""
        n_c, n = self.n_c, self.data.n_shapes
        slope = np.zeros((n_c, n, theta.size))
        if not self.common:
            ke = theta[2 * n_c :].reshape(n_c, n)
            slope[:, :, 2 * n_c :] = np.eye(n_c * n).reshape(n_c, n, n_c * n)
            return ke, slope
        ratio = np.exp(np.append(0.0, theta[2 * n_c : self.n_logs]))
        shape = theta[self.n_logs :]
        ke = ratio[:, None] * shape
        for i in range(n_c):
            slope[i, :, self.n_logs :] = ratio[i] * np.eye(n)
            if i:
                slope[i, :, 2 * n_c + i - 1] = ke[i]
        return ke, slope

    def gain(self, theta: Array) -> tuple[Array, Array, Array]:
        """Return (n_c,) log G, (n_c, n_θ) its derivatives, and (n_c,) r(0)."""
        n_c = self.n_c
        kr = np.exp(theta[:n_c])
        ke, ke_by = self.ke(theta)
        seen = glow((ke @ self.charge.light)[None, :], kr, self.charge.steps)
        q, q_a, q_kr = seen.value[0, 0], seen.by_a[0, 0], seen.by_kr[0, 0]
        # Back to lamp-off: after it the frame's mean falls to e^(-kr d) φ1(kr τ).
        fall, fall_kr = _fall(kr, self.charge.steps)
        by = np.einsum("i,j,ijp->ip", -q_a / q, self.charge.light, ke_by)
        by[:, :n_c] -= np.diag(kr * (q_kr / q - fall_kr / fall))
        by[:, n_c : 2 * n_c] += np.eye(n_c)
        return theta[n_c : 2 * n_c] - np.log(q / fall), by, q / (kr * fall)

    def signal(self, theta: Array) -> tuple[Array, Array]:
        """Return (n_frames, n_places) the signal and (n_frames, n_places, n_θ) its derivatives."""
        data, n_c = self.data, self.n_c
        kr = np.exp(theta[:n_c])
        ke, ke_by = self.ke(theta)
        log_gain, gain_by, _ = self.gain(theta)
        seen = glow(data.light @ ke.T, kr, data.steps)
        factor = data.response[None, :, None] * np.exp(log_gain)
        parts = factor * seen.value
        slope = parts @ gain_by
        slope[:, :, :n_c] += factor * seen.by_kr * kr
        by_place = np.einsum("sj,ijp->sip", data.light, ke_by)
        slope += np.einsum("fsi,sip->fsp", factor * seen.by_a, by_place, optimize=True)
        return parts.sum(axis=2), slope

    def residual(self, theta: Array) -> tuple[Array, Array]:
        """Return (m,) whitened residuals, model less data, and their Jacobian (m, n_θ); infinite beyond all rates."""
        if theta[: self.n_logs].max() > _LARGEST_LOG:
            m = self.data.signal.size + 3 * self.n_c
            return np.full(m, np.inf), np.full((m, theta.size), np.inf)
        # A state that no light excites has no gain. Where a search steps there, it finds no number and turns back.
        with np.errstate(all="ignore"):
            model, slope = self.signal(theta)
        data, n = self.data, theta.size
        used = np.isfinite(data.sigma)
        apart = data.whiten(np.where(used, model - data.signal, 0.0)).ravel()
        J = data.whiten(slope).reshape(-1, n)
        logs = np.concatenate([np.log(self.charge.kr_per_s), np.log(self.charge.amplitude)])
        # What turns errors of (log kr, log A) into unit, unrelated ones.
        prior = np.linalg.cholesky(np.linalg.inv(self.charge.covariance)).T
        known = prior @ (theta[: logs.size] - logs)
        J_known = np.hstack([prior, np.zeros((logs.size, n - logs.size))])
        wall, J_wall = self._wall(theta)
        return np.concatenate([apart, known, wall]), np.concatenate([J, J_known, J_wall])

    def _wall(self, theta: Array) -> tuple[Array, Array]:
        """Return (n_c,) what keeps a search from walking on for ever where ke has no lower end; 0 short of it."""
        ke, ke_by = self.ke(theta)
        a = ke @ self.charge.light
        beyond = np.log(_LINEAR) + theta[: self.n_c] - np.log(np.maximum(a, 1e-300))
        by = -np.einsum("j,ijp->ip", self.charge.light, ke_by) / np.maximum(a, 1e-300)[:, None]
        by[:, : self.n_c] += np.eye(self.n_c)
        active = beyond > 0
        return np.where(active, beyond, 0.0), np.where(active[:, None], by, 0.0)

    def start(self, saturation: float) -> Array:
        """Return (n_θ,) flat rates under which the lamp excites every state by `saturation` times its kr."""
        kr = self.charge.kr_per_s
        flat = saturation * kr / self.charge.light.sum()
        logs = np.concatenate([np.log(kr), np.log(self.charge.amplitude)])
        n = self.data.n_shapes
        if self.common:
            return np.concatenate([logs, np.log(flat[1:] / flat[0]), np.full(n, flat[0])])
        return np.concatenate([logs, np.repeat(flat, n)])


def ends(data: ExcitationData, fresh: Array) -> Array:
    """Return (n_places,) the signal after the longest exposure to the lamp, as a share of `fresh`.

    Args:
        fresh: (n_frames,) what delay and exposure time leave of any glow: frames differ in them.
    """
    last = data.steps.lit_s >= 0.999 * data.steps.lit_s.max()
    scaled, sigma = data.signal[last] / fresh[last, None], data.sigma[last] / fresh[last, None]
    weight = np.where(np.isfinite(sigma), 1 / sigma**2, 0.0)
    total = weight.sum(axis=0)
    signal = (weight * np.where(weight > 0, scaled, 0.0)).sum(axis=0)
    share: Array = np.divide(signal, total, out=np.zeros_like(total), where=total > 0)
    return share


def _fall(kr: Array, steps: Steps) -> tuple[Array, Array]:
    """Return (n_c,) e^(-kr d) φ1(kr τ) of the only frame of `steps`, from lamp-off on, and its derivative by kr."""
    delay, exposure = steps.delay_s[0], steps.exposure_s[0]
    x = kr * exposure
    _, phi1, phi2, _ = phi(x)
    fall = np.exp(-kr * delay)
    return fall * phi1, fall * (exposure * (phi2 - phi1) - delay * phi1)
