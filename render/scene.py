"""A scene: what `scene.toml` and the glTF file beside it say, checked, in the transport bands and units.

Loading needs no OpenGL. Everything that can be wrong with a scene is found here, before anything is drawn.
"""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab import bands as spectral
from phoslab import colorimetry, kinetics, presets, schemas, spectra
from phoslab.bands import Bands
from phoslab.errors import PhoslabError
from phoslab.files import inside, read_regular
from phoslab.material import Material
from phoslab.render.geometry import Geometry
from phoslab.render.gltf import GltfCamera, GltfInstance, GltfLight, GltfModel, load_gltf
from phoslab.render.light_course import parse_course
from phoslab.render.motion import Motion
from phoslab.render.optics import Optics, Texels, load_optics
from phoslab.render.schedule import Schedule
from phoslab.render.units import Claim, Units, settle_units

Array = NDArray[np.float64]

SCHEMA = "phoslab-scene/1"

# Far above what anybody writes by hand.
_LARGEST_BYTES = 1 << 24

# Per nm: what is left of float32's range is for products with it, and for points that are nearer than 1 m.
LARGEST_IRRADIANCE = 1e15

# A share of light or glow that falls outside the bands and is not worth a word.
NEGLIGIBLE = 1e-3


@dataclass(frozen=True)
class Initial:
    """The state at time 0: "empty", "saturated", or the "equilibrium" under `lights`."""

    state: str = "empty"
    lights: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class Phosphor:
    """What makes a drawable glow; `atlas_texels` along the side of its state texture."""

    material: Material
    optics: Optics
    atlas_texels: int
    initial: Initial


@dataclass(frozen=True, eq=False)
class Drawable:
    """One primitive of one node; a phosphor has its own state even where it shares its mesh.

    Args:
        name: of the node, or of its mesh where the node has none.
        reflectance: (h, w, K) float32, or float16 where it is a texture, in [0, 1]; 1 x 1 where there is no texture.
        node: its index in the glTF file.
    """

    name: str
    geometry: Geometry
    model_to_world: Array
    reflectance: Texels
    phosphor: Phosphor | None = None
    node: int = -1


@dataclass(frozen=True, eq=False)
class Light:
    """A punctual light: its place from glTF, and (K,) band-mean irradiance at 1 m in the scene's units."""

    place: GltfLight
    irradiance_at_1m: Array


@dataclass(frozen=True)
class Exposure:
    """From `from_s` on, luminance times `factor` is display white; None: chosen on the first picture."""

    from_s: float
    factor: float | None


@dataclass(frozen=True, eq=False)
class Scene:
    """All that a renderer needs to know.

    Args:
        file: the scene.toml.
        transport: the K spectral bands of all light in the scene.
        motion: where things are over time; None: nothing moves. `pose.py` puts them there.
        warnings: what is wrong but not fatal, for the user and for every output.
    """

    file: Path
    transport: Bands
    drawables: tuple[Drawable, ...]
    lights: tuple[Light, ...]
    camera: GltfCamera
    schedule: Schedule
    size: tuple[int, int]
    times: tuple[str, ...]
    supersampling: int
    exposures: tuple[Exposure, ...]
    warnings: tuple[str, ...]
    motion: Motion | None = None

    @property
    def phosphors(self) -> tuple[Drawable, ...]:
        """The drawables that glow."""
        return tuple(d for d in self.drawables if d.phosphor is not None)


def load_scene(path: str | PathLike[str]) -> Scene:
    """Read a scene.toml, or the one in the folder `path`, with all that it names.

    Raises:
        PhoslabError: something is missing, malformed, leaves the folder, or mixes units.
    """
    file = Path(path)
    file = file / "scene.toml" if file.is_dir() else file
    try:
        return _load(file)
    except RecursionError:
        raise PhoslabError(
            "holds tables or lists that are nested beyond reason",
            file=file,
            remedy="Write the scene in plain tables, as docs/formats-scene.md shows.",
        ) from None


def _load(file: Path) -> Scene:
    data = _read_toml(file)
    if data.get("schema") != SCHEMA:
        raise PhoslabError(
            f"is {data.get('schema')!r}, which this version of phoslab cannot read",
            file=file,
            field="schema",
            remedy=f"It reads {SCHEMA!r}.",
        )
    schemas.check(data, "scene-1", file=file)
    return _Loader(file, data).load()


def _read_toml(file: Path) -> dict[str, Any]:
    content = read_regular(file, _LARGEST_BYTES, remedy="Name a scene.toml, or a folder with one.")
    try:
        data = tomllib.loads(content.decode("utf-8"))
    except ValueError as error:  # what it raises for bad UTF-8, bad syntax and thousands of digits
        raise PhoslabError(f"is not valid TOML: {error}", file=file, remedy="Correct that line.") from error
    _refuse_nonfinite(data, "", file)
    return data


def _refuse_nonfinite(value: Any, field: str, file: Path) -> None:
    """Refuse nan and inf, which TOML has: no comparison with a bound would catch a NaN. So too endless integers."""
    if isinstance(value, float) and not np.isfinite(value):
        raise PhoslabError(f"is {value}", file=file, field=field, remedy="Give a finite number.")
    if isinstance(value, int) and value.bit_length() > 63:
        raise PhoslabError(
            "is beyond the 64-bit integers of TOML", file=file, field=field, remedy="Give a smaller number."
        )
    if isinstance(value, dict):
        for key, item in value.items():
            _refuse_nonfinite(item, f"{field}.{key}".lstrip("."), file)
    elif isinstance(value, list):
        for k, item in enumerate(value):
            _refuse_nonfinite(item, f"{field}[{k}]", file)


def _reflectance(rgb: NDArray[np.float32], transport: Bands) -> Texels:
    """Return (h, w, K) reflectances of (h, w, 3) colours, row by row: float64 of a large texture fills a memory.

    A texture becomes float16: its 8 bits are coarser. A plain colour stays exact.
    """
    dtype = np.float32 if rgb.shape[:2] == (1, 1) else np.float16
    texels: Texels = np.empty((*rgb.shape[:2], transport.n), dtype=dtype)
    for into, row in zip(texels, rgb, strict=True):
        into[:] = colorimetry.reflectance_from_rgb(row, transport)
    return texels


class _Loader:
    def __init__(self, file: Path, data: dict[str, Any]) -> None:
        self.file, self.data = file, data
        self.model: GltfModel = load_gltf(inside(file.parent, data["gltf"], file=file, field="gltf"))
        self.warnings: list[str] = list(self.model.warnings)

    def error(self, field: str, problem: str, remedy: str) -> PhoslabError:
        return PhoslabError(problem, file=self.file, field=field, remedy=remedy)

    def load(self) -> Scene:
        entries: dict[str, Any] = self.data.get("phosphors", {})
        materials = {name: self._material(name, entry["material"]) for name, entry in entries.items()}
        transport = self._transport(list(materials.values()))
        units = self._units(materials)
        schedule = self._schedule()
        lights = self._lights(transport, units.irradiance_unit)
        self._check_names("phosphors", entries, {n for i in self.model.instances for n in (i.node, i.mesh)})
        initial = self._initial(self.data.get("initial"), Initial(), "initial")
        phosphors = {
            name: Phosphor(
                material=material,
                optics=self._optics(name, material, transport, *units.factors[name]),
                atlas_texels=entries[name].get("atlas_texels", 512),
                initial=self._initial(entries[name].get("initial"), initial, f"phosphors.{name}.initial"),
            )
            for name, material in materials.items()
        }
        for name, material in materials.items():
            self._check_light_on(name, material, lights, transport, units.factors[name][0])
        render = self.data.get("render", {})
        width, height = render.get("size", (640, 480))
        return Scene(
            file=self.file,
            transport=transport,
            drawables=self._drawables(phosphors, transport),
            lights=tuple(lights.values()),
            camera=self._camera(),
            schedule=schedule,
            size=(width, height),
            times=tuple(render.get("times", ["0"])),
            supersampling=render.get("supersampling", 2),
            exposures=self._exposures(schedule),
            warnings=tuple(self.warnings),
            motion=self.model.motion,
        )

    def _material(self, name: str, text: str) -> Material:
        field = f"phosphors.{name}.material"
        if text.startswith("preset:"):
            wanted = text.removeprefix("preset:")
            if wanted not in presets.names():
                raise self.error(
                    field, f"names an unknown preset {wanted!r}", f"Use one of: {', '.join(presets.names())}."
                )
            return presets.preset(wanted)
        return Material.load(inside(self.file.parent, text, file=self.file, field=field))

    def _optics(
        self,
        name: str,
        material: Material,
        transport: Bands,
        irradiance_factor: float,
        radiance_factor: float,
    ) -> Optics:
        try:
            return load_optics(material, transport, irradiance_factor, radiance_factor)
        except PhoslabError as error:
            if error.file is not None:
                raise
            where = f"phosphors.{name}"
            raise self.error(
                where, f"cannot be rendered: its {error.field} {error.problem}", error.remedy
            ) from error

    def _transport(self, materials: Sequence[Material]) -> Bands:
        edges = self.data.get("render", {}).get("bands_nm")
        if edges is not None:
            try:
                return Bands(np.array(edges))
            except PhoslabError as error:
                raise self.error("render.bands_nm", error.problem, error.remedy) from error
        return spectral.merge(*(m.bands for m in materials)) if materials else Bands.uniform()

    def _units(self, materials: Mapping[str, Material]) -> Units:
        stated = self.data.get("units", {})
        system = stated.get("system", "relative")
        if system == "absolute" and "radiance_factor" in stated:
            raise self.error("units.radiance_factor", "has no meaning in an absolute scene", "Remove it.")
        claims = {
            name: Claim(m, entry.get("irradiance_factor"), entry.get("radiance_factor"))
            for name, m in materials.items()
            for entry in [self.data["phosphors"][name]]
        }
        return settle_units(system, stated.get("radiance_factor"), claims, self.file)

    def _schedule(self) -> Schedule:
        return Schedule(
            {
                name: parse_course(entry, file=str(self.file), field=f"lights.{name}")
                for name, entry in self.data.get("lights", {}).items()
            }
        )

    def _lights(self, transport: Bands, irradiance_unit: float) -> dict[str, Light]:
        entries = self.data.get("lights", {})
        places = {light.name: light for light in self.model.lights}
        if len(places) != len(self.model.lights):
            raise self.error(
                "gltf", "has two lights of the same name", "Give every light node a name of its own."
            )
        self._check_names("lights", entries, places)
        for name in places:
            if name not in entries:
                raise self.error(
                    f"lights.{name}",
                    "is missing, but the glTF file has that light",
                    f"Add [lights.{name}] with spectrum and irradiance_at_1m, or remove the light.",
                )
        lights = {}
        for name, entry in entries.items():
            field = f"lights.{name}.spectrum"
            with np.errstate(all="ignore"):  # the checks below find what overflows
                shape = spectra.shape(
                    entry["spectrum"], transport, folder=self.file.parent, file=self.file, field=field
                )
                total = float(shape @ transport.widths_nm)
                irradiance = (
                    shape / total * entry["irradiance_at_1m"] * irradiance_unit if total > 0 else shape
                )
            if not total > 0:
                raise self.error(field, "gives no light within the transport bands", "Choose other bands.")
            if not (irradiance <= LARGEST_IRRADIANCE).all():
                raise self.error(
                    f"lights.{name}.irradiance_at_1m",
                    f"gives more than {LARGEST_IRRADIANCE:g} per nm, with this spectrum and the reference lamp",
                    "Choose a lower irradiance, or a spectrum of fewer extremes.",
                )
            lights[name] = Light(places[name], irradiance)
        return lights

    def _check_names(self, table: str, entries: Mapping[str, Any], known: Iterable[str]) -> None:
        for name in entries:
            if name not in known:
                there = ", ".join(sorted(n for n in known if n)) or "none"
                raise self.error(
                    f"{table}.{name}",
                    f"is not in {self.data['gltf']!r}",
                    f"The names in that file are: {there}.",
                )

    def _initial(self, entry: dict[str, Any] | None, default: Initial, field: str) -> Initial:
        if entry is None:
            return default
        lights = entry.get("lights", [])
        if bool(lights) != (entry["state"] == "equilibrium"):
            raise self.error(
                field,
                "names lights without an equilibrium, or an equilibrium without lights",
                'Write `state = "equilibrium"` with `lights = ["NAME"]`, or another state without lights.',
            )
        for name in lights:
            if name not in self.data.get("lights", {}):
                raise self.error(
                    f"{field}.lights", f"names an unknown light {name!r}", "Use a name of [lights]."
                )
        return Initial(entry["state"], frozenset(lights))

    def _check_light_on(
        self, name: str, material: Material, lights: Mapping[str, Light], transport: Bands, factor: float
    ) -> None:
        """Refuse light where `ke` is unknown; report light and glow that fall outside the bands."""
        for light_name, light in lights.items():
            E = spectral.rebin(light.irradiance_at_1m, transport, material.bands) * factor
            if "ke_m2_per_J" not in material.maps:
                try:
                    kinetics.excitation(material, E)
                except PhoslabError as error:
                    raise self.error(
                        f"phosphors.{name}", f"{error.field} {error.problem}", error.remedy
                    ) from error
            lost = float(spectral.integral_outside(light.irradiance_at_1m, transport, material.bands))
            share = lost / max(float(light.irradiance_at_1m @ transport.widths_nm), np.finfo(float).tiny)
            if share > NEGLIGIBLE:
                self.warnings.append(
                    f"{share:.1%} of the light of {light_name!r} lies outside the bands of {name!r} "
                    "and cannot excite it"
                )
        L = material.kr_per_s @ material.emission
        total = float(L @ material.bands.widths_nm)
        lost = float(spectral.integral_outside(L, material.bands, transport))
        if lost > NEGLIGIBLE * total:
            share = lost / total
            self.warnings.append(f"{share:.1%} of the glow of {name!r} lies outside the scene's bands")

    def _check_energy(self, name: str, material: Material, reflectance: Texels, transport: Bands) -> None:
        """Report an absolute material that gives more than what its reflection leaves it to take."""
        if material.calibration != "absolute":
            return
        mean = spectral.rebin(reflectance.mean(axis=(0, 1), dtype=np.float64), transport, material.bands)
        excess = material.excess_emission(mean)
        if excess.any():
            band = int(np.argmax(excess))
            self.warnings.append(
                f"{name!r} gives more light than it takes at {material.bands.label(band)}, "
                f"by {excess[band]:.3g} of what it receives"
            )

    def _drawables(self, phosphors: Mapping[str, Phosphor], transport: Bands) -> tuple[Drawable, ...]:
        reflectances: dict[int, Texels] = {}
        drawables = []
        for instance in self.model.instances:
            phosphor = phosphors.get(instance.node) or phosphors.get(instance.mesh)
            key = id(instance.base_colour)
            if key not in reflectances:
                reflectances[key] = _reflectance(instance.base_colour, transport)
            reflectance = reflectances[key]
            if phosphor is not None and phosphor.optics.albedo is not None:
                reflectance = phosphor.optics.albedo.astype(np.float32)
            name = instance.node or instance.mesh
            if phosphor is not None:
                self._check_energy(name, phosphor.material, reflectance, transport)
            self._check_uv(name, instance, reflectance, phosphor)
            drawables.append(
                Drawable(
                    name, instance.geometry, instance.model_to_world, reflectance, phosphor, instance.index
                )
            )
        if not drawables:
            raise self.error("gltf", "holds no mesh", "Name a file with something to see in it.")
        return tuple(drawables)

    def _check_uv(
        self, name: str, instance: GltfInstance, reflectance: Texels, phosphor: Phosphor | None
    ) -> None:
        varies = reflectance.shape[:2] != (1, 1) or (phosphor is not None and bool(phosphor.material.maps))
        if varies and instance.geometry.uv is None:
            raise self.error(
                f"mesh {name!r}",
                "has a texture or a material map, but no texture coordinates",
                "Export it with UVs (TEXCOORD_0).",
            )

    def _camera(self) -> GltfCamera:
        cameras = {camera.name: camera for camera in self.model.cameras}
        if not cameras:
            raise self.error("gltf", "holds no perspective camera", "Export the file with one.")
        wanted = self.data.get("camera", next(iter(cameras)))
        self._check_names("camera", {wanted: None}, cameras)
        return cameras[wanted]

    def _exposures(self, schedule: Schedule) -> tuple[Exposure, ...]:
        display = self.data.get("display", {})
        entries = display.get("exposures", [{"from": "0", "exposure": display.get("exposure", "auto")}])
        exposures = []
        for k, entry in enumerate(entries):
            field = f"{self.file}: display.exposures[{k}].from"
            factor = None if entry["exposure"] == "auto" else float(entry["exposure"])
            exposures.append(Exposure(schedule.parse_time(entry["from"], field=field), factor))
        starts = [e.from_s for e in exposures]
        if starts[0] > 0 or any(b <= a for a, b in itertools.pairwise(starts)):
            raise self.error(
                "display.exposures", "do not ascend from 0", 'Begin with `from = "0"` and sort them by time.'
            )
        return tuple(exposures)
