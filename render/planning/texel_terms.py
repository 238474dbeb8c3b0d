"""Texels from what the camera can see: a surface needs about as many as pixels show it, and never more than it has.

With a texel `x` pixels wide, glow is off by `c x^p` of itself: where light ends at an edge, texels blur it. c and p
are measured (`phoslab trade model`). A surface that no pixel shows has `UNSEEN` texels, which light others well enough.
"""

from __future__ import annotations

import numpy as np

from phoslab.render.planning.costs import Costs
from phoslab.render.planning.pilot import Pilot

# Widths of a texel in pixels that are tried.
WIDTHS = (0.25, 0.5, 1.0, 2.0, 4.0)
FEWEST, UNSEEN = 16, 32

# Share of an atlas that charts cover: the rest is gutter.
PACKED = 0.7


def texels_for(pilot: Pilot, drawable: int, width_px: float) -> int:
    """Return the texels along the side of a drawable's state at which one is at most `width_px` pixels wide."""
    phosphor = pilot.scene.drawables[drawable].phosphor
    assert phosphor is not None
    side = pilot.side_px[drawable] / np.sqrt(PACKED) / width_px
    wanted = 2 ** int(np.ceil(np.log2(max(side, FEWEST)))) if side > 0 else UNSEEN
    return min(wanted, phosphor.atlas_texels)


def texel_error(pilot: Pilot, costs: Costs, drawable: int, texels: int) -> float:
    """Return how far the glow of a surface is off with so many texels along its side, relative to itself."""
    phosphor = pilot.scene.drawables[drawable].phosphor
    assert phosphor is not None
    if texels >= phosphor.atlas_texels:
        return 0.0
    width = pilot.side_px[drawable] / np.sqrt(PACKED) / texels
    return float(min(1.0, costs.texel_error * max(width, 1 / 4) ** costs.texel_power))
