"""The material: what fitting writes, what rendering reads, and the file between them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab import schemas
from phoslab.bands import Bands
from phoslab.errors import PhoslabError
from phoslab.files import read_regular, write_text

Array = NDArray[np.float64]

SCHEMA = "phoslab-material/1"

# The largest material, 4 states in 1024 bands with all its errors, is some 10 MB.
_LARGEST_BYTES = 1 << 26


@dataclass(frozen=True, eq=False, kw_only=True)
class Material:
    """A phosphorescent material: n_c states, n_λ bands (Nalbach 2017, 8.3).

    Args:
        name: for people.
        bands: the n_λ spectral bands.
        kr_per_s: (n_c,) re-radiation rates.
        ke_m2_per_J: (n_c, n_λ) excitation rates; 0 is "measured and below the limit", NaN "never measured".
        emission: (n_c, n_λ) re-radiation functions Λ in J m⁻² sr⁻¹ nm⁻¹.
        calibration: "relative" or "absolute".
        ke_upper_limit: (n_c, n_λ) bounds where `ke` is 0 and has one, else NaN; or None.
        albedo: (n_λ,) diffuse reflectance, or None for the scene's own.
        reference_irradiance: (n_λ,) the lamp, in its own units, to which a relative calibration refers.
        standard_error: by field name, in the field's shape and unit.
        covariance: {"parameters": names, "matrix": rows}.
        valid_s: first and last time after lamp-off that data support.
        maps: file name by field name: OpenEXR in UV space that replaces the field texel by texel.
        provenance: where the numbers come from.
        folder: where the maps lie; set by `load`.

    Raises:
        PhoslabError: a shape or value is wrong; the error names the field.
    """

    name: str
    bands: Bands
    kr_per_s: Array
    ke_m2_per_J: Array
    emission: Array
    calibration: str
    ke_upper_limit: Array | None = None
    albedo: Array | None = None
    reference_irradiance: Array | None = None
    standard_error: Mapping[str, Any] | None = None
    covariance: Mapping[str, Any] | None = None
    valid_s: tuple[float, float] | None = None
    maps: Mapping[str, str] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    folder: Path | None = None

    def __post_init__(self) -> None:
        n_c, n_b = np.size(self.kr_per_s), self.bands.n
        self._set("kr_per_s", (n_c,))
        self._set("ke_m2_per_J", (n_c, n_b), unknown_allowed=True)
        self._set("emission", (n_c, n_b))
        self._set("ke_upper_limit", (n_c, n_b), unknown_allowed=True)
        self._set("albedo", (n_b,))
        self._set("reference_irradiance", (n_b,))
        if not self.name.isprintable():
            raise self._error("name", "holds control characters", "Use letters, digits and signs.")
        if not 1 <= n_c <= 4:
            raise self._error("kr_per_s", f"has {n_c} states", "A material has 1 to 4 states.")
        if self.calibration not in ("relative", "absolute"):
            raise self._error("calibration", f"is {self.calibration!r}", 'Use "relative" or "absolute".')
        if self.albedo is not None and (self.albedo > 1).any():
            raise self._error("albedo", "is above 1", "A diffuse reflectance lies in 0..1.")
        if self.valid_s is not None and not 0 <= self.valid_s[0] < self.valid_s[1] < np.inf:
            raise self._error(
                "valid_s", f"is {list(self.valid_s)}", "Give [first, last] in seconds, ascending."
            )
        for name in ("maps", "provenance"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def _set(self, name: str, shape: tuple[int, ...], *, unknown_allowed: bool = False) -> None:
        """Freeze one array field after checking its shape and values."""
        if getattr(self, name) is None:
            return
        value = np.array(getattr(self, name), dtype=np.float64)
        if value.shape != shape:
            raise self._error(
                name, f"has shape {value.shape}", f"With these states and bands it must be {shape}."
            )
        known = value[~np.isnan(value)] if unknown_allowed else value
        if not np.isfinite(known).all() or (known < 0).any():
            raise self._error(
                name, "holds a negative or non-finite value", "Every value is 0 or more and finite."
            )
        value.setflags(write=False)
        object.__setattr__(self, name, value)

    def _error(self, name: str, problem: str, remedy: str) -> PhoslabError:
        return PhoslabError(problem, field=name, remedy=remedy)

    @property
    def n_states(self) -> int:
        """Number of states, n_c."""
        return self.kr_per_s.size

    def excess_emission(self, albedo: Array | None = None) -> Array:
        """Return (n_λ,) how much more than it takes an absolute material gives, per band; 0 where it is sound.

        The bound is π Σ_i Σ_k Λ_ik Δλ_k ke_ij <= 1 - albedo_j: light re-radiated for light taken.
        `albedo` stands in where the material has none of its own.
        """
        reflected = self.albedo if self.albedo is not None else albedo
        per_state = np.pi * self.emission @ self.bands.widths_nm
        given = per_state @ np.nan_to_num(self.ke_m2_per_J)
        excess: Array = np.clip(given - (1.0 - (0.0 if reflected is None else reflected)), 0.0, None)
        return excess

    def to_json(self) -> str:
        """Return the material file's text; `from_json` gives back the same numbers to the last bit."""
        data: dict[str, Any] = {
            "schema": SCHEMA,
            "name": self.name,
            "band_edges_nm": self.bands.edges_nm.tolist(),
            "kr_per_s": self.kr_per_s.tolist(),
            "ke_m2_per_J": _nullable(self.ke_m2_per_J),
            "ke_upper_limit": _nullable(self.ke_upper_limit),
            "emission": self.emission.tolist(),
            "albedo": None if self.albedo is None else self.albedo.tolist(),
            "calibration": self.calibration,
            "reference_irradiance": None
            if self.reference_irradiance is None
            else self.reference_irradiance.tolist(),
            "standard_error": self.standard_error,
            "covariance": self.covariance,
            "valid_s": None if self.valid_s is None else list(self.valid_s),
            "maps": dict(self.maps) or None,
            "provenance": dict(self.provenance) or None,
        }
        rows = ",\n".join(
            f"  {json.dumps(k)}: {json.dumps(v, ensure_ascii=False, allow_nan=False)}"
            for k, v in data.items()
        )
        return f"{{\n{rows}\n}}\n"

    @classmethod
    def from_json(cls, text: str, *, file: str | PathLike[str] | None = None) -> Material:
        """Read a material file's text.

        Raises:
            PhoslabError: the text is malformed or of an unknown version; the error names `file` and the field.
        """
        data = schemas.read_json(text, file=file)
        version = data.get("schema") if isinstance(data, dict) else None
        if version != SCHEMA:
            raise PhoslabError(
                f"is {version!r}, which this version of phoslab cannot read",
                file=file,
                field="schema",
                remedy=f"It reads {SCHEMA!r}; use a phoslab that knows the other one.",
            )
        schemas.check(data, "material-1", file=file)
        try:
            return cls(
                name=data["name"],
                bands=Bands(np.array(data["band_edges_nm"])),
                kr_per_s=_array(data, "kr_per_s"),
                ke_m2_per_J=_array(data, "ke_m2_per_J"),
                emission=_array(data, "emission"),
                calibration=data["calibration"],
                ke_upper_limit=_optional(data, "ke_upper_limit"),
                albedo=_optional(data, "albedo"),
                reference_irradiance=_optional(data, "reference_irradiance"),
                standard_error=data.get("standard_error"),
                covariance=data.get("covariance"),
                valid_s=None if data.get("valid_s") is None else tuple(data["valid_s"]),
                maps=data.get("maps") or {},
                provenance=data.get("provenance") or {},
            )
        except PhoslabError as error:
            raise PhoslabError(error.problem, remedy=error.remedy, file=file, field=error.field) from error

    def save(self, path: str | PathLike[str]) -> None:
        """Write the material file, whole or not at all. Its maps are not written: see `phoslab.maps`."""
        write_text(path, self.to_json())

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Material:
        """Read a material file.

        Raises:
            PhoslabError: it is missing, malformed or of an unknown version.
        """
        file = Path(path)
        remedy = "Name a material .json file, or a preset (`phoslab presets` lists them)."
        content = read_regular(file, _LARGEST_BYTES, remedy=remedy)
        try:
            text = content.decode("utf-8")
        except UnicodeDecodeError as error:
            raise PhoslabError("is not UTF-8 text", file=file, remedy=remedy) from error
        return replace(cls.from_json(text, file=file), folder=file.parent)


def _nullable(values: Array | None) -> Any:
    return None if values is None else [[None if np.isnan(v) else v for v in row] for row in values.tolist()]


def _array(data: dict[str, Any], name: str) -> Array:
    """Return a field as an array with NaN for null; rows of unlike length are an error that names the field."""
    rows = data[name]
    if isinstance(rows[0], list) and len({len(row) for row in rows}) > 1:
        raise PhoslabError(
            "has rows of unlike length", field=name, remedy="Give one value a band in every row."
        )
    return np.array(rows, dtype=np.float64)


def _optional(data: dict[str, Any], name: str) -> Array | None:
    return None if data.get(name) is None else _array(data, name)
