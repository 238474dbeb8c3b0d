"""The trade of glow transport: what each way costs, and how far it is from a path tracer, on this machine, in one run.

Every way of `glow_methods` that offers settings here is drawn at each of them: the time of a picture of a new view
(what holds while nothing moves apart: cells, and the path tracer's own scene), and of a later picture of the same
view. Mitsuba's `path` traces the same light with a few paths a pixel, as it comes and behind the same filter. The
truth is Mitsuba with many, twice: the product of the differences from both holds none of their noise.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phoslab.app.trades.page import Plot, Section, Table, write_trade
from phoslab.errors import PhoslabError
from phoslab.render import TransportParameters, load_scene
from phoslab.render.device import Device
from phoslab.render.glow_methods import METHODS
from phoslab.render.path_tracer import trace
from phoslab.render.reference import Reference
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.render.tiles import Tiles
from phoslab.sample_data import scene_confetti
from phoslab.sample_data.make_scenes import WRITERS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float32]
Progress = Callable[[int, int], None]

# By scene, the moment that is looked at: shortly after the light went off, where there was one.
MOMENTS = {
    "cornell": "off+1s",
    "occluder": "0",
    "corridor": "off+1s",
    "confetti": "0",
    "confetti-charged": "off+1s",
}

# The last: emission that varies over ten thousand triangles.
_WRITERS: dict[str, Callable[[Path], None]] = {
    **WRITERS,
    "confetti-charged": partial(scene_confetti.write, charged=True),
}

# What a way offers; one that is not named here is drawn at its defaults.
SETTINGS: dict[str, Sequence[dict[str, Any]]] = {
    "tiles": (
        {"directions": 1},
        {"directions": 2},
        {"directions": 4},
        {"directions": 8},
        {"directions": 32},
        {"directions": 8, "cell": 0.05},
        {"directions": 8, "cell": 0.0125},
        {"directions": 8, "detail": 0.15},
        {"directions": 8, "detail": 0.6},
    ),
    "dss": ({"epsilon": 0.08}, {"epsilon": 0.02}, {"surfel": 0.04}, {"levels": 2}, {"levels": 4}),
    "dss-z": ({"directions": 1}, {"directions": 4}, {"epsilon": 0.08}, {"surfel": 0.04}, {"levels": 4}),
}
PATHS = (1, 4, 16, 64)
# What has taken so long is not measured again.
LONG_S = 20.0
SUPERSAMPLING = 2
FEWER_PATHS = (1, 4, 16)


@dataclass(frozen=True)
class Point:
    """One way at one setting in one scene.

    Args:
        error: of reflected light: see `relative_error`.
        first_ms: of a picture of a new view.
        again_ms: of a later picture of the same view.
    """

    scene: str
    method: str
    setting: str
    error: float
    first_ms: float
    again_ms: float


def relative_error(a: Floats, one: Floats, two: Floats) -> float:
    """Return the mean of (a - r)² / (r² + 1e-4), all over the brightest value of r, the mean of `one` and `two`.

    The square is the product of the differences from one and from two, whose noise is independent and has mean 0.

    >>> r = np.array([1.0, 0.0])
    >>> round(relative_error(np.array([0.9, 0.0]), r, r), 4)
    0.005
    """
    r = (one.astype(np.float64) + two) / 2
    scale = float(r.max(initial=0.0)) or 1.0
    return float(np.mean((a - one) * (a.astype(np.float64) - two) / (r**2 + 1e-4 * scale**2)))


def measure(folder: Path, *, quick: bool, progress: Progress) -> tuple[list[str], list[Path]]:
    """Run every measurement; the page grows with each scene. Return its summary and the files.

    Raises:
        PhoslabError: Mitsuba is not installed.
    """
    check_reference()
    names = ("cornell",) if quick else tuple(MOMENTS)
    size, truth_samples, runs = ((96, 96), 64, 1) if quick else ((512, 512), 128, 3)
    points: list[Point] = []
    summary: list[str] = []
    written: list[Path] = []
    with tempfile.TemporaryDirectory() as temporary, Device() as device:
        for k, name in enumerate(names):
            progress(k, len(names))
            scene_folder = in_three_bands(name, Path(temporary))
            bench = _Bench(device, name, scene_folder, size, runs)
            with device.scope():
                points += bench.measure(truth_samples, FEWER_PATHS if quick else PATHS, quick)
            summary = [line for n in names for line in _verdicts(n, [p for p in points if p.scene == n])]
            if k + 1 < len(names):
                summary.append(f"Not finished: {k + 1} of {len(names)} scenes are measured.")
            caption = (
                f"Glow that is reflected once, {size[0]} x {size[1]} pixels of {SUPERSAMPLING}² samples, three bands, "
                f"against twice {truth_samples} paths a pixel. First: a new view, where only what moves with the scene "
                "was there; Mitsuba's time is without its set-up of the scene."
            )
            data = {"quick": quick, "complete": k + 1 == len(names), "points": [vars(p) for p in points]}
            title = "Glow that lights other things: speed against accuracy"
            written = write_trade(
                folder, "gi", title, summary, [_section(points, caption)], data, gl=device.renderer
            )
    progress(len(names), len(names))
    return summary, written


def _section(points: Sequence[Point], caption: str) -> Section:
    columns = ("scene", "method", "setting", "relative squared error", "first [ms]", "again [ms]")
    rows = [(p.scene, p.method, p.setting, p.error, p.first_ms, p.again_ms) for p in points]
    plot = Plot(
        "precision", "Error against the time of a new view; both fall to the lower left.", _plot(points)
    )
    return Section("What does an error cost?", [PROSE], [plot, Table("points", caption, columns, rows)])


PROSE = (
    "The path tracer's error is noise, whose square falls with the paths; what is filtered, ours and its own, keeps "
    "the filter's blur. Most of the gain over raw paths is the filter: both comparisons are given."
)


def in_three_bands(name: str, folder: Path) -> Path:
    """Write a sample scene, to be rendered in three bands."""
    copy = folder / name
    copy.mkdir(parents=True, exist_ok=True)
    _WRITERS[name](copy)
    toml = copy / "scene.toml"
    text = toml.read_text(encoding="utf-8")
    toml.write_text(
        text.replace("[render]\n", "[render]\nbands_nm = [400, 500, 600, 700]\n"), encoding="utf-8"
    )
    return copy


class _Bench:
    """One scene at one moment: its glow, by any way, as it is reflected alone."""

    def __init__(self, device: Device, name: str, folder: Path, size: tuple[int, int], runs: int) -> None:
        self._device, self._name, self._size, self._runs = device, name, size, runs
        self._scene = load_scene(folder)
        self._moment_s = self._scene.schedule.parse_time(MOMENTS[name])

    def measure(self, truth_samples: int, paths: Sequence[int], quick: bool) -> Iterator[Point]:
        """Yield a point for each way and setting."""
        renderer = self._renderer("tiles", {})
        tiles, reference = renderer.transport, self._renderer("reference", {"samples": 1}).transport
        assert isinstance(tiles, Tiles)
        assert isinstance(reference, Reference)
        self._truth = [self._paths(reference, truth_samples, seed=seed) for seed in (0, 1)]
        for method, settings in self._ways(quick):
            for setting in settings:
                with self._device.scope():
                    yield self._drawn(method, setting)
        empty_s = min(self._timed(reference, 1, reflections=0)[1] for _ in range(2))
        for n in paths:
            picture, s = self._timed(reference, n)
            # The same seed has the same rays from the camera, so what comes from where they end is taken off.
            picture -= self._paths(reference, n, reflections=0, direct=True)
            yield self._traced("mitsuba", n, picture, s - empty_s, 0.0)
            light = self._paths(reference, n, white=True)
            filtered, filter_s = self._filtered(renderer, tiles, light)
            yield self._traced("mitsuba, filtered", n, filtered, s - empty_s, filter_s)

    def _ways(self, quick: bool) -> Iterator[tuple[str, Sequence[dict[str, Any]]]]:
        for method in METHODS:
            if method != Reference.name:
                settings = SETTINGS.get(method, ({},))
                yield method, settings[: 4 if method == Tiles.name else 1] if quick else settings

    def _renderer(self, method: str, setting: dict[str, Any]) -> Renderer:
        transport = TransportParameters(method, **setting)
        renderer = Renderer(
            self._device, self._scene, RenderParameters(self._size, SUPERSAMPLING, transport=transport)
        )
        renderer.frame(self._moment_s)
        return renderer

    def _drawn(self, method: str, setting: dict[str, Any]) -> Point:
        renderer = self._renderer(method, setting)
        transport, device = renderer.transport, self._device
        assert transport is not None
        first: list[float] = []
        again: list[float] = []
        while len(first) < self._runs and sum(first) < LONG_S:
            device.ctx.finish()
            begin = time.perf_counter()
            transport.prepare()
            device.ctx.finish()
            prepared_s = time.perf_counter() - begin
            again.append(self._reflected(renderer, lambda: transport.run(renderer.direct_light.radiance)))
            first.append(prepared_s + again[-1])
        error = relative_error(renderer.resolve.read(), *self._truth)
        said = ", ".join(f"{k} {v:g}" for k, v in setting.items()) or "default"
        return Point(self._name, method, said, error, 1e3 * median(first), 1e3 * median(again))

    def _reflected(self, renderer: Renderer, add: Callable[[], None]) -> float:
        """Resolve what one way adds to a black picture; return how long that way took."""
        renderer.direct_light.run(renderer.gbuffer, renderer.drawables, {})
        self._device.ctx.finish()
        begin = time.perf_counter()
        add()
        self._device.ctx.finish()
        took_s = time.perf_counter() - begin
        renderer.resolve.run(renderer.direct_light.radiance)
        return took_s

    def _paths(
        self, reference: Reference, samples: int, *, seed: int = 2, white: bool = False, **more: Any
    ) -> Floats:
        """Return the light of one reflection by so many paths a pixel.

        Args:
            white: as if what the camera sees reflected all: E / π.
            more: of `trace`, in place of one reflection alone.
        """
        how = {"reflections": 1, "direct": False, **more}
        meshes, cameras = reference.meshes(white=white), [self._scene.camera]
        return trace(meshes, cameras, self._size, samples=samples, seed=seed, grid=SUPERSAMPLING, **how)

    def _timed(self, reference: Reference, samples: int, **more: Any) -> tuple[Floats, float]:
        """Return all light by so many paths a pixel, and its time: what comes directly is not traced a second time."""
        took: list[float] = []
        while len(took) < self._runs and sum(took) < LONG_S:
            begin = time.perf_counter()
            picture = self._paths(reference, samples, direct=True, **more)
            took.append(time.perf_counter() - begin)
        return picture, median(took)

    def _filtered(self, renderer: Renderer, tiles: Tiles, light: Floats) -> tuple[Floats, float]:
        took_s = self._reflected(renderer, lambda: tiles.reflect(light, renderer.direct_light.radiance))
        return renderer.resolve.read(), took_s

    def _traced(self, method: str, n: int, picture: Floats, traced_s: float, filter_s: float) -> Point:
        ms = 1e3 * (max(traced_s, 1e-4) + filter_s)
        return Point(self._name, method, f"{n} paths", relative_error(picture, *self._truth), ms, ms)


def _verdicts(name: str, points: Sequence[Point]) -> Iterator[str]:
    """Say how long tiles take to the error of the most raw paths, and to that of filtered ones."""
    if not points:
        return
    tiles = [p for p in points if p.method == Tiles.name]
    for method in ("mitsuba", "mitsuba, filtered"):
        rivals = [p for p in points if p.method == method]
        rival = rivals[-1] if method == "mitsuba" else min(rivals, key=lambda p: p.error)
        good = [p for p in tiles if p.error <= rival.error]
        if not good:
            best = min(tiles, key=lambda p: p.error)
            yield (
                f"{name}: {method} with {rival.setting} has the error {rival.error:.2g}, which tiles do not reach "
                f"(best {best.error:.2g}, {best.setting})."
            )
            continue
        quickest = min(good, key=lambda p: p.first_ms)
        yield (
            f"{name}: tiles ({quickest.setting}) have the error {quickest.error:.2g} in {quickest.first_ms:.0f} ms; "
            f"{method} with {rival.setting} has {rival.error:.2g} in {rival.first_ms:.0f} ms: "
            f"{rival.first_ms / quickest.first_ms:.2g} times as long."
        )


def _plot(points: Sequence[Point]) -> Figure:
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(p.scene for p in points))
    figure = Figure(figsize=(4.2 * len(names), 3.6), layout="constrained")
    for k, name in enumerate(names):
        axes = figure.add_subplot(1, len(names), k + 1)
        for method in dict.fromkeys(p.method for p in points):
            of = sorted(
                (p for p in points if (p.scene, p.method) == (name, method)), key=lambda p: p.first_ms
            )
            axes.loglog([p.first_ms for p in of], [p.error for p in of], "o-", label=method, markersize=4)
        axes.set(title=name, xlabel="time of a new view [ms]", ylabel="relative squared error")
        axes.grid(visible=True, which="major", alpha=0.3)
    axes.legend(fontsize="small")
    return figure


def check_reference() -> None:
    """Refuse before any work where there is no Mitsuba.

    Raises:
        PhoslabError: it is not installed.
    """
    import importlib.util

    if importlib.util.find_spec("mitsuba") is None:
        raise PhoslabError(
            "is not installed", field="the path tracer mitsuba", remedy="pip install 'phoslab[reference]'"
        )
