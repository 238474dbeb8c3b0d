"""The fewest states: those that have died, or were never charged, are dropped; those of near-equal rates are merged.

The error of a surface is what its glow changes by, relative, at the worst of the points that the pilot met and the
moments asked for. In the picture it counts as the surface's share of the light.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from phoslab.render.planning.charging import charged, per_light
from phoslab.render.planning.pilot import Pilot, Sampled
from phoslab.render.planning.reduced import merge_states

Array = NDArray[np.float64]
Groups = tuple[tuple[int, ...], ...]

# Points of a surface that are tried, of those that were met: from the dimmest to the brightest.
POINTS = 64


def groupings(n: int) -> Iterator[Groups]:
    """Yield every way to keep some of n states, each alone or merged with others, most states first."""
    seen = set()
    for assignment in np.ndindex(*(n + 1,) * n):
        groups = [tuple(i for i in range(n) if assignment[i] == g) for g in range(1, n + 1)]
        kept = tuple(sorted(g for g in groups if g))
        if kept and kept not in seen:
            seen.add(kept)
    yield from sorted(seen, key=lambda g: (-len(g), sum(len(x) for x in g) * -1, g))


def change(pilot: Pilot, sampled: Sampled, groups: Groups) -> Array:
    """Return (T,) the largest relative change of XYZ, of points that give more than a millionth of the brightest."""
    n = sampled.kr.shape[-1]
    if groups == tuple((i,) for i in range(n)):
        return np.zeros(len(pilot.moments))
    order = np.argsort(sampled.glow.sum(axis=(0, 2)))
    some = order[np.unique(np.linspace(0, len(order) - 1, POINTS).astype(int))]
    kr, ke, emission = merge_states(sampled.kr[some], sampled.ke_width[some], sampled.emission[some], groups)
    drive = type(sampled.drive)(sampled.drive.factors[some], sampled.drive.names)
    r = charged(
        pilot.scene.schedule, sampled.phosphor.initial, drive, kr, per_light(ke, pilot.scene), pilot.moments
    )
    reduced = np.einsum("tnc,nc,nck->tnk", r, kr, emission) @ pilot.to_xyz
    exact = sampled.glow[:, some]
    total = exact.sum(axis=-1)
    counts = total > 1e-6 * total.max(axis=1, keepdims=True)
    ratio = np.divide(np.abs(reduced - exact).sum(axis=-1), total, out=np.zeros_like(total), where=counts)
    return np.asarray(ratio.max(axis=1, initial=0.0))


def fewer_states(pilot: Pilot, sampled: Sampled) -> dict[int, tuple[Groups, Array]]:
    """Return, by the number of states, the best grouping and its (T,) change."""
    best: dict[int, tuple[Groups, Array]] = {}
    for groups in groupings(sampled.kr.shape[-1]):
        error = change(pilot, sampled, groups)
        if len(groups) not in best or error.max() < best[len(groups)][1].max():
            best[len(groups)] = groups, error
    return best
