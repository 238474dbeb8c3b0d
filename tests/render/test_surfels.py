"""Surfels: as much area as the triangles have, evenly placed, wherever the triangles lie."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phoslab.render import load_scene
from phoslab.render.device import ITEMS, MOST_GROUPS, Device, set_uniforms
from phoslab.render.gpu_scene import upload
from phoslab.render.prefix_sums import prefix_sums, sum_buffer
from phoslab.render.surfels import Extent, View, surfelize

RADIUS = 0.02  # of a surfel on the screen, over half the picture's height


def grid(n, side=1.0):
    """Return positions and triangles of a square of 2 n² triangles that faces the camera."""
    x = np.linspace(-side / 2, side / 2, n + 1)
    points = np.stack([*np.meshgrid(x, x), np.zeros((n + 1, n + 1))], axis=-1).reshape(-1, 3)
    row, column = (k.ravel() for k in np.mgrid[:n, :n])
    a = row * (n + 1) + column
    return points, np.concatenate(
        [
            np.column_stack([a, a + 1, a + n + 2]),
            np.column_stack([a, a + n + 2, a + n + 1]),
        ]
    )


def surfels_of(device, path, *, two_pass=True, radius=RADIUS):
    scene = load_scene(path)
    drawables = upload(device, scene)
    extent = Extent.of(drawables)
    view = View.of(scene.camera, extent, radius)
    return surfelize(device, drawables, extent, view, two_pass=two_pass).read().astype(np.float64), extent


@settings(max_examples=20)
@given(st.lists(st.integers(0, 2**40), min_size=1, max_size=300))
def test_prefix_sums_are_those_of_numpy(values):
    """Also beyond 32 bits, and over more than one chunk."""
    values = np.array(values * 3, dtype=np.uint64)
    with Device() as device:
        buffer = sum_buffer(device, len(values))
        buffer.write(values.tobytes())
        assert prefix_sums(device, buffer, len(values)) == values.sum()
        sums = np.frombuffer(buffer.read(), dtype=np.uint64)
    np.testing.assert_array_equal(sums[:-1], np.cumsum(values) - values)


def test_more_items_than_a_device_takes_in_a_row_are_all_reached(device):
    """Four million points and some, each of whose one ray meets a leaf of its own radiance."""
    n = MOST_GROUPS * ITEMS + 100
    shader = device.compute("cell_gather", {"LAYERS": 1, "DIRECTIONS": 1})
    hits, leaves = np.arange(n, dtype=np.uint32) % 7, np.arange(6 * 4, dtype=np.float32)
    light = device.reserve(n * 16)
    for k, buffer in enumerate((device.buffer(hits), device.buffer(leaves), light)):
        buffer.bind_to_storage_buffer(k)
    set_uniforms(shader, point_count=n)
    device.dispatch_items(shader, n)
    met = np.frombuffer(light.read(), dtype=np.float32).reshape(n, 4)[:, 1]
    np.testing.assert_array_equal(met, np.where(hits > 0, 4.0 * hits - 3.0, 0.0))


@pytest.mark.parametrize("two_pass", [False, True])
@pytest.mark.parametrize("n", [1, 8, 32, 180])
def test_areas_sum_to_the_surface(device, build, n, two_pass):
    """Triangles of 1000, 15, 1 and 0.03 surfels and, of a larger surfel, 0.01: within 1 %. One pass makes them equal.

    Two passes thin by one running sum of shares. The rest is what ideal areas vary by between two that are kept.
    """
    points, triangles = grid(n)
    build.mesh("wall", points, triangles, uv=None).camera(distance=2.0, yfov=0.6)
    for radius in (RADIUS, 0.035):
        disks, extent = surfels_of(device, build.write(), two_pass=two_pass, radius=radius)
        area = np.pi * np.sum(disks[:, 3] ** 2) * extent.radius**2
        assert area == pytest.approx(1.0, rel=0.01 if two_pass else 1e-5)
    if n == 180 and two_pass:
        assert len(disks) < 0.02 * len(triangles)


@pytest.mark.parametrize("n", [1, 32])
@pytest.mark.parametrize(
    "place",
    [
        {"translation": [0, 0, -60]},
        {"translation": [0, 0, 30]},
        {"translation": [0, -0.6, 0], "rotation": [-np.sqrt(0.5), 0, 0, np.sqrt(0.5)]},
        {"translation": [0, 0, 1.9]},
    ],
    ids=["far", "behind", "grazing", "near"],
)
def test_areas_sum_to_the_surface_wherever_it_lies(device, build, place, n):
    """Within 1 %, or half a disk where they are few: on what is far they are 41, as large as the wall allows."""
    points, triangles = grid(n)
    build.mesh("wall", points, triangles, uv=None, **place).camera(distance=2.0, yfov=0.6)
    disks, extent = surfels_of(device, build.write())
    area = np.pi * np.sum(disks[:, 3] ** 2) * extent.radius**2
    assert area == pytest.approx(1.0, rel=max(0.01, 0.5 / len(disks)))


@pytest.mark.parametrize("n", [1, 8, 32, 180])
def test_placement_is_more_even_than_chance(device, build, n):
    """Counts in 64 equal squares: at random their variance would be their mean; chi-squared of 63 degrees of freedom
    lies above 39.9 with 99 %, so below that is even. No square is off by more than a third. So within a triangle, and
    where many share a surfel."""
    points, triangles = grid(n)
    path = build.mesh("wall", points, triangles, uv=None).camera(distance=2.0, yfov=0.6).write()
    disks, extent = surfels_of(device, path)
    at = disks[:, :2] * extent.radius + np.array(extent.centre)[:2]
    counts = np.histogram2d(*at.T, bins=8, range=[[-0.5, 0.5]] * 2)[0]
    mean = counts.mean()
    assert mean > 10
    assert np.sum((counts - mean) ** 2) / mean < 39.9
    # The wall is nearer in its middle, by less than 3 %: surfels there are smaller.
    assert np.abs(counts / mean - 1).max() < 1 / 3


def test_what_the_camera_does_not_see_has_surfels_too(device, build, rooms):
    """A closed room around the camera: each wall its share, whether before, beside or behind, all facing inwards."""
    disks, _ = surfels_of(device, rooms.closed_box(build).write())
    normals, area = disks[:, 4:7], disks[:, 3] ** 2
    assert (np.sum(normals * disks[:, :3], axis=1) < 0).all()
    for axis in range(3):
        for sign in (-1, 1):
            share = area[sign * normals[:, axis] > 0.9].sum() / area.sum()
            assert share == pytest.approx(1 / 6, rel=0.02)


def test_radius_follows_the_distance_from_the_eye(device, build, rooms):
    scene_path = rooms.closed_box(build).write()
    scene = load_scene(scene_path)
    disks, extent = surfels_of(device, scene_path)
    view = View.of(scene.camera, extent, RADIUS)
    away = np.linalg.norm(disks[:, :3] - view.eye, axis=1)
    np.testing.assert_allclose(disks[:, 3], view.per_distance * away, rtol=1e-5)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_scenes_of_any_size_have_the_same_surfels(device, build, scale):
    """A wall of 1 mm and of 1 km: as many as its area holds of the ideal ones in its middle; in its corners, 1.06 times
    as far away, they are larger."""
    points, triangles = grid(4)
    path = build.mesh("wall", points * scale, triangles, uv=None).camera(distance=2 * scale, yfov=0.6).write()
    disks, _ = surfels_of(device, path)
    ideal = np.pi * (RADIUS * np.tan(0.3) * 2) ** 2
    assert 1 / ideal / 1.06**2 < len(disks) < 1 / ideal
    assert np.isfinite(disks).all()
