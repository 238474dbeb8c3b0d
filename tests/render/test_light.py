"""Irradiance on the atlas and radiance in the picture, against the formulas."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import phoslab
from phoslab.render import load_scene, render
from phoslab.render.device import Device, read_array, read_texture
from phoslab.render.renderer import Renderer, RenderParameters

# A few float32 operations a texel, on positions that are themselves interpolated in float32.
FLOAT32 = 64 * 2.0**-24


def atlas_irradiance(device: Device, path: Any) -> tuple[np.ndarray, Any]:
    """Return (h, w, K) irradiance at time 0 on the first phosphor's atlas, and the scene."""
    scene = load_scene(path)
    renderer = Renderer(device, scene, RenderParameters((16, 16), 1))
    renderer.frame(0.5)
    return read_array(renderer.states[0].light.irradiance, scene.transport.n), scene


def texel_positions(n: int) -> np.ndarray:
    """(n, n, 2) where the quad's texels lie, in m."""
    centre = (np.arange(n) + 0.5) / n - 0.5
    return np.stack(np.meshgrid(centre, centre), axis=-1)


def aimed(eye: tuple[float, float, float], target: tuple[float, float, float]) -> np.ndarray:
    z = np.subtract(eye, target) / np.linalg.norm(np.subtract(eye, target))
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([x, np.cross(z, x), z, eye])
    return matrix


def expected_point(at: tuple[float, float, float]) -> np.ndarray:
    p = texel_positions(64)
    d2 = (p[..., 0] - at[0]) ** 2 + (p[..., 1] - at[1]) ** 2 + at[2] ** 2
    return at[2] / d2**1.5


def test_point_light_gives_cosine_over_distance_squared(quad, device, lamp_toml, green_toml):
    at = (0.3, -0.2, 0.35)  # so low that four of its six views see the quad
    E, scene = atlas_irradiance(device, quad.lamp(at).text(lamp_toml + green_toml).write())
    at_1m = scene.lights[0].irradiance_at_1m
    np.testing.assert_allclose(E, expected_point(at)[..., None] * at_1m, rtol=FLOAT32)


def test_spot_light_falls_off_as_its_cone_says(quad, device, lamp_toml, green_toml):
    at, target, inner, outer = (0.1, 0.2, 1.0), (0.0, 0.1, 0.0), 0.15, 0.45
    quad.light("lamp", "spot", aimed(at, target), innerConeAngle=inner, outerConeAngle=outer)
    E, scene = atlas_irradiance(device, quad.text(lamp_toml + green_toml).write())
    p = np.concatenate([texel_positions(64), np.zeros((64, 64, 1))], axis=-1) - at
    axis = np.subtract(target, at) / np.linalg.norm(np.subtract(target, at))
    cosine = p @ axis / np.linalg.norm(p, axis=-1)
    cone = np.clip((cosine - np.cos(outer)) / (np.cos(inner) - np.cos(outer)), 0, 1) ** 2
    want = (cone * expected_point(at))[..., None] * scene.lights[0].irradiance_at_1m
    # Near the rim the cone's own cosine is a difference: its error is absolute.
    np.testing.assert_allclose(E, want, rtol=FLOAT32, atol=FLOAT32 * want.max() * 10)


def test_spot_too_wide_for_one_view_still_lights_as_its_cone_says(quad, device, lamp_toml, green_toml):
    at = (0.0, 0.0, 0.5)
    quad.light("lamp", "spot", aimed(at, (0, 0, 0)), innerConeAngle=1.2, outerConeAngle=1.5)
    E, scene = atlas_irradiance(device, quad.text(lamp_toml + green_toml).write())
    want = expected_point(at)[..., None] * scene.lights[0].irradiance_at_1m
    np.testing.assert_allclose(E, want, rtol=FLOAT32)


def test_directional_light_gives_the_cosine_at_any_distance(quad, device, lamp_toml, green_toml):
    quad.light("lamp", "directional", aimed((1.0, 0.0, 1.0), (0, 0, 0)))
    E, scene = atlas_irradiance(device, quad.text(lamp_toml + green_toml).write())
    want = np.broadcast_to(np.sqrt(0.5) * scene.lights[0].irradiance_at_1m, E.shape)
    np.testing.assert_allclose(E, want, rtol=FLOAT32)


def test_irradiance_at_1m_is_the_total_in_multiples_of_the_reference_lamp(quad, lamp_toml, green_toml):
    scene = load_scene(quad.lamp().text(lamp_toml + green_toml).write())
    green = phoslab.preset("green")
    total = scene.lights[0].irradiance_at_1m @ scene.transport.widths_nm
    assert total == pytest.approx(2.0 * green.reference_irradiance @ green.bands.widths_nm, rel=1e-12)


@pytest.mark.parametrize("kind", ["point", "spot", "directional"])
def test_shadow_is_dark_inside_and_lit_outside(kind, quad, device, lamp_toml, green_toml):
    """A square of 0.2 m at half way to a light at 2 m throws a shadow of 0.4 m (point) or 0.2 m (directional)."""
    quad.mesh("blocker", uv=None, scale=[0.2, 0.2, 1], translation=[0, 0, 1.0])
    matrix = np.eye(4)
    matrix[2, 3] = 2.0
    cone = {"innerConeAngle": 0.5, "outerConeAngle": 0.9} if kind == "spot" else {}
    quad.light("lamp", kind, matrix, **cone)
    E, scene = atlas_irradiance(device, quad.text(lamp_toml + green_toml).write())
    lit = E[..., 0] / scene.lights[0].irradiance_at_1m[0]
    half = 0.1 if kind == "directional" else 0.2
    distance = np.abs(texel_positions(64)).max(axis=-1)
    # The filter reaches 3.5 shadow texels; the widest view here (six sides of a cube) has texels of 2 mm on the quad.
    blur = 4 * 0.002
    assert (lit[distance < half - blur] == 0).all()
    want = np.ones((64, 64)) if kind == "directional" else expected_point((0, 0, 2.0))
    outside = distance > half + blur
    np.testing.assert_allclose(lit[outside], want[outside], rtol=FLOAT32)


def test_light_from_behind_gives_nothing(quad, device, lamp_toml, green_toml):
    E, _ = atlas_irradiance(device, quad.lamp((0, 0, -1.0)).text(lamp_toml + green_toml).write())
    assert (E == 0).all()


def test_picture_shows_lambert_reflection_of_the_irradiance(build, lamp_toml):
    """L = ρ E / π in every band; without a phosphor the reference lamp's unit is 1."""
    build.mesh("quad", colour=(0.5, 0.25, 0.125)).camera().lamp((0, 0, 2.0))
    scene = load_scene(build.text(lamp_toml).write())
    frame = render(scene, ["1"], size=(33, 33), supersampling=1).frames[0]
    rho = phoslab.render.scene.colorimetry.reflectance_from_rgb([0.5, 0.25, 0.125], scene.transport)
    want = rho / np.pi * scene.lights[0].irradiance_at_1m / 4
    np.testing.assert_allclose(frame.radiance[16, 16], want, rtol=FLOAT32)


def test_background_is_black_even_after_a_brighter_frame(build, lamp_toml):
    build.mesh("quad").camera(distance=5.0, yfov=0.6).lamp()
    frames = render(build.text(lamp_toml).write(), ["0", "off+1"], size=(32, 32))
    assert (frames[0].radiance[0] == 0).all()
    assert frames[0].radiance[16, 16].min() > 0
    assert (frames[1].radiance == 0).all()


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_scene_of_any_scale_shows_no_self_shadow(scale, build, device, lamp_toml):
    """A curved floor under a slanted light: bias follows the shadow texels, so no acne at 1 mm or 1 km."""
    u = np.linspace(-0.5, 0.5, 41)
    x, y = np.meshgrid(u, u)
    points = np.stack([x, y, -0.3 * (x**2 + y**2)], axis=-1).reshape(-1, 3)
    corner = (np.arange(40)[:, None] * 41 + np.arange(40)).ravel()
    triangles = np.concatenate(
        [np.stack([corner, corner + 1, corner + 41], 1), np.stack([corner + 1, corner + 42, corner + 41], 1)]
    )
    build.mesh("quad", points, triangles, uv=None, scale=[scale] * 3)
    build.camera(distance=2.0 * scale, yfov=0.4)
    build.light("lamp", "directional", aimed((2.0, 0.7, 1.0), (0, 0, 0)))
    scene = load_scene(build.text(lamp_toml).write())
    renderer = Renderer(device, scene, RenderParameters((64, 64), 1))
    radiance = renderer.frame(0.0).radiance[..., 0]
    normal = read_texture(renderer.gbuffer.normal_w)[::-1, :, :3].astype(float)
    cosine = normal @ np.array([2.0, 0.7, 1.0]) / np.linalg.norm([2.0, 0.7, 1.0])
    unshadowed = cosine / np.pi * scene.lights[0].irradiance_at_1m[0]
    # The G-buffer's normals are half floats: 2^-11 each, seen at a cosine of 0.1 or more.
    assert cosine.min() > 0.1
    np.testing.assert_allclose(radiance, unshadowed, rtol=3 * 2.0**-11 / 0.1)
