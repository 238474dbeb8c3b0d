"""Spectral sensitivities of a camera: as colour-science names them, or from a JSON file as rawtoaces has them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.files import read_regular
from phoslab.schemas import read_json
from phoslab.spectra import camera_sensitivities

Array = NDArray[np.float64]

_LARGEST_BYTES = 1 << 22


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """What red, green and blue pixels make of light.

    Args:
        name: of the camera, or of the file.
        nm: (n,) ascending wavelengths.
        values: (n, 3); 0 beyond the ends.
    """

    name: str
    nm: Array
    values: Array

    @classmethod
    def of(cls, camera: str | Path | None, *, file: str | PathLike[str]) -> Sensitivities:
        """Look a name up, or read a file whose name ends with .json.

        Args:
            file: where the name stood, for the error.

        Raises:
            PhoslabError: there is no name, or nothing of that name; or the file is not of rawtoaces' form.
        """
        if camera is None:
            raise PhoslabError(
                "does not say which spectral sensitivities the camera has",
                file=file,
                remedy="Name them with --camera: a name that colour-science knows, or a rawtoaces JSON file.",
            )
        if str(camera).endswith(".json"):
            return _read(Path(camera))
        nm, values = camera_sensitivities(str(camera), file=Path(file))
        return cls(str(camera), nm, values)

    def at(self, nm: Array) -> Array:
        """(n, 3) at wavelengths (n,)."""
        return np.stack([np.interp(nm, self.nm, v, left=0.0, right=0.0) for v in self.values.T], axis=-1)

    def times(self, gains: Array) -> Sensitivities:
        """The same with each channel multiplied by one of `gains` (3,)."""
        return replace(self, values=self.values * gains)


def _read(path: Path) -> Sensitivities:
    remedy = "Give a camera file of rawtoaces: spectral_data.data.main maps wavelengths in nm to [R, G, B]."
    try:
        text = read_regular(path, _LARGEST_BYTES, remedy=remedy).decode("utf-8")
    except UnicodeDecodeError as error:
        raise PhoslabError("is not UTF-8 text", file=path, remedy=remedy) from error
    data = read_json(text, file=path)
    try:
        content = data["spectral_data"]
        order = [str(c).upper() for c in content["index"]["main"]]
        table: dict[str, Any] = content["data"]["main"]
        rows = sorted((float(nm), [float(x) for x in values]) for nm, values in table.items())
        nm = np.array([row[0] for row in rows])
        values = np.array([[row[1][order.index(c)] for c in "RGB"] for row in rows])
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise PhoslabError(
            f"is not a camera file of rawtoaces ({type(error).__name__}: {error})", file=path, remedy=remedy
        ) from error
    if (
        nm.size < 8
        or not np.isfinite(values).all()
        or (values < 0).any()
        or not (values.max(axis=0) > 0).all()
    ):
        raise PhoslabError(
            "does not hold sensitivities of 0 or more at 8 wavelengths or more in every channel",
            file=path,
            remedy=remedy,
        )
    if not math.isfinite(nm[0]) or (np.diff(nm) <= 0).any():
        raise PhoslabError("does not hold ascending wavelengths", file=path, remedy=remedy)
    return Sensitivities(path.name, nm, values)
