"""Compare deep screen space with the reference: python tests/benchmarks/deep_screen_space.py OUT [SCENE...]

For each scene and setting the relative squared error, mean((a - r)² / (r² + 1e-4)) over the brightest value, HDR-FLIP,
and the light that is reflected over that of the reference; and OUT/sheet.png: reference, dss, dss-z, and where the last
two differ (blue: too dark, red: too bright). References are kept in OUT and rendered only once. Three bands, 256².
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from PIL import Image

from phoslab.bands import Bands
from phoslab.colorimetry import display_srgb, xyz_matrix, xyz_to_linear_srgb
from phoslab.render import TransportParameters, load_scene, render
from phoslab.sample_data.make_scenes import SCENES

SIZE, SAMPLES = (256, 256), 256
TIMES = {"cornell": "off+1s", "occluder": "0", "corridor": "off+1s"}
SETTINGS = [
    TransportParameters("dss", epsilon=0.1, surfel=0.04),
    TransportParameters("dss"),
    TransportParameters("dss", epsilon=0.005, surfel=0.01),
    TransportParameters("dss-z", directions=1),
    TransportParameters("dss-z", directions=4),
    TransportParameters("dss-z"),
    TransportParameters("dss-z", surfel=0.01),
    TransportParameters("dss-z", epsilon=0.005, filter_px=8),
]


def picture(path: Path, time_text: str, transport: TransportParameters) -> np.ndarray:
    return render(path, [time_text], size=SIZE, supersampling=2, transport=transport)[0].radiance


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


def main(out: Path, names: list[str]) -> None:
    rows = []
    for name in names:
        path, when = three_bands(name, out), TIMES[name]
        kept = out / f"{name}.npy"
        if not kept.exists():
            np.save(kept, picture(path, when, TransportParameters("reference", samples=SAMPLES)))
        r = np.load(kept)
        none = picture(path, when, TransportParameters())
        bands = load_scene(path).transport
        to_xyz = xyz_matrix(bands)
        shown = {}
        for setting in SETTINGS:
            start = time.perf_counter()
            a = picture(path, when, setting)
            seconds = time.perf_counter() - start
            error = np.mean(((a - r) / r.max()) ** 2 / ((r / r.max()) ** 2 + 1e-4))
            sent = (a - none).sum() / (r - none).sum()
            flip = flip_of(r, a, bands)
            said = (
                f"{name} {setting.method} surfel {setting.surfel} epsilon {setting.epsilon} "
                f"directions {setting.directions} filter {setting.filter_px}"
            )
            print(f"{said}: {error:.2e}, FLIP {flip:.3f}, light {sent:.3f}, {seconds:.1f} s", flush=True)
            if setting in (SETTINGS[1], SETTINGS[5]):
                shown[setting.method] = a
        exposure = 1.0 / np.percentile((r @ to_xyz)[..., 1], 99)
        row = [display_srgb(v @ to_xyz, exposure) for v in (r, shown["dss"], shown["dss-z"])]
        for a in shown.values():
            off = (a - r).sum(axis=-1) / np.percentile(r.sum(axis=-1), 99)
            off = np.sign(off) * np.sqrt(np.abs(off).clip(0, 1))
            row.append(np.stack([off.clip(0, 1), np.zeros_like(off), (-off).clip(0, 1)], axis=-1))
        rows.append(np.concatenate(row, axis=1))
    sheet = (np.concatenate(rows, axis=0).clip(0, 1) * 255).round().astype(np.uint8)
    Image.fromarray(sheet).save(out / "sheet.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:] or list(TIMES))
