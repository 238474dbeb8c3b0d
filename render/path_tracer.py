"""Mitsuba 3 as the judge: a scene of meshes whose texels send light, followed along random paths.

Transport is linear and knows no wavelengths here, so K bands are traced three at a time in a variant of three
channels, with textures taken as they are. Emission is scaled to 1 before and back after: float32 then serves at any
brightness.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.render.gltf import GltfCamera

Array = NDArray[np.float64]
Texels = NDArray[np.float32]

# Mitsuba's vectorised variant compiles with LLVM: older ones than this end the process instead of failing.
OLDEST_LLVM = 16
LLVM, SCALAR = "llvm_ad_rgb", "scalar_rgb"
LLVM_FOLDERS = (
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib64",
    "/usr/lib/llvm-*/lib",
)

# Paths that the vectorised variant follows at once: some 100 bytes each.
MOST_AT_ONCE = 1 << 23
UNLIMITED = -1

# After so many reflections a path goes on by chance, and counts for more if it does: half the time of 16, for a tenth
# more noise.
SURE_REFLECTIONS = 5

# A mesh that sends little is still aimed at by so much of what the brightest is: near it, it may be all there is.
LEAST_WEIGHT = 0.02


@dataclass(frozen=True, eq=False)
class TracedMesh:
    """A mesh in world space that reflects, on both sides, and may send light from its outside.

    Args:
        positions: (n, 3) in m.
        normals: (n, 3), of length 1.
        triangles: (m, 3).
        uv: (n, 2); one-to-one where the mesh sends.
        reflectance: (h, w, K) in [0, 1]; row 0 is v = 0.
        repeat: whether the reflectance repeats beyond [0, 1].
        radiance: (h, w, K) what its texels send, nearest; or None.
    """

    positions: Texels
    normals: Texels
    triangles: NDArray[np.uint32]
    uv: Texels
    reflectance: Texels
    repeat: bool = True
    radiance: Texels | None = None


def trace(
    meshes: Sequence[TracedMesh],
    cameras: Sequence[GltfCamera],
    size: tuple[int, int],
    *,
    reflections: int,
    samples: int,
    at_once: int | None = None,
    seed: int = 0,
    direct: bool = True,
    grid: int = 1,
    variant: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Texels:
    """Return (h, n w, K) the radiance that reaches n cameras, side by side, top row first: the mean over each pixel.

    The vectorised variant sees a pixel through the middles of its grid x grid parts, as the other passes do, in turn;
    the other variant through places at random, since it offers no other: edges then differ.

    Args:
        size: (width, height) in pixels of each camera's picture.
        reflections: the most on a path; `UNLIMITED` follows light to its end.
        samples: paths a pixel, stratified over the pixel and over what sends light (multi-jittered, Kensler 2013).
        at_once: the most that are stratified, and compiled for, at once; None: as many as memory has room for.
        direct: whether light that comes without a reflection counts.
        grid: parts along the side of a pixel.
        variant: `LLVM` or `SCALAR`; None: `usual_variant`.
        progress: called with (bands done, bands in all).

    Raises:
        PhoslabError: Mitsuba is not installed.
    """
    mi = _mitsuba(variant or usual_variant())
    n_bands = meshes[0].reflectance.shape[-1]
    brightest = max((float(m.radiance.max()) for m in meshes if m.radiance is not None), default=0.0)
    whole = len(cameras) * size[0], size[1]
    picture = np.zeros((*whole[::-1], n_bands), dtype=np.float32)
    if brightest == 0.0 or (reflections == 0 and not direct):
        return picture
    for first in range(0, n_bands, 3):
        bands = np.minimum(np.arange(first, first + 3), n_bands - 1)
        if not any(m.radiance is not None and m.radiance[..., bands].any() for m in meshes):
            continue
        scene = mi.load_dict(_describe(mi, meshes, cameras, size, bands, 1.0 / brightest))
        depths = [(1.0, reflections + 1 if reflections >= 0 else UNLIMITED)]
        # The same seed gives the same rays from the camera, so what comes directly cancels to the last bit.
        if not direct:
            depths.append((-1.0, 1))
        for sign, depth in depths:
            part = _render(mi, scene, depth, samples, at_once or samples, seed, whole, grid)
            n = min(3, n_bands - first)
            picture[..., first : first + n] += np.float32(sign * brightest) * part[..., :n]
        if progress is not None:
            progress(min(first + 3, n_bands), n_bands)
    return picture


def _render(
    mi: Any, scene: Any, depth: int, samples: int, at_once: int, seed: int, size: tuple[int, int], grid: int
) -> Texels:
    integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": SURE_REFLECTIONS})
    at_once = max(1, min(samples, at_once, MOST_AT_ONCE // (size[0] * size[1])))
    total = np.zeros((size[1], size[0], 3))
    done = part = 0
    while done < samples:
        n = min(at_once, samples - done)
        numbered = (seed << 12) + part
        if mi.variant() == LLVM:
            mean = _on_grid(mi, scene, integrator, n, numbered, size, grid)
        else:
            mean = np.asarray(mi.render(scene, integrator=integrator, spp=n, seed=numbered))
        total += n * mean
        done, part = done + n, part + 1
    return (total / samples).astype(np.float32)


def _on_grid(
    mi: Any, scene: Any, integrator: Any, samples: int, seed: int, size: tuple[int, int], grid: int
) -> Array:
    """Return (h, w, 3) the mean over so many paths a pixel, or a few more, which begin in the middles of its parts."""
    import drjit as dr

    width, height = size
    sampler = scene.sensors()[0].sampler().clone()
    sampler.set_sample_count(samples)
    samples = sampler.sample_count()
    sampler.set_samples_per_wavefront(samples)
    # As a literal, every seed would be compiled anew: half a second each.
    opaque = dr.opaque(mi.UInt32, seed)
    sampler.seed(opaque, width * height * samples)
    index = dr.arange(mi.UInt32, width * height * samples)
    pixel = index // samples
    # Each pixel begins at another part, so that fewer paths than parts favour none.
    part = (index + mi.sample_tea_32(pixel, opaque)[0]) % (grid * grid)
    x = mi.Float(pixel % width) + (mi.Float(part % grid) + 0.5) / grid
    y = mi.Float(pixel // width) + (mi.Float(part // grid) + 0.5) / grid
    ray, _ = scene.sensors()[0].sample_ray(0.0, 0.0, mi.Point2f(x / width, y / height), mi.Point2f(0.5))
    light, _, _ = integrator.sample(scene, sampler, mi.RayDifferential3f(ray))
    film = dr.zeros(mi.Float, 3 * width * height)
    for k, value in enumerate((light.x, light.y, light.z)):
        dr.scatter_add(film, value, 3 * pixel + k)
    return np.asarray(film, dtype=np.float64).reshape(height, width, 3) / samples


def _describe(
    mi: Any,
    meshes: Sequence[TracedMesh],
    cameras: Sequence[GltfCamera],
    size: tuple[int, int],
    bands: NDArray[np.intp],
    scale: float,
) -> dict[str, Any]:
    # One scene, and one kernel, for all of them.
    sensor: dict[str, Any] = {
        "type": "batch",
        "film": _film(len(cameras) * size[0], size[1]),
        "sampler": {"type": "multijitter"},
    }
    for k, camera in enumerate(cameras):
        sensor[f"camera{k}"] = _camera(mi, camera, size)
    scene: dict[str, Any] = {"type": "scene", "sensor": sensor}
    sent = np.array([_sent(mesh) for mesh in meshes])
    weights = np.maximum(sent / sent.max(), LEAST_WEIGHT)
    for k, (mesh, weight) in enumerate(zip(meshes, weights, strict=True)):
        scene[f"mesh{k}"] = _mesh(mi, f"mesh{k}", mesh, bands, scale, float(weight))
    return scene


def _camera(mi: Any, camera: GltfCamera, size: tuple[int, int]) -> dict[str, Any]:
    # Mitsuba's camera looks along its +z, glTF's along -z; both have y up.
    turn = np.diag([-1.0, 1.0, -1.0, 1.0])
    return {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f((np.linalg.inv(camera.world_to_view) @ turn).tolist()),
        "fov_axis": "y",
        "fov": float(np.rad2deg(camera.yfov_rad)),
        "near_clip": camera.near_m,
        "film": _film(*size),
    }


def _film(width: int, height: int) -> dict[str, Any]:
    return {
        "type": "hdrfilm",
        "width": width,
        "height": height,
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
        "component_format": "float32",
    }


def _sent(mesh: TracedMesh) -> float:
    """Return what a mesh sends in all bands, up to a factor that all share: its area times the mean of its texels."""
    if mesh.radiance is None:
        return 0.0
    total = mesh.radiance.sum(axis=-1, dtype=np.float64)
    bright = total[total > 0]
    a, b, c = np.moveaxis(mesh.positions[mesh.triangles].astype(np.float64), 1, 0)
    area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
    return area * float(bright.mean()) if bright.size else 0.0


def _mesh(mi: Any, name: str, mesh: TracedMesh, bands: NDArray[np.intp], scale: float, weight: float) -> Any:
    wrap = "repeat" if mesh.repeat else "clamp"
    smooth = "bilinear" if mesh.reflectance.shape[:2] != (1, 1) else "nearest"
    reflectance = _bitmap(mi, mesh.reflectance[..., bands], wrap, smooth)
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(
        {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}
    )
    # An emitter that sends nothing would make Mitsuba divide by 0.
    if mesh.radiance is not None and mesh.radiance[..., bands].any():
        radiance = _bitmap(mi, mesh.radiance[..., bands] * np.float32(scale), "clamp", "nearest")
        properties["mesh_emitter"] = mi.load_dict(
            {"type": "area", "radiance": radiance, "sampling_weight": weight}
        )
    shape = mi.Mesh(
        name, len(mesh.positions), len(mesh.triangles), properties, has_vertex_normals=True,
        has_vertex_texcoords=True,
    )  # fmt: skip
    values = mi.traverse(shape)
    values["vertex_positions"] = np.ravel(mesh.positions)
    values["vertex_normals"] = np.ravel(mesh.normals)
    values["vertex_texcoords"] = np.ravel(mesh.uv)
    values["faces"] = np.ravel(mesh.triangles)
    values.update()
    return shape


def _bitmap(mi: Any, texels: Texels, wrap: str, filter_type: str) -> dict[str, Any]:
    bitmap = mi.Bitmap(np.ascontiguousarray(texels, dtype=np.float32))
    return {
        "type": "bitmap",
        "bitmap": bitmap,
        "raw": True,
        "filter_type": filter_type,
        "wrap_mode": wrap,
    }


def usual_variant() -> str:
    """Return the variant of Mitsuba that pictures take: the vectorised one where there is an LLVM for it."""
    return SCALAR if find_llvm() is None else LLVM


def _mitsuba(variant: str) -> Any:
    """Load Mitsuba in a variant.

    Raises:
        PhoslabError: it is not installed.
    """
    llvm = find_llvm()
    if llvm is not None:
        os.environ["DRJIT_LIBLLVM_PATH"] = str(llvm)
    try:
        import mitsuba
    except ImportError as error:
        raise PhoslabError(
            "is not installed", field="the path tracer mitsuba", remedy="pip install 'phoslab[reference]'"
        ) from error
    if mitsuba.variant() != variant:  # to set it anew loads modules again, for a tenth of a second
        mitsuba.set_variant(variant)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    return mitsuba


def find_llvm() -> Path | None:
    """Return the LLVM library that `DRJIT_LIBLLVM_PATH` names, or the newest in the usual folders.

    Returns:
        None where there is none, all are too old, or the variable names what is not there.
    """
    named = os.environ.get("DRJIT_LIBLLVM_PATH")
    if named:
        return Path(named) if Path(named).is_file() else None
    found: list[tuple[int, Path]] = []
    for folder in LLVM_FOLDERS:
        for path in Path("/").glob(f"{folder[1:]}/libLLVM*.so*"):
            version = re.search(r"(\d+)", path.name.removeprefix("libLLVM"))
            if version is not None and int(version[1]) >= OLDEST_LLVM:
                found.append((int(version[1]), path))
    return max(found)[1] if found else None
