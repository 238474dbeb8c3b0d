"""Makes the sample scenes: `python -m phoslab.sample_data.make_scenes`. Seeded, so that it makes the same files again.

fading: a shelf of glow-in-the-dark things in different paints, a lamp that goes off; the situation of
Nalbach 2017, Fig. 8.1.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SCENES = Path(__file__).resolve().parent / "scenes"
TAU = 2 * np.pi


@dataclass(frozen=True, eq=False)
class Shape:
    """A triangle mesh: positions (n, 3), normals (n, 3), triangles (m, 3), and uv (n, 2) where it has any."""

    positions: Array
    normals: Array
    triangles: NDArray[np.uint32]
    uv: Array | None = None


def surface(f: Callable[[Array, Array], Array], n_u: int, n_v: int) -> Shape:
    """Return the surface f(u, v) -> (..., 3) over the unit square; its uv are one-to-one."""
    u, v = np.meshgrid(np.linspace(0, 1, n_u + 1), np.linspace(0, 1, n_v + 1))
    positions = f(u, v)
    h = 1e-4
    du = f(u + h, v) - f(u - h, v)
    dv = f(u, np.clip(v + h, 0, 1)) - f(u, np.clip(v - h, 0, 1))
    normals = np.cross(du, dv)
    # At a pole du vanishes: take the normal from just inside.
    inner = np.clip(v, 2e-3, 1 - 2e-3)
    pole = np.cross(f(u + h, inner) - f(u - h, inner), f(u, inner + h) - f(u, inner - h))
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.where(length < 1e-10, pole, normals)
    corner = (np.arange(n_v)[:, None] * (n_u + 1) + np.arange(n_u)).ravel()
    right, up = corner + 1, corner + n_u + 1
    triangles = np.concatenate([np.stack([corner, right, up], 1), np.stack([right, up + 1, up], 1)])
    return Shape(
        positions.reshape(-1, 3),
        _unit(normals.reshape(-1, 3)),
        triangles.astype(np.uint32),
        np.stack([u, v], axis=-1).reshape(-1, 2),
    )


def lathe(profile: Sequence[tuple[float, float]], *, crisp: bool = False) -> Shape:
    """Turn a curve through the (radius, height) points of `profile`, from the bottom up, around y.

    Args:
        crisp: keep corners (monotone between points) instead of flowing through them.
    """
    from scipy.interpolate import CubicSpline, PchipInterpolator

    points = np.array(profile, dtype=np.float64)
    at = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    curve = (PchipInterpolator if crisp else CubicSpline)(at / at[-1], points)

    def turned(u: Array, v: Array) -> Array:
        radius, height = np.moveaxis(np.maximum(curve(v), 0.0), -1, 0)
        return np.stack([radius * np.cos(TAU * u), height, -radius * np.sin(TAU * u)], axis=-1)

    return surface(turned, 64, 80)


def sphere(radius: float) -> Shape:
    """Return a sphere that stands on y = 0."""

    def ball(u: Array, v: Array) -> Array:
        polar, around = np.pi * (1 - v), TAU * u
        return radius * np.stack(
            [np.sin(polar) * np.cos(around), 1 + np.cos(polar), -np.sin(polar) * np.sin(around)], axis=-1
        )

    return surface(ball, 72, 36)


def tube(centre: Callable[[Array], Array], radius: float, n_u: int, n_v: int = 32) -> Shape:
    """Return a closed tube around the closed curve centre(u) -> (..., 3), u in [0, 1]."""

    def around(u: Array, v: Array) -> Array:
        h = 1e-3
        tangent = _unit(centre(u + h) - centre(u - h))
        bend = centre(u + h) - 2 * centre(u) + centre(u - h)
        inward = _unit(bend - tangent * np.sum(bend * tangent, axis=-1, keepdims=True))
        beside = np.cross(tangent, inward)
        turn = TAU * v[..., None]
        return centre(u) + radius * (np.cos(turn) * inward + np.sin(turn) * beside)

    shape = surface(around, n_u, n_v)
    return outside_out(replace(shape, normals=_normals_of(around, n_u, n_v)))


def _normals_of(f: Callable[[Array, Array], Array], n_u: int, n_v: int) -> Array:
    """Return normals of f, which closes in v: at v = 0 and 1 the clipped difference above would tilt them."""
    u, v = np.meshgrid(np.linspace(0, 1, n_u + 1), np.linspace(0, 1, n_v + 1))
    h = 1e-4
    return _unit(np.cross(f(u + h, v) - f(u - h, v), f(u, v + h) - f(u, v - h))).reshape(-1, 3)


def torus(ring: float, radius: float) -> Shape:
    """Return a torus around y that lies on y = 0."""

    def circle(u: Array) -> Array:
        return np.stack([ring * np.cos(TAU * u), np.full_like(u, radius), -ring * np.sin(TAU * u)], axis=-1)

    return tube(circle, radius, 80, 28)


def knot(size: float, radius: float) -> Shape:
    """Return a trefoil knot that stands on y = 0."""

    def trefoil(u: Array) -> Array:
        t = TAU * u
        x, y = np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t)
        return size / 3 * np.stack([x, y + 3.0 + 0.0 * t, -np.sin(3 * t)], axis=-1)

    shape = tube(trefoil, radius, 200, 20)
    return _moved(shape, (0, -float(shape.positions[:, 1].min()), 0))


def bevelled_cube(size: float, bevel: float) -> Shape:
    """Return a cube with rounded edges that stands on y = 0: a sphere's points pushed out along a box. No uv."""
    n = 10
    flat = np.linspace(-1, 1, 2)
    half = size / 2 - bevel
    turn = np.tan(np.linspace(-np.pi / 4, np.pi / 4, n + 1))
    # Each face: rounded rim, flat middle, rounded rim.
    grid = np.concatenate([turn[: n // 2 + 1], turn[n // 2 :]])
    push = np.concatenate([np.full(n // 2 + 1, flat[0]), np.full(n // 2 + 1, flat[1])])
    a, b = np.meshgrid(grid, grid)
    pa, pb = np.meshgrid(push, push)
    positions: list[Array] = []
    normals: list[Array] = []
    triangles: list[NDArray[Any]] = []
    base = 0
    for axis in range(3):
        for sign in (1.0, -1.0):
            direction = np.zeros((*a.shape, 3))
            core = np.zeros((*a.shape, 3))
            i, j = (axis + 1) % 3, (axis + 2) % 3
            direction[..., axis], direction[..., i], direction[..., j] = sign, sign * a, b
            core[..., axis], core[..., i], core[..., j] = sign, sign * pa, pb
            normal = _unit(direction)
            positions.append((half * core + bevel * normal).reshape(-1, 3))
            normals.append(normal.reshape(-1, 3))
            k = len(grid)
            corner = (np.arange(k - 1)[:, None] * k + np.arange(k - 1)).ravel() + base
            triangles += [
                np.stack([corner, corner + 1, corner + k], 1),
                np.stack([corner + 1, corner + k + 1, corner + k], 1),
            ]
            base += k * k
    shape = Shape(np.concatenate(positions), np.concatenate(normals), np.concatenate(triangles).astype("u4"))
    return _moved(shape, (0, size / 2, 0))


def pillow(rim: Array, spine: Array, thickness: float, rings: int = 10) -> Shape:
    """Return a cushion-like solid around the z = 0 plane; both sides meet in a sharp rim. No uv.

    Args:
        rim: (n, 2) a closed outline, counter-clockwise.
        spine: (n, 2) the point of the middle line towards which each point of the rim runs.
    """
    n = len(rim)
    t = np.linspace(0, 1, rings + 1)
    positions: list[Array] = []
    triangles: list[NDArray[Any]] = []
    for side in (1.0, -1.0):
        base = len(positions) * n
        for s in t:
            xy = rim + (spine - rim) * s
            z = side * thickness * np.sqrt(1 - (1 - s) ** 2)
            positions.append(np.column_stack([xy, np.full(n, z)]))
        for ring in range(rings):
            here = base + ring * n + np.arange(n)
            there = base + ring * n + (np.arange(n) + 1) % n
            quad = [np.stack([here, there, here + n], 1), np.stack([there, there + n, here + n], 1)]
            triangles += [q if side > 0 else q[:, ::-1] for q in quad]
    points = np.concatenate(positions)
    faces = np.concatenate(triangles)
    return outside_out(Shape(points, _smooth(points, faces), faces.astype(np.uint32)))


def star(points: int, outer: float, inner: float, thickness: float) -> Shape:
    """Return a star with folded arms, centred at the origin, facing z. No uv, flat faces."""
    angle = np.pi / 2 + TAU * np.arange(2 * points) / (2 * points)
    radius = np.where(np.arange(2 * points) % 2 == 0, outer, inner)
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros_like(angle)], axis=1)
    soup = []
    for k in range(2 * points):
        a, b = rim[k], rim[(k + 1) % (2 * points)]
        soup += [[a, b, [0, 0, thickness]], [b, a, [0, 0, -thickness]]]
    positions = np.array(soup).reshape(-1, 3)
    a, b, c = np.array(soup).transpose(1, 0, 2)
    normals = np.repeat(_unit(np.cross(b - a, c - a)), 3, axis=0)
    return Shape(positions, normals, np.arange(len(positions), dtype=np.uint32).reshape(-1, 3))


def moon(radius: float, thickness: float) -> Shape:
    """Return a crescent, centred at the origin, facing z. No uv."""
    n = 96
    half = np.deg2rad(128)
    outer_angle = np.linspace(-half, half, n)
    tip = radius * np.array([np.cos(half), np.sin(half)])
    centre, inner_radius = 0.5 * radius, np.hypot(tip[0] - 0.5 * radius, tip[1])
    inner_half = np.arctan2(tip[1], tip[0] - centre)
    inner_angle = np.linspace(inner_half, -inner_half, n)
    outer = radius * np.column_stack([np.cos(outer_angle), np.sin(outer_angle)])
    inner = np.column_stack([centre + inner_radius * np.cos(inner_angle), inner_radius * np.sin(inner_angle)])
    # Both arcs run through x > 0; the crescent lies to the left once mirrored.
    rim = np.concatenate([outer, inner[1:-1]])
    middle = (outer + inner[::-1]) / 2
    spine = np.concatenate([middle, middle[::-1][1:-1]])
    return pillow(rim, spine, thickness)


def box(low: Sequence[float], high: Sequence[float]) -> Shape:
    """Return an axis-aligned box with flat faces. No uv."""
    soup = []
    for axis in range(3):
        for sign, level in ((1, high[axis]), (-1, low[axis])):
            i, j = (axis + 1) % 3, (axis + 2) % 3
            corners = np.zeros((4, 3))
            corners[:, axis] = level
            corners[:, i] = [low[i], high[i], high[i], low[i]]
            corners[:, j] = [low[j], low[j], high[j], high[j]]
            soup.append((corners if sign > 0 else corners[::-1], np.eye(3)[axis] * sign))
    positions = np.concatenate([c for c, _ in soup])
    normals = np.concatenate([np.repeat(n[None], 4, axis=0) for _, n in soup])
    quad = np.array([[0, 1, 2], [0, 2, 3]])
    triangles = np.concatenate([quad + 4 * k for k in range(6)])
    return Shape(positions, normals, triangles.astype(np.uint32))


def sweep(width: float, depth: float, height: float, bend: float) -> Shape:
    """Return a studio sweep: a floor that bends up into a wall; u across, v in metres along."""
    straight = depth - bend
    arc = bend * np.pi / 2
    total = straight + arc + height - bend

    def bent(u: Array, v: Array) -> Array:
        s = v * total
        angle = np.clip((s - straight) / bend, 0, np.pi / 2)
        z = -np.minimum(s, straight) - bend * np.sin(angle)
        y = bend * (1 - np.cos(angle)) + np.clip(s - straight - arc, 0, None)
        return np.stack([(u - 0.5) * width, y, z], axis=-1)

    shape = surface(bent, 2, 96)
    assert shape.uv is not None
    return replace(shape, uv=shape.uv * [width / 1.6, total / 1.6])


def planks(texels: int, seed: int) -> NDArray[np.uint8]:
    """Return (texels, texels, 3) sRGB of pale floor boards that tile without a seam."""
    rng = np.random.default_rng(seed)
    boards, y = 4, np.arange(texels)
    image = np.empty((texels, texels, 3))
    for k in range(boards):
        columns = slice(k * texels // boards, (k + 1) * texels // boards)
        width = columns.stop - columns.start
        tone = np.array([0.80, 0.74, 0.67]) * (1 + 0.07 * rng.standard_normal())
        x = np.arange(width)
        grain = np.zeros((texels, width))
        for _ in range(14):
            fx, fy, phase = rng.integers(3, 40), rng.integers(0, 3), rng.uniform(0, TAU)
            warp = 0.8 * np.sin(TAU * y / texels * rng.integers(1, 3) + rng.uniform(0, TAU))[:, None]
            grain += np.sin(TAU * (fx * x / width + fy * y[:, None] / texels) + phase + warp) / 14
        gap = np.minimum(x, width - 1 - x)[None, :] < 1.5
        image[:, columns] = tone * (1 + 0.09 * grain[..., None]) * np.where(gap, 0.62, 1.0)[..., None]
    return np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)


def _unit(v: Array) -> Array:
    unit: Array = v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-30)
    return unit


def outside_out(shape: Shape) -> Shape:
    """Return the closed shape with its faces and normals outwards, whichever way it was made."""
    a, b, c = shape.positions[shape.triangles].transpose(1, 0, 2)
    if np.sum(a * np.cross(b, c)) < 0:
        shape = replace(shape, triangles=shape.triangles[:, ::-1])
    a, b, c = shape.positions[shape.triangles].transpose(1, 0, 2)
    agree = np.sum(np.cross(b - a, c - a) * shape.normals[shape.triangles[:, 0]])
    return replace(shape, normals=shape.normals * np.sign(agree))


def _moved(shape: Shape, by: Sequence[float]) -> Shape:
    return replace(shape, positions=shape.positions + np.array(by))


def _smooth(points: Array, faces: NDArray[Any]) -> Array:
    """Return (n, 3) normals, averaged over the faces at a point."""
    a, b, c = points[faces].transpose(1, 0, 2)
    weighted = np.cross(b - a, c - a)
    normals = np.zeros_like(points)
    for k in range(3):
        np.add.at(normals, faces[:, k], weighted)
    return _unit(normals)


class GlbWriter:
    """Collects nodes and writes them as one .glb."""

    def __init__(self) -> None:
        import pygltflib as gl

        self.gl = gl
        self.document = gl.GLTF2(asset=gl.Asset(version="2.0", generator="phoslab make_scenes"))
        self.document.scenes = [gl.Scene(nodes=[])]
        self.document.scene = 0
        self.blob = bytearray()
        self.lights: list[dict[str, Any]] = []

    def _view(self, data: bytes) -> int:
        self.blob += bytes(-len(self.blob) % 4)
        self.document.bufferViews.append(
            self.gl.BufferView(buffer=0, byteOffset=len(self.blob), byteLength=len(data))
        )
        self.blob += data
        return len(self.document.bufferViews) - 1

    def _accessor(self, values: NDArray[Any], component: int, kind: str) -> int:
        bounds = {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        self.document.accessors.append(
            self.gl.Accessor(
                bufferView=self._view(np.ascontiguousarray(values).tobytes()),
                componentType=component,
                count=len(values),
                type=kind,
                **(bounds if kind == "VEC3" else {}),
            )
        )
        return len(self.document.accessors) - 1

    def _node(self, name: str, matrix: Array, **what: Any) -> None:
        self.document.nodes.append(self.gl.Node(name=name, matrix=matrix.T.ravel().tolist(), **what))
        self.document.scenes[0].nodes.append(len(self.document.nodes) - 1)

    def material(self, colour: Sequence[float], texture: NDArray[np.uint8] | None = None) -> int:
        """Add a diffuse material; return its number."""
        from PIL import Image

        pbr = self.gl.PbrMetallicRoughness(
            baseColorFactor=[*colour, 1.0], metallicFactor=0.0, roughnessFactor=1.0
        )
        if texture is not None:
            png = io.BytesIO()
            Image.fromarray(texture).save(png, format="PNG", optimize=True)
            self.document.images.append(
                self.gl.Image(bufferView=self._view(png.getvalue()), mimeType="image/png")
            )
            self.document.textures.append(self.gl.Texture(source=len(self.document.images) - 1))
            pbr.baseColorTexture = self.gl.TextureInfo(index=len(self.document.textures) - 1)
        self.document.materials.append(self.gl.Material(pbrMetallicRoughness=pbr))
        return len(self.document.materials) - 1

    def mesh(self, name: str, shape: Shape, material: int, matrix: Array | None = None) -> None:
        """Add a mesh and a node of the same name that places it."""
        attributes = self.gl.Attributes(
            POSITION=self._accessor(shape.positions.astype("<f4"), 5126, "VEC3"),
            NORMAL=self._accessor(shape.normals.astype("<f4"), 5126, "VEC3"),
        )
        if shape.uv is not None:
            attributes.TEXCOORD_0 = self._accessor(shape.uv.astype("<f4"), 5126, "VEC2")
        small = len(shape.positions) < 1 << 16
        indices = shape.triangles.reshape(-1, 1).astype("<u2" if small else "<u4")
        primitive = self.gl.Primitive(
            attributes=attributes,
            indices=self._accessor(indices, 5123 if small else 5125, "SCALAR"),
            material=material,
        )
        self.document.meshes.append(self.gl.Mesh(name=name, primitives=[primitive]))
        self._node(name, np.eye(4) if matrix is None else matrix, mesh=len(self.document.meshes) - 1)

    def light(
        self, name: str, kind: str, eye: Sequence[float], target: Sequence[float], **spot: float
    ) -> None:
        """Add a punctual light that shines from `eye` towards `target`."""
        self.lights.append({"name": name, "type": kind, **({"spot": spot} if spot else {})})
        self._node(
            name, aim(eye, target), extensions={"KHR_lights_punctual": {"light": len(self.lights) - 1}}
        )

    def camera(self, name: str, eye: Sequence[float], target: Sequence[float], yfov_deg: float) -> None:
        """Add a perspective camera."""
        lens = self.gl.Perspective(yfov=np.deg2rad(yfov_deg), znear=0.1, zfar=100.0, aspectRatio=4 / 3)
        self.document.cameras.append(self.gl.Camera(type="perspective", perspective=lens))
        self._node(name, aim(eye, target), camera=len(self.document.cameras) - 1)

    def save(self, path: Path) -> None:
        """Write the .glb."""
        self.document.extensionsUsed = ["KHR_lights_punctual"]
        self.document.extensions = {"KHR_lights_punctual": {"lights": self.lights}}
        self.document.buffers = [self.gl.Buffer(byteLength=len(self.blob))]
        self.document.set_binary_blob(bytes(self.blob))
        path.parent.mkdir(parents=True, exist_ok=True)
        self.document.save_binary(str(path))


def aim(eye: Sequence[float], target: Sequence[float]) -> Array:
    """Return (4, 4) of a node at `eye` whose -z points to `target`, y up."""
    p, z = np.array(eye, dtype=np.float64), _unit(np.array(eye, dtype=np.float64) - np.array(target))
    x = _unit(np.cross([0.0, 1.0, 0.0], z))
    matrix = np.eye(4)
    matrix[:3, :4] = np.column_stack([x, np.cross(z, x), z, p])
    return matrix


def place(at: Sequence[float], turn_deg: Sequence[float] = (0, 0, 0)) -> Array:
    """Return (4, 4): turned about x, then y, then z, then moved."""
    from scipy.spatial.transform import Rotation

    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    matrix[:3, 3] = at
    return matrix


def write_fading(folder: Path) -> None:
    """Write the scene `fading`: nine things in nine materials."""
    glb = GlbWriter()
    glb.camera("camera", eye=(0.10, 1.02, 3.05), target=(0.02, 0.43, -0.35), yfov_deg=30)
    glb.light(
        "lamp", "spot", (-1.55, 2.35, 1.75), (0.05, 0.25, -0.15), innerConeAngle=0.32, outerConeAngle=0.75
    )
    glb.light("sky", "directional", (1.6, 2.2, 2.2), (0.0, 0.2, 0.0))

    floor = glb.material((1.0, 1.0, 1.0), planks(512, seed=7))
    stand = glb.material((0.42, 0.36, 0.33))
    glb.mesh("floor", sweep(width=9.0, depth=4.2, height=4.0, bend=0.5), floor, place((0, 0, 3.0)))
    glb.mesh("plinth", box((-0.34, 0.0, -0.86), (0.44, 0.24, -0.34)), stand)
    glb.mesh("step", box((0.58, 0.0, -0.62), (1.06, 0.12, -0.14)), stand)

    paint = {
        "blue": (0.72, 0.80, 0.86),
        "green": (0.84, 0.88, 0.74),
        "orange": (0.90, 0.66, 0.46),
        "pink": (0.90, 0.68, 0.74),
        "purple": (0.76, 0.68, 0.86),
        "red": (0.88, 0.56, 0.50),
        "white": (0.88, 0.87, 0.84),
        "yellow": (0.90, 0.88, 0.66),
        "fitted": (0.82, 0.86, 0.78),
    }
    number = {name: glb.material(colour) for name, colour in paint.items()}
    vase = [
        (0.0, 0.0), (0.085, 0.0), (0.105, 0.015), (0.150, 0.10), (0.155, 0.16), (0.115, 0.26),
        (0.060, 0.34), (0.052, 0.40), (0.075, 0.45), (0.082, 0.455), (0.070, 0.448), (0.040, 0.40), (0.0, 0.36),
    ]  # fmt: skip
    pawn = [
        (0.0, 0.0), (0.125, 0.0), (0.132, 0.02), (0.125, 0.045), (0.095, 0.06), (0.058, 0.11), (0.045, 0.20),
        (0.055, 0.235), (0.085, 0.245), (0.085, 0.255), (0.050, 0.268), (0.072, 0.305), (0.082, 0.345),
        (0.072, 0.385), (0.040, 0.415), (0.0, 0.423),
    ]  # fmt: skip
    cone = [
        (0.0, 0.0),
        (0.150, 0.0),
        (0.158, 0.008),
        (0.150, 0.030),
        (0.012, 0.400),
        (0.006, 0.408),
        (0.0, 0.410),
    ]
    glb.mesh("blue-ball", sphere(0.17), number["blue"], place((-0.72, 0.0, -0.30)))
    glb.mesh("green-ring", torus(0.165, 0.060), number["green"], place((-0.30, 0.0, 0.20)))
    glb.mesh("orange-cone", lathe(cone, crisp=True), number["orange"], place((0.50, 0.0, 0.10)))
    glb.mesh(
        "purple-cube", bevelled_cube(0.26, 0.035), number["purple"], place((0.14, 0.0, 0.12), (0, 32, 0))
    )
    glb.mesh("pink-vase", lathe(vase), number["pink"], place((-0.13, 0.24, -0.58)))
    glb.mesh("red-knot", knot(0.21, 0.046), number["red"], place((0.82, 0.12, -0.38), (0, -18, 0)))
    glb.mesh("white-moon", moon(0.20, 0.05), number["white"], place((-0.62, 0.87, -1.06), (0, 0, 205)))
    glb.mesh(
        "yellow-star", star(5, 0.20, 0.085, 0.05), number["yellow"], place((0.62, 0.84, -1.06), (0, 0, 12))
    )
    glb.mesh("fitted-pawn", lathe(pawn, crisp=True), number["fitted"], place((0.22, 0.24, -0.56)))
    glb.save(folder / "scene.glb")

    (folder / "scene.toml").write_text(FADING_TOML, encoding="utf-8")


FADING_TOML = """\
# Nine things in nine glow-in-the-dark materials, lit for twenty seconds, then left in the dark.
# Made by phoslab.sample_data.make_scenes.
schema = "phoslab-scene/1"
gltf = "scene.glb"

[units]
system = "relative"
# The presets' emission is relative: this much of the scene's radiance is one unit of theirs.
radiance_factor = 0.001

[lights.lamp]
spectrum = "blackbody:4500"
irradiance_at_1m = 0.8
schedule = [[0, 20]]

[lights.sky]
spectrum = "illuminant:D65"
irradiance_at_1m = 0.02
schedule = [[0, 20]]

[phosphors]
blue-ball.material = "preset:blue"
green-ring.material = "preset:green"
orange-cone.material = "preset:orange"
pink-vase.material = "preset:pink"
purple-cube.material = "preset:purple"
red-knot.material = "preset:red"
white-moon.material = "preset:white"
yellow-star.material = "preset:yellow"
# What `phoslab fit` made of the sample session. Its radiance is in the camera's units, so it states a factor of its
# own: one that lets it start about as bright as the preset green.
fitted-pawn.material = "material.json"
fitted-pawn.radiance_factor = 1.3e-8

[initial]
state = "empty"

[render]
size = [640, 480]
supersampling = 3
times = ["off-1s", "off+1s", "off+80s"]

[display]
# Lamp light and glow differ by orders of magnitude; the glow's exposure is kept, so that fading is seen.
exposures = [{ from = "0", exposure = "auto" }, { from = "off", exposure = "auto" }]
"""


def main() -> None:
    """Write every sample scene."""
    write_fading(SCENES / "fading")


if __name__ == "__main__":
    main()
