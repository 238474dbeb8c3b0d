"""Scenes with a closed form for what glow lights: a closed box, two disks that face each other, a floor by a wall."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.maps import write_map
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


def let_glow_where(build: Any, name: str, on: NDArray[np.bool_]) -> None:
    """Let a material that was written give off its light where (h, w) `on` is true alone; row 0 is v = 0."""
    path = build.folder / f"{name}.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    write_map(build.folder / f"{name}.exr", np.where(on[..., None, None], content["emission"], 0.0))
    content["maps"] = {"emission": f"{name}.exr"}
    path.write_text(json.dumps(content), encoding="utf-8")


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


STRIPED_TEXELS = 256


def striped_quad(build: Any, period: int) -> Any:
    """A quad that fills the picture: upright stripes of `period` texels, of which half give off (2, 4, 8)."""
    build.mesh("quad").camera()
    toml = write_material(build, "quad", [2.0, 4.0, 8.0], [0.0] * 3).replace("= 64", f"= {STRIPED_TEXELS}")
    column = np.arange(STRIPED_TEXELS) % period < period // 2
    let_glow_where(build, "quad", np.tile(column, (STRIPED_TEXELS, 1)))
    return build.text(toml + SATURATED)


# A floor of two squares before and under a white wall of 1 m that the camera sees: they meet at x = 0.
FLOOR = np.array(
    [(x + side, -0.5, z) for side in (-0.5, 0.0) for x, z in ((0, 1), (0.5, 1), (0.5, 0), (0, 0))]
)
FLOOR_TRIANGLES = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
# Between two islands of an atlas, and around them, as shares of it.
GAP, MARGIN = 0.06, 0.02


def floor_uv(islands: str) -> NDArray[Any]:
    """Return (8, 2) texture coordinates of the floor: as "one" island, or two.

    Two may lie "side by side", "swapped", so that the seam's two sides are farthest from each other, or "turned": the
    second by half a turn.
    """
    left = np.arange(8) < 4
    across, along = 2 * FLOOR[:, 0] + left, FLOOR[:, 2]  # of each half
    if islands == "one":
        return np.column_stack(
            [MARGIN + (1 - 2 * MARGIN) * (FLOOR[:, 0] + 0.5), MARGIN + (1 - 2 * MARGIN) * along]
        )
    if islands == "turned":
        across, along = np.where(left, across, 1 - across), np.where(left, along, 1 - along)
    first = ~left if islands == "swapped" else left
    width = 0.5 - MARGIN - GAP / 2
    u = np.where(first, MARGIN, 0.5 + GAP / 2) + width * across
    return np.column_stack([u, MARGIN + (1 - 2 * MARGIN) * along])


def floor_by_wall(build: Any, islands: str = "one", texels: int = 64, kr: float = 0.5) -> Any:
    """The floor, which is to give off (1, 2, 4) once it is charged, and the wall; the camera sees the wall alone."""
    build.mesh("wall", uv=None).mesh("floor", FLOOR, FLOOR_TRIANGLES, uv=floor_uv(islands)).camera()
    toml = write_material(build, "floor", [1.0, 2.0, 4.0], [0.0] * 3, kr)
    return build.text(toml.replace("= 64", f"= {texels}"))


# Columns of the map of the floor that glow in `partly_lit_wall`: their end is none of a cell.
GLOWING, COLUMNS = 21, 64


def partly_lit_wall(build: Any) -> Any:
    """The wall by the floor, of whose map the first `GLOWING` of `COLUMNS` columns glow alone."""
    floor_by_wall(build)
    let_glow_where(build, "floor", np.tile(np.arange(COLUMNS) < GLOWING, (COLUMNS, 1)))
    return build.text(SATURATED)


def error_on_the_wall(L: NDArray[Any]) -> float:
    """Return how far (n, n, 3) L of `partly_lit_wall` is off from its closed form: root mean square, over the mean."""
    x = ((np.arange(len(L)) + 0.5) / len(L) * 2 - 1) * 2.0 * np.tan(0.25)
    x, y = np.meshgrid(x, -x)
    inner = (np.abs(x) < 0.5) & (np.abs(y) < 0.5)
    end = (GLOWING / COLUMNS - MARGIN) / (1 - 2 * MARGIN) - 0.5
    corners = np.array([[-0.5, -0.5, 1], [end, -0.5, 1], [end, -0.5, 0], [-0.5, -0.5, 0]])
    want = polygon_share(corners, np.stack([x, y, np.zeros_like(x)], axis=-1), np.array([0.0, 0, 1]))[inner]
    return float(np.sqrt(np.mean((L[inner, 0] - want) ** 2)) / want.mean())


def polygon_share(corners: NDArray[Any], p: NDArray[Any], normal: NDArray[Any]) -> NDArray[Any]:
    """Return (...) the share of what points p (..., 3) see, weighted by the cosine, that is a polygon before their
    horizon: Σ angle n . axis / 2π over its edges (Lambert 1760)."""
    to = corners - p[..., None, :]
    to /= np.linalg.norm(to, axis=-1, keepdims=True)
    following = np.roll(to, -1, axis=-2)
    axis = np.cross(to, following)
    sine = np.linalg.norm(axis, axis=-1)
    angle = np.arctan2(sine, np.sum(to * following, axis=-1))
    return np.asarray(np.abs(np.sum(angle * (axis @ normal) / sine, axis=-1)) / (2 * np.pi))
