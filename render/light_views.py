"""Where each light looks from for its shadows, and the lights as the shaders take them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.render.gltf import GltfLight
from phoslab.render.optics import to_layers
from phoslab.render.scene import Light

Array = NDArray[np.float64]

# Kinds as in shaders/include/lights.glsl.
DIRECTIONAL, ONE_VIEW, SIX_VIEWS = 0.0, 1.0, 2.0

# A spot wider than this from its axis is seen in six views: one would waste its texels on the rim.
WIDEST_VIEW_RAD = np.deg2rad(60.0)

# Nearest over farthest depth of a view: what 24 bits of depth resolve to 6e-5 of the farthest.
NEAR_OVER_FAR = 1e-3

_AXES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class LightViews:
    """One light's shadow views.

    Args:
        kind: DIRECTIONAL, ONE_VIEW or SIX_VIEWS.
        world_to_clip: (n_views, 4, 4).
        texel_at_unit_depth_m: the world size of a shadow texel at depth 1 (directional: anywhere).
    """

    kind: float
    world_to_clip: Array
    texel_at_unit_depth_m: float


def views_of(light: GltfLight, box: Array, tile: int, guard: int) -> LightViews:
    """Return the views that a light needs to see everything in `box`.

    Args:
        box: (2, 3) the corners of the scene, in m.
        tile: texels along the side of a view.
        guard: texels at each edge of a view that only the filter may read.
    """
    usable = 1.0 - 2.0 * guard / tile
    corners = np.array([[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    if light.kind == "directional":
        view = look_along(box.mean(axis=0), light.direction_w)
        reach = np.abs(corners @ view[:3, :3].T + view[:3, 3]).max(axis=0) * 1.01 + 1e-9
        half = float(reach[:2].max()) / usable
        clip = _orthographic(half, -float(reach[2]), float(reach[2])) @ view
        return LightViews(DIRECTIONAL, clip[None], 2.0 * half / tile)
    p = light.position_w
    far = float(np.linalg.norm(corners - p, axis=1).max()) * 1.01 + 1e-9
    nearest = float(np.linalg.norm(np.clip(p, box[0], box[1]) - p))
    if light.kind == "spot" and light.outer_cone_rad <= WIDEST_VIEW_RAD:
        # Depth is measured along the axis: the box's nearest point may be nearer along it than in space.
        kind, axes, tangent = ONE_VIEW, light.direction_w[None], np.tan(light.outer_cone_rad)
        near = max(nearest * np.cos(light.outer_cone_rad), far * NEAR_OVER_FAR) * 0.99
    else:
        kind, axes, tangent = SIX_VIEWS, _AXES, 1.0
        near = max(nearest / np.sqrt(3.0), far * NEAR_OVER_FAR) * 0.99
    half = tangent / usable
    projection = perspective(half, half, near, far)
    clips = np.stack([projection @ look_along(p, axis) for axis in axes])
    return LightViews(kind, clips, 2.0 * half / tile)


def pack_lights(
    lights: Sequence[Light], views: Sequence[LightViews], factors: Mapping[str, float]
) -> NDArray[np.float32]:
    """Return (n_lights, 3, 4): the array of `Light` of shaders/include/lights.glsl.

    Args:
        factors: of the lights' irradiance, by name; 0 for those that it leaves out.
    """
    packed = np.zeros((len(lights), 3, 4), dtype=np.float32)
    first = 0
    for row, light, view in zip(packed, lights, views, strict=True):
        place = light.place
        scale, offset = 0.0, 1.0
        if place.kind == "spot":
            # The angular falloff that KHR_lights_punctual recommends.
            inner, outer = np.cos(place.inner_cone_rad), np.cos(place.outer_cone_rad)
            scale = 1.0 / max(1e-3, inner - outer)
            offset = -outer * scale
        row[0] = *place.position_w, view.kind
        row[1] = *place.direction_w, view.texel_at_unit_depth_m
        row[2] = scale, offset, first, factors.get(place.name, 0.0)
        first += len(view.world_to_clip)
    return packed


def pack_spectra(lights: Sequence[Light], n_bands: int) -> NDArray[np.float32]:
    """Return (n_lights, layers, 4) each light's band-mean irradiance at 1 m."""
    values = np.array([light.irradiance_at_1m for light in lights]).reshape(-1, 1, n_bands)
    return to_layers(values)[:, :, 0].transpose(1, 0, 2).astype(np.float32)


def look_along(eye: Array, direction: Array) -> Array:
    """Return (4, 4) world to view: from `eye` along `direction`, which becomes -z; up is any way."""
    up = _AXES[2] if abs(direction[1]) < 0.99 else _AXES[0]
    right = np.cross(direction, up)
    right /= np.linalg.norm(right)
    view = np.eye(4)
    view[:3, :3] = right, np.cross(right, direction), -direction
    view[:3, 3] = -view[:3, :3] @ eye
    return view


def perspective(half_width: float, half_height: float, near: float, far: float) -> Array:
    """Return (4, 4) view to clip; the half sizes are those of the picture at depth 1."""
    return np.array(
        [
            [1 / half_width, 0, 0, 0],
            [0, 1 / half_height, 0, 0],
            [0, 0, (near + far) / (near - far), 2 * near * far / (near - far)],
            [0, 0, -1, 0],
        ]
    )


def _orthographic(half: float, near: float, far: float) -> Array:
    return np.array(
        [
            [1 / half, 0, 0, 0],
            [0, 1 / half, 0, 0],
            [0, 0, 2 / (near - far), (near + far) / (near - far)],
            [0, 0, 0, 1],
        ]
    )
