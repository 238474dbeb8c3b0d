"""Where pixels may look for what glows: a few spheres that hold all of its surfels.

A direction at random seldom meets a small sender. Others aim at these spheres; how likely each is, and that a direction
was chosen so or so, is known in closed form, so that all count as one sample (shaders/bounce_directions.comp.glsl).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Spheres: a power of two. More are tighter; finding a pixel's directions takes as long as there are.
GUIDES = 32
# Surfels that face opposite ways lie as far apart as this share of all, when spheres are made of what lies together.
TURNED = 0.25


def make_guides(surfels: NDArray[np.float32], glows: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return (GUIDES, 2, 4) sphere (centre, radius) and facing (mean normal, area) of parts of what glows.

    Args:
        surfels: (n, 12) as `Surfels` holds them.
        glows: (n,) of which of them light may come; where of none, every guide has an area of 0.
    """
    guides = np.zeros((GUIDES, 2, 4), dtype=np.float32)
    disks = surfels[glows].astype(np.float64)
    if not len(disks):
        return guides
    size = float(np.ptp(disks[:, :3], axis=0).max())
    features = np.concatenate([disks[:, :3], TURNED / 2 * size * disks[:, 4:7]], axis=1)
    parts = [np.arange(len(disks))]
    while len(parts) < GUIDES:
        parts = [half for part in parts for half in _halves(features, part)]
    for guide, part in zip(guides, parts, strict=True):
        if not len(part):
            continue
        centre, radius, normal = disks[part, :3], disks[part, 3], disks[part, 4:7]
        middle = (centre.min(axis=0) + centre.max(axis=0)) / 2
        area = np.pi * radius**2
        guide[0] = [*middle, float(np.max(np.linalg.norm(centre - middle, axis=1) + radius))]
        guide[1] = [*(area @ normal / area.sum()), area.sum()]
    return guides


def _halves(features: Array, part: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Cut at the median of what varies most; one half of a single surfel is empty."""
    half = -(-len(part) // 2)
    if not len(part):
        return part, part
    order = np.argpartition(features[part, int(np.argmax(np.ptp(features[part], axis=0)))], half - 1)
    return part[order[:half]], part[order[half:]]
