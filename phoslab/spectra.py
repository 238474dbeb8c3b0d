"""Named spectra, and files of spectra, as band means: lamps, LEDs, camera sensitivities.

A spectrum's shape is named by a short text that scenes, presets and the bench share:

    blackbody:3000      a thermal radiator at that many kelvin
    illuminant:D65      a CIE illuminant, as colour-science names it
    source:NAME         a measured light source of colour-science
    line:450,20         a Gaussian: centre and full width at half maximum in nm
    flat                the same at every wavelength
    NAME.csv            two columns, wavelength in nm and value, in the folder of the file that names it
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phoslab.bands import Bands
from phoslab.errors import PhoslabError
from phoslab.files import inside, read_regular

Array = NDArray[np.float64]

# Fine enough for fluorescent lines and camera sensitivities, which are published at 1 to 5 nm.
STEP_NM = 0.5

_LARGEST_CSV_BYTES = 1 << 24


def band_means(spectrum: Callable[[Array], Array], bands: Bands) -> Array:
    """Return (..., n_λ) the mean of `spectrum` over each band, by the midpoint rule at `STEP_NM` or finer.

    Args:
        spectrum: maps (n,) wavelengths in nm to (..., n) values.
    """
    means = []
    for low, high in zip(bands.edges_nm[:-1], bands.edges_nm[1:], strict=True):
        n = int(np.ceil((high - low) / STEP_NM))
        means.append(spectrum(low + (np.arange(n) + 0.5) * (high - low) / n).mean(axis=-1))
    return np.stack(means, axis=-1)


def shape(name: str, bands: Bands, *, folder: Path | None = None, file: Path, field: str) -> Array:
    """Return (n_λ,) the band means of a named spectrum, in its own scale.

    Args:
        name: see the head of this module.
        folder: where CSV files may lie.
        file, field: where the name stood, for the error.

    Raises:
        PhoslabError: the name is unknown, or its file is missing or malformed.
    """
    return band_means(spectrum(name, folder=folder, file=file, field=field), bands)


def unit_length(values: Array) -> Array:
    """Scale (n_λ,) band means to Euclidean length 1, as Nalbach 2017, 8.4.6, normalises its lamp."""
    scaled: Array = values / np.linalg.norm(values)
    return scaled


@cache
def camera_sensitivities(camera: str, *, file: Path | None = None) -> tuple[Array, Array]:
    """Return (n,) wavelengths in nm and (n, 3) RGB sensitivities of a camera that colour-science knows.

    Args:
        camera: its name there.
        file: where the name stood, for the error.

    Raises:
        PhoslabError: colour-science has no such camera.
    """
    import colour

    known = colour.MSDS_CAMERA_SENSITIVITIES
    if camera not in known:
        raise PhoslabError(
            f"{camera!r} is unknown",
            file=file,
            field="camera.sensitivities",
            remedy=f"Use one of: {', '.join(known)}.",
        )
    return np.asarray(known[camera].wavelengths, float), np.asarray(known[camera].values, float)


def camera_response(emission: Array, bands: Bands, camera: str) -> Array:
    """Return (..., 3) what a camera's RGB channels make of (..., n_λ) band-mean radiance, in its own scale."""
    wavelengths, sensitivities = camera_sensitivities(camera)

    def at(nm: Array) -> Array:
        return np.stack([np.interp(nm, wavelengths, s, left=0.0, right=0.0) for s in sensitivities.T])

    response: Array = emission @ (band_means(at, bands) * bands.widths_nm).T
    return response


def spectrum(name: str, *, folder: Path | None = None, file: Path, field: str) -> Callable[[Array], Array]:
    """Return a named spectrum as a function of wavelengths in nm, in its own scale; see `shape`."""
    kind, _, detail = name.partition(":")

    def unknown(remedy: str) -> PhoslabError:
        return PhoslabError(f"names an unknown spectrum {name!r}", file=file, field=field, remedy=remedy)

    if name == "flat":
        return np.ones_like
    if name.endswith(".csv"):
        path = inside(folder or file.parent, name, file=file, field=field)
        return _table(*_read_csv(path))
    if kind in ("blackbody", "line"):
        try:
            numbers = [float(part) for part in detail.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) != {"blackbody": 1, "line": 2}[kind] or not all(0 < x < 1e9 for x in numbers):
            raise unknown("Write `blackbody:KELVIN` or `line:CENTRE_NM,WIDTH_NM`, with positive numbers.")
        return _planck(numbers[0]) if kind == "blackbody" else _gaussian(*numbers)
    if kind in ("illuminant", "source"):
        import colour

        known = colour.SDS_ILLUMINANTS if kind == "illuminant" else colour.SDS_LIGHT_SOURCES
        if detail not in known:
            raise unknown(f"colour-science has: {', '.join(list(known)[:40])}.")
        return _table(np.asarray(known[detail].wavelengths, float), np.asarray(known[detail].values, float))
    raise unknown("Use blackbody:K, illuminant:NAME, source:NAME, line:NM,WIDTH, flat, or a .csv file.")


def _planck(kelvin: float) -> Callable[[Array], Array]:
    from colour.colorimetry import planck_law

    # Relative to its value at 560 nm, as the CIE's illuminant A is given.
    return lambda nm: np.asarray(planck_law(nm * 1e-9, kelvin) / planck_law(560e-9, kelvin), dtype=np.float64)


def _gaussian(centre_nm: float, fwhm_nm: float) -> Callable[[Array], Array]:
    return lambda nm: np.exp(-4 * np.log(2) * ((nm - centre_nm) / fwhm_nm) ** 2)


def _table(nm: Array, values: Array) -> Callable[[Array], Array]:
    return lambda at: np.interp(at, nm, values, left=0.0, right=0.0)


def _read_csv(path: Path) -> tuple[Array, Array]:
    remedy = "Give two columns, wavelength in nm and value, separated by a comma."
    try:
        text = read_regular(path, _LARGEST_CSV_BYTES, remedy=remedy).decode("utf-8")
        lines = [line for line in text.splitlines() if line and line[0] in "0123456789"]
        table = np.array([[float(x) for x in line.split(",")[:2]] for line in lines])
        nm, values = table.T
    except ValueError as error:
        raise PhoslabError(f"cannot be read as a spectrum ({error})", file=path, remedy=remedy) from error
    if nm.size < 2 or (np.diff(nm) <= 0).any() or not np.isfinite(values).all() or (values < 0).any():
        raise PhoslabError(
            "does not hold ascending wavelengths with values of 0 or more",
            file=path,
            remedy="Sort it by wavelength and remove what is negative or not a number.",
        )
    return nm, values
