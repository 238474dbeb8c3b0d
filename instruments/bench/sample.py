"""The bench's sample: a persistent phosphor with a distribution of trap depths and retrapping.

Deliberately not the model that is fitted to it. A sum of exponentials is the light of traps that empty
one by one into nothing; here every electron that leaves a trap meets ionised centres and empty traps of
all depths, and the tail follows a power law rather than an exponential.

Traps of depth E_i (N_i of them, n_i full, both as shares of all traps) release at p_i = s exp(-E_i / kT).
A free electron recombines with one of h ionised centres or is trapped again, with cross sections in the
ratio R; free electrons are few and live short, so their number follows the rest (quasi-steady):

    free  = g(t) (1 - h) + Σ p_i n_i              electrons set free per second
    light = free h / (h + R Σ (N_i - n_i))        the share that recombines
    dn_i/dt = -p_i n_i + free R (N_i - n_i) / (h + R Σ (N_i - n_i))
    h = Σ n_i                                     charge is neutral

as in the general one-trap model of thermoluminescence (Halperin and Braner 1960), over many depths.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from phoslab.bands import Bands

Array = NDArray[np.float64]

BOLTZMANN_EV_PER_K = 8.617333262e-5
RELATIVE_TOLERANCE = 1e-10


@dataclass(frozen=True)
class Sample:
    """A phosphor paint. Its colour is constant; only its brightness changes.

    Args:
        name: for people.
        depth_eV, width_eV: mean and standard deviation of the trap depths.
        more_traps: further groups of traps: how many there are for each of the first group's, the mean and the
            standard deviation of their depths in eV.
        attempts_per_s: s, how often an electron tries to leave its trap.
        retrapping: R.
        temperature_C: of the sample.
        excitation_per_s: share of the centres that unit irradiance at a wavelength that excites fully
            ionises per second.
        excitation_edge_nm, excitation_softness_nm: light of longer wavelengths does not excite.
        emission_nm: wavelength of the emission's peak.
        emission_widths_nm: standard deviations below and above it.
    """

    name: str = "green"
    depth_eV: float = 0.74
    width_eV: float = 0.05
    more_traps: tuple[tuple[float, float, float], ...] = ()
    attempts_per_s: float = 1e12
    retrapping: float = 3.0
    temperature_C: float = 21.0
    excitation_per_s: float = 0.35
    excitation_edge_nm: float = 450.0
    excitation_softness_nm: float = 12.0
    emission_nm: float = 522.0
    emission_widths_nm: tuple[float, float] = (27.0, 40.0)

    # 40 depths a group over ±3.2 standard deviations: their rates are a factor of 1.4 apart, narrower than the
    # width of one exponential on a logarithmic time axis, so that the sum is smooth.
    _N_GROUP = 40

    @property
    def n_depths(self) -> int:
        """Number of depths, all groups together."""
        return self._N_GROUP * (1 + len(self.more_traps))

    @property
    def _groups(self) -> tuple[tuple[float, float, float], ...]:
        return ((1.0, self.depth_eV, self.width_eV), *self.more_traps)

    @property
    def _depths(self) -> Array:
        """(n_depths,) E_i in eV."""
        spread = np.linspace(-3.2, 3.2, self._N_GROUP)
        return np.concatenate([depth + width * spread for _, depth, width in self._groups])

    @property
    def capacity(self) -> Array:
        """(n_depths,) N_i; they sum to 1."""
        spread = np.linspace(-3.2, 3.2, self._N_GROUP)
        density = np.exp(-0.5 * spread**2)
        many = np.concatenate([share * density for share, _, _ in self._groups])
        return np.asarray(many / many.sum())

    @property
    def release_per_s(self) -> Array:
        """(n_depths,) p_i."""
        return self.release_at(self.temperature_C)

    def release_at(self, temperature_C: float) -> Array:
        """(n_depths,) p_i at another temperature: some 12 % more a degree."""
        kT_eV = BOLTZMANN_EV_PER_K * (temperature_C + 273.15)
        return np.asarray(self.attempts_per_s * np.exp(-self._depths / kT_eV))

    @property
    def empty(self) -> Array:
        """(n_depths,) the state of a sample that was kept dark for long."""
        return np.zeros(self.n_depths)

    def emission(self, nm: Array) -> Array:
        """Relative spectral radiance at wavelengths `nm`, 1 at the peak: a Gaussian with a red tail."""
        below, above = self.emission_widths_nm
        offset = nm - self.emission_nm
        return np.asarray(np.exp(-0.5 * (offset / np.where(offset < 0, below, above)) ** 2))

    def excitation(self, nm: Array) -> Array:
        """Share of light at wavelengths `nm` that excites, 0..1."""
        return np.asarray(1 / (1 + np.exp((nm - self.excitation_edge_nm) / self.excitation_softness_nm)))

    def drive_per_s(self, irradiance: Array, bands: Bands) -> float:
        """Share of the centres that light of (n_λ,) relative irradiance ionises per second: g."""
        effective = self.excitation(bands.centres_nm) * irradiance
        return float(self.excitation_per_s * np.average(effective, weights=bands.widths_nm))

    def light(self, state: Array, drive_per_s: float = 0.0) -> float:
        """Light of a state (n_depths,), in recombinations per second as a share of the traps."""
        return float(self._flow(state, drive_per_s)[1])

    def _flow(self, state: Array, drive_per_s: float) -> tuple[Array, Array]:
        """The state's rate of change (n_depths,) and its light ()."""
        free_traps = self.capacity - state
        holes = state.sum()
        released = self.release_per_s * state
        free = drive_per_s * (1 - holes) + released.sum()
        retrapped = self.retrapping * free_traps
        sinks = holes + retrapped.sum()
        return free * retrapped / sinks - released, free * holes / sinks

    def advance(
        self, state: Array, duration_s: float, drive: Callable[[float], float] | None = None
    ) -> tuple[Array, float]:
        """Let time pass; return the state afterwards and the light that came out (integral over time).

        Args:
            state: (n_depths,) n_i.
            duration_s: how long.
            drive: g in 1/s (see `drive_per_s`) as a function of seconds from now; None: dark.
        """
        if duration_s <= 0:
            return state, 0.0
        solution = self._solve(state, duration_s, drive, np.array([duration_s]))
        return solution[:-1, -1], float(solution[-1, -1])

    def afterglow(self, state: Array, times_s: Array, drive: Callable[[float], float] | None = None) -> Array:
        """(n,) light at ascending times after `state`; see `advance` for `drive`."""
        solution = self._solve(state, float(times_s[-1]), drive, times_s)
        driven = [0.0 if drive is None else drive(t) for t in times_s]
        return np.array([self.light(n, d) for n, d in zip(solution[:-1].T, driven, strict=True)])

    def _solve(
        self, state: Array, duration_s: float, drive: Callable[[float], float] | None, times_s: Array
    ) -> Array:
        """(n_depths + 1, n_times): the state and, last, the light integral."""

        def flow(t: float, y: Array) -> Array:
            change, light = self._flow(y[:-1], 0.0 if drive is None else drive(t))
            return np.append(change, light)

        # Release rates span from 100/s to 4e-4/s, over minutes: stiff.
        solution = solve_ivp(
            flow,
            (0.0, duration_s),
            np.append(state, 0.0),
            method="LSODA",
            t_eval=times_s,
            rtol=RELATIVE_TOLERANCE,
            atol=1e-14,
        )
        if not solution.success:
            raise RuntimeError(f"the sample's equations could not be solved: {solution.message}")
        return np.asarray(solution.y)
