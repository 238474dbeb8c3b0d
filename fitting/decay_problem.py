"""The model of a decay, as a problem that variable projection solves (Nalbach 2017, 8.4.4).

The model of channel c at time t after lamp-off, averaged over the exposure τ that begins at t:

    S_c(t) = O_c + Σ_i A_ic exp(-kr_i t) φ(kr_i τ),    φ(x) = (1 - exp(-x)) / x

`rank_one`: the spectrum of the glow is constant in time, so one colour C (its largest channel is 1) serves all
states, A_ic = A_i C_c (the paper's form, for sessions). Otherwise each channel has amplitudes of its own (tables,
whose channels may be anything). The offset O is 0 unless it is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.fitting import varpro
from phoslab.fitting.decay_data import DecayData

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Problem:
    """A decay as `varpro` takes it.

    Args:
        data: the decay.
        n_states: number of exponentials.
        offset: whether each channel has a constant.
        rank_one: whether one colour serves all states.
        reference: the channel whose colour is 1.
        W: (n, n_channels, n_channels) whitening.
        y: (n_blocks, m) whitened data: one block if `rank_one`, else one a channel.
    """

    data: DecayData
    n_states: int
    offset: bool
    rank_one: bool
    reference: int
    W: Array
    y: Array

    @property
    def n_parameters(self) -> int:
        """Number of free parameters."""
        return n_parameters(self.data, self.n_states, offset=self.offset, rank_one=self.rank_one)

    @property
    def signed(self) -> NDArray[np.bool_]:
        """(n_x,) which linear parameters may be negative: offsets."""
        n_offsets = (self.data.signal.shape[1] if self.rank_one else 1) if self.offset else 0
        return np.arange(self.n_states + n_offsets) >= self.n_states

    def basis(self, theta: Array) -> tuple[Array, Array]:
        """Return Φ and dΦ/dθ, weighted."""
        data, n_states, W = self.data, self.n_states, self.W
        n, n_channels = data.signal.shape
        g, dg = exposed_decay(np.exp(theta[:n_states]), data.t_s, data.exposure_s)
        i = np.arange(n_states)
        if not self.rank_one:
            weight = np.diagonal(W, axis1=1, axis2=2).T  # (n_channels, n)
            phi = np.empty((n_channels, n, n_states + int(self.offset)), theta.dtype)
            phi[:, :, :n_states] = weight[:, :, None] * g
            phi[:, :, n_states:] = weight[:, :, None]
            dphi = np.zeros((n_states, *phi.shape), theta.dtype)
            dphi[i, :, :, i] = weight[None] * dg.T[:, None, :]
            return phi, dphi
        seen = W @ np.insert(theta[n_states:], self.reference, 1.0)  # (n, n_channels)
        n_x = n_states + n_channels * int(self.offset)
        phi = np.empty((n, n_channels, n_x), theta.dtype)
        phi[:, :, :n_states] = seen[:, :, None] * g[:, None, :]
        if self.offset:
            phi[:, :, n_states:] = W
        dphi = np.zeros((theta.size, n, n_channels, n_x), theta.dtype)
        dphi[i, :, :, i] = seen[None] * dg.T[:, :, None]
        for j, channel in enumerate(self.other_channels):
            dphi[n_states + j, :, :, :n_states] = W[:, :, channel, None] * g[:, None, :]
        return phi.reshape(1, n * n_channels, n_x), dphi.reshape(theta.size, 1, n * n_channels, n_x)

    @property
    def other_channels(self) -> NDArray[np.intp]:
        """The channels but the reference."""
        return np.delete(np.arange(self.data.signal.shape[1]), self.reference)

    def reweighted(self, model: Array) -> Problem:
        """Return the problem with the noise that the values would have about `model`."""
        return _weighted(replace(self, data=self.data.weighted_by(model)))

    def solve(self, start: Array, **options: object) -> varpro.Solution:
        """Minimise from one θ; `options` are those of `varpro.solve`."""
        return varpro.solve(self.basis, self.y, start, signed=self.signed, **options)  # type: ignore[arg-type]

    def model(self, found: varpro.Solution) -> Array:
        """Return (n, n_channels) the modelled signal of a solution."""
        amplitude, offset = self.linear(found)
        g, _ = exposed_decay(np.exp(found.theta[: self.n_states]), self.data.t_s, self.data.exposure_s)
        signal: Array = g @ amplitude + offset
        return signal

    def linear(self, found: varpro.Solution) -> tuple[Array, Array]:
        """Return amplitude (n_c, n_channels) and offset (n_channels,) of a solution."""
        n_states, n_channels = self.n_states, self.data.signal.shape[1]
        x = found.linear
        if self.rank_one:
            colour = np.insert(found.theta[n_states:], self.reference, 1.0)
            return x[0, :n_states, None] * colour, (x[0, n_states:] if self.offset else np.zeros(n_channels))
        return x[:, :n_states].T, (x[:, n_states] if self.offset else np.zeros(n_channels))


def n_parameters(data: DecayData, n_states: int, *, offset: bool, rank_one: bool) -> int:
    """Return how many parameters a fit to `data` has."""
    n_channels = int(data.signal.shape[1])
    own = n_states + n_channels - 1 if rank_one else n_states * n_channels
    return n_states + own + n_channels * int(offset)


def problem(data: DecayData, n_states: int, *, offset: bool = False, rank_one: bool = True) -> Problem:
    """State a fit of `n_states` exponentials.

    Raises:
        PhoslabError: fewer values than parameters.
    """
    if data.repeatability and not rank_one:
        raise ValueError("errors that channels share need rank one")
    empty = np.zeros(0)
    stated = Problem(data, n_states, offset, rank_one, int(np.argmax(first_colour(data))), empty, empty)
    if data.n_values < stated.n_parameters:
        raise PhoslabError(
            f"has {data.n_values} usable values, too few for {stated.n_parameters} parameters",
            field="the decay",
            remedy="Take more frames, expose them better, or fit fewer states.",
        )
    return _weighted(stated)


def _weighted(stated: Problem) -> Problem:
    W = stated.data.whitening()
    y = (W @ np.where(stated.data.used, stated.data.signal, 0.0)[:, :, None])[:, :, 0]
    return replace(stated, W=W, y=y.reshape(1, -1) if stated.rank_one else y.T.copy())


def exposed_decay(kr: Array, t_s: Array, exposure_s: Array) -> tuple[Array, Array]:
    """Return (n, n_c) exp(-kr t) φ(kr τ) and its derivative by log kr."""
    start = np.exp(-t_s[:, None] * kr)
    if not exposure_s.any():
        return start, -t_s[:, None] * kr * start
    x = exposure_s[:, None] * kr
    phi = np.divide(-np.expm1(-x), x, out=np.ones_like(x), where=x > 0)
    return start * phi, start * (np.exp(-x) - phi - t_s[:, None] * kr * phi)


def first_colour(data: DecayData) -> Array:
    """Return (n_channels,) a first guess of the colour, its largest 1."""
    weight = 1 / data.total_sigma
    y = np.where(data.used, data.signal, 0.0) * weight
    light, information = (y * weight).sum(axis=0), (weight**2).sum(axis=0)
    colour = np.divide(light, information, out=np.zeros_like(light), where=information > 0)
    scaled: Array = colour / (np.abs(colour).max() or 1.0)
    return scaled
