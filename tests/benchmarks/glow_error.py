"""How far glow is from the reference: python tests/benchmarks/glow_error.py OUT [SCENE...] [--gi WAY...]

For each scene and setting the relative squared error, mean((a - r)² / (r² + 1e-4)) over the brightest value, HDR-FLIP,
the light that is reflected over that of the reference, and a core's time; and OUT/SCENE-sheet.png: the reference, each
way at its default, and where these differ (blue: too dark, red: too bright). Two references of other paths, which are
kept in OUT, take the place of one: the mean of the product of both differences holds none of their noise, as FLIP
against their mean still does. Three bands, 2² samples a pixel.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from phoslab.app.trades.gi import MOMENTS, in_three_bands, relative_error
from phoslab.bands import Bands
from phoslab.colorimetry import display_srgb, xyz_matrix, xyz_to_linear_srgb
from phoslab.errors import PhoslabError
from phoslab.render import TransportParameters, load_scene, render

SETTINGS: dict[str, list[dict[str, Any]]] = {
    "tiles": [
        {},
        {"directions": 2},
        {"directions": 4},
        {"directions": 32},
        {"directions": 128},
        {"directions": 128, "cell": 1 / 400, "detail": 0.05},
    ],
    "dss": [{}, {"surfel": 0.04, "epsilon": 0.1}, {"epsilon": 0.005}, {"surfel": 0.01, "epsilon": 0.005}],
    "dss-z": [{}, {"directions": 1}, {"directions": 4}, {"guided": 0.0}, {"epsilon": 0.005, "filter_px": 8}],
}


def picture(path: Path, time_text: str, transport: TransportParameters, side: int) -> np.ndarray:
    return render(path, [time_text], size=(side, side), supersampling=2, transport=transport)[0].radiance


def flip_of(reference: np.ndarray, test: np.ndarray, bands: Bands) -> float:
    """Return the mean of HDR-FLIP."""
    import flip_evaluator

    to_rgb = xyz_matrix(bands) @ xyz_to_linear_srgb().T
    pictures = [np.maximum(v @ to_rgb, 0.0).astype("f4") for v in (reference, test)]
    return float(flip_evaluator.evaluate(*pictures, "HDR")[1])


def reference(path: Path, out: Path, when: str, side: int, samples: int) -> list[np.ndarray]:
    """Return two pictures of the same light by different paths."""
    pictures = []
    for seed in (0, 1):
        kept = out / f"{path.name}-{side}-{samples}-{seed}.npy"
        if not kept.exists():
            transport = TransportParameters("reference", samples=samples, seed=seed)
            np.save(kept, picture(path, when, transport, side))
        pictures.append(np.load(kept))
    return pictures


def compare(name: str, ways: list[str], out: Path, side: int, samples: int) -> None:
    path, when = in_three_bands(name, out), MOMENTS[name]
    one, two = reference(path, out, when, side, samples)
    r = (one + two) / 2
    none = picture(path, when, TransportParameters(), side)
    bands = load_scene(path).transport
    noise = np.mean((one - two) ** 2 / 4 / (r**2 + 1e-4 * r.max() ** 2))
    print(
        f"{name} reference: noise {noise:.1e}, FLIP of one half to the other {flip_of(one, two, bands):.3f}"
    )
    to_xyz = xyz_matrix(bands)
    shown = []
    for way in ways:
        for setting in SETTINGS[way]:
            said = ", ".join(f"{k} {v:g}" for k, v in setting.items()) or "default"
            start = time.process_time()
            try:
                a = picture(path, when, TransportParameters(way, **setting), side)
            except PhoslabError as refused:
                print(f"{name} {way}, {said}: {refused}", flush=True)
                continue
            seconds = time.process_time() - start
            error = relative_error(a, one, two)
            light = (a - none).sum() / (r - none).sum()
            figures = f"{error:.2e}, FLIP {flip_of(r, a, bands):.3f}, light {light:.3f}, {seconds:.1f} s"
            print(f"{name} {way}, {said}: {figures}", flush=True)
            if not setting:
                shown.append(a)
    exposure = 1.0 / np.percentile((r @ to_xyz)[..., 1], 99)
    row = [display_srgb(v @ to_xyz, exposure) for v in (r, *shown)]
    for a in shown:
        off = (a - r).sum(axis=-1) / np.percentile(r.sum(axis=-1), 99)
        off = np.sign(off) * np.sqrt(np.abs(off).clip(0, 1))
        row.append(np.stack([off.clip(0, 1), np.zeros_like(off), (-off).clip(0, 1)], axis=-1))
    sheet = (np.concatenate(row, axis=1).clip(0, 1) * 255).round().astype(np.uint8)
    Image.fromarray(sheet).save(out / f"{name}-sheet.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("scenes", nargs="*", default=list(MOMENTS))
    parser.add_argument("--gi", nargs="+", default=list(SETTINGS), choices=SETTINGS)
    parser.add_argument("--side", type=int, default=512, help="of the picture in pixels")
    parser.add_argument("--samples", type=int, default=512, help="of each of the two references")
    args = parser.parse_args()
    for name in args.scenes:
        compare(name, args.gi, args.out, args.side, args.samples)


if __name__ == "__main__":
    main()
