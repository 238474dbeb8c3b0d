"""Frames as files: PNG for people, OpenEXR for measurement.

The EXR follows the layout of Fichet et al. 2021, "An OpenEXR layout for spectral images": one float32 channel a
band, named by its centre (`S0.418,75nm`), beside X, Y and Z.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from phoslab import __version__
from phoslab.bands import Bands
from phoslab.colorimetry import display_srgb
from phoslab.exr import write_channels
from phoslab.files import replacing
from phoslab.render.frame import Frame
from phoslab.render.passes import Picture


def write_png(
    path: Path,
    frame: Frame,
    *,
    scene: str,
    solver: str,
    exposure: float,
    about: Mapping[str, str] | None = None,
) -> None:
    """Write the frame as a display shows it, 8-bit sRGB, with time, scene, solver and warnings as text."""
    from PIL.PngImagePlugin import PngInfo

    text = PngInfo()
    for key, value in {
        "Software": f"phoslab {__version__}",
        "Source": scene,
        "phoslab:time_s": repr(frame.time_s),
        "phoslab:solver": solver,
        "phoslab:exposure": repr(exposure),
        "phoslab:warnings": "\n".join(frame.warnings),
        **(about or {}),
    }.items():
        text.add_itxt(key, value)
    _write_rgb(path, display_srgb(frame.xyz, exposure), text)


def write_view(path: Path, view: Picture) -> None:
    """Write (h, w, 3) values in [0, 1] as they are."""
    _write_rgb(path, view, None)


def write_exr(
    path: Path, frame: Frame, *, scene: str, solver: str, about: Mapping[str, str] | None = None
) -> None:
    """Write the frame's band radiance and XYZ as float32, linear, in the scene's units."""
    names = band_channels(frame.bands)
    channels = {name: frame.radiance[..., k] for k, name in enumerate(names)}
    channels |= {name: frame.xyz[..., k] for k, name in enumerate("XYZ")}
    attributes = {
        "spectralLayoutVersion": "1.0",
        "emissiveUnits": "W.m^-2.sr^-1.nm^-1",
        "software": f"phoslab {__version__}",
        "phoslab:scene": scene,
        "phoslab:time_s": repr(frame.time_s),
        "phoslab:solver": solver,
        "phoslab:band_edges_nm": json.dumps(frame.bands.edges_nm.tolist()),
        "phoslab:warnings": "\n".join(frame.warnings),
        **(about or {}),
    }
    write_channels(path, channels, attributes)


def band_channels(bands: Bands) -> list[str]:
    """Name the channels of emitted radiance, with a decimal comma since a dot separates layers.

    >>> band_channels(Bands.uniform())[:2]
    ['S0.418,75nm', 'S0.456,25nm']
    """
    return ["S0." + f"{centre:.12g}".replace(".", ",") + "nm" for centre in bands.centres_nm]


def _write_rgb(path: Path, rgb: Picture, text: object) -> None:
    from PIL import Image

    eight_bit = np.round(np.clip(rgb, 0.0, 1.0) * 255).astype(np.uint8)
    with replacing(path) as temporary:
        Image.fromarray(eight_bit, mode="RGB").save(temporary, format="PNG", pnginfo=text)
