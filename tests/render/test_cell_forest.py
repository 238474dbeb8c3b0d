"""Cells of triangle soups: nothing is lost, and every tree can be walked."""

from __future__ import annotations

import numpy as np
import pytest

from phoslab.render.cell_boxes import FARTHEST, NEXT_BITS, REACH, STEP
from phoslab.render.cell_forest import grow
from phoslab.render.cell_likeness import NEVER
from phoslab.render.cell_meshes import FlatMesh
from phoslab.render.cells import Cells

SMALLEST = 0.05


def soup(rng, n, size, *, glows):
    """Triangles of about one size, strewn within 1 of the origin; every third is a parallelogram."""
    corners = rng.uniform(-0.7, 0.7, (n, 1, 3)) + size * rng.normal(size=(n, 3, 3))
    is_triangle = np.arange(n) % 3 > 0
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(doubled, axis=1)
    areas = np.where(is_triangle, length / 2, length)
    uv = rng.random((n, 3, 2)) if glows else np.full((n, 3, 2), np.nan)
    return FlatMesh(corners, is_triangle, doubled / length[:, None], areas, uv, rng.uniform(1, 2, n))


def sheet(n, bend):
    """A square of 2 n² small triangles, which may be bent."""
    x, y = np.meshgrid(*[np.linspace(-0.4, 0.4, n + 1)] * 2)
    points = np.stack([x, y, bend * x**2], axis=2)
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, :-1], points[1:, 1:]
    corners = np.concatenate([np.stack(t, axis=2).reshape(-1, 3, 3) for t in ((a, b, c), (d, c, b))])
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(doubled, axis=1)
    ones = np.ones(len(corners))
    return FlatMesh(
        corners, ones > 0, doubled / length[:, None], length / 2, np.full((len(corners), 3, 2), np.nan), ones
    )


@pytest.fixture(scope="module")
def meshes():
    rng = np.random.default_rng(5)
    nothing = FlatMesh(*(a[:0] for a in vars(soup(rng, 3, 0.1, glows=False)).values()))
    return {
        7: soup(rng, 40, 0.3, glows=True),
        2: nothing,
        4: soup(rng, 900, 0.004, glows=True),
        9: sheet(40, 0.3),
        1: soup(rng, 1, 0.01, glows=False),
    }


@pytest.fixture(scope="module")
def forest(meshes):
    return grow(meshes, SMALLEST)


def test_no_area_is_lost_and_each_mesh_owns_its_own(meshes, forest):
    leaves = np.add.reduceat(np.append(forest.leaf_areas, 0.0), forest.owners[:-1])
    for k, mesh in enumerate(meshes.values()):
        owned = leaves[k] if forest.owners[k + 1] > forest.owners[k] else 0.0
        assert owned == pytest.approx(mesh.areas.sum(), rel=1e-12)
    assert (forest.leaf_areas > 0).all()


def test_each_cell_ends_where_its_second_part_does(forest):
    n = len(forest.skip)
    inner = forest.skip > np.arange(1, n + 1)
    first = np.flatnonzero(inner) + 1
    second = forest.skip[first]
    np.testing.assert_array_equal(forest.skip[second], forest.skip[inner])
    np.testing.assert_array_equal(forest.leaves[inner, 0], forest.leaves[first, 0])
    np.testing.assert_array_equal(forest.leaves[first, 1], forest.leaves[second, 0])
    np.testing.assert_array_equal(forest.leaves[inner, 1], forest.leaves[second, 1])
    assert (np.diff(forest.leaves[~inner], axis=1) == 1).all()
    np.testing.assert_array_equal(forest.leaves[~inner, 0], np.arange(len(forest.leaf_areas)))
    # All small ones are likenesses, or halved until they are small.
    assert (forest.errors[~inner] < NEVER).all()


def test_what_glows_keeps_its_area_in_the_atlas(meshes, forest):
    assert sorted(forest.patches) == [4, 7]
    for number, patches in forest.patches.items():
        mesh = meshes[number]
        area = np.abs(np.linalg.det(mesh.uv[:, 1:] - mesh.uv[:, :1])) * np.where(mesh.is_triangle, 0.5, 1)
        have = np.abs(np.linalg.det(patches.uv[:, 1:] - patches.uv[:, :1])) / 2
        assert have.sum() == pytest.approx(area.sum(), rel=1e-10)
        weighed = (have * patches.density).sum()
        assert weighed == pytest.approx((area * mesh.density).sum(), rel=1e-10)


def test_small_triangles_lie_within_the_error_of_what_stands_for_them(meshes):
    """A bent sheet: each corner lies over a likeness, no farther from its plane than its error says."""
    mesh = meshes[9]
    forest = grow({9: mesh}, SMALLEST)
    assert len(forest.leaf_areas) < len(mesh.areas) / 4
    cells = Cells(**vars(forest), centre=np.zeros(3), radius=1.0)
    low, high = cells.boxes()
    like = np.flatnonzero(forest.errors < NEVER)
    points = mesh.corners.reshape(-1, 3)
    covered = np.zeros(len(points), dtype=bool)
    for k in like:
        sides = forest.corners[k, 1:] - forest.corners[k, 0]
        shares = (points - forest.corners[k, 0]) @ np.linalg.pinv(sides)
        off = np.abs((points - forest.corners[k, 0]) @ forest.normals[k])
        covered |= ((shares > -1e-9) & (shares < 1 + 1e-9)).all(axis=1) & (off <= forest.errors[k] + 1e-12)
        assert (low[k] <= forest.corners[k].min(axis=0) + 1e-12).all()
        assert (high[k] >= forest.corners[k].max(axis=0) - 1e-12).all()
    assert covered.all()


def test_a_cell_that_is_aimed_at_is_one_that_the_walk_takes(meshes):
    """A walk that went on to the parts of a cell at which a ray was aimed would lose the ray, and its light."""
    cells = Cells(**vars(grow(meshes, SMALLEST)), centre=np.zeros(3), radius=1.0)
    rows, boxes = cells.walk(0.1, sends_on=False)
    words = boxes.reshape(-1, 4)[: len(rows)]
    smallest = cells.skip == np.arange(1, len(cells.skip) + 1)
    both = cells.glows() & ~cells.is_halved & ~smallest
    assert both.sum() > 20
    apart = FARTHEST * ((words[both, 3] >> NEXT_BITS) / 255) ** 2
    np.testing.assert_allclose(rows[both, 2, 3], apart, rtol=2.0**-23)
    low, high = ((words[both, :3] >> shift & 0xFFFF) * STEP - REACH for shift in (0, 16))
    np.testing.assert_allclose(rows[both, 2, :3], (low + high) / 2, atol=2.0**-24)
