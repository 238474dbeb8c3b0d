"""Glow gathered in tiles: closed forms, the path tracer, and what must change nothing."""

from __future__ import annotations

import numpy as np
import pytest

from phoslab.errors import PhoslabError
from phoslab.render import TransportParameters, load_scene, render
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.sample_data.make_scenes import SCENES


def tiles(path, size, *, times=("0",), supersampling=1, **parameters):
    transport = TransportParameters("tiles", **parameters)
    frames = render(path, [*times], size=size, supersampling=supersampling, transport=transport)
    return frames[0].radiance if len(frames) == 1 else frames


@pytest.mark.parametrize("supersampling", [1, 2])
def test_closed_box_of_albedo_and_emission_one_half_reads_three_quarters(build, rooms, supersampling):
    """Every direction meets a wall that gives off 0.5: without aim, only float32 is left to differ.

    Pixels on the diagonals see the very edges of the room, where a point lies in two walls at once.
    """
    L = tiles(rooms.closed_box(build).write(), (48, 48), supersampling=supersampling, guided=0.0)
    np.testing.assert_allclose(L, 0.75, rtol=1e-5)


def test_no_cell_is_lost_where_a_walk_takes_more_rounds_than_a_loop_has(build, rooms, device):
    """llvmpipe ends a shader's loops after 65535 rounds in all, and says nothing: half of the walls would be gone."""
    path = rooms.closed_box(build).write()
    _, tiled = hits_of(device, path, (16, 16), cell=0.006, detail=0.01, guided=0.5)
    assert len(tiled.cells.skip) > 65535
    assert tiled.aim_counts.max() > 65535
    hits = tiled.hits() > 0
    # Those that aim at walls behind the pixel's own count nothing; the others meet a wall.
    assert hits[..., :4].all()
    assert hits[..., 4:].mean() > 0.5


def test_a_walk_that_the_driver_ends_is_refused(build, rooms, device):
    """Sheets behind each other beside the floor that is seen, which are found the farthest first: of the eight rays of
    a pixel some four pass 9000 of them each, in two loops, and more than 65535 turns are not had."""
    n = 9000
    x = np.linspace(-3.0, -1.0, n).repeat(3)
    yz = np.tile([[-9.0, -1.0], [9.0, -1.0], [0.0, 9.0]], (n, 1))
    floor = [[-0.9, -1.0, -1.0], [0.9, -1.0, -1.0], [0.0, 1.0, -1.0]]
    positions = np.concatenate([np.column_stack([x, yz]), floor])
    build.mesh("sheets", positions, np.arange(len(positions)).reshape(-1, 3), uv=None)
    build.camera(distance=0.5)
    path = build.text(rooms.write_material(build, "sheets", [0.5] * 3, [0.5] * 3) + rooms.SATURATED).write()
    with pytest.raises(PhoslabError, match="--cell or --detail"):
        hits_of(device, path, (4, 4), cell=0.7, detail=0.01)


@pytest.mark.parametrize("guided", [0.25, 0.5, 0.75])
def test_directions_that_aim_change_no_mean(build, rooms, guided):
    """The balance heuristic is unbiased: 48² pixels x 8 weights below 4, whose deviation is thus below 2, leave 0.015
    of the 0.25 that is reflected: four of these are 2 % of the whole."""
    L = tiles(rooms.closed_box(build).write(), (48, 48), guided=guided)
    assert L.mean() == pytest.approx(0.75, rel=0.02)


@pytest.mark.parametrize("guided", [0.0, 0.5])
def test_facing_disks_exchange_their_form_factor(build, rooms, guided):
    """The mean over the receiver is L F in each band, to 1 %: 804 pixels x 16 directions at random
    would leave sqrt((1 - F) / F / 804 / 16) = 1.3 %; even ones leave a tenth of it."""
    L = tiles(rooms.facing_disks(build).write(), (32, 32), directions=16, guided=guided)
    seen = L[L.max(axis=-1) > 0].mean(axis=0)
    np.testing.assert_allclose(seen, rooms.form_factor() * np.array([1.0, 2.0, 4.0]), rtol=0.005)


def test_more_directions_are_nearer_to_the_closed_form(build, rooms):
    """Even directions whose number is multiplied by 8: at random, the error would fall by 2.8."""
    path = rooms.partly_lit_wall(build).write()
    few, some, many = (
        rooms.error_on_the_wall(tiles(path, (32, 32), directions=n, filter_px=0)) for n in (2, 16, 128)
    )
    assert few > 2.8 * some > 2.8**2 * many


def test_smaller_cells_are_nearer_to_the_closed_form(build, rooms):
    """Where a floor glows in parts, until the error of the directions is left."""
    path = rooms.partly_lit_wall(build).write()
    coarse, middle, fine = (
        rooms.error_on_the_wall(tiles(path, (32, 32), directions=128, cell=r)) for r in (1.0, 0.3, 0.1)
    )
    assert coarse > 2 * middle > 4 * fine


def test_a_cell_sends_the_mean_of_what_lies_under_it(device, build, rooms):
    """Of stripes that divide it: half of what they give off, where a point would find all or nothing; so does every
    larger cell. Of stripes that it divides, all or nothing, and their mean over what is larger than those."""
    n, (w, h) = rooms.STRIPED_TEXELS, (16, 16)
    for period in (8, 128):
        here = type(build)(build.folder)
        _, tiled = hits_of(device, rooms.striped_quad(here, period).write(), (w, h), cell=0.1)
        cells, glow = tiled.cells, tiled.lit_cells.cell_glow
        sent = cells.averages(glow.emitted())[:, :3]
        is_smallest = cells.skip == np.arange(1, len(cells.skip) + 1)
        assert is_smallest.sum() == 128
        assert (cells.leaf_areas * cells.radius**2 * n**2 > 8**2).all()
        if period == 8:
            np.testing.assert_allclose(sent, np.broadcast_to([1.0, 2, 4], sent.shape), rtol=1e-5)
        else:
            assert np.isclose(sent[is_smallest, 0, None], [0.0, 2.0], atol=1e-5).any(axis=1).all()
            np.testing.assert_allclose(sent[0], [1.0, 2.0, 4.0], rtol=1e-5)


def hits_of(device, path, size, **parameters):
    transport = TransportParameters("tiles", **parameters)
    renderer = Renderer(device, load_scene(path), RenderParameters(size, 1, transport=transport))
    renderer.frame(0.0)
    return renderer, renderer.transport


def test_every_ray_meets_what_a_search_of_all_smallest_cells_finds(device):
    """Culling and whole walls change no ray in a scene of flat walls: whatever the tile was given, each meets the same
    one of the smallest cells, or nothing. (A ray within rounding of an edge may fall either way.)"""
    met = []
    for parameters in ({"detail": 0.5}, {"detail": 0.02, "bounces": 2}):
        _, tiled = hits_of(device, SCENES / "cornell", (64, 64), guided=0.0, **parameters)
        met.append(tiled.hits())
        glows = tiled.cells.glows()
    assert ((met[0] > 0) != (met[1] > 0)).mean() < 1e-4
    lit = (met[1] > 0) & np.append(False, glows)[met[1]]
    assert lit.mean() > 0.05
    assert (met[0] != met[1])[lit].mean() < 1e-3  # in one wall, the edges of cells are many


def test_rays_agree_with_a_brute_force_search(device, build, rooms):
    """Each of 16 directions of each pixel, against the disk's equation."""
    from phoslab.render.device import read_texture
    from phoslab.render.directions import on_hemisphere, over_picture, patterned_points

    n, side = 16, 4
    path = rooms.facing_disks(build).write()
    renderer, tiled = hits_of(device, path, (32, 32), directions=n, filter_px=side, guided=0.0)
    met = tiled.hits() > 0
    w = on_hemisphere(over_picture(patterned_points(side, n), (32, 32)))
    position = read_texture(renderer.gbuffer.position_w)
    seen = position[..., 3] > 0
    at = position[..., None, :2] + w[..., :2] * (rooms.APART / w[..., 2:])
    want = np.sum(at**2, axis=-1) < rooms.SENDER**2
    # The disk is a polygon of 128 sides: its rim is off by up to 4e-4 of the radius, where 1e-3 of the rays go.
    assert (met != want)[seen].mean() < 1e-3


def test_directions_are_even_over_any_block_as_wide_as_the_pattern():
    """Moments of the cosine over π: mean z 2/3, mean z² 1/2, mean x 0; and one point in each stratum in any block of
    8 x 8, though no two patterns have the same."""
    from phoslab.render.directions import on_hemisphere, ordered_places, over_picture, patterned_points

    places = ordered_places(8)
    assert sorted(places.ravel()) == list(range(64))
    for corner in ((0, 0), (3, 5)):
        block = np.roll(places, corner, (0, 1))[:8, :8]
        assert len(np.unique(block)) == 64
    w = on_hemisphere(patterned_points(8, 4)).reshape(-1, 3)
    np.testing.assert_allclose(np.sum(w**2, axis=1), 1.0)
    np.testing.assert_allclose(w.mean(axis=0), [0, 0, 2 / 3], atol=2 / 256)
    assert np.mean(w[:, 2] ** 2) == pytest.approx(0.5, abs=2 / 256)
    points = over_picture(patterned_points(8, 4), (32, 24))
    assert len(np.unique(points[..., 0])) == points[..., 0].size
    for y, x in ((0, 0), (3, 5), (13, 20)):
        block = points[y : y + 8, x : x + 8].reshape(-1, 2)
        for axis in range(2):
            assert sorted((block[:, axis] * 256).astype(int)) == list(range(256))


@pytest.mark.parametrize("supersampling", [1, 2])
def test_the_inside_of_the_crate_stays_dark(supersampling):
    """No line from the panel enters it: not one direction of a pixel inside may meet light, filtered or not.

    At the rim, a pixel of the inside shares light with no pixel that is lit: their normals differ.
    """
    L = tiles(SCENES / "occluder", (128, 128), supersampling=supersampling)
    inside = crate_inside((128, 128))
    assert inside.sum() > 500
    assert (L[inside] == 0).all()
    assert L.max() > 0


def crate_inside(size):
    """Return the pixels, top row first, that see an inner wall of the crate, or its floor away from the walls: the
    filter knows no wall that is thinner than its reach."""
    from phoslab.render.device import Device, read_texture
    from phoslab.sample_data import scene_occluder

    with Device() as device:
        renderer = Renderer(device, load_scene(SCENES / "occluder"), RenderParameters(size, 1))
        renderer.frame(0.0)
        p = read_texture(renderer.gbuffer.position_w)[::-1]
    low = np.array(scene_occluder.LOW) + np.array([1, 0, 1]) * scene_occluder.WALL
    high = np.array(scene_occluder.HIGH) - np.array([1, 1, 2]) * scene_occluder.WALL
    inside = ((p[..., :3] > low - 1e-4) & (p[..., :3] < high + 1e-4)).all(axis=-1)
    on_floor = p[..., 1] < 1e-4
    middle = ((p[..., [0, 2]] > low[[0, 2]] + 0.15) & (p[..., [0, 2]] < high[[0, 2]] - 0.15)).all(axis=-1)
    inside &= ~on_floor | middle
    for axis in (0, 1):
        inside &= np.roll(inside, 1, axis) & np.roll(inside, -1, axis)
    return inside


def test_what_has_faded_by_six_decades_is_lit_as_well():
    """The picture is the earlier one times a factor, to the rounding of float32: some 20 operations and a sum of 16."""
    frames = tiles(SCENES / "occluder", (64, 64), times=("0", "95"))
    bright, dim = (frame.radiance.astype(np.float64).sum(axis=-1) for frame in frames.frames)
    lit = bright > 0
    factor = dim.max() / bright.max()
    assert factor < 1e-6
    np.testing.assert_allclose(dim[lit] / bright[lit], factor, rtol=64 * 2.0**-24)


def test_the_filter_carries_no_light_into_a_shadow():
    """Behind the panel of the occluder the floor's light ends at a line, which no normal or position shows. What the
    filter takes from the noise must be more than what it carries across: with it, the error is below that of the same
    directions without, against four times as many. (By position and normal alone it was twenty times larger.)"""
    truth, plain, shared = (
        tiles(SCENES / "occluder", (96, 96), directions=n, filter_px=px).sum(axis=-1)
        for n, px in ((128, 0), (32, 0), (32, 4))
    )

    def error(L):
        return np.mean((L - truth) ** 2 / (truth**2 + 1e-4 * truth.max() ** 2))

    assert 0 < error(shared) < error(plain)


@pytest.mark.parametrize("name", ["cornell", "corridor"])
def test_tiles_agree_with_the_path_tracer(name, tmp_path):
    """Relative squared error, against the matched reference: at most 1e-2, as emission varies over the walls.

    Two independent references multiply their differences, so that their own noise has mean 0. The filter is as narrow
    as the picture is small. Pixels at edges are left out: without LLVM the path tracer samples them at random, the
    renderer on a grid, and both are right. Three bands take a third of the time of eight.
    """
    pytest.importorskip("mitsuba")
    from phoslab.render.device import Device, read_texture
    from phoslab.render.path_tracer import trace
    from phoslab.render.reference import Reference

    for file in (SCENES / name).iterdir():
        text = file.read_bytes().replace(b"[render]", b"[render]\nbands_nm = [400, 500, 600, 700]")
        (tmp_path / file.name).write_bytes(text if file.suffix == ".toml" else file.read_bytes())
    scene, size = load_scene(tmp_path), (96, 96)
    with Device() as device:
        transport = TransportParameters("tiles", directions=32, filter_px=2)
        renderer = Renderer(device, scene, RenderParameters(size, 3, transport=transport))
        t = max(scene.schedule.parse_time(text) for text in scene.times[:2])
        lit = renderer.frame(t).radiance
        seen = read_texture(renderer.gbuffer.position_w)[::-1, :, 3].reshape(size[1], 3, size[0], 3)
        around = renderer.transport._around
        meshes = Reference(device, around, transport).meshes()
        renderer.transport = None
        direct = renderer.frame(t).radiance
    one, two = (
        direct
        + trace(meshes, [scene.camera], size, reflections=1, samples=64, seed=seed, direct=False, grid=3)
        for seed in (0, 1000)
    )
    inner = seen.min(axis=(1, 3)) == seen.max(axis=(1, 3))
    scale = lit.max()
    square = (lit - one) / scale * ((lit - two) / scale)
    error = square / (one / scale * (two / scale) + 1e-4).clip(1e-4)
    assert inner.mean() > 0.8
    assert error[inner].mean() < 1e-2
    assert (lit - direct).sum() == pytest.approx((one - direct).sum(), rel=0.02)
