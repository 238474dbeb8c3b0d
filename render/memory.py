"""Whether what a picture takes is there: an answer before the work, not after."""

from __future__ import annotations

import os
from pathlib import Path

from phoslab.errors import PhoslabError
from phoslab.render.optics import layer_count

REMEDY = (
    "Ask for a smaller picture (--size), or for less supersampling, fewer atlas_texels or smaller textures."
)

# Of a sample of the G-buffer: position and coordinates of 16 bytes each, normal of 8, depth of 4.
_SAMPLE_BYTES = 44
_LAYER_BYTES = 16


def available_bytes() -> int:
    """Return the memory of this machine that is free, or would be if asked for."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        (free,) = (line.split()[1] for line in lines if line.startswith("MemAvailable:"))
        return int(free) * 1024
    except (OSError, ValueError):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def check_room(needed_bytes: int, what: str) -> None:
    """Refuse what takes more than the memory that is free.

    Raises:
        PhoslabError: it does; `what` takes it.
    """
    free = available_bytes()
    if needed_bytes > free:
        raise PhoslabError(
            f"takes {needed_bytes / 1e9:.3g} GB of memory, and {free / 1e9:.3g} GB are free",
            field=what,
            remedy=REMEDY,
        )


def picture_bytes(size: tuple[int, int], supersampling: int, n_bands: int, n_frames: int) -> int:
    """Return about how much the pictures take, from samples to colours.

    Args:
        size: (width, height) in pixels.
        supersampling: samples along the side of a pixel.
        n_bands: spectral bands of a sample.
        n_frames: how many pictures are kept until all are written.
    """
    pixels = size[0] * size[1]
    layers = layer_count(n_bands) * _LAYER_BYTES
    on_device = pixels * supersampling**2 * (_SAMPLE_BYTES + layers) + pixels * layers
    read_back = pixels * layers
    kept = n_frames * pixels * 4 * (n_bands + 3)
    in_colour = pixels * 8 * (n_bands + 9)
    return on_device + read_back + kept + in_colour
