"""Scenes with a closed form for what glow lights: a closed box, two disks that face each other."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.sample_data.shapes import box

BANDS = [400.0, 500.0, 600.0, 700.0]
SATURATED = '\n[initial]\nstate = "saturated"\n[units]\nradiance_factor = 1.0\n'


def write_material(build: Any, name: str, radiance: list[float], albedo: list[float], kr: float = 0.5) -> str:
    """Write a material of one state that, saturated, gives off `radiance` in three bands; return its TOML."""
    content = {
        "schema": "phoslab-material/1",
        "name": name,
        "band_edges_nm": BANDS,
        "kr_per_s": [kr],
        "ke_m2_per_J": [[1.0, 0.0, 0.0]],
        "emission": [[L / kr for L in radiance]],
        "albedo": albedo,
        "calibration": "relative",
        "reference_irradiance": [1.0, 1.0, 1.0],
    }
    (build.folder / f"{name}.json").write_text(json.dumps(content), encoding="utf-8")
    return f'\n[phosphors.{name}]\nmaterial = "{name}.json"\natlas_texels = 64\n'


def closed_box(build: Any) -> Any:
    """A camera in a closed cube of 2 m whose inside has albedo 0.5 and gives off 0.5: L = 1 - 2^-(n + 1)."""
    shape = box((-1, -1, -1), (1, 1, 1))
    build.mesh("room", shape.positions, shape.triangles[:, ::-1], uv=None)
    build.camera(distance=0.3, yfov=1.4)
    return build.text(write_material(build, "room", [0.5] * 3, [0.5] * 3) + SATURATED)


def disk(radius: float, z: float, facing: float, sides: int = 128) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return positions and triangles of a regular polygon of the disk's area; it faces along z * facing."""
    angle = 2 * np.pi * np.arange(sides) / sides
    # The polygon's area is sides / 2 sin(2π / sides) R².
    R = radius * np.sqrt(2 * np.pi / (sides * np.sin(2 * np.pi / sides)))
    rim = np.column_stack([R * np.cos(angle), R * np.sin(angle), np.full(sides, z)])
    positions = np.concatenate([[[0.0, 0.0, z]], rim])
    k = np.arange(sides)
    triangles = np.column_stack([np.zeros(sides, int), 1 + k, 1 + (k + 1) % sides])
    return positions, triangles if facing > 0 else triangles[:, ::-1]


# Of two coaxial disks: their radii and distance in m.
SENDER, RECEIVER, APART = 0.6, 0.5, 0.8


def facing_disks(build: Any) -> Any:
    """A disk that gives off (1, 2, 4), and a white one that faces it and fills the picture from rim to rim."""
    at, triangles = disk(SENDER, APART, -1.0)
    build.mesh("sender", at, triangles, uv=at[:, :2] / (2.1 * SENDER) + 0.5)
    at, triangles = disk(RECEIVER, 0.0, 1.0)
    build.mesh("receiver", at, triangles, uv=None)
    build.camera(distance=0.5, yfov=2 * np.arctan(RECEIVER / 0.5))
    return build.text(write_material(build, "sender", [1.0, 2.0, 4.0], [0.0] * 3) + SATURATED)


def form_factor() -> float:
    """Return the share of what the receiver's side sees, on its mean, that is the sender (Howell, C-41)."""
    r1, r2 = RECEIVER / APART, SENDER / APART
    x = 1 + (1 + r2**2) / r1**2
    return float((x - np.sqrt(x**2 - 4 * (r2 / r1) ** 2)) / 2)
