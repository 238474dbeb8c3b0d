"""The likeness of small triangles that lie together and face one way: the parallelogram that covers them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.render.cell_meshes import FlatMesh
from phoslab.render.clusters import Clusters

Array = NDArray[np.float64]

# A cell stands for small triangles only if so much of their area faces one way, and fills so much of it.
COHERENT, FILLED = 0.95, 0.5
# What no distance makes good enough: such a cell is always replaced by those that it is made of.
NEVER = 1e30
# Directions that are tried for the sides of a parallelogram, over a right angle, and by how many parts at least.
TURNS, JUDGES = 16, 32


@dataclass(frozen=True, eq=False)
class Likenesses:
    """What could stand for some clusters.

    Args:
        corners: (c, 3, 3) a parallelogram's corner and its two neighbours; of a cluster that has none, its middle.
        normals: (c, 3).
        radii: (c,) of all that it stands for.
        heights: (c,) how far that is off its plane; `NEVER` where there is none.
        errors: (c,) the same, and how far the parallelogram reaches beyond it; `NEVER` where it is no likeness.
    """

    corners: Array
    normals: Array
    radii: Array
    heights: Array
    errors: Array

    @staticmethod
    def of(mesh: FlatMesh, clusters: Clusters) -> Likenesses:
        points = mesh.points(clusters.of)
        middles = (clusters.least(points.min(axis=0)) + clusters.most(points.max(axis=0))) / 2
        each = middles[clusters.which]
        far2 = np.max([np.einsum("ki,ki->k", p - each, p - each) for p in points], axis=0)
        radii = np.sqrt(clusters.most(far2))
        areas = mesh.areas[clusters.of]
        facing = clusters.total(areas[:, None] * mesh.normals[clusters.of])
        area = clusters.total(areas)
        coherence = np.linalg.norm(facing, axis=1) / area
        like = coherence >= COHERENT
        corners, normals = np.repeat(middles[:, None], 3, axis=1), np.tile([0.0, 0.0, 1.0], (len(like), 1))
        heights, errors = (np.full(len(like), NEVER) for _ in range(2))
        if like.any():
            normals[like] = facing[like] / np.linalg.norm(facing[like], axis=1, keepdims=True)
            centres = clusters.total(areas[:, None] * mesh.centres(clusters.of)) / area[:, None]
            corners[like], heights[like], extents = _cover(
                clusters.select(like), points[:, like[clusters.which]], centres[like], normals[like]
            )
            filled = np.minimum(1.0, (coherence * area)[like] / np.maximum(extents.prod(axis=1), 1e-30))
            # What is nearest in a direction counts once, so where cells overlap nothing is added; but through a gap
            # one would look into the dark inside.
            rims = (1.0 - np.sqrt(filled)) * extents.max(axis=1) / 2
            errors[like] = np.where(filled >= FILLED, heights[like] + rims, NEVER)
        return Likenesses(corners, normals, radii, heights, errors)


def _cover(clusters: Clusters, points: Array, centres: Array, normals: Array) -> tuple[Array, Array, Array]:
    """Return (c, 3, 3) the smallest parallelograms, (c,) how far points are off their planes, and (c, 2) their sides.

    Args:
        points: (4, k, 3) corners of the parts.
        centres: (c, 3) where the planes pass.
    """
    side = np.cross(normals, np.eye(3)[np.argmin(np.abs(normals), axis=1)])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(normals, side)

    judges = clusters.thinned(JUDGES)
    few = Clusters(clusters.of[judges], np.bincount(clusters.which[judges], minlength=len(clusters.sizes)))
    flat_x, flat_y = (_along(points[:, judges], centres, axis, few) for axis in (side, up))
    turns = np.pi / 2 * np.arange(TURNS) / TURNS
    boxes = []
    for c, s in zip(np.cos(turns), np.sin(turns), strict=True):
        x, y = (np.ptp(_span(few, a * flat_x + b * flat_y), axis=0) for a, b in ((c, s), (-s, c)))
        boxes.append(x * y)
    turn = turns[np.argmin(boxes, axis=0)][:, None]

    x, y = np.cos(turn) * side + np.sin(turn) * up, np.cos(turn) * up - np.sin(turn) * side
    (x_low, x_high), (y_low, y_high) = (
        _span(clusters, _along(points, centres, axis, clusters)) for axis in (x, y)
    )
    corner = centres + x_low[:, None] * x + y_low[:, None] * y
    extents = np.stack([x_high - x_low, y_high - y_low], axis=1)
    corners = [corner, corner + extents[:, :1] * x, corner + extents[:, 1:] * y]
    heights = clusters.most(np.abs(_along(points, centres, normals, clusters)).max(axis=0))
    return np.stack(corners, axis=1), heights, extents


def _along(points: Array, centres: Array, axes: Array, clusters: Clusters) -> Array:
    """Return (4, k) the coordinates of (4, k, 3) points along each cluster's axis, from its centre."""
    begin, axis = centres[clusters.which], axes[clusters.which]
    return np.stack([np.einsum("ki,ki->k", p - begin, axis) for p in points])


def _span(clusters: Clusters, values: Array) -> Array:
    """Return (2, c) the least and the largest of (4, k) values."""
    return np.stack([clusters.least(values.min(axis=0)), clusters.most(values.max(axis=0))])
