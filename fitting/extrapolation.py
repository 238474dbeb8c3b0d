"""What the data allow outside of the times measured: a band that no number of states is assumed for.

Every decay that only falls, and falls ever more slowly, is a sum of exponentials with non-negative amplitudes
(Bernstein). The band at a time is the least and the largest value that any such sum takes there while it fits the
data not worse than the best by more than chance. With the rates on a fine grid that is a convex problem: χ² as a
function of the value asked for, by non-negative least squares. Where an offset was fitted, a constant light is taken to
be the room's for the lower end and the sample's for the upper one: nothing in the data tells which. Only a fit without
offset says that there is no light but the sample's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from phoslab.fitting.decay import DecayFit, misfit
from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.decay_problem import exposed_decay
from phoslab.fitting.written import for_json

Array = NDArray[np.float64]

_PER_DECADE = 12
_EDGE = 1e-3  # to which the ends of a band are found
_LIMIT = 3.841  # 95 % of chi² with one degree of freedom


@dataclass(frozen=True)
class Beyond:
    """The signal at a time, and the band that the data allow.

    Args:
        t_s: when.
        value: (n_channels,) the fit continued, offset left out; NaN where it is not to be told.
        low, high: (n_channels,) the band of 95 %.
        outside: "", or where the time lies: "before the data", "beyond the data".
        constant: whether a fitted constant counts as no glow for `low`, and as glow for `high`.
        untold: "", or why a value is left out.
    """

    t_s: float
    value: Array
    low: Array
    high: Array
    outside: str
    constant: bool
    untold: str = ""

    def without_value(self, why: str) -> Beyond:
        """Return it with the band alone."""
        return replace(self, value=np.full_like(self.value, np.nan), untold=why)

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON takes it."""
        band = np.stack([self.low, self.high], axis=1)
        return {"t_s": self.t_s, "value": for_json(self.value), "band95": band.tolist()}


def lines(beyonds: Sequence[Beyond], channels: Sequence[str]) -> list[str]:
    """Return them as text for people, one line each and one above."""
    if not beyonds:
        return []
    constant = beyonds[0].constant
    text = [
        "[[at other times: the glow without its constant, and the band of 95 %, whose upper end counts it as glow]]"
        if constant
        else "[[at other times: the glow, and the band of 95 % that the data allow]]"
    ]
    for b in beyonds:
        cells = ", ".join(
            f"{c} {f'{v:.4g}' if np.isfinite(v) else 'not told by the fit'} ({lo:.3g} .. {hi:.3g})"
            for c, v, lo, hi in zip(channels, b.value, b.low, b.high, strict=True)
        )
        text.append(f"  {b.t_s:g} s: {cells}{'   ' * bool(b.outside)}{b.outside}")
    return text


def warnings(beyonds: Sequence[Beyond], data: DecayData) -> list[str]:
    """Return sentences on those outside of the data, without a value, and with a constant."""
    said = []
    span = f"reach from {data.begin_s:.4g} s to {data.end_s:.4g} s"
    for where in ("before the data", "beyond the data"):
        if far := [b.t_s for b in beyonds if b.outside == where]:
            lie = "lies" if len(far) == 1 else "lie"
            said.append(
                f"extrapolated: {_times(far)} {lie} {where}, which {span}; only the band is supported."
            )
    for why in dict.fromkeys(b.untold for b in beyonds if b.untold):
        times = _times([b.t_s for b in beyonds if b.untold == why])
        said.append(f"not-told: at {times} the fit's own value is left out, since {why}.")
    if any(b.constant for b in beyonds):
        said.append(
            "constant-or-glow: a constant was fitted, and nothing in these data tells light of the room from glow "
            "that is too slow to be seen falling: at other times anything from none of the constant to all "
            "of it may be glow. Measure the reading without the sample, subtract it, and fit with --offset none."
        )
    return said


def _times(times_s: Sequence[float]) -> str:
    return ", ".join(f"{t:g} s" for t in times_s)


def beyond(fit: DecayFit, t_s: float) -> Beyond:
    """Return the glow of each channel at `t_s`, and the band that the data allow whatever the number of states."""
    data = fit.data
    end = max(t_s, data.end_s)
    low, high = 1e-3 / end, 10 / data.shortest_step_s
    rates = np.geomspace(low, high, int(_PER_DECADE * np.log10(high / low)) + 2)
    rates = np.concatenate([[0.0], np.unique(np.concatenate([rates, fit.kr_per_s]))])
    g, _ = exposed_decay(rates, data.t_s, data.exposure_s)
    at = np.exp(-rates * t_s)
    value = np.exp(-fit.kr_per_s * t_s) @ fit.amplitude
    ends = np.zeros((2, len(value)))
    for c in range(len(value)):
        used = data.used[:, c]
        w = 1 / data.total_sigma[used, c]
        # A negative constant is no light: it is taken off. Of the room's light there is any amount from none on.
        phi, y = w[:, None] * g[used], w * (data.signal[used, c] - min(float(fit.offset[c]), 0.0))
        room = fit.has_offset and fit.offset[c] > 0
        ends[:, c] = (
            _extremes(np.column_stack([phi, w]), y, np.append(at, 0.0), fit)
            if room
            else _extremes(phi, y, at, fit)
        )
    # A fit that misses the data says what no course through them does.
    held = (value >= ends[0] * (1 - _EDGE)) & (value <= ends[1] * (1 + _EDGE))
    constant = bool(fit.has_offset and (fit.offset > 0).any())
    outside = "before the data" if t_s < data.begin_s else "beyond the data" if t_s > data.end_s else ""
    clear = (not outside) | (value >= fit.offset)
    why = "it leaves the band that the data allow"
    if held.all():
        why = "" if clear.all() else "it is less than its own constant, which may be glow as well"
    return Beyond(t_s, np.where(held & clear, value, np.nan), ends[0], ends[1], outside, constant, untold=why)


def _extremes(phi: Array, y: Array, at: Array, fit: DecayFit) -> tuple[float, float]:
    """Return the least and largest value of `at` · x over x >= 0 with chi² within the limit."""
    x, norm = nnls(phi, y, maxiter=50 * phi.shape[1])
    bar = norm**2 + _LIMIT * misfit(fit.chi2, fit.dof)
    middle = float(at @ x)
    # A row so heavy that the value is met to 1e-6 of a typical residual.
    scale = max(middle, float(np.abs(y).max() / np.linalg.norm(phi, axis=0).max()) * 1e-9)
    heavy = 1e3 * max(1.0, float(np.sqrt(bar))) / scale

    def chi2(value: float) -> float:
        A = np.concatenate([phi, heavy * at[None]])
        found, _ = nnls(A, np.append(y, heavy * value), maxiter=50 * phi.shape[1])
        return float(np.sum((y - phi @ found) ** 2)) if abs(at @ found - value) < 0.01 * scale else np.inf

    top = middle + scale
    for _ in range(60):
        if chi2(top) > bar:
            break
        top = middle + 2 * (top - middle)
    return _crossing(chi2, bar, middle, 0.0), _crossing(chi2, bar, middle, top)


def _crossing(chi2: Callable[[float], float], bar: float, inner: float, outer: float) -> float:
    """Bisect for the value between, at which chi² passes the bar; the outer one if it never does."""
    if chi2(outer) <= bar:
        return outer
    for _ in range(40):
        middle = (inner + outer) / 2
        inner, outer = (middle, outer) if chi2(middle) <= bar else (inner, middle)
        if abs(outer - inner) <= 1e-4 * max(abs(outer), abs(inner)):
            break
    return (inner + outer) / 2
