"""A claim about a sample, what data say of it, and how that is told.

The claim is fitted, and the same data without the claim. It is refused if the second fit is better by more than
chance (F-test) would make it 1 time in 100 while the claim is true. Whether or not it is refused, its size is told:
by how much the data lie off it beyond what noise makes of them, and the size that these data would have shown. A
claim that is refused may still serve: its size is the error that a model makes by taking it for granted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, fdtrc

Array = NDArray[np.float64]

CHANCE = 0.01
"""A claim that is true is refused so often."""

TOLERATED = 0.05
"""What the dissertation took for no direction at all (8.3): below it a claim that is refused still serves."""


@dataclass(frozen=True)
class Verdict:
    """One claim and what the data say of it.

    Args:
        claim: in one sentence.
        held: whether it holds within the noise; None: not tested.
        p: how often chance alone would look so bad.
        size: by how much the data lie off it beyond their noise, root mean square, as a share of the signal.
        worst: the largest such difference, noise and all.
        seen_from: the size that these data would show.
        sentence: what that means.
    """

    claim: str
    held: bool | None
    p: float | None = None
    size: float | None = None
    worst: float | None = None
    seen_from: float | None = None
    sentence: str = ""

    def to_dict(self) -> dict[str, object]:
        """Return everything as JSON takes it."""
        return {**vars(self), "verdict": self.word}

    @property
    def word(self) -> str:
        """The verdict in a word or two."""
        if self.held is None or self.size is None:
            return "not tested"
        if self.held:
            return "holds"
        return "nearly holds" if self.size <= TOLERATED else "does not hold"


@dataclass(frozen=True)
class Misfit:
    """What a fit leaves: χ², and values less parameters."""

    chi2: float
    dof: int


def judge(claim: str, off: Array, noise: Array, with_it: Misfit, without: Misfit, end: str) -> Verdict:
    """Compare a claim with the same data without it.

    Args:
        off: (n,) relative differences from the claim.
        noise: (n,) standard deviations of them.
        with_it, without: what the claim, and the data without it, leave; of the data alone nothing is left.
        end: of the verdict's sentence.
    """
    gained, lost = with_it.dof - without.dof, with_it.chi2 - without.chi2
    # Where even the freer fit misses, its scatter is the noise; where it does not, σ are known.
    scatter = max(without.chi2 / without.dof, 1.0) if without.dof else 1.0
    p = float(fdtrc(gained, without.dof or 1e9, lost / gained / scatter))
    # A relative difference d in all values raises χ² by d² Σ 1 / noise²; chance raises it by as much as is gained.
    information = float(np.sum(noise**-2.0))
    size = float(np.sqrt(max(0.0, lost - gained * scatter) / information))
    seen_from = float(np.sqrt(max(0.0, chdtri(gained, CHANCE) - gained) * scatter / information))
    clear = np.abs(off)[np.abs(off) > 3 * noise * np.sqrt(scatter)]
    worst = float(clear.max()) if clear.size else None
    held = p >= CHANCE
    if held:
        words = f"Nothing is seen; {_percent(seen_from)} would have been."
    else:
        words = (
            f"Off by {_percent(size)} (root mean square{f'; at most {_percent(worst)}' if worst else ''})."
        )
    return Verdict(claim, held, p, size, worst, seen_from, f"{words} {end}")


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


def untested(claim: str, why: str) -> Verdict:
    """Return that nothing is known of a claim."""
    return Verdict(claim, None, sentence=f"Not tested: {why}.")


def report(verdicts: Sequence[Verdict], name: str) -> str:
    """Return verdicts as text."""
    lines = [f"[[{name}: what the model takes for granted]]"]
    for v in verdicts:
        lines.append(f"  {v.word:14} {v.claim}")
        if v.p is not None:
            lines.append(f"  {'':14} chance alone: {v.p:.2g}")
        lines.append(f"  {'':14} {v.sentence}")
    return "\n".join(lines) + "\n"
