"""How many exponentials the data carry, by four criteria of which one decides and all are shown.

The choice is the smallest model that no larger one which contains it (a state more, an offset more, a state in place of
the offset, which is one that never falls) beats by more than chance, at 1 in 200 (F-test; chi² test where σ is known).
Offsets are among the models because an offset that nobody modelled looks like one more, endlessly slow state. AICc, BIC
and cross-validation stand beside it; where one of them would choose otherwise, that is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc, fdtrc

from phoslab.fitting import decay, decay_problem
from phoslab.fitting.decay import MOST_STATES, DecayFit, fit_decay
from phoslab.fitting.decay_data import DecayData

# A state more must be this unlikely to be chance.
SIGNIFICANCE = 0.005
_FOLDS = 5
_LEAST_DOF = 2
# Enough states to follow any decay, few enough to leave scatter.
_PILOT_STATES = 3
_LEAST_SCATTER = 0.1


@dataclass(frozen=True)
class Candidate:
    """A number of states, with or without offset, and what the criteria say of it.

    Args:
        fit: the fit, to weights that all candidates share.
        f_test: chance of such an improvement over one state less if that were enough; None for one state.
        cross_validation: mean squared error of values held out, in units of their variance; None for too few.
        cross_validation_error: standard error of that mean.
    """

    fit: DecayFit
    f_test: float | None
    cross_validation: float | None
    cross_validation_error: float | None

    @property
    def n_states(self) -> int:
        """Number of exponentials."""
        return self.fit.n_states

    @property
    def sound(self) -> bool:
        """Whether all its states are alive and distinct."""
        return self.fit.n_states == 1 or not self.fit.degenerate


@dataclass(frozen=True)
class Selection:
    """The candidates and the choice.

    Args:
        candidates: in order of states, without offset first.
        chosen: one of them.
        votes: the candidate that each criterion would choose: AICc, BIC, F-test, cross-validation.
        rival: the larger candidate that looks best beside the chosen one, and how often chance alone would make it look
            so; None if there is none.
    """

    candidates: tuple[Candidate, ...]
    chosen: Candidate
    votes: dict[str, Candidate]
    rival: tuple[Candidate, float] | None = None

    @property
    def dissent(self) -> list[str]:
        """The criteria that would choose another number of states."""
        return [name for name, vote in self.votes.items() if vote.n_states != self.chosen.n_states]


def select(
    data: DecayData,
    *,
    states: Sequence[int] = tuple(range(1, MOST_STATES + 1)),
    offsets: Sequence[bool] = (False, True),
    rank_one: bool = False,
    sigma_known: bool = True,
    approximate: bool = False,
) -> Selection:
    """Fit every number of states, with and without offset, and choose.

    Args:
        data: the decay; where its noise follows the model, all candidates share the weights of one pilot fit.
        states: numbers of states to choose from.
        offsets: whether to choose from fits without offset, with one, or both.
        sigma_known: whether σ are known, or only relative to one another.
        approximate: see `chance`.

    Raises:
        PhoslabError: fewer values than parameters for every candidate.
    """
    data = _share_weights(data, max(states), rank_one=rank_one)
    fits: dict[tuple[int, bool], DecayFit] = {}
    for n_states in states:
        for offset in offsets:
            n_parameters = decay_problem.n_parameters(data, n_states, offset=offset, rank_one=rank_one)
            # AICc needs two values more than parameters; with fewer, nothing tells a candidate from another.
            if data.n_values < n_parameters + (_LEAST_DOF if fits else 0):
                continue
            fits[n_states, offset] = fit_decay(data, n_states, offset=offset, rank_one=rank_one, polish=False)
    if not fits:
        # Says what is missing.
        fits[states[0], offsets[0]] = fit_decay(data, states[0], offset=offsets[0], rank_one=rank_one)
    candidates = []
    for (n_states, offset), fit in fits.items():
        smaller = fits.get((n_states - 1, offset))
        cv, cv_error = _cross_validation(data, fit)
        p = (
            None
            if smaller is None
            else chance(smaller, fit, sigma_known=sigma_known, approximate=approximate)
        )
        candidates.append(Candidate(fit, p, cv, cv_error))
    decided, rival = _decide(candidates, sigma_known, approximate)
    sound = [c for c in candidates if c.sound] or candidates[:1]
    votes = {
        "AICc": min(sound, key=lambda c: c.fit.aicc),
        "BIC": min(sound, key=lambda c: c.fit.bic),
        "F-test": decided,
    }
    validated = [c for c in sound if c.cross_validation is not None and c.cross_validation_error is not None]
    if validated:
        # The simplest within one standard error of the best (Breiman et al. 1984).
        best = min(validated, key=lambda c: c.cross_validation or 0.0)
        bar = (best.cross_validation or 0.0) + (best.cross_validation_error or 0.0)
        votes["cross-validation"] = min(
            (c for c in validated if (c.cross_validation or 0.0) <= bar), key=lambda c: c.fit.n_parameters
        )
    return Selection(tuple(candidates), decided, votes, rival)


def _share_weights(data: DecayData, most_states: int, *, rank_one: bool) -> DecayData:
    """Return the data with weights from a pilot fit: chi² that are compared must have the same."""
    if data.law is None and not (data.repeatability and data.expected is None):
        return data
    carried = [
        n
        for n in range(1, min(_PILOT_STATES, most_states) + 1)
        if data.n_values > decay_problem.n_parameters(data, n, offset=False, rank_one=rank_one)
    ]
    pilot = fit_decay(data, max(carried, default=1), rank_one=rank_one, polish=False)
    return replace(pilot.data, law=None)


def chance(
    smaller: DecayFit, larger: DecayFit, *, sigma_known: bool = True, approximate: bool = False
) -> float:
    """Return how likely so much better a fit would be if the smaller model were true (F-test, chi² test).

    Where the larger model misses the data by more than known σ explain, its own scatter counts instead: the σ may be
    wrong. Not so if exponentials are known to be only `approximate`: what they miss is then no noise.
    """
    extra = larger.n_parameters - smaller.n_parameters
    gained = max(0.0, smaller.chi2 - larger.chi2)
    if extra <= 0 or larger.dof <= 0:
        return 1.0
    if sigma_known and (approximate or decay.misfit(larger.chi2, larger.dof) == 1.0):
        return float(chdtrc(extra, gained))
    # σ estimated from the data make this close to 1. It is less where they are the last digits of the file, not noise.
    scatter = max(larger.chi2 / larger.dof, _LEAST_SCATTER)
    return float(fdtrc(extra, larger.dof, gained / extra / scatter))


def _decide(
    candidates: Sequence[Candidate], sigma_known: bool, approximate: bool
) -> tuple[Candidate, tuple[Candidate, float] | None]:
    """Return the smallest candidate that no larger, sound one which contains it beats by more than chance, and the
    one that comes nearest to it."""
    ladder = sorted((c for c in candidates if c.sound), key=lambda c: c.fit.n_parameters) or list(candidates)
    for here in ladder:
        larger = [
            c
            for c in ladder
            if c.fit.n_parameters > here.fit.n_parameters
            and c.n_states + c.fit.has_offset >= here.n_states + here.fit.has_offset
            and c.n_states >= here.n_states
        ]
        chances = [
            (c, chance(here.fit, c.fit, sigma_known=sigma_known, approximate=approximate)) for c in larger
        ]
        rival = min(chances, key=lambda one: one[1], default=None)
        if rival is None or rival[1] >= SIGNIFICANCE:
            return here, rival
    return ladder[-1], None


def _cross_validation(data: DecayData, fit: DecayFit) -> tuple[float | None, float | None]:
    """Return the mean squared error, in units of the variance, of frames held out by turns, and its standard error.

    The first and the last frame are never held out: that would ask for what lies beyond the data.
    """
    n = data.t_s.size
    inner = np.flatnonzero(data.used.any(axis=1))[1:-1]
    errors = []
    for fold in range(_FOLDS):
        out = inner[fold::_FOLDS]
        rest = np.setdiff1d(np.arange(n), out)
        seen, unseen = data.take(rest), data.take(out)
        if seen.n_values <= fit.n_parameters or not unseen.n_values:
            return None, None
        stated = decay_problem.problem(seen, fit.n_states, offset=fit.has_offset, rank_one=fit.rank_one)
        again = decay.conclude(stated, stated.solve(fit.theta, polish=False))
        miss = np.where(unseen.used, again.predict(unseen.t_s, unseen.exposure_s) - unseen.signal, 0.0)
        errors.append(((miss / unseen.total_sigma) ** 2)[unseen.used])
    squared = np.concatenate(errors)
    return float(squared.mean()), float(squared.std() / np.sqrt(squared.size))
