"""How well a fit predicts frames that it has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from phoslab.fitting.decay import DecayFit
from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.selection import select

# A prediction may miss a frame by this many standard deviations of the frame's own noise without being wrong.
NOISE_ALLOWANCE = 3.0


@dataclass(frozen=True)
class HoldOut:
    """The worst misprediction of the frames held out, by a fit to the others.

    Args:
        n_states: of the fit.
        automatic: whether this number of states would have been chosen.
        worst: largest |predicted - measured| / measured, after `NOISE_ALLOWANCE` σ of noise are taken off.
        worst_t_s: when, the middle of the exposure in s since lamp-off.
    """

    n_states: int
    automatic: bool
    worst: float
    worst_t_s: float


def hold_out(data: DecayData, states: Sequence[int] = (1, 2, 3)) -> list[HoldOut]:
    """Fit each number of states to every second frame and predict the others. Empty if there are too few frames."""
    seen, unseen = data.take(slice(0, None, 2)), data.take(slice(1, None, 2))
    if seen.n_values <= 2 * min(states) + data.signal.shape[1] or not unseen.n_values:
        return []
    selection = select(seen, states=states, offsets=[False], rank_one=True)
    return [_misprediction(c.fit, unseen, automatic=c is selection.chosen) for c in selection.candidates]


def _misprediction(fit: DecayFit, unseen: DecayData, *, automatic: bool) -> HoldOut:
    predicted = fit.predict(unseen.t_s, unseen.exposure_s)
    with np.errstate(divide="ignore", invalid="ignore"):
        excess = np.abs(predicted - unseen.signal) - NOISE_ALLOWANCE * unseen.sigma
        relative = np.where(unseen.used, np.clip(excess, 0, None) / np.abs(unseen.signal), 0.0)
    frame, _ = np.unravel_index(int(np.argmax(relative)), relative.shape)
    return HoldOut(fit.n_states, automatic, float(relative.max()), float(unseen.middle_s[frame]))
