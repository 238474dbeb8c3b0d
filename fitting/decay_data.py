"""A measured decay: signals of channels at times after lamp-off, and their noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phoslab.fitting.noise import NoiseLaw

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DecayData:
    """A measured decay.

    Args:
        t_s: (n,) start of each exposure, in s since lamp-off.
        exposure_s: (n,) exposure times in s.
        signal: (n, n_channels) linear signal a second, in units of the camera.
        sigma: (n, n_channels) standard deviation of its noise; infinite for a value that is left out.
        repeatability: relative standard deviation of a whole frame (shutter, gain), shared by its channels.
        channels: names of the channels.
        law: how `sigma` depends on the signal, where that is known: the fit then takes it from its own model.
        expected: (n, n_channels) the signal that `repeatability` refers to; by default that of the fit.
    """

    t_s: Array
    exposure_s: Array
    signal: Array
    sigma: Array
    repeatability: float = 0.0
    channels: tuple[str, ...] = ("R", "G", "B")
    law: NoiseLaw | None = None
    expected: Array | None = None

    def __post_init__(self) -> None:
        if not np.isfinite(self.signal[self.used]).all() or not (self.sigma > 0).all():
            raise ValueError("signal must be finite and sigma positive wherever a value is used")

    @property
    def used(self) -> NDArray[np.bool_]:
        """(n, n_channels) the values that take part."""
        return np.isfinite(self.sigma)

    @property
    def _reference(self) -> Array:
        return self.signal if self.expected is None else self.expected

    @property
    def total_sigma(self) -> Array:
        """(n, n_channels) noise and repeatability together; infinite for a value that is left out."""
        return np.where(self.used, np.hypot(self.sigma, self.repeatability * self._reference), np.inf)

    def whitening(self) -> Array:
        """Return (n, n_channels, n_channels): matrices that turn a frame's errors into unit, unrelated ones.

        A frame's covariance is D (1 + u uᵀ) D with D = diag(σ) and u = repeatability * signal / σ: the noise of
        the channels is their own, the frame's scale is common. Its inverse root is closed; rows and columns of
        values that are left out are 0.
        """
        u = self.repeatability * np.where(self.used, self._reference / self.sigma, 0.0)
        u2 = (u**2).sum(axis=1)
        shrink = np.divide(1 - 1 / np.sqrt(1 + u2), u2, out=np.zeros_like(u2), where=u2 > 0)
        roots = np.eye(u.shape[1]) - shrink[:, None, None] * u[:, :, None] * u[:, None, :]
        matrices: Array = roots / self.sigma[:, None, :]
        return matrices

    def weighted_by(self, model: Array) -> DecayData:
        """Return the same values with the noise that they would have about `model` (n, n_channels)."""
        # A value that is left out binds the model to nothing, and a fast state may be anything there.
        largest = 10 * np.abs(np.where(self.used, self.signal, 0.0)).max(axis=0)
        model = np.where(self.used, np.clip(model, -largest, largest), 0.0)
        sigma = self.sigma if self.law is None else np.where(self.used, self.law.sigma(model), np.inf)
        return replace(self, sigma=sigma, expected=model)

    @property
    def n_values(self) -> int:
        """How many values take part."""
        return int(np.count_nonzero(self.used))

    @property
    def begin_s(self) -> float:
        """When the first exposure began."""
        return float(self.t_s.min())

    @property
    def middle_s(self) -> Array:
        """(n,) the middles of the exposures."""
        middle: Array = self.t_s + self.exposure_s / 2
        return middle

    @property
    def shortest_step_s(self) -> float:
        """The shortest time between two exposures; all of it where there is one only."""
        steps = np.diff(np.sort(self.t_s))
        return float(steps[steps > 0].min()) if (steps > 0).any() else self.end_s

    @property
    def end_s(self) -> float:
        """When the last exposure ended."""
        return float((self.t_s + self.exposure_s).max())

    def take(self, frames: slice | NDArray[np.bool_] | NDArray[np.intp]) -> DecayData:
        """Return the decay with only some of its frames."""
        return replace(
            self,
            t_s=self.t_s[frames],
            exposure_s=self.exposure_s[frames],
            signal=self.signal[frames],
            sigma=self.sigma[frames],
            expected=None if self.expected is None else self.expected[frames],
        )
