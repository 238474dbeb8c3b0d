"""Geometry, base colours, cameras and punctual lights out of a glTF 2.0 file.

What is read: node hierarchy and its animation, triangle primitives (lists, strips, fans) with POSITION, NORMAL and
TEXCOORD_0, base colour factor and texture, perspective cameras, KHR_lights_punctual. Distances are metres. A light's
colour, intensity and range are left aside: `scene.toml` gives lights a spectrum and an irradiance.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.files import read_regular
from phoslab.render.geometry import Geometry, bounds, build
from phoslab.render.gltf_accessors import LARGEST_BYTES, REMEDY, Buffers
from phoslab.render.gltf_animations import node_matrix, read_motion
from phoslab.render.motion import Motion

Matrix = NDArray[np.float64]

SUPPORTED_EXTENSIONS = {"KHR_lights_punctual", "KHR_materials_unlit", "KHR_mesh_quantization"}
MAX_DEPTH = 256  # of the node hierarchy; a deeper one is a cycle or an attack
MAX_IMAGE_PIXELS = 1 << 26

# Linear from encoded 8-bit sRGB (IEC 61966-2-1).
_CODES = np.arange(256) / 255.0
LINEAR = np.where(_CODES <= 0.04045, _CODES / 12.92, ((_CODES + 0.055) / 1.055) ** 2.4).astype(np.float32)

# In m: farther from the origin, float32 loses the squares of distances; smaller, their inverses.
FARTHEST_M, SMALLEST_SCALE = 1e9, 1e-9
# The volume of a node's axes, each brought to length 1: below this they lie in a plane.
FLATTEST = 1e-9
NARROWEST_RAD = 1e-4


@dataclass(frozen=True, eq=False)
class GltfInstance:
    """One primitive of a mesh, placed by a node.

    Args:
        node, mesh: names; "" where the file gives none.
        geometry: in the mesh's own space; the same object for every instance of the mesh.
        model_to_world: (4, 4).
        base_colour: (h, w, 3) linear sRGB in [0, 1]; 1 x 1 where there is no texture.
        index: of the node in the file.
    """

    node: str
    mesh: str
    geometry: Geometry
    model_to_world: Matrix
    base_colour: NDArray[np.float32]
    index: int = -1


@dataclass(frozen=True, eq=False)
class GltfLight:
    """A punctual light: `kind` is "directional", "point" or "spot"; cone angles in rad from its axis."""

    name: str
    kind: str
    position_w: Matrix
    direction_w: Matrix
    inner_cone_rad: float
    outer_cone_rad: float
    index: int = -1

    def placed(self, to_world: Matrix) -> GltfLight:
        """Return the light where its node is now: it shines along the node's -z."""
        direction = to_world[:3, :3] @ np.array([0.0, 0.0, -1.0])
        return replace(self, position_w=to_world[:3, 3], direction_w=direction / np.linalg.norm(direction))


@dataclass(frozen=True, eq=False)
class GltfCamera:
    """A perspective camera: vertical field of view in rad, near plane in m, (4, 4) world to view."""

    name: str
    world_to_view: Matrix
    yfov_rad: float
    near_m: float
    index: int = -1

    def placed(self, to_world: Matrix) -> GltfCamera:
        """Return the camera where its node is now; a node's scale does not change what it sees."""
        rigid = np.eye(4)
        rigid[:3, :3] = to_world[:3, :3] / np.linalg.norm(to_world[:3, :3], axis=0)
        rigid[:3, 3] = to_world[:3, 3]
        return replace(self, world_to_view=np.asarray(np.linalg.inv(rigid), dtype=np.float64))


@dataclass(frozen=True, eq=False)
class GltfModel:
    """What one file holds, its hierarchy flattened, at rest; `warnings` say what was left aside."""

    instances: tuple[GltfInstance, ...]
    lights: tuple[GltfLight, ...]
    cameras: tuple[GltfCamera, ...]
    warnings: tuple[str, ...]
    motion: Motion | None = None


def load_gltf(file: Path) -> GltfModel:
    """Read a .glb or .gltf file.

    Raises:
        PhoslabError: the file is missing, malformed or asks for an extension that is not supported.
    """
    try:
        with np.errstate(all="ignore"):  # what overflows is found by the checks that everything passes
            return _Reader(file).read()
    except PhoslabError:
        raise
    except Exception as error:  # a malformed file can break the parser, or us, in any way
        raise PhoslabError(
            f"cannot be read as glTF 2.0 ({type(error).__name__}: {error})", file=file, remedy=REMEDY
        ) from error


class _Reader:
    def __init__(self, file: Path) -> None:
        import pygltflib

        content = read_regular(file, LARGEST_BYTES, remedy="Put the glTF file there, or name another.")
        with warnings.catch_warnings(action="ignore"):  # what is wrong with a file is ours to say
            if file.suffix == ".glb":
                self.document = pygltflib.GLTF2.load_from_bytes(content)
            else:
                self.document = pygltflib.GLTF2.gltf_from_json(content.decode("utf-8"))
        self.file = file
        if self.document is None:
            raise PhoslabError("is not a glTF 2.0 file", file=file, remedy=REMEDY)
        if not str(self.document.asset.version).startswith("2."):
            raise PhoslabError(
                f"is glTF {self.document.asset.version}, which is not 2.x",
                file=file,
                field="asset.version",
                remedy=REMEDY,
            )
        self.buffers = Buffers(self.document, file)
        unknown = sorted(set(self.document.extensionsRequired or []) - SUPPORTED_EXTENSIONS)
        if unknown:
            raise self.buffers.error(
                "extensionsRequired",
                f"holds {unknown[0]!r}, which phoslab does not know",
                "Export without it.",
            )
        self._primitives: dict[tuple[int, int], Geometry] = {}
        self._colours: dict[int | None, NDArray[np.float32]] = {}
        self._parents: dict[int, int | None] = {}

    def read(self) -> GltfModel:
        instances: list[GltfInstance] = []
        lights: list[GltfLight] = []
        cameras: list[GltfCamera] = []
        for index, node, to_world in self._walk():
            name = str(node.name or "")
            if node.mesh is not None or node.camera is not None or node.extensions:
                check_placed(self.file, name, to_world)
            if node.mesh is not None:
                instances += self._instances(index, node, name, to_world)
            if node.camera is not None:
                cameras += self._camera(node.camera, index, name, to_world)
            if "KHR_lights_punctual" in (node.extensions or {}):
                light = node.extensions["KHR_lights_punctual"]["light"]
                lights.append(self._light(light, index, name, to_world))
        ignored = [
            what
            for what, there in (
                ("skins", self.document.skins),
                ("morph targets", any(p.targets for m in self.document.meshes for p in m.primitives)),
            )
            if there
        ]
        left = (f"{self.file.name}: {' and '.join(ignored)} are left aside",) if ignored else ()
        motion = read_motion(self.buffers, self._parents)
        return GltfModel(tuple(instances), tuple(lights), tuple(cameras), left, motion)

    def _walk(self) -> Iterator[tuple[int, Any, Matrix]]:
        """Yield the index of every node of the scene, it, and its transformation to world space."""
        nodes = self.document.nodes
        if self.document.scenes:
            chosen = self.document.scene
            roots = self.buffers.pick("scenes", 0 if chosen is None else chosen).nodes or []
        else:
            children = {c for n in nodes for c in n.children or []}
            roots = [i for i in range(len(nodes)) if i not in children]
        stack: list[tuple[int, int | None, Matrix, int]] = [(i, None, np.eye(4), 0) for i in reversed(roots)]
        while stack:
            index, parent, above, depth = stack.pop()
            node = self.buffers.pick("nodes", index)
            if depth > MAX_DEPTH or index in self._parents:
                raise self.buffers.error(f"nodes[{index}]", "is part of a hierarchy that is not a tree")
            self._parents[index] = parent
            to_world = above @ node_matrix(node)
            if not np.isfinite(to_world).all():
                raise self.buffers.error(f"nodes[{index}]", "has a transformation that is not finite")
            yield index, node, to_world
            stack += [(c, index, to_world, depth + 1) for c in reversed(node.children or [])]

    def _instances(self, index: int, node: Any, name: str, to_world: Matrix) -> list[GltfInstance]:
        mesh = self.buffers.pick("meshes", node.mesh)
        for p in range(len(mesh.primitives)):
            if (np.abs(bounds(self._geometry(node.mesh, p), to_world)) > FARTHEST_M).any():
                raise self.buffers.error(
                    f"node {name!r}",
                    f"reaches farther than {FARTHEST_M:g} m",
                    "Move it nearer, or scale it down.",
                )
        return [
            GltfInstance(
                node=name,
                mesh=str(mesh.name or ""),
                geometry=self._geometry(node.mesh, p),
                model_to_world=to_world,
                base_colour=self._base_colour(primitive.material),
                index=index,
            )
            for p, primitive in enumerate(mesh.primitives)
        ]

    def _geometry(self, mesh_index: int, primitive_index: int) -> Geometry:
        key = (mesh_index, primitive_index)
        if key not in self._primitives:
            mesh = self.document.meshes[mesh_index]
            where = f"mesh {mesh.name or mesh_index!r}"
            self._primitives[key] = self._read_primitive(mesh.primitives[primitive_index], where)
        return self._primitives[key]

    def _read_primitive(self, primitive: Any, where: str) -> Geometry:
        attributes = primitive.attributes
        if attributes.POSITION is None:
            raise self.buffers.error(where, "has no positions")
        positions = self._vectors(attributes.POSITION, 3, where, "position")
        n = len(positions)
        order = np.arange(n, dtype=np.uint32)
        if primitive.indices is not None:
            order = self.buffers.read_accessor(primitive.indices)[:, 0].astype(np.uint32)
        if order.size and int(order.max()) >= n:
            raise self.buffers.error(where, f"has a vertex index beyond its {n} vertices")
        triangles = self._triangles(order, primitive.mode, where)
        uv = None
        if attributes.TEXCOORD_0 is not None:
            uv = self._vectors(attributes.TEXCOORD_0, 2, where, "texture coordinate")
        normals = None
        if attributes.NORMAL is not None:
            normals = self.buffers.read_accessor(attributes.NORMAL).astype(np.float32)
        for other in (uv, normals):
            if other is not None and len(other) != n:
                raise self.buffers.error(where, "has attributes of unlike length")
        geometry = build(positions, normals, triangles, uv)
        if not len(geometry.triangles):
            raise self.buffers.error(where, "has no triangle with an area", "Remove it, or mend it.")
        return geometry

    def _vectors(self, accessor: int, width: int, where: str, what: str) -> NDArray[np.float32]:
        values = self.buffers.read_accessor(accessor).astype(np.float32)
        if values.shape[1] != width:
            raise self.buffers.error(where, f"has a {what} that is not of {width} numbers")
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if bad.size:
            raise self.buffers.error(
                where, f"has a {what} that is not finite, at vertex {bad[0]}", "Mend or remove that vertex."
            )
        return values

    def _triangles(self, order: NDArray[np.uint32], mode: int | None, where: str) -> NDArray[np.uint32]:
        mode = 4 if mode is None else mode
        if mode == 4:
            return order[: order.size // 3 * 3].reshape(-1, 3)
        if mode == 5:  # strip: every second triangle turns the other way
            strip = np.stack([order[:-2], order[1:-1], order[2:]], axis=1)
            strip[1::2] = strip[1::2, [1, 0, 2]]
            return strip
        if mode == 6:  # fan
            return np.stack([np.full(max(order.size - 2, 0), order[0]), order[1:-1], order[2:]], axis=1)
        raise self.buffers.error(where, "is made of points or lines", "Only triangles can be rendered.")

    def _base_colour(self, index: int | None) -> NDArray[np.float32]:
        if index not in self._colours:
            factor, texture = np.ones(3), None
            if index is not None:
                pbr = self.buffers.pick("materials", index).pbrMetallicRoughness
                if pbr is not None:
                    factor = np.array(pbr.baseColorFactor or [1.0] * 4, dtype=np.float64)[:3]
                    texture = pbr.baseColorTexture
            if factor.shape != (3,) or not ((factor >= 0) & (factor <= 1)).all():
                raise self.buffers.error(f"materials[{index}]", "has a base colour outside 0..1")
            colour = factor[None, None, :]
            if texture is not None:
                image = self._image(self.buffers.pick("textures", texture.index).source)
                colour = np.multiply(image, colour, out=image)
            self._colours[index] = colour.astype(np.float32, copy=False)
        return self._colours[index]

    def _image(self, index: int) -> NDArray[np.float32]:
        """Return (h, w, 3) linear sRGB of an image; its first row is v = 0, as glTF counts."""
        from PIL import Image, UnidentifiedImageError

        encoded = self.buffers.read_image(index)
        try:
            with Image.open(io.BytesIO(encoded)) as image:
                if image.width * image.height > MAX_IMAGE_PIXELS:
                    raise self.buffers.error(f"images[{index}]", "is too large", "Use at most 64 megapixels.")
                rgb: NDArray[np.float32] = LINEAR[np.asarray(image.convert("RGB"))]
                return rgb
        except (OSError, UnidentifiedImageError, Image.DecompressionBombError) as error:
            raise self.buffers.error(
                f"images[{index}]", f"cannot be read ({error})", "Save it again as PNG or JPEG."
            ) from error

    def _camera(self, index: int, node: int, name: str, to_world: Matrix) -> list[GltfCamera]:
        camera = self.buffers.pick("cameras", index)
        if camera.perspective is None:
            return []
        yfov, near = float(camera.perspective.yfov), float(camera.perspective.znear)
        if not (NARROWEST_RAD <= yfov < np.pi and SMALLEST_SCALE <= near <= FARTHEST_M):
            raise self.buffers.error(
                f"cameras[{index}]",
                "has no valid field of view or near plane",
                f"Give a yfov from {NARROWEST_RAD:g} to below pi, and a znear from {SMALLEST_SCALE:g} "
                f"to {FARTHEST_M:g} m.",
            )
        at_rest = GltfCamera(name or str(camera.name or ""), np.eye(4), yfov, near, node)
        return [at_rest.placed(to_world)]

    def _light(self, index: int, node: int, name: str, to_world: Matrix) -> GltfLight:
        lights = self.document.extensions["KHR_lights_punctual"]["lights"]
        light = self.buffers.pick("KHR_lights_punctual.lights", index, lights)
        kind, spot = light["type"], light.get("spot", {})
        inner, outer = float(spot.get("innerConeAngle", 0.0)), float(spot.get("outerConeAngle", np.pi / 4))
        if kind not in ("directional", "point", "spot") or not 0 <= inner < outer <= np.pi / 2:
            raise self.buffers.error(
                f"light {name!r}",
                "has an unknown type, or cone angles that are not 0 <= inner < outer <= pi/2",
            )
        axis = np.array([0.0, 0.0, -1.0])
        shape = GltfLight(name or str(light.get("name", "")), kind, np.zeros(3), axis, inner, outer, node)
        return shape.placed(to_world)


def check_placed(file: Path, name: str, to_world: Matrix, when: str = "") -> None:
    """Refuse a node's place that is too far away, too small, too large or flat for float32.

    Args:
        when: appended to what is wrong, where the node moves.

    Raises:
        PhoslabError: it is.
    """

    def error(problem: str, remedy: str) -> PhoslabError:
        return PhoslabError(problem + when, file=file, field=f"node {name!r}", remedy=remedy)

    axes = to_world[:3, :3]
    scale = np.linalg.norm(axes, axis=0)
    if (np.abs(to_world[:3, 3]) > FARTHEST_M).any() or scale.max() > FARTHEST_M:
        raise error(f"lies or reaches farther than {FARTHEST_M:g} m", "Move it nearer, or scale it down.")
    if scale.min() < SMALLEST_SCALE or abs(np.linalg.det(axes / scale)) < FLATTEST:
        raise error("is scaled to nothing", "Give it a scale that is not 0.")
    if (to_world[3] != (0.0, 0.0, 0.0, 1.0)).any():
        raise error("has a matrix whose last row is not 0 0 0 1", REMEDY)
