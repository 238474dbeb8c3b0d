"""In the limited workers: what two frames of one thing differ by, in tiles (`phoslab.fitting.photon_transfer`)."""

from __future__ import annotations

from typing import Any

import numpy as np

from phoslab.raw_worker import SATURATED, decode, planes

TILES = 6
"""Each way: a frame is darker in its corners, so its tiles show several levels at once."""

_BEYOND = 5.0
"""Differences of more than so many standard deviations are not noise: hot pixels that flicker, a cosmic ray."""


def job_pair(path: str, other: str) -> dict[str, Any]:
    """Mean signal and noise variance of a pixel in each tile of each of LibRaw's colours, from two frames.

    Half the variance of their difference: what differs from pixel to pixel in both alike (gain, hot pixels) drops out.

    Returns:
        `mean`, `variance`, `n` (tiles,) in DN above black, DN² and pixels; `n_saturated`.
    """
    first, second = decode(path), decode(other)
    for frame in (first, second):
        if isinstance(frame, dict):
            return frame
    assert not isinstance(first, dict)
    assert not isinstance(second, dict)
    if first.values.shape != second.values.shape:
        return {
            "refused": "has another size than the frame it is paired with",
            "remedy": "Record the session anew with one camera.",
        }
    mean, variance, n, n_saturated = [], [], [], 0
    for cfa, (a, b) in planes(first.cfa, first.values, second.values):
        black, white = first.black[cfa], first.white[cfa]
        for strip_a, strip_b in zip(np.array_split(a, TILES), np.array_split(b, TILES), strict=True):
            for x, y in zip(
                np.array_split(strip_a, TILES, axis=1), np.array_split(strip_b, TILES, axis=1), strict=True
            ):
                good = np.maximum(x, y) < black + SATURATED * (white - black)
                n_saturated += int(good.size - np.count_nonzero(good))
                if np.count_nonzero(good) < 16 or np.count_nonzero(good) < 0.99 * good.size:
                    continue
                p, q = x[good].astype(float), y[good].astype(float)
                d = p - q - (p.mean() - q.mean())
                # As the tile's brightest quarter shows it: with an edge in the tile, the rest has less noise.
                bright = p >= np.quantile(p, 0.75)
                spread = max(1.4826 * float(np.median(np.abs(d[bright]))), 0.5)
                d = d[np.abs(d) < _BEYOND * spread]
                mean.append((p.mean() + q.mean()) / 2 - black)
                variance.append(float(np.sum(d**2)) / (d.size - 1) / 2)
                n.append(d.size)
    return {
        "mean": np.array(mean, dtype=float),
        "variance": np.array(variance, dtype=float),
        "n": np.array(n, dtype=np.int64),
        "n_saturated": n_saturated,
    }
