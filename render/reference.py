"""The path-traced reference: the same meshes, states and camera in Mitsuba 3.

Two depths: `full=False` reflects the glow once, as the other ways do, and is what they are tested against;
`full=True` follows it to the end, and shows what one reflection leaves out. Lamp light stays that of the passes
before. Paths begin where the other passes sample a pixel, so that edges do not differ (`path_tracer.trace`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import moderngl
import numpy as np

from phoslab.render.atlas_glow import AtlasGlow
from phoslab.render.device import Device, read_texture, set_uniforms
from phoslab.render.glow_transport import Surroundings, TransportParameters
from phoslab.render.gpu_scene import GpuDrawable
from phoslab.render.optics import layer_count, to_layers
from phoslab.render.passes import Picture, false_grey
from phoslab.render.path_tracer import UNLIMITED, Texels, TracedMesh, trace


class Reference:
    """Follows random paths; the error falls with the square root of `samples`."""

    name: ClassVar[str] = "reference"
    aims: ClassVar[bool] = False
    linear: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = ("meshes", "camera", "reflectance", "atlas.radiance")
    writes: ClassVar[tuple[str, ...]] = ("radiance",)

    def __init__(self, device: Device, surroundings: Surroundings, parameters: TransportParameters) -> None:
        self._device, self._around, self._parameters = device, surroundings, parameters
        layers = layer_count(surroundings.scene.transport.n)
        self._pixels = device.texture_array(surroundings.size, layers)
        self._program = device.compute(
            "add_pixels", {"LAYERS": layers, "SUPERSAMPLING": surroundings.supersampling}
        )
        self.reflected: Texels | None = None

    def prepare(self) -> None:
        """Nothing: meshes go to the path tracer with every picture."""

    def run(self, radiance: moderngl.TextureArray) -> None:
        """Add what is reflected, alike to all samples of a pixel.

        Raises:
            PhoslabError: Mitsuba is not installed.
        """
        around, p = self._around, self._parameters
        self.reflected = trace(
            self.meshes(),
            [around.gbuffer.camera],
            around.size,
            reflections=UNLIMITED if p.full else p.bounces,
            samples=p.samples,
            seed=p.seed,
            direct=False,
            grid=around.supersampling,
        )
        self._pixels.write(to_layers(self.reflected[::-1]).astype("f4").tobytes())
        self._pixels.use(0)
        set_uniforms(self._program, pixels=0)
        radiance.bind_to_image(0, read=True, write=True)
        self._device.dispatch(self._program, around.gbuffer.size)

    def meshes(self, *, white: bool = False) -> list[TracedMesh]:
        """Return the scene as the path tracer takes it; `white`: as if everything reflected all light."""
        around = self._around
        glows = {glow.drawable.number: glow for glow in around.glows}
        atlases = {
            glow.drawable.number: atlas for glow, atlas in zip(around.glows, around.atlases, strict=True)
        }
        meshes = []
        for drawable in around.drawables:
            glow = glows.get(drawable.number)
            if glow is None:
                meshes.append(_mesh(drawable, drawable.geometry.uv, drawable.drawable.reflectance, None))
                continue
            # One mesh has one set of coordinates there: the atlas's, in which reflectance is looked up too.
            uv = read_texture(atlases[drawable.number].uv)[..., :2]
            reflectance = _looked_up(drawable.drawable.reflectance, uv)
            meshes.append(_mesh(drawable, drawable.geometry.atlas_uv, reflectance, glow))
        if white:
            ones = np.ones((1, 1, around.scene.transport.n), dtype=np.float32)
            return [replace(mesh, reflectance=ones) for mesh in meshes]
        return meshes

    def debug_views(self) -> dict[str, Picture]:
        """The sum over the bands of what is reflected."""
        return {} if self.reflected is None else {"reflected": false_grey(self.reflected.sum(axis=-1))}


def _mesh(
    drawable: GpuDrawable,
    uv: Texels | None,
    reflectance: np.ndarray[tuple[int, ...], np.dtype[np.floating]],
    glow: AtlasGlow | None,
) -> TracedMesh:
    geometry, to_world = drawable.geometry, drawable.drawable.model_to_world
    positions = geometry.positions.astype(np.float64) @ to_world[:3, :3].T + to_world[:3, 3]
    normals = geometry.normals.astype(np.float64) @ np.linalg.inv(to_world[:3, :3])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # A mirrored mesh has its triangles' outside where the normals point only if they are turned round.
    triangles = geometry.triangles if drawable.handedness > 0 else geometry.triangles[:, ::-1]
    return TracedMesh(
        positions=positions.astype(np.float32),
        normals=normals.astype(np.float32),
        triangles=triangles,
        uv=np.zeros((len(positions), 2), dtype=np.float32) if uv is None else uv,
        reflectance=np.asarray(reflectance, dtype=np.float32),
        repeat=glow is None,
        radiance=None if glow is None else glow.read(),
    )


def _looked_up(reflectance: np.ndarray[tuple[int, ...], np.dtype[np.floating]], uv: Texels) -> Texels:
    """Return (h, w, K) the reflectance at the texture coordinates of each texel of an atlas, nearest."""
    h, w = reflectance.shape[:2]
    if (h, w) == (1, 1):
        return np.asarray(reflectance, dtype=np.float32)
    column = np.floor(uv[..., 0] % 1.0 * w).astype(int).clip(0, w - 1)
    row = np.floor(uv[..., 1] % 1.0 * h).astype(int).clip(0, h - 1)
    return np.asarray(reflectance[row, column], dtype=np.float32)
