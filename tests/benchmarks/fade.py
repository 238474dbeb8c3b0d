"""Measure a film of a fade: python tests/benchmarks/fade.py

Two materials of two states at 512², ten minutes at 30 pictures a second: each is the sum of four pictures, shown as
sRGB and encoded. Beside it, pictures of a film of `cornell` one by one, in the dark and in the light, with things at
rest, a lamp that swings, and a camera that does, with tiles and without glow on other surfaces. Medians; the ratios are
what counts on a machine with other work.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

from phoslab.bands import Bands
from phoslab.render import FadeBasis, Frame, TransportParameters, load_scene
from phoslab.render.device import Device
from phoslab.render.film import Film
from phoslab.render.phosphor_state import Stepping
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.render.scene import Exposure, Scene
from phoslab.sample_data.make_scenes import SCENES

SIDE, RATES, RUNS, FPS = 512, (0.004, 0.01, 0.13, 0.4), 40, 30.0


def fade_ms() -> tuple[float, float]:
    """Return the time of a sum, and of a picture in the film."""
    rng = np.random.default_rng(0)
    bands = Bands.uniform()
    pictures = rng.random((len(RATES), SIDE, SIDE, bands.n), dtype=np.float32)
    basis = FadeBasis(0.0, np.array(RATES), pictures, bands)
    sums, films = [], []
    with (
        tempfile.TemporaryDirectory() as folder,
        Film(Path(folder) / "fade.mp4", (SIDE, SIDE), FPS, (Exposure(0.0, None),)) as film,
    ):
        for k in range(RUNS):
            begin = time.perf_counter()
            radiance = basis.at(k * 600 / RUNS)
            summed = time.perf_counter()
            film.show(Frame(k * 600 / RUNS, "", bands, radiance))
            films.append(time.perf_counter() - begin)
            sums.append(summed - begin)
    return 1e3 * median(sums), 1e3 * median(films)


class Swings:
    """A motion like that of a glTF file: one node of a scene goes to and fro, 10 cm, once in 2 s.

    Args:
        node: which; None: none.
    """

    span_s = (0.0, 60.0)

    def __init__(self, scene: Scene, node: int | None) -> None:
        self._node, self._world = node, {d.node: d.model_to_world for d in scene.drawables}
        self._world[scene.camera.index] = np.linalg.inv(scene.camera.world_to_view)
        for light in scene.lights:
            at = np.eye(4)
            at[:3, 3] = light.place.position_w
            self._world[light.place.index] = at

    def moved(self, node: int) -> bool:
        """Whether it is that node."""
        return node == self._node

    def at(self, t_s: float) -> dict[int, np.ndarray]:
        """Return (4, 4) where each node is."""
        world = dict(self._world)
        if self._node is not None:
            world[self._node] = world[self._node].copy()
            world[self._node][0, 3] += 0.1 * np.sin(np.pi * t_s)
        return world


def frame_ms(device: Device, name: str) -> dict[str, float]:
    """Return the times of whole frames of a film of a scene, with and without glow on other surfaces."""
    scene = load_scene(SCENES / name)
    moves = {
        "dark, at rest": ("off+1s", None),
        "lit, at rest": ("off-5s", None),
        "lit, moving light": ("off-5s", scene.lights[0].place.index),
        "dark, moving camera": ("off+1s", scene.camera.index),
    }
    taken: dict[str, list[float]] = {}
    for move, (begins, node) in moves.items():
        moving = replace(scene, motion=Swings(scene, node) if node is not None else None)
        t_s = scene.schedule.parse_time(begins)
        renderers = {
            method: Renderer(
                device,
                moving,
                RenderParameters(
                    (SIDE, SIDE), 2, Stepping(step_s=1 / FPS), transport=TransportParameters(method)
                ),
            )
            for method in ("none", "tiles")
        }
        for k in range(-1, 5):
            for method, renderer in renderers.items():
                begin = time.perf_counter()
                renderer.frame(t_s + k / FPS)
                device.ctx.finish()
                if k >= 0:
                    taken.setdefault(f"{method}, {move}", []).append(time.perf_counter() - begin)
    return {key: 1e3 * median(times) for key, times in taken.items()}


def main() -> None:
    sum_ms, film_ms = fade_ms()
    print(f"a sum of {len(RATES)} pictures: {sum_ms:.1f} ms; shown and encoded: {film_ms:.1f} ms")
    with Device() as device:
        for key, ms in frame_ms(device, "cornell").items():
            print(f"{key}: {ms:.0f} ms, {ms / sum_ms:.0f} times the sum")


if __name__ == "__main__":
    main()
