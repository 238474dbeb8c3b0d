"""Whether a channel is seen to fall at all: noise, and a light that does not change, can be fitted but tell no rate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc
from scipy.stats import kendalltau

from phoslab.fitting.decay import DecayFit, fit_decay, misfit
from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.intervals import rate_intervals

Array = NDArray[np.float64]

# Fewer values do not tell noise from a decay.
_FEWEST = 6
# A constant is refused as an explanation if it looks so bad by chance this often.
_CHANCE = 0.01
# A mean within so many standard errors of 0 is no light.
_NOTHING = 3.0


def not_falling(data: DecayData, channel: int, *, sigma_known: bool) -> str | None:
    """Return why a channel tells no rate; None where it falls in rank, or a decay describes it better than a constant.

    Args:
        channel: its index.
        sigma_known: whether σ are known, or only relative to one another.
    """
    used = data.used[:, channel]
    if used.sum() < _FEWEST:
        return None
    # Few values leave few degrees of freedom, where one exponential alone may be as far off as a constant is.
    if kendalltau(data.t_s[used], data.signal[used, channel], alternative="less").pvalue < _CHANCE:
        return None
    one = DecayData(
        data.t_s[used], data.exposure_s[used], data.signal[used, channel, None], data.sigma[used, channel, None],
        channels=(data.channels[channel],),
    )  # fmt: skip
    weight = one.sigma**-2
    mean = float((weight * one.signal).sum() / weight.sum())
    chi2 = float((weight * (one.signal - mean) ** 2).sum())
    dof = one.n_values - 1
    alone, on_offset = (
        fit_decay(one, 1, offset=offset, rank_one=False, polish=False) for offset in (False, True)
    )
    if min(_chance(chi2, fit, sigma_known) for fit in (alone, on_offset)) < _CHANCE:
        return None
    scale = 1.0 if sigma_known else chi2 / dof
    if abs(mean) < _NOTHING * np.sqrt(scale / float(weight.sum())):
        return "is nowhere above its scatter: nothing glows"
    high = float(rate_intervals(alone, sigma_known=sigma_known)[0, 1])
    return (
        f"is not seen to fall within the {one.end_s:.4g} s measured: if it fades, then at less than {high:.2g} 1/s "
        "(95 %)"
    )


def _chance(chi2: float, fit: DecayFit, sigma_known: bool) -> float:
    """Return how likely a fit is so much better than a constant, whose χ² is given, if that is the truth."""
    gained, extra = max(0.0, chi2 - fit.chi2), fit.n_parameters - 1
    if sigma_known and misfit(fit.chi2, fit.dof) == 1.0:
        return float(chdtrc(extra, gained))
    return float(fdtrc(extra, fit.dof, gained / extra / max(fit.chi2 / fit.dof, 1e-12 * chi2 / fit.dof)))
