"""Which wavelength passes where on the linear variable filter, from a mercury lamp's lines and a known white light.

Each place s passes a band around λ(s), in proportion to it as wide as a wedge of interference layers makes it, and a
little of everything else:

    T(s, λ) = a(s) (exp(-ln 2 |2 (λ - λ(s)) / (w λ(s) / 550)|^p) + leak)

λ(s) is a polynomial that the data may bend only gently, a(s) a smooth curve; w, p and the leak are common. This shape
serves to locate the bands, no more: their true shapes are found by `lvf_curves.py` without it. Every
line of mercury has
an intensity of its own, none below zero, so that a line may be missing, and 576.96 and 579.07 nm may blend, as they do
in bands of 25 nm. Known lights (the LED, alone and behind filters) hold the ends, where mercury has no line: which
wavelength passes there can be seen from the colour in which the camera sees it, and from the filters' edges.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.optimize import least_squares, nnls

Array = NDArray[np.float64]

NM = np.arange(370.0, 741.0)
"""Wavelengths at which light is integrated."""

FEATURES_NM: dict[str, dict[float, float]] = {
    "404.66": {404.656: 1.0, 407.783: 0.08},
    "435.83": {435.833: 1.0, 433.922: 0.06},
    "546.07": {546.074: 1.0},
    "576.96 + 579.07": {576.960: 0.9, 579.066: 1.0},
}
"""The strong lines of mercury in air, as bands of 25 nm separate them, with what blends into each, in the ratio of the
intensities in NIST's table. A ratio that is off by a fifth moves the pair at 578 nm by 0.1 nm."""

_WEAK_NM = (491.607, 623.440, 671.643, 690.752)
"""Weaker ones, which may be there."""

_WIDTH_NM = 25.0
"""What is expected of a band's width (Nalbach 2017, 8.4.2)."""

_DEGREE = 6
_BEND_NM = (1.5, 0.7, 0.4, 0.3)
"""By how much the terms from the third degree on are expected to bend the map."""

_MERCURY_FLOOR, _LIGHT_FLOOR = (0.02, 0.006), (0.02, 0.002)
"""How well the model describes what is seen, as shares of the signal there and of the brightest place.
The shape's tails
show in a line spectrum, where it is dark beside the lines; colours depend on the sensitivities, which are those of
another body of the same model."""

_LIGHTS = 7
"""So many lights are looked at: more are the same witness, the sensitivities, again."""

_GAIN = 0.15
"""Standard deviation of red and blue gain against the sensitivities' own."""


@dataclass(frozen=True, eq=False)
class KnownLight:
    """What the camera sees of a light whose spectrum is known.

    Args:
        name: for people.
        signal: (n, 3) at the nodes.
        sigma: (n, 3) its noise; infinite where it says nothing.
        spectrum: (n_nm,) relative, at `NM`.
    """

    name: str
    signal: Array
    sigma: Array
    spectrum: Array


@dataclass(frozen=True)
class Feature:
    """A line of mercury, or two that blend.

    Args:
        name: its wavelength in nm.
        seen: whether its light is there; if not, the map rests on the others.
        off_nm: by how much it lies off the map.
    """

    name: str
    seen: bool
    off_nm: float


@dataclass(frozen=True, eq=False)
class WavelengthMap:
    """The wavelength at each place.

    Args:
        ends_px: s at which the polynomial's variable is -1 and 1.
        coefficients_nm: (d,) of Chebyshev polynomials.
        covariance_nm2: (d, d) of them.
        width_nm: full width of a band at half its height, at 550 nm.
        features: of mercury.
        gains: (3,) of red, green and blue against the sensitivities' own.
        misfit: root mean square of what the model misses, in the standard deviations that it expects.
    """

    ends_px: tuple[float, float]
    coefficients_nm: Array
    covariance_nm2: Array
    width_nm: float
    features: tuple[Feature, ...]
    gains: Array
    misfit: float = field(default=0.0)

    def nm(self, s: Array) -> Array:
        """(n,) wavelengths at places s (n,)."""
        return np.asarray(chebyshev.chebval(self._variable(s), self.coefficients_nm))

    def standard_error_nm(self, s: Array) -> Array:
        """(n,) of `nm`."""
        basis = chebyshev.chebvander(self._variable(s), self.coefficients_nm.size - 1)
        return np.asarray(np.sqrt(np.einsum("ij,jk,ik->i", basis, self.covariance_nm2, basis)))

    def place(self, nm: Array) -> Array:
        """(n,) s at which wavelengths `nm` (n,) pass; NaN beyond the strip."""
        s = np.linspace(*self.ends_px, 4001)
        at = self.nm(s)
        order = slice(None, None, 1 if at[-1] > at[0] else -1)
        # Beyond the turning point of a polynomial that bends back at an end, nothing is believed.
        rising = np.maximum.accumulate(at[order])
        return np.interp(nm, rising, s[order], left=np.nan, right=np.nan)

    def _variable(self, s: Array) -> Array:
        low, high = self.ends_px
        return np.asarray(2 * (s - low) / (high - low) - 1)


def fit_map(
    nodes_px: Array,
    mercury: KnownLight | None,
    lights: list[KnownLight],
    sensitivities: Array,
    shape: tuple[Array, Array] | None = None,
) -> WavelengthMap:
    """Fit the map to whatever is there: mercury, known lights, or both; no guess is needed.

    Args:
        nodes_px: (n,) s of the nodes.
        mercury: what the camera sees of the mercury lamp; its `spectrum` is not looked at.
        lights: the LED, alone and behind filters.
        sensitivities: (n_nm, 3) of the camera at `NM`.
        shape: of a band at 550 nm, if it is known: distance from its middle in nm, and height, 1 at most. It takes the
            place of the exponential in T; only its width is fitted.
    """
    model = _Model(nodes_px, mercury, _unlike(lights), sensitivities, shape)
    starts = sorted(
        (model.cost(start), tuple(start))
        for blue in (350.0, 370.0, 390.0, 410.0, 430.0)
        for red in (640.0, 670.0, 700.0, 730.0, 760.0)
        for start in (model.start(blue, red), model.start(red, blue))
    )
    fits = [
        least_squares(model.residuals, start, loss="soft_l1", x_scale=model.scales, max_nfev=40)
        for _, start in starts[:2]
    ]
    best = min(fits, key=lambda f: float(f.cost))
    return model.answer(best.x, best.jac)


def _unlike(lights: list[KnownLight]) -> list[KnownLight]:
    """The few that differ most: the first, then each time the one least like any that is taken."""
    shapes = [light.spectrum / (np.linalg.norm(light.spectrum) + 1e-300) for light in lights]
    taken = [0][: len(lights)]
    while len(taken) < min(_LIGHTS, len(lights)):
        nearest = [min(float(np.sum((s - shapes[k]) ** 2)) for k in taken) for s in shapes]
        taken.append(int(np.argmax(nearest)))
    return [lights[k] for k in taken]


class _Model:
    """The equations above; what is linear (a, the lines' intensities) is eliminated."""

    def __init__(
        self,
        nodes: Array,
        mercury: KnownLight | None,
        lights: list[KnownLight],
        sensitivities: Array,
        shape: tuple[Array, Array] | None,
    ) -> None:
        self.shape = shape
        self.ends = (float(nodes[0]), float(nodes[-1]))
        self.t = 2 * (nodes - nodes[0]) / (nodes[-1] - nodes[0]) - 1
        self.mercury, self.lights = mercury, lights
        self.sensitivities = sensitivities
        self.lines_nm = np.array([*(x for f in FEATURES_NM.values() for x in f), *_WEAK_NM])
        self.at_lines = np.stack([np.interp(self.lines_nm, NM, s) for s in sensitivities.T], axis=-1)
        # Lines to unknown intensities: those of a feature share one.
        shares = [(k, r) for k, f in enumerate(FEATURES_NM.values()) for r in f.values()]
        shares += [(len(FEATURES_NM) + k, 1.0) for k in range(len(_WEAK_NM))]
        self.members = np.zeros((self.lines_nm.size, shares[-1][0] + 1))
        for line, (k, ratio) in enumerate(shares):
            self.members[line, k] = ratio
        self.smooth = chebyshev.chebvander(self.t, 5)
        # Of each light, the share of it that each channel sees: (n_nm, lights, 3).
        self.seen = np.stack([x.spectrum[:, None] * sensitivities for x in lights], 1) if lights else None
        if lights:
            self.light = np.nan_to_num(np.stack([x.signal for x in lights], 1))
            self.light_weight = _weight(self.light, np.stack([x.sigma for x in lights], 1), _LIGHT_FLOOR)
        if mercury is not None:
            self.mercury_weight = _weight(
                np.nan_to_num(mercury.signal)[:, None], mercury.sigma[:, None], _MERCURY_FLOOR
            )[:, 0]
        self.scales = np.array([10.0, 10.0, 3.0, *_BEND_NM, 3.0, 0.5, 0.5, 0.05, 0.05])

    def start(self, first_nm: float, last_nm: float) -> Array:
        middle, half = (first_nm + last_nm) / 2, (last_nm - first_nm) / 2
        return np.array([middle, half, *[0.0] * (_DEGREE - 1), _WIDTH_NM, 3.0, np.log(1e-3), 0.0, 0.0])

    def cost(self, p: Array) -> float:
        # Of unbounded residuals: a start that misses everything must not look as good as any other.
        return float(np.sum(np.log1p(self.residuals(p) ** 2)))

    def residuals(self, p: Array) -> Array:
        parts, _ = self.parts(p)
        prior = np.concatenate(
            [
                p[3 : _DEGREE + 1] / _BEND_NM,
                [
                    p[2] / 20,
                    (p[-5] - _WIDTH_NM) / 10,
                    (p[-4] - 3) / 1.0,
                    (p[-3] + 7) / 2,
                    p[-2] / _GAIN,
                    p[-1] / _GAIN,
                ],
            ]
        )
        return np.concatenate([*(part.ravel() for part in parts), prior])

    def parts(self, p: Array) -> tuple[list[Array], Array]:
        """Residuals of mercury (n, 3) and of the lights (n, lights, 3), in their σ; and the lines' intensities."""
        centre = chebyshev.chebval(self.t, p[: _DEGREE + 1])
        gains = np.exp([p[-2], 0.0, p[-1]])
        amplitude: Array = np.ones(self.t.size)
        parts = []
        if self.seen is not None:
            band = self._band(p, centre, NM)
            predicted = np.tensordot(band, self.seen, 1) * gains
            amplitude, missed = self._amplitude(predicted)
            parts.append(missed)
        intensity = np.zeros(self.members.shape[1])
        if self.mercury is not None:
            profile = self._band(p, centre, self.lines_nm) * amplitude[:, None]
            columns = profile[:, None, :] * (self.at_lines.T * gains[:, None])[None] @ self.members
            flat = (self._band(p, centre, NM) @ self.sensitivities) * amplitude[:, None] * gains
            columns = np.concatenate([columns, flat[..., None]], axis=-1)
            weight = self.mercury_weight
            A = (columns * weight[..., None]).reshape(-1, columns.shape[-1])
            length = np.linalg.norm(A, axis=0) + 1e-300
            y = (np.nan_to_num(self.mercury.signal) * weight).ravel()
            solved, _ = nnls(A / length, y)
            intensity = (solved / length)[:-1]
            parts.append((A @ (solved / length) - y).reshape(weight.shape))
        return parts, intensity

    def _amplitude(self, predicted: Array) -> tuple[Array, Array]:
        """Fit a(s), a smooth curve, to the lights; return it and the residuals."""
        weight = self.light_weight
        y = self.light * weight
        A = (predicted * weight)[..., None] * self.smooth[:, None, None, :]
        flat = A.reshape(-1, self.smooth.shape[1])
        ridge = 1e-4 * np.sqrt(np.sum(flat**2) / flat.shape[1]) * np.eye(flat.shape[1])
        solved = np.linalg.lstsq(
            np.concatenate([flat, ridge]), np.append(y.ravel(), np.zeros(ridge.shape[0])), rcond=None
        )[0]
        missed = (flat @ solved).reshape(y.shape) - y
        curve = self.smooth @ solved
        return np.asarray(np.maximum(curve, 1e-3 * float(np.abs(curve).max()))), np.asarray(missed)

    def _band(self, p: Array, centre: Array, nm: Array) -> Array:
        if self.shape is not None:
            x = (nm - centre[:, None]) * 550 / np.maximum(centre, 1.0)[:, None] * _WIDTH_NM / max(p[-5], 1.0)
            known: Array = np.interp(x, *self.shape, left=0.0, right=0.0)
            return np.asarray(known + np.exp(np.clip(p[-3], -14, -2)))
        width, power, leak = p[-5] * centre / 550, np.clip(p[-4], 1.2, 8.0), np.exp(np.clip(p[-3], -14, -2))
        offset = np.abs(2 * (nm - centre[:, None]) / np.maximum(width, 1.0)[:, None])
        return np.asarray(np.exp(-np.log(2) * np.minimum(offset**power, 60.0)) + leak)

    def answer(self, p: Array, jacobian: Array) -> WavelengthMap:
        parts, intensity = self.parts(p)
        missed = np.concatenate([part[np.isfinite(part)].ravel() for part in parts])
        scale = max(1.0, float(np.mean(missed**2)))
        # One misfit is seen by many neighbouring nodes, and what the sensitivities miss by all lights: they are not
        # independent witnesses. All lights together count as one.
        independent = jacobian.copy()
        if self.lights:
            independent[: self.light.size] /= np.sqrt(len(self.lights))
        covariance = np.linalg.pinv(independent.T @ independent) * scale * self._neighbours(p)
        d = _DEGREE + 1
        return WavelengthMap(
            ends_px=self.ends,
            coefficients_nm=p[:d],
            covariance_nm2=np.asarray(covariance[:d, :d], float),
            width_nm=float(p[-5]),
            features=self._features(p, intensity),
            gains=np.exp([p[-2], 0.0, p[-1]]),
            misfit=float(np.sqrt(np.mean(missed**2))),
        )

    def _neighbours(self, p: Array) -> float:
        """How many nodes lie within a band: what the shape misses there, it misses together."""
        per_node = abs(2 * p[1] / self.t.size)
        return max(1.0, float(p[-5] / per_node / 2))

    def _features(self, p: Array, intensity: Array) -> tuple[Feature, ...]:
        """How far each feature lies off the map: the step that would mend it, from its own surroundings."""
        if self.mercury is None:
            return ()
        here = self.parts(p)[0][-1]
        moved = p.copy()
        moved[0] += 0.2
        slope = (self.parts(moved)[0][-1] - here) / 0.2
        centre = chebyshev.chebval(self.t, p[: _DEGREE + 1])
        found = []
        strongest = float(intensity.max())
        for (name, lines), mine in zip(FEATURES_NM.items(), intensity, strict=False):
            near = np.abs(centre - np.mean(list(lines))) < 0.8 * p[-5]
            a, b = slope[near].ravel(), here[near].ravel()
            square = float(a @ a)
            seen = bool(near.any()) and mine > 0.01 * strongest and square > 0
            found.append(Feature(name, seen, float(-(a @ b) / square) if seen else float("nan")))
        return tuple(found)


def _weight(signal: Array, sigma: Array, floor: tuple[float, float]) -> Array:
    """1 / σ of signals (n, lights, 3), with what the model is not expected to describe."""
    brightest = np.where(np.isfinite(sigma), signal, 0.0).max(axis=(0, 2))[None, :, None]
    return np.asarray(1 / np.sqrt(sigma**2 + (floor[0] * signal) ** 2 + (floor[1] * brightest) ** 2))
