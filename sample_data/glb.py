"""Writes meshes, lights and cameras as one .glb."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.sample_data.shapes import Array, Shape, unit


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

    def animate(self, name: str, **channels: tuple[Array, Array]) -> None:
        """Move the node `name`: by property, (n,) times in s and (n, 3 or 4) values, with straight lines between."""
        from scipy.spatial.transform import Rotation

        index, node = next((k, n) for k, n in enumerate(self.document.nodes) if n.name == name)
        at_rest = np.array(node.matrix).reshape(4, 4).T
        node.matrix = None
        node.translation = at_rest[:3, 3].tolist()
        node.rotation = Rotation.from_matrix(at_rest[:3, :3]).as_quat().tolist()
        if not self.document.animations:
            self.document.animations.append(self.gl.Animation(name="motion"))
        (animation,) = self.document.animations
        for path, (times, values) in channels.items():
            keys = self._accessor(times.reshape(-1, 1).astype("<f4"), 5126, "SCALAR")
            self.document.accessors[keys].min, self.document.accessors[keys].max = (
                [float(times.min())],
                [float(times.max())],
            )
            kind = {3: "VEC3", 4: "VEC4"}[values.shape[1]]
            animation.samplers.append(
                self.gl.AnimationSampler(input=keys, output=self._accessor(values.astype("<f4"), 5126, kind))
            )
            target = self.gl.AnimationChannelTarget(node=index, path=path)
            animation.channels.append(
                self.gl.AnimationChannel(sampler=len(animation.samplers) - 1, target=target)
            )

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
    p, z = np.array(eye, dtype=np.float64), unit(np.array(eye, dtype=np.float64) - np.array(target))
    x = unit(np.cross([0.0, 1.0, 0.0], z))
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
