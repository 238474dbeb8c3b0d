"""Deep screen space without and with the bounced z-buffer: closed forms, and what must change nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from phoslab.render import TransportParameters, load_scene, render
from phoslab.render.bounced_z_buffer import INFLATION
from phoslab.render.device import read_array, read_texture
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.render.shells import ShellLevels
from phoslab.sample_data.make_scenes import SCENES

SIZE = (64, 64)


def lit(path, method="dss", *, times=("0",), size=SIZE, supersampling=1, **parameters):
    transport = TransportParameters(method, **parameters)
    frames = render(path, [*times], size=size, supersampling=supersampling, transport=transport)
    return frames[0].radiance.astype(np.float64) if len(frames) == 1 else frames


def transport_of(device, path, method="dss", size=SIZE, **parameters):
    scene = load_scene(path) if not hasattr(path, "camera") else path
    renderer = Renderer(
        device, scene, RenderParameters(size, 1, transport=TransportParameters(method, **parameters))
    )
    renderer.frame(0.0)
    return renderer, renderer.transport


def disks_ratio(path, rooms, method, **parameters):
    L = lit(path, method, **parameters)
    return L[L.max(axis=-1) > 0].mean(axis=0) / (rooms.form_factor() * np.array([1.0, 2.0, 4.0]))


def test_facing_disks_exchange_their_form_factor(build, rooms):
    """Within 1 %: the disks are thousands, and each adds its own."""
    np.testing.assert_allclose(disks_ratio(rooms.facing_disks(build).write(), rooms, "dss"), 1.0, rtol=0.01)


# What disks of `INFLATION` times their radius, placed at random, leave open of a plane; even ones leave less.
HOLES = np.exp(-(INFLATION**2))
# How far random disks of radius 1 whose middles lie beside a straight rim reach across it on the mean, when they are so
# dense: the integral of 1 - exp(-1.4² h(x)) from 0 to 1, where h is the share of a disk that lies beyond x.
BEYOND = 0.311


@pytest.mark.parametrize("epsilon", [0.02, 0.005, 0.001])
def test_hidden_by_holes_or_widened_by_rims_disks_exchange_their_form_factor(build, rooms, epsilon):
    """With the z-buffer 1 % does not hold, however small disks are: holes take a share, and the sender is widened.

    On level l a disk is hit within 1.4 r 2^l from its middle, at a distance of r sqrt(1 / epsilon - 1) 2^l / 2 or more:
    so disks reach across the rim, which is 1 m away, by a share of that which epsilon alone brings down.
    """
    parameters = {"epsilon": epsilon, "directions": 16}
    ratio = disks_ratio(rooms.facing_disks(build).write(), rooms, "dss-z", **parameters)
    away = np.hypot(rooms.SENDER, rooms.APART)
    reach = BEYOND * 2 * INFLATION / np.sqrt(1 / epsilon - 1) * away
    assert (1 - HOLES < ratio).all()
    assert (ratio < (1 + reach / rooms.SENDER) ** 2).all()


def test_smaller_epsilon_is_nearer_to_the_form_factor_with_visibility(build, rooms):
    """Until what reaches across the rim is no more than what is lost through holes."""
    path = rooms.facing_disks(build).write()
    far, middle, near = (
        np.abs(disks_ratio(path, rooms, "dss-z", epsilon=e, directions=16) - 1).max()
        for e in (0.3, 0.02, 0.005)
    )
    assert far > 2 * middle > 4 * near


def test_large_surfels_blur_what_glows_in_parts_with_visibility(build, rooms):
    """Until the error stalls: that of 64 directions, and of holes, is left."""
    path = rooms.partly_lit_wall(build).write()
    coarse, fine = (
        rooms.error_on_the_wall(lit(path, "dss-z", size=(32, 32), surfel=r, directions=64))
        for r in (0.2, 0.05)
    )
    assert fine < coarse / 1.5


def sent_by_disks(transport):
    """Return (n, 3) what each surfel sends to the front, in three bands."""
    n = transport.surfels.count
    sent = np.frombuffer(transport.surfel_glow.radiances.read(), dtype="f4").reshape(n, -1)[:, :3]
    return sent * transport.surfel_glow.glow


@pytest.mark.parametrize("method", ["dss", "dss-z"])
def test_a_disk_sends_the_mean_of_what_lies_under_it(device, build, rooms, method):
    """Of stripes narrower than any disk: half of what they give off, where points would find all or nothing. Means over
    blocks of texels hold whole stripes, so only float32 differs."""
    _, transport = transport_of(device, rooms.striped_quad(build, 8).write(), method, (16, 16), surfel=0.04)
    radius = transport.surfels.read()[:, 3] * transport.extent.radius * rooms.STRIPED_TEXELS
    assert (np.pi * radius**2 > 8**2).all()
    sent = sent_by_disks(transport)
    np.testing.assert_allclose(sent, np.broadcast_to([1.0, 2, 4], sent.shape), rtol=1e-5)


def test_a_disk_sends_nothing_of_what_lies_beside_it(device, build, rooms):
    """Stripes of 64 texels, disks of up to 16², whose means reach 16 to either side: half see one stripe only."""
    _, dss = transport_of(device, rooms.striped_quad(build, 128).write(), "dss", (16, 16), surfel=0.04)
    radius = dss.surfels.read()[:, 3] * dss.extent.radius * rooms.STRIPED_TEXELS
    assert (np.pi * radius**2 < 16**2).all()
    sent = sent_by_disks(dss)[:, 0]
    dark, bright = np.isclose(sent, 0.0, atol=1e-6), np.isclose(sent, 2.0, rtol=1e-5)
    assert dark.mean() > 0.25
    assert bright.mean() > 0.25


ISLANDS = ["side by side", "swapped", "turned"]


def lights_of_floors(build, rooms, method, islands, charge, **floor):
    """Return the picture of the wall by a floor whose atlas is one island, and that by one of two, 1.5 s on."""
    parameters = {} if method == "dss" else {"directions": 16, "guided": 0.0}
    pictures = []
    for name in ("one", islands):
        room = rooms.floor_by_wall(type(build)(build.folder), name, texels=256, **floor)
        pictures.append(lit(charge(room).write(), method, times=("1.5",), size=(32, 32), **parameters))
    assert pictures[0].max() > 0
    return pictures


@pytest.mark.parametrize("islands", ISLANDS)
@pytest.mark.parametrize("method", ["dss", "dss-z", "tiles"])
def test_seams_of_an_atlas_do_not_show_in_the_light_of_what_glows_evenly(build, rooms, method, islands):
    """A floor whose atlas is two islands lights a wall as one island does, but for float32."""
    one, two = lights_of_floors(build, rooms, method, islands, charge=lambda room: room.text(rooms.SATURATED))
    np.testing.assert_allclose(two, one, rtol=1e-5)


@pytest.mark.parametrize("islands", ISLANDS)
@pytest.mark.parametrize("method", ["dss", "tiles"])
def test_seams_of_an_atlas_do_not_show_in_the_light_of_what_a_lamp_has_charged(build, rooms, method, islands):
    """From 0.5 m above, light that falls as cos / d² changes by up to 3 / m, and texels are up to 1/230 m wide: half a
    texel off in either atlas makes 1.3 %."""

    def charge(room):
        lamp = '[lights.lamp]\nspectrum = "flat"\nirradiance_at_1m = 1e-3\nschedule = [[0, 1]]\n'
        return room.lamp((0.3, 0.0, 0.3)).text("\n[units]\nradiance_factor = 1.0\n" + lamp)

    one, two = lights_of_floors(build, rooms, method, islands, charge, kr=0.01)
    np.testing.assert_allclose(two, one, rtol=0.013, atol=1e-3 * one.max())


@pytest.mark.parametrize("texels", [3, 33, 171, 256])
def test_disks_send_what_the_atlas_holds_whatever_its_size(device, build, rooms, texels):
    """One radiance all over: every mean of it is it, to the rounding of the MIP levels' and the cover's quotient."""
    build.mesh("quad").camera()
    toml = rooms.write_material(build, "quad", [1.0, 2.0, 4.0], [0.0] * 3).replace("= 64", f"= {texels}")
    _, dss = transport_of(device, build.text(toml + rooms.SATURATED).write())
    sent = np.frombuffer(dss.surfel_glow.radiances.read(), dtype="f4").reshape(dss.surfels.count, 4)
    np.testing.assert_allclose(
        sent[:, :3] * dss.surfel_glow.glow, np.broadcast_to([1.0, 2, 4], sent[:, :3].shape), rtol=1e-5
    )


def test_what_is_missing_falls_as_levels_rise(build, rooms):
    """Each level reaches twice as far: with too few, light from afar is lost."""
    path = rooms.closed_box(build).write()
    error = [abs(lit(path, levels=n).mean() - 0.75) for n in (2, 4, 7)]
    assert error[0] > 1.3 * error[1] > 5 * error[2]


def test_smaller_epsilon_is_nearer_to_the_form_factor(build, rooms):
    path = rooms.facing_disks(build).write()
    coarse, fine = (np.abs(disks_ratio(path, rooms, "dss", epsilon=e) - 1).max() for e in (0.3, 0.003))
    assert fine < coarse / 4


def test_large_surfels_miss_more(build, rooms):
    path = rooms.closed_box(build).write()
    coarse, fine = (abs(lit(path, surfel=r).mean() - 0.75) for r in (0.15, 0.02))
    assert fine < coarse / 2


@pytest.mark.parametrize(("method", "within"), [("dss", 0.02), ("dss-z", 0.05)])
@pytest.mark.parametrize("supersampling", [1, 2])
def test_closed_box_of_albedo_and_emission_one_half_reads_three_quarters(
    build, rooms, method, within, supersampling
):
    """Without visibility nothing else differs in a convex room; with it, holes between the disks are left."""
    L = lit(rooms.closed_box(build).write(), method, supersampling=supersampling)
    assert L.mean() == pytest.approx(0.75, rel=within)


@pytest.mark.parametrize(
    ("method", "surfel", "within"), [("dss", 0.02, 0.02), ("tiles", 0.02, 0.02), ("dss-z", 0.04, HOLES)]
)
def test_energy_that_arrives_at_the_walls_is_what_was_sent(build, rooms, device, method, surfel, within):
    """One wall of a cube glows, all are white: over six views from the middle, E of each pixel times its area of wall.

    A pixel at direction d sees r² dω / cos of wall; π L is E. Sent are π times 1 over an area of 4, all of it to
    the other five walls. 2 %: what the point-to-disk form factor leaves out in the corners, and what directions of
    tiles differ by in 6 x 64² pixels; with the z-buffer, what is lost through holes.
    """
    x = np.array([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1]], dtype=float)
    shape = rooms.box((-1, -1, -1), (1, 1, 1))
    build.mesh("lamp", x, np.array([[0, 1, 2], [0, 2, 3]]), uv=x[:, :2] / 2.1 + 0.5)
    turned = shape.triangles[:, ::-1]
    away = ~(shape.positions[turned][:, :, 2] < -0.99).all(axis=1)
    build.mesh("walls", shape.positions, turned[away], uv=None).camera(distance=0.5, yfov=np.pi / 2)
    build.text(rooms.write_material(build, "lamp", [1.0] * 3, [1.0] * 3) + rooms.SATURATED)
    scene = load_scene(build.write())
    arrived = 0.0
    for axis in range(3):
        for sign in (1.0, -1.0):
            turn = np.roll(np.eye(3), axis, axis=1)[[1, 2, 0]] * [[1], [sign], [sign]]
            view = np.eye(4)
            view[:3, :3] = turn
            turned_scene = replace(scene, camera=replace(scene.camera, world_to_view=view))
            renderer, transport = transport_of(device, turned_scene, method, surfel=surfel)
            sent = transport.lit_cells.cell_glow if method == "tiles" else transport.surfel_glow
            E = np.pi * sent.glow * read_array(transport._pixels.light, 3)[..., 0]
            p = read_texture(renderer.gbuffer.position_w)[..., :3]
            n = read_texture(renderer.gbuffer.normal_w)[..., :3]
            r = np.linalg.norm(p, axis=-1)
            k = (np.arange(SIZE[0]) + 0.5) / SIZE[0] * 2 - 1
            a, b = np.meshgrid(k, k)
            solid_angle = (2 / SIZE[0]) ** 2 * (1 + a**2 + b**2) ** -1.5
            cosine = np.abs(np.sum(p * n, axis=-1)) / r
            arrived += float(np.sum(E * r**2 * solid_angle / cosine))
    assert arrived == pytest.approx(np.pi * 4.0, rel=within)


@pytest.mark.parametrize("size", [(64, 64), (37, 23)])
@pytest.mark.parametrize("level", [0, 1, 3, 5])
def test_unshuffling_undoes_shuffling(device, build, rooms, size, level):
    """What pixels see, to the sub-buffers and back, bit by bit; and each pixel lies there once."""
    renderer, dss = transport_of(device, rooms.closed_box(build).write(), size=size, levels=6)
    seen = read_texture(renderer.gbuffer.position_w)
    dss.shells.shuffle(level)
    dss._targets[0].write(dss.shells.position.read())
    dss._pixels.clear()
    dss._unshuffle(level)
    back = read_array(dss._pixels.light, 4)
    extent = dss.extent
    np.testing.assert_allclose(back[..., :3] * extent.radius + extent.centre, seen[..., :3], atol=1e-6)
    assert (back[..., 3] == 1).all()
    blocks = -(-np.array(size) // 2**level) * 2**level
    shuffled = read_texture(dss.shells.position)[: blocks[1], : blocks[0]]
    assert (shuffled[..., 3] == 1).sum() == size[0] * size[1]
    if level and min(size) >> level:
        # The first sub-buffer does not always have the same pixel of a block.
        first = shuffled[: size[1] >> level, : size[0] >> level, :3]
        regular = back[:: 1 << level, :: 1 << level, :3][: first.shape[0], : first.shape[1]]
        assert (first != regular).any(axis=-1).sum() >= 0.3 * first.shape[0] * first.shape[1]


def cull_by(monkeypatch, frustum, boxes):
    """Let ShellLevels cull by the frustum, by the boxes of what is seen, by both or neither. Return a list to which
    go the number of splats and of their pixels, for each level."""
    prepare, find_splats, drawn = ShellLevels.prepare, ShellLevels.find_splats, []

    def prepared(self):
        prepare(self)
        if not boxes:  # each block of pixels sees points that lie all around the scene
            far = np.array([[-9, -9, -9, 0], [9, 9, 9, 0]], dtype="f4")
            self._boxes.write(np.tile(far, (self._boxes.size // far.nbytes, 1)).tobytes())
        if not frustum:  # the eye is everywhere
            self._camera |= {"to_view": np.diag([0.0, 0, 0, 1]), "near_limit": 0.0}

    def found(self, *args, **kwargs):
        splats = find_splats(self, *args, **kwargs)
        drawn.append((splats.count, splats.fragments() if splats.count else 0))
        return splats

    monkeypatch.setattr(ShellLevels, "prepare", prepared)
    monkeypatch.setattr(ShellLevels, "find_splats", found)
    return drawn


def lights_by_culling(monkeypatch, renderer):
    """Return what pixels get, how many splats are drawn, and how many of their pixels: without culling, by the frustum,
    by the boxes, and by both."""
    light, splats, pixels = [], [], []
    transport = renderer.transport
    for frustum, boxes in ((False, False), (True, False), (False, True), (True, True)):
        with monkeypatch.context() as patch:
            drawn = cull_by(patch, frustum, boxes)
            patch.setattr(type(transport), "shells_culled", frustum or boxes)
            transport.prepare()
            transport.run(renderer.direct_light.radiance)
        light.append(read_array(transport._pixels.light, renderer.scene.transport.n))
        for kind, number in zip((splats, pixels), np.sum(drawn, axis=0), strict=True):
            kind.append(number)
    return light, splats, pixels


# A view along a corridor, and one of so little of a room that most of it lies beside the picture.
VIEWS = {"corridor": {}, "cornell": {"yfov_rad": 0.25}}


@pytest.mark.parametrize("name", VIEWS)
@pytest.mark.parametrize("method", ["dss", "dss-z"])
@pytest.mark.parametrize("more", [{}, {"bounces": 2, "cell": 0.2}], ids=["once", "sent on"])
def test_culling_changes_no_pixel(device, monkeypatch, name, method, more):
    """Against every splat drawn all over its sub-buffer: bit by bit, since what is added has its place. The frustum and
    the boxes each leave splats or parts of them out, also of those that the other leaves."""
    scene = load_scene(SCENES / name)
    scene = replace(scene, camera=replace(scene.camera, **VIEWS[name]))
    parameters = {"surfel": 0.2, "epsilon": 0.05, "directions": 2, **more}
    renderer, transport = transport_of(device, scene, method, (32, 32), **parameters)
    assert transport.surfel_glow.sides == (2 if more else 1)
    renderer.frame(scene.schedule.parse_time("off+1s"))
    (full, *culled), splats, pixels = lights_by_culling(monkeypatch, renderer)
    assert full.max() > 0
    for light in culled:
        np.testing.assert_array_equal(light, full)
    every, by_frustum, by_boxes, by_both = pixels
    assert every > by_frustum > by_both
    assert every > by_boxes > by_both
    assert splats[3] < splats[0]
    if name == "cornell":
        assert splats[1] < splats[0]
        assert by_frustum < 0.5 * every


def test_culling_keeps_what_backs_send(device, monkeypatch, build, rooms):
    """A roof over a glowing floor, whose outside is above: its other side lights the wall. Bit by bit, as above."""
    roof = np.array([[-0.5, 0.6, 0], [-0.5, 0.6, 1], [0.5, 0.6, 1], [0.5, 0.6, 0]])
    room = rooms.floor_by_wall(build).text(rooms.SATURATED)
    room.mesh("roof", roof, np.array([[0, 1, 2], [0, 2, 3]]), uv=None)
    parameters = {"surfel": 0.1, "epsilon": 0.1, "bounces": 2, "cell": 0.2}
    renderer, dss = transport_of(device, room.write(), "dss", (32, 32), **parameters)
    with device.scope():
        assert any(dss.find_splats(level, side=1).count for level in range(dss.shells.levels))
    (full, *culled), splats, _ = lights_by_culling(monkeypatch, renderer)
    for light in culled:
        np.testing.assert_array_equal(light, full)
    assert splats[3] < splats[0]


def test_cost_follows_what_glows_and_not_the_scene(device, build, rooms):
    """A glowing quad among 200,000 triangles that do not: as many surfels and splats as without them."""
    counts = []
    for bystanders in (False, True):
        here = type(build)(build.folder)
        here.mesh("lamp", np.array([[-1.0, -1, -2], [1, -1, -2], [1, 1, -2], [-1, 1, -2]]))
        here.mesh("floor", np.array([[-3.0, -1, -3], [3, -1, -3], [3, -1, 3], [-3, -1, 3]]), uv=None)
        if bystanders:
            rng = np.random.default_rng(0)
            corner = rng.uniform([-3, -1, -3], [3, 1, 3], (10_000, 1, 3))
            soup = (corner + rng.uniform(0, 0.01, (10_000, 3, 3))).clip(-3, 3).reshape(-1, 3)
            for k in range(20):
                here.mesh(f"soup{k}", soup, np.arange(len(soup)).reshape(-1, 3), uv=None)
        here.camera(distance=3.0, yfov=0.8)
        here.text(rooms.write_material(here, "lamp", [1.0] * 3, [1.0] * 3) + rooms.SATURATED)
        _, dss = transport_of(device, here.write())
        with device.scope():
            counts.append(
                (dss.surfels.count, sum(dss.find_splats(k).count for k in range(dss.shells.levels)))
            )
    assert counts[0][0] > 500
    assert counts[1] == counts[0] or abs(counts[1][0] / counts[0][0] - 1) < 0.02


@pytest.mark.parametrize("method", ["dss", "dss-z"])
def test_what_has_faded_by_six_decades_is_lit_as_well(method):
    """The picture is the earlier one times a factor: float32 rounds what is added, but the shells stay."""
    frames = lit(SCENES / "occluder", method, times=("0", "95"))
    bright, dim = (frame.radiance.astype(np.float64).sum(axis=-1) for frame in frames.frames)
    there = bright > 0
    factor = dim.max() / bright.max()
    assert factor < 1e-6
    np.testing.assert_allclose(dim[there] / bright[there], factor, rtol=1e-4)


def test_what_is_behind_the_crate_is_dark_only_with_visibility():
    """Inside, where no line from the panel enters: `dss` leaks, and with the z-buffer less than 1 % of that is left."""
    leaked, shadowed = (
        lit(SCENES / "occluder", m, size=(96, 96), directions=4)[inside((96, 96))].mean()
        for m in ("dss", "dss-z")
    )
    assert leaked > 0
    assert shadowed < 0.01 * leaked


def inside(size):
    """Return the pixels, top row first, on the inner walls of the crate."""
    from phoslab.render.device import Device
    from phoslab.sample_data import scene_occluder

    with Device() as device:
        renderer = Renderer(device, load_scene(SCENES / "occluder"), RenderParameters(size, 1))
        renderer.frame(0.0)
        p = read_texture(renderer.gbuffer.position_w)[::-1, :, :3]
    low = np.array(scene_occluder.LOW) + np.array([1, 0, 1]) * scene_occluder.WALL
    high = np.array(scene_occluder.HIGH) - np.array([1, 1, 2]) * scene_occluder.WALL
    return ((p > low - 1e-4) & (p < high + 1e-4)).all(axis=-1) & (p[..., 1] > 1e-3)


def test_directions_are_those_of_a_lambertian_times_the_cosine(device, build, rooms):
    """Chi-squared of cos² and the angle around the normal, 6 x 6 equal parts of cos / π, over one pattern of pixels on
    each of three walls: at random, 35 degrees of freedom pass 57.3 once in a hundred times; even ones lie far below."""
    scene = load_scene(rooms.closed_box(build).write())
    wide = replace(scene, camera=replace(scene.camera, yfov_rad=2.6))
    renderer, z = transport_of(
        device, wide, "dss-z", directions=16, guided=0.0, filter_px=8, surfel=0.1, epsilon=0.3
    )
    (d, _), n = z.directions(), read_texture(renderer.gbuffer.normal_w)[..., :3].astype(np.float64)
    assert np.sum(d * n[:, :, None], axis=-1).min() > -1e-3
    normals = set()
    for row, column in ((28, 28), (28, 8), (52, 28)):
        normal = n[row, column]
        normals.add(tuple(normal))
        assert (n[row : row + 8, column : column + 8] == normal).all()
        chosen = d[row : row + 8, column : column + 8].reshape(-1, 3)
        x = np.cross(normal, [0.3, 0.5, 0.8])
        x /= np.linalg.norm(x)
        turn = np.arctan2(chosen @ np.cross(normal, x), chosen @ x) / (2 * np.pi) % 1.0
        counts = np.histogram2d((chosen @ normal) ** 2, turn, bins=6, range=[[0, 1], [0, 1]])[0]
        expected = len(chosen) / counts.size
        assert np.sum((counts - expected) ** 2) / expected < 57.3
    assert len(normals) == 3


def cones(guides, p, n):
    """Return the axes (g, 3), cosines (g,) and hopes (g,) of guides for one receiver: as find_cone of guides.glsl."""
    (c, r), (facing, area) = ((guides[:, k, :3], guides[:, k, 3]) for k in range(2))
    to = c - p
    d = np.linalg.norm(to, axis=1)
    axis = to / d[:, None]
    above = np.clip((to @ n + r) / d, 0, 1)
    spread = 1 - np.linalg.norm(facing, axis=1) + r / d
    hope = area * above * np.clip(spread - np.sum(axis * facing, axis=1), 0, 1) / d**2
    return axis, np.sqrt(np.maximum(1 - (r / d) ** 2, 0)), np.where(d < 1.2 * r, 0.0, hope)


def density(d, axis, cosine, hope):
    """Return (...) how densely directions d (..., 3) are chosen that aim at the cones."""
    within = d @ axis.T >= cosine
    return within @ (hope / hope.sum() / (2 * np.pi * np.maximum(1 - cosine, 1e-7)))


@pytest.mark.parametrize("name", ["corridor", "cornell"])
def test_aimed_directions_are_as_dense_as_their_weights_take_them_to_be(device, name):
    """Chi-squared of the aimed directions of one pattern of pixels, over 12 x 12 equal parts of the sphere, against the
    density of the mixture of cones, by 20000 even points; parts that expect less than 5 are one. Even directions lie
    below what random ones pass 99 times in a hundred. Then every weight: cos / π over the density of all directions."""
    renderer, z = transport_of(
        device, SCENES / name, "dss-z", directions=32, filter_px=8, surfel=0.1, epsilon=0.3
    )
    (d, weight), aimless = z.directions(), z._choice["AIMLESS"]
    seen, n = (
        read_texture(t).astype(np.float64) for t in (renderer.gbuffer.position_w, renderer.gbuffer.normal_w)
    )
    p = (seen[..., :3] - z.extent.centre) / z.extent.radius
    guides = np.frombuffer(z._guides.read(), dtype="f4").reshape(-1, 2, 4).astype(np.float64)
    k = np.arange(20_000) + 0.5
    height, turn = 1 - k / 10_000, k * np.pi * (1 + 5**0.5)
    even = np.stack([np.sqrt(1 - height**2) * f(turn) for f in (np.cos, np.sin)] + [height], axis=1)

    def part(d):
        around = np.arctan2(d[..., 1], d[..., 0]) / (2 * np.pi) % 1.0
        return (
            np.minimum(around * 12, 11).astype(int) * 12 + ((d[..., 2] + 1) * 6).clip(0, 11).astype(int)
        ).ravel()

    block = [(y, x) for y in range(24, 32) for x in range(24, 32)]
    assert all(seen[y, x, 3] > 0 for y, x in block)
    counts, expected = np.zeros(144), np.zeros(144)
    for y, x in block:
        axes = cones(guides, p[y, x], n[y, x, :3])
        aimed = (32 - aimless) / 32
        counts += np.bincount(part(d[y, x, aimless:]), minlength=144)
        share = density(even, *axes) * 4 * np.pi / len(even)
        expected += (32 - aimless) * np.bincount(part(even), share, minlength=144)
        cosine = np.maximum(d[y, x] @ n[y, x, :3], 0) / np.pi
        want = cosine / ((1 - aimed) * cosine + aimed * density(d[y, x], *axes))
        # One in a hundred may lie on a cone's rim, where float32 decides otherwise.
        assert np.isclose(weight[y, x], want, rtol=1e-3, atol=1e-3).mean() > 0.96
    rare = expected < 5
    counts, expected = (np.append(v[~rare], v[rare].sum()) for v in (counts, expected))
    chi2 = np.sum((counts - expected) ** 2 / np.maximum(expected, 1.0))
    from scipy.stats import chi2 as law

    assert counts.sum() == pytest.approx(expected.sum(), rel=0.01)
    assert chi2 < law.ppf(0.99, len(counts) - 1)


@pytest.mark.parametrize("guided", [0.25, 0.5, 0.75])
def test_aimed_directions_bring_as_much_light_as_aimless_ones(device, guided):
    """The weights' mean is 1, and with the cosine 2/3, what evenly lit surroundings bring; a pixel's own mean of 32 has
    a deviation of 0.05, and there are some 3000 pixels: three of these are 0.3 %."""
    renderer, z = transport_of(
        device, SCENES / "corridor", "dss-z", directions=32, guided=guided, surfel=0.1, epsilon=0.3
    )
    d, weight = z.directions()
    n, there = (
        read_texture(renderer.gbuffer.normal_w)[..., :3],
        read_texture(renderer.gbuffer.position_w)[..., 3] > 0,
    )
    cosine = np.sum(d * n[:, :, None], axis=-1)
    assert weight[there].mean() == pytest.approx(1, rel=3e-3)
    assert (weight * cosine)[there].mean() == pytest.approx(2 / 3, rel=3e-3)


def test_a_hit_is_the_nearest_disk_of_its_shell(device, build, rooms):
    """Each pixel's directions against all surfels of its sub-buffer, in NumPy, on level 0: front, back or nothing."""
    renderer, z = transport_of(
        device, rooms.facing_disks(build).write(), "dss-z", (32, 32), levels=1, surfel=0.1, directions=2
    )
    from phoslab.render.bounced_z_buffer import INFLATION

    surfel, _ = z.hits()
    disks = z.surfels.read().astype(np.float64)
    seen = read_texture(renderer.gbuffer.position_w)
    p = (seen[..., None, :3] - z.extent.centre) / z.extent.radius
    d, _ = z.directions()
    centre, r, normal = disks[:, :3], disks[:, 3], disks[:, 4:7]
    height = np.einsum("hwdk,nk->hwdn", -p, normal) + np.sum(centre * normal, axis=1)
    with np.errstate(divide="ignore"):
        t = height / np.einsum("hwdk,nk->hwdn", d, normal)
    hit = p[..., None, :] + t[..., None] * d[..., None, :]
    away = np.linalg.norm(hit - centre, axis=-1)
    t[(t < 0.05) | ~(away < INFLATION * r)] = np.inf
    there = (seen[..., 3] > 0)[..., None] & np.ones(2, dtype=bool)
    found = np.isfinite(t.min(axis=-1))
    assert ((surfel >= 0) == found)[there].mean() > 0.998


def test_views_are_those_of_the_method(tmp_path, capsys):
    from phoslab.app.cli import main

    args = ["render", str(SCENES / "occluder"), "-o", str(tmp_path / "a.png"), "--at", "0", "--size", "24x24"]
    views = "surfels,levels,shells,directions,hits"
    quick = ["--surfel", "0.1", "--epsilon", "0.1"]
    assert main([*args, "--gi", "dss-z", "--directions", "2", "--debug", views, *quick]) == 0
    assert {p.name.split(".")[2] for p in tmp_path.glob("a.glow_transport.*.png")} == set(views.split(","))
    capsys.readouterr()
    assert main([*args, "--gi", "dss", "--debug", "hits", *quick]) == 1
    assert "directions and hits are those of dss-z" in capsys.readouterr().err


@pytest.mark.parametrize("method", ["dss", "dss-z"])
def test_preparing_again_keeps_no_more_on_the_device(device, method):
    """As after every move of the camera or of a thing."""
    _, transport = transport_of(device, SCENES / "occluder", method, (24, 24), surfel=0.1, epsilon=0.1)
    before = device.live
    transport.prepare()
    assert device.live == before
