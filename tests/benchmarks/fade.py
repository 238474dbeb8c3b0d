"""Measure a film of a fade: python tests/benchmarks/fade.py

Two materials of two states at 512², ten minutes at 30 pictures a second: each is the sum of four pictures, shown as
sRGB and encoded. Beside it, one picture of tiles with all its rays (a new view) and without (a later one), and
the picture without glow transport. Medians; the ratios are what counts on a machine with other work.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from statistics import median

import numpy as np

from phoslab.bands import Bands
from phoslab.render import FadeBasis, Frame, TransportParameters, load_scene
from phoslab.render.device import Device
from phoslab.render.film import Film
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.render.scene import Exposure
from phoslab.sample_data.make_scenes import SCENES

SIDE, RATES, RUNS = 512, (0.004, 0.01, 0.13, 0.4), 40


def fade_ms() -> tuple[float, float]:
    """Return the time of a sum, and of a picture in the film."""
    rng = np.random.default_rng(0)
    bands = Bands.uniform()
    pictures = rng.random((len(RATES), SIDE, SIDE, bands.n), dtype=np.float32)
    basis = FadeBasis(0.0, np.array(RATES), pictures, bands)
    sums, films = [], []
    with (
        tempfile.TemporaryDirectory() as folder,
        Film(Path(folder) / "fade.mp4", (SIDE, SIDE), 30.0, (Exposure(0.0, None),)) as film,
    ):
        for k in range(RUNS):
            begin = time.perf_counter()
            radiance = basis.at(k * 600 / RUNS)
            summed = time.perf_counter()
            film.show(Frame(k * 600 / RUNS, "", bands, radiance))
            films.append(time.perf_counter() - begin)
            sums.append(summed - begin)
    return 1e3 * median(sums), 1e3 * median(films)


def frame_ms(device: Device, name: str) -> dict[str, float]:
    """Return the times of whole frames of a scene in the dark, with and without glow on other surfaces."""
    scene = load_scene(SCENES / name)
    t_s = scene.schedule.parse_time("off+1s")
    taken: dict[str, list[float]] = {}
    renderers = {
        method: Renderer(
            device, scene, RenderParameters((SIDE, SIDE), 2, transport=TransportParameters(method))
        )
        for method in ("none", "tiles")
    }
    for k in range(5):
        for method, renderer in renderers.items():
            for moves in ("at rest", "moving light", "moving camera"):
                begin = time.perf_counter()
                if moves == "moving light":
                    renderer.shadow_map.run()
                    for state in renderer.states:
                        state.excite()
                if moves == "moving camera":
                    renderer.gbuffer.run(scene.camera)
                    if renderer.transport is not None:
                        renderer.transport.prepare()
                renderer.frame(t_s + 0.01 * k)
                device.ctx.finish()
                taken.setdefault(f"{method}, {moves}", []).append(time.perf_counter() - begin)
    return {key: 1e3 * median(times) for key, times in taken.items()}


def main() -> None:
    sum_ms, film_ms = fade_ms()
    print(f"a sum of {len(RATES)} pictures: {sum_ms:.1f} ms; shown and encoded: {film_ms:.1f} ms")
    with Device() as device:
        for key, ms in frame_ms(device, "cornell").items():
            print(f"{key}: {ms:.0f} ms, {ms / sum_ms:.0f} times the sum")


if __name__ == "__main__":
    main()
