"""Scenes made for one claim each, and a guard against what OpenGL leaves behind."""

from __future__ import annotations

import base64
import gc
import importlib.util
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.render.device import Device

QUAD = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
QUAD_UV = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
QUAD_TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])


@pytest.fixture(autouse=True)
def _no_gl_leaks() -> Iterator[None]:
    """Fail a test that leaves an OpenGL error or an open device behind."""
    yield
    left = [thing for thing in gc.get_objects() if isinstance(thing, Device) and not thing.closed]
    try:
        assert not left, f"{len(left)} devices are open, with {[d.live for d in left]} objects"
    finally:
        for device in left:
            device.close()


@pytest.fixture
def device() -> Iterator[Device]:
    """An OpenGL device whose objects are all released, and without an error, at the end."""
    with Device() as opened:
        yield opened
        opened.check()
    assert opened.live == 0


@dataclass
class Builder:
    """Collects a glTF scene with the buffer inside the file, and a scene.toml beside it."""

    folder: Path
    buffers: bytearray = field(default_factory=bytearray)
    gltf: dict[str, Any] = field(
        default_factory=lambda: {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
            "meshes": [],
            "accessors": [],
            "bufferViews": [],
            "materials": [],
            "cameras": [],
        }
    )
    lights: list[dict[str, Any]] = field(default_factory=list)
    toml: str = 'schema = "phoslab-scene/1"\ngltf = "scene.gltf"\n'

    def accessor(self, values: NDArray[Any], component: int, kind: str, **more: Any) -> int:
        data = np.ascontiguousarray(values).tobytes()
        self.buffers += bytes(-len(self.buffers) % 4)
        view = {"buffer": 0, "byteOffset": len(self.buffers), "byteLength": len(data)}
        self.gltf["bufferViews"].append(view)
        self.buffers += data
        self.gltf["accessors"].append(
            {
                "bufferView": len(self.gltf["bufferViews"]) - 1,
                "componentType": component,
                "count": len(values),
                "type": kind,
                **more,
            }
        )
        return len(self.gltf["accessors"]) - 1

    def mesh(
        self,
        name: str,
        positions: NDArray[Any] = QUAD,
        triangles: NDArray[Any] = QUAD_TRIANGLES,
        uv: NDArray[Any] | None = QUAD_UV,
        colour: Sequence[float] = (1.0, 1.0, 1.0),
        **node: Any,
    ) -> Builder:
        attributes = {"POSITION": self.accessor(positions.astype("<f4"), 5126, "VEC3")}
        if uv is not None:
            attributes["TEXCOORD_0"] = self.accessor(uv.astype("<f4"), 5126, "VEC2")
        self.gltf["materials"].append({"pbrMetallicRoughness": {"baseColorFactor": [*colour, 1.0]}})
        primitive = {
            "attributes": attributes,
            "indices": self.accessor(triangles.reshape(-1, 1).astype("<u2"), 5123, "SCALAR"),
            "material": len(self.gltf["materials"]) - 1,
        }
        self.gltf["meshes"].append({"name": name, "primitives": [primitive]})
        return self.node(name=name, mesh=len(self.gltf["meshes"]) - 1, **node)

    def node(self, **node: Any) -> Builder:
        self.gltf["nodes"].append(node)
        self.gltf["scenes"][0]["nodes"].append(len(self.gltf["nodes"]) - 1)
        return self

    def camera(self, distance: float = 2.0, yfov: float = 0.5) -> Builder:
        self.gltf["cameras"].append(
            {"type": "perspective", "perspective": {"yfov": yfov, "znear": 0.01 * distance}}
        )
        return self.node(name="camera", camera=0, translation=[0, 0, distance])

    def light(self, name: str, kind: str, matrix: NDArray[Any], **spot: float) -> Builder:
        self.lights.append({"type": kind, **({"spot": spot} if spot else {})})
        return self.node(
            name=name,
            matrix=matrix.T.ravel().tolist(),
            extensions={"KHR_lights_punctual": {"light": len(self.lights) - 1}},
        )

    def animate(
        self, name: str, path: str, times: Any, values: Any, interpolation: str = "LINEAR"
    ) -> Builder:
        """Move the node `name`; one with a matrix is given its place alone."""
        index, node = next((k, n) for k, n in enumerate(self.gltf["nodes"]) if n["name"] == name)
        if "matrix" in node:
            node["translation"] = node.pop("matrix")[12:15]
        (animation,) = self.gltf.setdefault("animations", [{"samplers": [], "channels": []}])
        values = np.array(values, dtype="<f4")
        animation["samplers"].append(
            {
                "input": self.accessor(np.array(times, dtype="<f4").reshape(-1, 1), 5126, "SCALAR"),
                "output": self.accessor(values, 5126, f"VEC{values.shape[1]}"),
                "interpolation": interpolation,
            }
        )
        target = {"node": index, "path": path}
        animation["channels"].append({"sampler": len(animation["samplers"]) - 1, "target": target})
        return self

    def lamp(self, at: Sequence[float] = (0, 0, 2)) -> Builder:
        """A point light called `lamp`."""
        matrix = np.eye(4)
        matrix[:3, 3] = at
        return self.light("lamp", "point", matrix)

    def text(self, toml: str) -> Builder:
        self.toml += toml
        return self

    def write(self) -> Path:
        if self.lights:
            self.gltf["extensions"] = {"KHR_lights_punctual": {"lights": self.lights}}
        uri = "data:application/octet-stream;base64," + base64.b64encode(bytes(self.buffers)).decode()
        self.gltf["buffers"] = [{"byteLength": len(self.buffers), "uri": uri}]
        (self.folder / "scene.gltf").write_text(json.dumps(self.gltf), encoding="utf-8")
        path = self.folder / "scene.toml"
        path.write_text(self.toml, encoding="utf-8")
        return path


@pytest.fixture
def build(tmp_path: Path) -> Builder:
    """An empty scene in a folder of its own."""
    return Builder(tmp_path)


@pytest.fixture
def quad(build: Builder) -> Builder:
    """A square metre of white at z = 0 that fills the picture, its texture coordinates one-to-one, and a camera."""
    return build.mesh("quad").camera()


LAMP = """
[units]
radiance_factor = 0.5
[lights.lamp]
spectrum = "blackbody:3000"
irradiance_at_1m = 2.0
schedule = [[0, 10]]
"""

GREEN = """
[phosphors.quad]
material = "preset:green"
atlas_texels = 64
"""


@pytest.fixture
def lamp_toml() -> str:
    return LAMP


@pytest.fixture
def green_toml() -> str:
    return GREEN


@pytest.fixture
def refuses() -> Callable[..., str]:
    """Call something that must raise a PhoslabError; return its one sentence."""

    def call(what: Callable[..., Any], *args: Any, **kwargs: Any) -> str:
        with pytest.raises(PhoslabError) as caught:
            what(*args, **kwargs)
        message = str(caught.value)
        assert caught.value.remedy
        assert "\n" not in message
        return message

    return call


@pytest.fixture(scope="session")
def rooms() -> ModuleType:
    """The module `glow_rooms.py` beside this file: scenes with a closed form for what glow lights."""
    return _beside("glow_rooms")


@pytest.fixture(scope="session")
def planned_scenes() -> ModuleType:
    """The module `planned_scenes.py` beside this file: scenes drawn from seeds."""
    return _beside("planned_scenes")


def _beside(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where dataclasses look for their module
    spec.loader.exec_module(module)
    return module
