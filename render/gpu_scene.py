"""A scene's meshes and materials as buffers and textures: made once, read by every pass."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.render.atlas import Atlas, make_atlas
from phoslab.render.device import Device
from phoslab.render.geometry import Geometry, bounds
from phoslab.render.optics import Optics, to_layers
from phoslab.render.scene import Drawable, Phosphor, Scene

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MeshBuffers:
    """One mesh's vertex attributes, by the names that shaders give them, and its triangles."""

    attributes: dict[str, tuple[moderngl.Buffer, str]]
    indices: moderngl.Buffer


@dataclass(frozen=True, eq=False)
class MaterialTextures:
    """One phosphor's fields over its texture space: kr (n_c channels), ke_width and emission (n_c x layers)."""

    kr: moderngl.Texture
    ke_width: moderngl.TextureArray
    emission: moderngl.TextureArray
    n_states: int
    uniform_kr: Array | None


@dataclass(eq=False)
class GpuDrawable:
    """A drawable, ready to draw. Only `place` changes it.

    Args:
        number: from 1; what the G-buffer holds.
        geometry: its mesh, with atlas coordinates where it glows.
        box_w: (2, 3) its corners in world space, in m.
        atlas_size: (width, height) of its state textures; None where it does not glow.
    """

    number: int
    drawable: Drawable
    geometry: Geometry
    mesh: MeshBuffers
    box_w: Array
    reflectance: moderngl.TextureArray
    material: MaterialTextures | None
    atlas_size: tuple[int, int] | None

    def place(self, model_to_world: Array) -> None:
        """Move it."""
        self.drawable = replace(self.drawable, model_to_world=model_to_world)
        self.box_w = bounds(self.geometry, model_to_world)

    @property
    def placement(self) -> dict[str, Array]:
        """The uniforms that place it in the world."""
        to_model = np.asarray(np.linalg.inv(self.drawable.model_to_world[:3, :3]), dtype=np.float64)
        return {"model_to_world": self.drawable.model_to_world, "normal_to_world": to_model.T}

    @property
    def handedness(self) -> float:
        """-1 where its node mirrors the mesh, else 1."""
        return float(np.sign(np.linalg.det(self.drawable.model_to_world[:3, :3])))


def upload(device: Device, scene: Scene) -> tuple[GpuDrawable, ...]:
    """Make the buffers and textures of every drawable; give every phosphor its atlas.

    Instances of one mesh share their buffers and their atlas, never their state.
    """
    atlases: dict[tuple[int, int], Atlas] = {}
    meshes: dict[int, MeshBuffers] = {}
    reflectances: dict[int, moderngl.TextureArray] = {}
    drawables = []
    for number, drawable in enumerate(scene.drawables, start=1):
        geometry, atlas_size, material = drawable.geometry, None, None
        if drawable.phosphor is not None:
            key = (id(geometry), drawable.phosphor.atlas_texels)
            if key not in atlases:
                atlases[key] = make_atlas(device, geometry, drawable.phosphor.atlas_texels)
            geometry, atlas_size = atlases[key].geometry, atlases[key].size
            _check_maps(device, drawable.phosphor)
            material = _upload_material(device, drawable.phosphor.optics)
        if id(geometry) not in meshes:
            meshes[id(geometry)] = _upload_mesh(device, geometry)
        if id(drawable.reflectance) not in reflectances:
            reflectances[id(drawable.reflectance)] = _upload_reflectance(device, drawable)
        drawables.append(
            GpuDrawable(
                number=number,
                drawable=drawable,
                geometry=geometry,
                mesh=meshes[id(geometry)],
                box_w=bounds(geometry, drawable.model_to_world),
                reflectance=reflectances[id(drawable.reflectance)],
                material=material,
                atlas_size=atlas_size,
            )
        )
    return tuple(drawables)


def _upload_mesh(device: Device, geometry: Geometry) -> MeshBuffers:
    empty = np.zeros((len(geometry.positions), 2), dtype=np.float32)
    arrays = {
        "position": geometry.positions,
        "normal": geometry.normals,
        "uv": empty if geometry.uv is None else geometry.uv,
        "atlas_uv": empty if geometry.atlas_uv is None else geometry.atlas_uv,
    }
    return MeshBuffers(
        {name: (device.buffer(a.astype("f4")), f"{a.shape[1]}f") for name, a in arrays.items()},
        device.buffer(geometry.triangles.astype("u4")),
    )


def _check_maps(device: Device, phosphor: Phosphor) -> None:
    """Refuse a material's map that the driver cannot hold by its file."""
    material, optics = phosphor.material, phosphor.optics
    fields = {
        "kr_per_s": optics.kr_per_s,
        "ke_m2_per_J": optics.ke_width,
        "emission": optics.emission,
        "albedo": optics.albedo,
    }
    for field, name in material.maps.items():
        values = fields[field]
        assert values is not None
        file = (material.folder or Path()) / name
        device.check_size(
            (values.shape[1], values.shape[0]), f"the map of {field}", file=file, remedy="Use a smaller map."
        )


def _upload_material(device: Device, optics: Optics) -> MaterialTextures:
    def layered(values: Array) -> moderngl.TextureArray:
        h, w, n_c, _ = values.shape
        layers = np.concatenate([to_layers(values[:, :, i]) for i in range(n_c)])
        return device.texture_array((w, h), len(layers), layers, linear=True)

    h, w, n_c = optics.kr_per_s.shape
    return MaterialTextures(
        kr=device.texture((w, h), n_c, optics.kr_per_s, linear=True),
        ke_width=layered(optics.ke_width),
        emission=layered(optics.emission),
        n_states=n_c,
        uniform_kr=optics.uniform_kr,
    )


def _upload_reflectance(device: Device, drawable: Drawable) -> moderngl.TextureArray:
    h, w = drawable.reflectance.shape[:2]
    device.check_size((w, h), f"the texture of {drawable.name!r}", remedy="Use a smaller texture.")
    layers = to_layers(drawable.reflectance)
    own = drawable.phosphor is not None and drawable.phosphor.optics.albedo is not None
    # glTF textures repeat; a material's map ends with its surface.
    return device.texture_array(
        (layers.shape[2], layers.shape[1]),
        len(layers),
        layers,
        dtype="f2" if layers.dtype == np.float16 else "f4",
        linear=True,
        repeat=not own,
    )
