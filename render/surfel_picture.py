"""Surfels as the camera sees them: each disk in a colour of its own where it lies on what is seen, holes dark."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phoslab.render.device import read_texture
from phoslab.render.gbuffer import GBuffer
from phoslab.render.passes import Picture
from phoslab.render.surfels import Extent, Surfels


def colours(numbers: NDArray[np.int64]) -> Picture:
    """Return (..., 3) a colour for each number from 0 on, the same for the same."""
    table = np.random.default_rng(0).uniform(0.2, 1.0, (4096, 3))
    each: Picture = table[numbers % len(table)]
    return each


def picture_of(surfels: Surfels, gbuffer: GBuffer, extent: Extent) -> Picture:
    """Return (h, w, 3) the samples of the G-buffer in the colour of the nearest surfel that covers them."""
    from scipy.spatial import cKDTree

    seen = read_texture(gbuffer.position_w)[::-1]
    picture = np.zeros((*seen.shape[:2], 3))
    there = seen[..., 3] > 0
    if not surfels.count or not there.any():
        return picture
    disks = surfels.read()
    points = (seen[there][:, :3] - extent.centre) / extent.radius
    away, nearest = cKDTree(disks[:, :3]).query(points)
    covered = away <= disks[nearest, 3]
    shade = np.where(covered, 1.0, np.where(away <= 2 * disks[nearest, 3], 0.2, 0.0))
    picture[there] = colours(nearest) * shade[:, None]
    return picture
