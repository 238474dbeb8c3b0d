"""The path tracer as the judge: it must be right itself before anything is held to it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from phoslab.app.cli import main
from phoslab.render import TransportParameters, load_scene, path_tracer, render
from phoslab.sample_data.make_scenes import SCENES

pytest.importorskip("mitsuba")


def reference(path, size, samples, full=False, **more):
    transport = TransportParameters("reference", samples=samples, full=full)
    return render(path, ["0"], size=size, supersampling=1, transport=transport, **more)[0].radiance


@pytest.mark.parametrize(("full", "want"), [(False, 0.75), (True, 1.0)])
def test_closed_box_of_albedo_and_emission_one_half(build, rooms, full, want):
    """Once reflected: 1/2 + 1/4; to the end: 1.

    32² pixels x 64 samples of a deviation below 1/2 leave 0.5 / 256 = 2e-3; five of them are allowed.
    """
    L = reference(rooms.closed_box(build).write(), (32, 32), 64, full)
    assert L.mean() == pytest.approx(want, abs=1e-2)


@pytest.mark.parametrize(("reflections", "want"), [(0, 0.5), (1, 0.75), (2, 0.875), (3, 0.9375)])
def test_each_reflection_adds_half_of_what_the_one_before_added(build, rooms, device, reflections, want):
    from phoslab.render.renderer import Renderer, RenderParameters

    scene = load_scene(rooms.closed_box(build).write())
    renderer = Renderer(
        device, scene, RenderParameters((8, 8), 1, transport=TransportParameters("reference"))
    )
    renderer.frame(0.0)
    L = path_tracer.trace(
        renderer.transport.meshes(), [scene.camera], (8, 8), reflections=reflections, samples=1024
    )
    # As above, with 8² pixels x 1024 samples.
    assert L.mean() == pytest.approx(want, abs=1e-2)


def test_facing_disks_exchange_their_form_factor(build, rooms):
    """The mean over the receiver is L F, in each of three bands: 804 pixels x 512 samples of a relative deviation
    below 1.5 leave 0.24 %; 1 % is four of these."""
    L = reference(rooms.facing_disks(build).write(), (32, 32), 512)
    seen = L.sum(axis=(0, 1)) / (np.pi * 16**2)
    np.testing.assert_allclose(seen, rooms.form_factor() * np.array([1.0, 2.0, 4.0]), rtol=0.01)


def test_what_the_camera_sees_is_what_the_renderer_sees():
    """Emission that comes straight to the camera agrees with the rasterized glow away from edges: same camera, same
    texels. A texel is nearest there and bilinear here: half a texel's slope, below 2 % of the glow in this scene."""
    from phoslab.render.device import Device
    from phoslab.render.renderer import Renderer, RenderParameters

    scene = load_scene(SCENES / "cornell")
    with Device() as device:
        p = RenderParameters((96, 96), 1, transport=TransportParameters("reference", samples=1))
        renderer = Renderer(device, scene, p)
        want = renderer.frame(21.0).radiance - renderer.transport.reflected
        got = path_tracer.trace(
            renderer.transport.meshes(), [scene.camera], (96, 96), reflections=0, samples=64
        )
    bright = want.max(axis=-1) > 0.2 * want.max()
    for axis in (0, 1):  # not at an edge
        bright &= np.roll(bright, 1, axis) & np.roll(bright, -1, axis)
    assert bright.sum() > 1000
    assert (np.abs(got - want).max(axis=-1)[bright] < 0.02 * want.max()).all()


def test_pictures_of_two_seeds_differ_by_noise_alone(build, rooms):
    """Their means agree within five standard errors of the difference of their pixels."""
    path = rooms.facing_disks(build).write()
    one, same, other = (
        render(path, ["0"], size=(32, 32), supersampling=1,
               transport=TransportParameters("reference", samples=16, seed=seed))[0].radiance.sum(axis=-1)
        for seed in (1, 1, 2)
    )  # fmt: skip
    np.testing.assert_array_equal(one, same)
    difference = one - other
    assert difference.any()
    assert abs(difference.mean()) < 5 * difference.std() / np.sqrt(difference.size)


def test_paths_begin_where_the_renderer_samples_a_pixel():
    """Four paths are then its 2² samples, and edges agree but for a sample on the very line: the mean difference is a
    quarter of that of paths which all begin in the pixel's middle; a texel's slope (above) keeps it from 0."""
    from phoslab.render.device import Device
    from phoslab.render.renderer import Renderer, RenderParameters

    if path_tracer.usual_variant() != path_tracer.LLVM:
        pytest.skip("without LLVM paths begin anywhere in a pixel")
    scene, size = load_scene(SCENES / "cornell"), (64, 51)
    with Device() as device:
        p = RenderParameters(size, 2, transport=TransportParameters("reference", samples=1))
        renderer = Renderer(device, scene, p)
        want = renderer.frame(21.0).radiance - renderer.transport.reflected
        meshes = renderer.transport.meshes()
    same, middle = (
        np.abs(
            path_tracer.trace(meshes, [scene.camera], size, reflections=0, samples=4, grid=grid) - want
        ).mean()
        for grid in (2, 1)
    )
    assert same < 0.5 * middle


def test_what_has_faded_by_six_decades_is_traced_as_well():
    bright, dim = (
        render(SCENES / "occluder", [t], size=(48, 48), supersampling=1,
               transport=TransportParameters("reference", samples=16))[0].radiance
        for t in (0.0, 60.0)
    )  # fmt: skip
    lit = bright.max(axis=-1) > 1e-3 * bright.max()
    ratio = (dim / np.maximum(bright, 1e-30))[lit][:, 2:5]
    # One state fades by one factor everywhere. Rounding of float32, in a sum of samples and a difference of two.
    np.testing.assert_allclose(ratio, np.median(ratio), rtol=1e-4)


def test_without_mitsuba_the_error_says_how_to_get_it(monkeypatch, capsys, tmp_path):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    out = tmp_path / "glow.png"
    args = ["render", str(SCENES / "occluder"), "-o", str(out), "--at", "0", "--size", "8x8"]
    assert main([*args, "--gi", "reference"]) == 1
    assert "pip install 'phoslab[reference]'" in capsys.readouterr().err
    assert not out.exists()


def test_an_llvm_that_is_too_old_is_passed_over(tmp_path, monkeypatch):
    """Mitsuba would end the process with it."""
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(path_tracer, "LLVM_FOLDERS", (str(tmp_path),))
    (tmp_path / "libLLVM-15.so").touch()
    assert path_tracer.find_llvm() is None
    (tmp_path / "libLLVM-16.so.1").touch()
    (tmp_path / "libLLVM.so.19.1").touch()
    assert path_tracer.find_llvm() == Path(tmp_path / "libLLVM.so.19.1")


def test_a_variable_that_names_no_library_leaves_the_path_tracer_without_llvm(tmp_path, monkeypatch):
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM.so"))
    assert path_tracer.usual_variant() == path_tracer.SCALAR
