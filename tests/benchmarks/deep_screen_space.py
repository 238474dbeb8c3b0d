"""Compare deep screen space with the reference: python tests/benchmarks/deep_screen_space.py OUT [SCENE...]

For each scene and setting the relative squared error, mean((a - r)² / (r² + 1e-4)) over the brightest value, HDR-FLIP,
the light that is reflected over that of the reference, and a core's time; and OUT/SCENE-sheet.png: reference, dss,
dss-z, and where the last two differ (blue: too dark, red: too bright). References are kept in OUT and rendered only
once; with 512 paths a pixel their own noise is some 2e-3 of relative squared error. Three bands, 2² samples a pixel.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from PIL import Image

from phoslab.bands import Bands
from phoslab.colorimetry import display_srgb, xyz_matrix, xyz_to_linear_srgb
from phoslab.render import TransportParameters, load_scene, render
from phoslab.sample_data.make_scenes import SCENES

TIMES = {"cornell": "off+1s", "occluder": "0", "corridor": "off+1s", "confetti": "0"}
DSS, DSS_Z = TransportParameters("dss"), TransportParameters("dss-z")
SETTINGS = {
    "dss, surfel 0.04, epsilon 0.1": TransportParameters("dss", epsilon=0.1, surfel=0.04),
    "dss": DSS,
    "dss, surfel 0.01, epsilon 0.005": TransportParameters("dss", epsilon=0.005, surfel=0.01),
    "dss-z, 4 directions": TransportParameters("dss-z", directions=4),
    "dss-z": DSS_Z,
    "dss-z, none aimed": TransportParameters("dss-z", guided=0.0),
    "dss-z, epsilon 0.005, filter 8": TransportParameters("dss-z", epsilon=0.005, filter_px=8),
}


def picture(path: Path, time_text: str, transport: TransportParameters, side: int) -> np.ndarray:
    return render(path, [time_text], size=(side, side), supersampling=2, transport=transport)[0].radiance


def three_bands(name: str, out: Path) -> Path:
    """Return a copy of a sample scene in three bands."""
    folder = out / name
    folder.mkdir(parents=True, exist_ok=True)
    for file in (SCENES / name).iterdir():
        text = file.read_bytes().replace(b"[render]", b"[render]\nbands_nm = [400, 500, 600, 700]")
        (folder / file.name).write_bytes(text if file.suffix == ".toml" else file.read_bytes())
    return folder


def flip_of(reference: np.ndarray, test: np.ndarray, bands: Bands) -> float:
    """Return the mean of HDR-FLIP."""
    import flip_evaluator

    to_rgb = xyz_matrix(bands) @ xyz_to_linear_srgb().T
    pictures = [np.maximum(v @ to_rgb, 0.0).astype("f4") for v in (reference, test)]
    return float(flip_evaluator.evaluate(*pictures, "HDR")[1])


def compare(name: str, out: Path, side: int, samples: int) -> None:
    path, when = three_bands(name, out), TIMES[name]
    kept = out / f"{name}-{side}-{samples}.npy"
    if not kept.exists():
        np.save(kept, picture(path, when, TransportParameters("reference", samples=samples), side))
    r = np.load(kept)
    none = picture(path, when, TransportParameters(), side)
    bands = load_scene(path).transport
    to_xyz = xyz_matrix(bands)
    shown = []
    for said, setting in SETTINGS.items():
        start = time.process_time()
        a = picture(path, when, setting, side)
        seconds = time.process_time() - start
        error = np.mean(((a - r) / r.max()) ** 2 / ((r / r.max()) ** 2 + 1e-4))
        light = (a - none).sum() / (r - none).sum()
        flip = flip_of(r, a, bands)
        print(f"{name} {said}: {error:.2e}, FLIP {flip:.3f}, light {light:.2f}, {seconds:.1f} s", flush=True)
        if setting in (DSS, DSS_Z):
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
    parser.add_argument("scenes", nargs="*", default=list(TIMES))
    parser.add_argument("--side", type=int, default=512, help="of the picture in pixels")
    parser.add_argument("--samples", type=int, default=512, help="of the reference")
    args = parser.parse_args()
    for name in args.scenes:
        compare(name, args.out, args.side, args.samples)


if __name__ == "__main__":
    main()
