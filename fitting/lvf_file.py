"""lvf.json: a calibration of a linear variable filter as a file (docs/formats-lvf.md)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab import __version__, journal, schemas
from phoslab.errors import PhoslabError
from phoslab.files import read_regular, sha256, write_text
from phoslab.fitting.card import Shading
from phoslab.fitting.lvf import POSITIONS_NM, Calibration
from phoslab.fitting.lvf_curves import GRID_NM, X_NM, Curves
from phoslab.fitting.photon_transfer import Noise
from phoslab.fitting.sensitivities import Sensitivities
from phoslab.fitting.settings import Settings
from phoslab.fitting.wavelength_map import Feature, WavelengthMap
from phoslab.strip import Strip

Array = NDArray[np.float64]

SCHEMA = "phoslab-lvf/1"
_LARGEST_BYTES = 1 << 24


def save(calibration: Calibration, path: Path) -> None:
    """Write a calibration, whole or not at all."""
    c = calibration
    curves = c.curves
    data = {
        "schema": SCHEMA,
        "software": __version__,
        "sessions": [{"name": n, "plan": p, "sha256": h} for n, p, h in c.sessions],
        "simulated": c.simulated,
        "strip": {
            "shape_px": list(c.strip.shape),
            "angle_deg": c.strip.angle_deg,
            "top_px": list(c.strip.top),
            "bottom_px": list(c.strip.bottom),
            "slant": c.strip.slant,
            "ends_px": list(c.strip.ends_px),
        },
        "wavelengths": {
            "ends_px": list(c.map.ends_px),
            "chebyshev_nm": c.map.coefficients_nm.tolist(),
            "covariance_nm2": c.map.covariance_nm2.tolist(),
            "width_nm": c.map.width_nm,
            "misfit": c.map.misfit,
            "mercury": [
                {"line_nm": f.name, "seen": f.seen, "off_nm": f.off_nm if f.seen else None}
                for f in c.map.features
            ],
        },
        "positions_nm": POSITIONS_NM.tolist(),
        "places_px": _listed(c.places_px),
        "curves": None
        if curves is None
        else {
            "wavelengths_nm": GRID_NM.tolist(),
            "transmission": _listed(curves.curve),
            "standard_error": _listed(curves.standard_error),
            **_covariance_listed(curves.covariance),
            "absolute": c.absolute,
            "misfit": curves.misfit,
            "scale": curves.scale,
            "degrees": curves.degrees,
            "strength": curves.strength,
            "at_end": curves.at_end,
        },
        "camera": {
            "name": c.sensitivities.name,
            "gains": c.map.gains.tolist(),
            "wavelengths_nm": c.sensitivities.nm.tolist(),
            "sensitivities": c.sensitivities.values.tolist(),
        },
        "settings": [
            {"kind": kind, "value": value, "log_gain": log, "standard_error": error}
            for (kind, value), (log, error) in sorted(c.settings.corrections.items())
        ],
        "settings_misfit": c.settings_misfit,
        "noise": [
            {
                "iso": iso,
                "gain_dn_per_e": list(n.gain),
                "read_dn": list(n.read_dn),
                "dark_dn_per_s": None if n.dark_dn_per_s is None else list(n.dark_dn_per_s),
                "pairs": n.pairs,
                "chi2_per_dof": n.chi2_per_dof,
            }
            for iso, n in sorted(c.noise.items())
        ],
        "shading": None
        if c.shading is None
        else {
            "shape_px": list(c.shading.shape),
            "coefficients": c.shading.coefficients.tolist(),
            "misfit": c.shading.misfit,
        },
        "light": c.light,
        "filters": list(c.filters),
        "warnings": list(c.warnings),
    }
    write_text(path, json.dumps(data, allow_nan=False) + "\n")


def load(path: Path) -> tuple[Calibration, str]:
    """Read a calibration; also the file's SHA-256, by which results name it.

    Raises:
        PhoslabError: the file is missing, no calibration, of another version, or does not fit the schema.
    """
    remedy = "Write it with `phoslab calibrate SESSION... -o lvf.json`, and name that file."
    try:
        text = read_regular(path, _LARGEST_BYTES, remedy=remedy).decode("utf-8")
    except UnicodeDecodeError as error:
        raise PhoslabError("is not UTF-8 text", file=path, remedy=remedy) from error
    try:
        data = schemas.read_json(text, file=path)
    except PhoslabError as error:
        raise PhoslabError(
            f"is no calibration of the filter: it {error.problem}", file=path, remedy=remedy
        ) from error
    kind = data.get("schema") if isinstance(data, dict) else None
    if not isinstance(kind, str) or not kind.startswith(SCHEMA.partition("/")[0]):
        what = "is a material" if str(kind).startswith("phoslab-material") else f"has the schema {kind!r}"
        raise PhoslabError(f"{what}, and is no calibration of the filter", file=path, remedy=remedy)
    journal.check_version(data.get("schema"), SCHEMA, path, "schema")
    schemas.check(data, "lvf-1", file=path)
    try:
        return _calibration(data), sha256(path)
    except (ValueError, TypeError) as error:
        raise PhoslabError(
            f"holds tables that do not fit together ({error})", file=path, remedy=remedy
        ) from error


def _calibration(data: dict[str, Any]) -> Calibration:
    strip, at, curves, camera = (data[k] for k in ("strip", "wavelengths", "curves", "camera"))
    coefficients = np.array(at["chebyshev_nm"], float)
    covariance = np.array(at["covariance_nm2"], float)
    places = _array(data["places_px"])
    nm, values = np.array(camera["wavelengths_nm"], float), np.array(camera["sensitivities"], float)
    if (
        covariance.shape != (coefficients.size,) * 2
        or places.shape != POSITIONS_NM.shape
        or values.shape != (nm.size, 3)
    ):
        raise ValueError("wavelengths, places_px or camera")
    if data["positions_nm"] != POSITIONS_NM.tolist():
        raise ValueError("positions_nm are not 400, 410 ... 700")
    read = None
    if curves is not None:
        curve, error = _array(curves["transmission"]), _array(curves["standard_error"])
        if curves["wavelengths_nm"] != GRID_NM.tolist() or not (
            curve.shape == error.shape == (POSITIONS_NM.size, GRID_NM.size)
        ):
            raise ValueError("curves")
        read = Curves(
            curve,
            error,
            **{k: curves[k] for k in ("misfit", "scale", "degrees", "strength", "at_end")},
            covariance=_covariance(curves),
        )
    ends = (float(at["ends_px"][0]), float(at["ends_px"][1]))
    shading = data.get("shading")  # files of before it was measured have none
    return Calibration(
        strip=Strip(
            shape=(strip["shape_px"][0], strip["shape_px"][1]),
            angle_deg=strip["angle_deg"],
            top=(strip["top_px"][0], strip["top_px"][1]),
            bottom=(strip["bottom_px"][0], strip["bottom_px"][1]),
            slant=strip["slant"],
            ends_px=(strip["ends_px"][0], strip["ends_px"][1]),
        ),
        map=WavelengthMap(
            ends_px=ends,
            coefficients_nm=coefficients,
            covariance_nm2=covariance,
            width_nm=at["width_nm"],
            features=tuple(
                Feature(f["line_nm"], f["seen"], float("nan") if f["off_nm"] is None else f["off_nm"])
                for f in at["mercury"]
            ),
            gains=np.array(camera["gains"], float),
            misfit=at["misfit"],
        ),
        places_px=places,
        curves=read,
        absolute=curves is not None and curves["absolute"],
        sensitivities=Sensitivities(camera["name"], nm, values),
        settings=Settings(
            {(s["kind"], s["value"]): (s["log_gain"], s["standard_error"]) for s in data["settings"]}
        ),
        light=data["light"],
        filters=tuple(data["filters"]),
        sessions=tuple((s["name"], s["plan"], s["sha256"]) for s in data["sessions"]),
        simulated=data["simulated"],
        warnings=tuple(data["warnings"]),
        settings_misfit=data["settings_misfit"],
        noise={
            n["iso"]: Noise(
                gain=_with_error(n["gain_dn_per_e"]),
                read_dn=_with_error(n["read_dn"]),
                dark_dn_per_s=None if n["dark_dn_per_s"] is None else _with_error(n["dark_dn_per_s"]),
                pairs=n["pairs"],
                chi2_per_dof=n["chi2_per_dof"],
            )
            for n in data["noise"]
        },
        shading=None if shading is None else _shading(shading),
    )


# Of a covariance: a file has 31 times a thousand numbers. What they round off moves a variance by less than this share
# of the largest.
DIGITS = 7
ROUNDED = 1e-5


def _covariance_listed(covariance: Array | None) -> dict[str, Any]:
    """The fields that hold the curves' covariance; none where it is not known."""
    if covariance is None:
        return {}
    lower = np.tril_indices(covariance.shape[1])
    return {
        "nodes": X_NM.tolist(),
        "covariance": [
            None if np.isnan(c).any() else [float(f"{v:.{DIGITS}g}") for v in c[lower]] for c in covariance
        ],
    }


def _covariance(curves: dict[str, Any]) -> Array | None:
    """(n_k, n_x + 1, n_x + 1) the curves' covariance, NaN where there is no curve; None if the file has none."""
    if "covariance" not in curves:
        return None
    size = X_NM.size + 1
    lower = np.tril_indices(size)
    covariance = np.full((POSITIONS_NM.size, size, size), np.nan)
    if curves.get("nodes") != X_NM.tolist():
        raise ValueError("the curves' nodes")
    for k, values in enumerate(curves["covariance"]):
        if values is not None:
            if len(values) != lower[0].size:
                raise ValueError("the curves' covariance")
            covariance[k][lower] = values
            covariance[k].T[lower] = values
            known, along = np.linalg.eigh(covariance[k])
            if known[0] < -ROUNDED * known[-1]:
                raise ValueError("the curves' covariance, in which some variance is negative")
            covariance[k] = along * np.maximum(known, 0.0) @ along.T
    return covariance


def _shading(data: dict[str, Any]) -> Shading:
    shape = (data["shape_px"][0], data["shape_px"][1])
    return Shading(shape, np.array(data["coefficients"], float), data["misfit"])


def _with_error(values: list[float]) -> tuple[float, float]:
    return values[0], values[1]


def _listed(values: Array) -> list[Any]:
    """Lists with null for NaN."""
    listed = values.astype(object)
    listed[np.isnan(values)] = None
    return list(listed.tolist())


def _array(values: list[Any]) -> Array:
    """NaN for null."""
    return np.array(values, dtype=float)
