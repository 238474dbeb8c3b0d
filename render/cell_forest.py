"""How the parts of meshes become trees of cells: large parts are halved, small ones gathered into likenesses.

Trees grow a level at a time, all at once; then they are laid out in the order of a walk.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from phoslab.render.cell_halves import Halved, halve_all
from phoslab.render.cell_likeness import NEVER, Likenesses
from phoslab.render.cell_meshes import FlatMesh
from phoslab.render.clusters import Clusters

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# A smallest cell is at most so uneven, over the radius that smallest cells have; what cannot be is this much smaller.
FLAT, ROUNDEST = 0.05, 4


@dataclass(frozen=True, eq=False)
class Patches:
    """Where the smallest cells of one mesh lie in its atlas, as a soup of triangles.

    Args:
        uv: (k, 3, 2) atlas coordinates.
        leaf: (k,) the smallest cell that each is of.
        density: (k,) area in the world over area in the atlas.
    """

    uv: Array
    leaf: Indices
    density: Array


@dataclass(frozen=True, eq=False)
class Forest:
    """Cells in the order of the walk, n of them, of which m are the smallest; a tree for each mesh.

    Args:
        corners: (n, 3, 3) the corner and its two neighbours: of a triangle, or of a parallelogram.
        normals: (n, 3) to the outside.
        is_triangle: (n,).
        heights: (n,) how far all that a cell stands for reaches from its plane; `NEVER` where it is no likeness.
        errors: (n,) the same, and how far the cell reaches beyond that; `NEVER` as well.
        is_halved: (n,) whether it is made of two halves, which lie in its plane.
        skip: (n,) the index after a cell's last descendant.
        leaves: (n, 2) first and end of the smallest cells below, in their own count.
        leaf_areas: (m,).
        owners: (n_meshes + 1,) the first of the smallest cells of each mesh, and their end.
        patches: by the number of each mesh that glows.
    """

    corners: Array
    normals: Array
    is_triangle: NDArray[np.bool_]
    heights: Array
    errors: Array
    is_halved: NDArray[np.bool_]
    skip: Indices
    leaves: Indices
    leaf_areas: Array
    owners: Indices
    patches: dict[int, Patches]


def grow(meshes: Mapping[int, FlatMesh], smallest: float) -> Forest:
    """Make the cells of meshes, by their numbers; the smallest have so small a radius."""
    mesh = FlatMesh.joined(list(meshes.values()))
    counts = np.array([len(m.areas) for m in meshes.values()], dtype=np.intp)
    levels = _levels(mesh, Clusters(np.arange(counts.sum()), counts[counts > 0]), smallest)
    halved = list(halve_all(mesh, np.concatenate([level.singles for level in levels]), smallest))
    cells, leaves = (np.ones(len(mesh.areas), dtype=np.intp) for _ in range(2))
    for batch in halved:
        cells[batch.parts], leaves[batch.parts] = batch.n, batch.n_leaves
    for level, below in zip(reversed(levels), [None, *reversed(levels[1:])], strict=True):
        level.count(below, cells, leaves)
    # Roots stand one after the other.
    levels[0].at, levels[0].leaf_at = (np.cumsum(n) - n for n in (levels[0].n, levels[0].n_leaves))
    for level, below in pairwise(levels):
        level.place(below)
    owners = np.zeros(len(counts) + 1, dtype=np.intp)
    owners[1:][counts > 0] = levels[0].n_leaves
    return _Layout(mesh, levels).forest(halved, list(meshes), np.cumsum(owners))


@dataclass
class _Level:
    """Cells that are equally far from their roots. Those that are `split` have two each on the next level, in a row.

    Args:
        is_single, is_leaf, split: (c,) whether a cell is one part, or a likeness of some, or two.
        singles, leaves: what is in the first and in the second.
        n, n_leaves: (c,) how many cells and smallest cells each is made of, itself included.
        at, leaf_at: (c,) where the cell stands in the order of the walk, and its first smallest cell in theirs.
    """

    likenesses: Likenesses
    is_single: NDArray[np.bool_]
    is_leaf: NDArray[np.bool_]
    singles: Indices
    leaves: Clusters
    n: Indices = field(init=False)
    n_leaves: Indices = field(init=False)
    at: Indices = field(init=False)
    leaf_at: Indices = field(init=False)

    @property
    def split(self) -> NDArray[np.bool_]:
        return ~self.is_leaf & ~self.is_single

    def count(self, below: _Level | None, cells: Indices, leaves: Indices) -> None:
        """Count the cells, those of the level below and of all parts being counted."""
        self.n, self.n_leaves = (np.ones(len(self.is_leaf), dtype=np.intp) for _ in range(2))
        self.n[self.is_single], self.n_leaves[self.is_single] = cells[self.singles], leaves[self.singles]
        if below is not None:
            self.n[self.split] = 1 + below.n.reshape(-1, 2).sum(axis=1)
            self.n_leaves[self.split] = below.n_leaves.reshape(-1, 2).sum(axis=1)

    def place(self, below: _Level) -> None:
        """Place the level below."""
        first, first_leaf = self.at[self.split] + 1, self.leaf_at[self.split]
        below.at = np.stack([first, first + below.n[::2]], axis=1).ravel()
        below.leaf_at = np.stack([first_leaf, first_leaf + below.n_leaves[::2]], axis=1).ravel()


def _levels(mesh: FlatMesh, roots: Clusters, smallest: float) -> list[_Level]:
    levels, clusters = [], roots
    while len(clusters.sizes):
        like = Likenesses.of(mesh, clusters)
        is_single = clusters.sizes == 1
        # What is round is followed closer: where such things touch, a cell as large as the gap would keep light out.
        is_flat = (like.heights <= FLAT * smallest) | (like.radii <= smallest / ROUNDEST)
        is_leaf = (like.radii <= smallest) & (like.errors < NEVER) & is_flat & ~is_single
        levels.append(
            _Level(like, is_single, is_leaf, clusters.select(is_single).of, clusters.select(is_leaf))
        )
        split = levels[-1].split
        radii, clusters = np.maximum(like.radii[split], smallest), clusters.select(split)
        # Halved where parts differ most: in place, or, once the cluster is small, in direction.
        places = mesh.centres(clusters.of) / radii[clusters.which, None]
        clusters = clusters.halves(np.concatenate([places, mesh.normals[clusters.of] * 0.5], axis=1))
    return levels


class _Layout:
    """All cells, as they are put where they stand."""

    def __init__(self, mesh: FlatMesh, levels: Sequence[_Level]) -> None:
        self._mesh, self._levels = mesh, levels
        n, n_leaves = int(levels[0].n.sum()), int(levels[0].n_leaves.sum())
        self._corners, self._normals = np.empty((n, 3, 3)), np.empty((n, 3))
        self._heights, self._errors = np.zeros(n), np.zeros(n)
        self._is_triangle, self._is_halved = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
        self._skip, self._leaves = np.empty(n, dtype=np.intp), np.empty((n, 2), dtype=np.intp)
        self._leaf_areas = np.empty(n_leaves)
        self._patches: list[tuple[Array, Indices, Array]] = []

    def forest(self, halved: Sequence[Halved], numbers: Sequence[int], owners: Indices) -> Forest:
        at, leaf_at = (np.zeros(len(self._mesh.areas), dtype=np.intp) for _ in range(2))
        for level in self._levels:
            self._put_likenesses(level)
            at[level.singles] = level.at[level.is_single]
            leaf_at[level.singles] = level.leaf_at[level.is_single]
        for batch in halved:
            self._put_halved(batch, at[batch.parts], leaf_at[batch.parts])
        return Forest(
            self._corners,
            self._normals,
            self._is_triangle,
            self._heights,
            self._errors,
            self._is_halved,
            self._skip,
            self._leaves,
            self._leaf_areas,
            owners,
            dict(self._owned_patches(numbers, owners)),
        )

    def _owned_patches(self, numbers: Sequence[int], owners: Indices) -> Iterator[tuple[int, Patches]]:
        uv, leaf, density = (np.concatenate(each) for each in zip(*self._patches, strict=True))
        order = np.argsort(leaf, kind="stable")
        begins = np.searchsorted(leaf[order], owners).tolist()
        for number, (begin, end) in zip(numbers, pairwise(begins), strict=True):
            of = order[begin:end]
            if of.size:
                yield number, Patches(uv[of], leaf[of], density[of])

    def _put_likenesses(self, level: _Level) -> None:
        of = ~level.is_single
        at, like = level.at[of], level.likenesses
        self._corners[at], self._normals[at] = like.corners[of], like.normals[of]
        self._heights[at], self._errors[at] = like.heights[of], like.errors[of]
        self._skip[at] = at + level.n[of]
        self._leaves[at] = level.leaf_at[of, None] + np.stack([np.zeros_like(at), level.n_leaves[of]], axis=1)
        if level.is_leaf.any():
            leaves, at = level.leaves, level.leaf_at[level.is_leaf]
            self._leaf_areas[at] = leaves.total(self._mesh.areas[leaves.of])
            self._put_patches(leaves.of, self._mesh.uv[leaves.of], at[leaves.which])

    def _put_halved(self, batch: Halved, at: Indices, leaf_at: Indices) -> None:
        mesh, parts, every = self._mesh, batch.parts, at[:, None] + np.arange(batch.n)
        self._corners[every], skip, leaves = batch.in_order()
        self._normals[every], self._is_triangle[every] = (
            mesh.normals[parts, None],
            mesh.is_triangle[parts, None],
        )
        self._is_halved[every] = skip > np.arange(1, batch.n + 1)
        self._skip[every], self._leaves[every] = at[:, None] + skip, leaf_at[:, None, None] + leaves
        leaf = leaf_at[:, None] + np.arange(batch.n_leaves)
        self._leaf_areas[leaf] = mesh.areas[parts, None] / batch.n_leaves
        self._put_patches(np.repeat(parts, batch.n_leaves), batch.uv.reshape(-1, 3, 2), leaf.ravel())

    def _put_patches(self, parts: Indices, uv: Array, leaf: Indices) -> None:
        """Note where parts lie in the atlas: a parallelogram is two triangles."""
        glows = ~np.isnan(uv[:, 0, 0])
        parts, uv, leaf = parts[glows], uv[glows], leaf[glows]
        pairs = ~self._mesh.is_triangle[parts]
        a, b, c = uv[pairs].transpose(1, 0, 2)
        second = np.stack([b, b + c - a, c], axis=1)
        every = np.concatenate([parts, parts[pairs]])
        self._patches.append(
            (np.concatenate([uv, second]), np.concatenate([leaf, leaf[pairs]]), self._mesh.density[every])
        )
