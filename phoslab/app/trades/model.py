"""The trade of the model: what leaving out bands, states, texels, samples and reflections does to a picture, and saves.

Each scene is rendered at one moment of its darkness, small, with one choice changed at a time, and is held against the
same with everything on and glow followed to its end by the path tracer. What is learnt of each way (how far off it is
in what it does model, how long each part takes) is what `phoslab plan` reads.

Where processors draw, time is that of all of them together, which says the same on a machine that others use. Where a
graphics card draws, it is that on the clock.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.app.trades import model_page
from phoslab.app.trades.model_page import Point
from phoslab.app.trades.page import write_trade
from phoslab.model_plan import Choices, Surface
from phoslab.render import Scene, load_scene
from phoslab.render.device import Device
from phoslab.render.glow_methods import METHODS
from phoslab.render.glow_transport import NONE, TransportParameters
from phoslab.render.path_tracer import LLVM, SCALAR, UNLIMITED, trace, usual_variant
from phoslab.render.phosphor_state import Stepping
from phoslab.render.planning.bounds import radiance_error
from phoslab.render.planning.costs import FEATURES, PATH_FEATURES, Work, features
from phoslab.render.planning.drawn import render_choices
from phoslab.render.planning.pilot import Pilot, look
from phoslab.render.planning.reduced import whole
from phoslab.render.planning.spectrum_terms import fewest_bands
from phoslab.render.planning.state_terms import fewer_states
from phoslab.render.planning.texel_terms import PACKED
from phoslab.render.reference import Reference
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.trades import SOFTWARE_RENDERERS

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

SCENES = ("cornell", "occluder", "corridor")
SIDE, QUICK_SIDE = 64, 32
TRUTH_SAMPLES, QUICK_TRUTH_SAMPLES = 512, 64
SAMPLES = (8, 32, 128)

# Scenes that are more even than that tell nothing of others.
LEAST_UNEVENNESS = 0.01

# Paths a pixel that are timed, and how often: the shortest counts.
TIMED_SAMPLES, REPEATS = (4, 64), 3

# What a way is measured with, and after how many reflections; else with its defaults. The last two of tiles are for
# large pictures of which much is asked.
FINE = {"directions": 128, "filter_px": 2, "cell": 1 / 80, "detail": 0.15}
FINEST = {**FINE, "directions": 256, "cell": 1 / 160}
SETTINGS: dict[str, tuple[Sequence[dict[str, Any]], tuple[int, ...]]] = {
    "tiles": ([*({"directions": n} for n in (4, 8, 16, 64)), FINE, FINEST], (1, 3)),
    "dss-z": ([{"directions": n} for n in (4, 16)], (1,)),
}
REFERENCE = "reference"


@dataclass(frozen=True, eq=False)
class Case:
    """A scene, the moment at which it is looked at, and the size of the picture."""

    name: str
    scene: Scene
    time: str
    size: tuple[int, int]
    pilot: Pilot


@dataclass(frozen=True, eq=False)
class Run:
    """One rendering: what was chosen, its picture in XYZ, and how long it took."""

    case: Case
    choices: Choices
    picture: Array
    seconds: float


def measure(
    folder: Path, *, quick: bool, progress: Progress, scenes: Sequence[Path] = ()
) -> tuple[list[str], list[Path]]:
    """Run every measurement and write the page; return its summary and the files."""
    places = list(scenes) or [
        Path(str(files("phoslab.sample_data") / "scenes" / name)) for name in SCENES[: 1 if quick else None]
    ]
    size = (QUICK_SIDE, QUICK_SIDE) if quick else (SIDE, SIDE)
    samples = QUICK_TRUTH_SAMPLES if quick else TRUTH_SAMPLES
    cases = [_case(place, size) for place in places]
    points: list[Point] = []
    runs: list[Run] = []
    learnt: list[dict[str, Any]] = []
    with Device() as device:
        gl = device.renderer
        for k, case in enumerate(cases):
            progress(k, len(cases))
            own, said, known = _one_scene(device, case, samples, quick)
            points += said
            runs += own
            learnt.append(known)
    progress(len(cases), len(cases))
    uneven = max(LEAST_UNEVENNESS, *(case.pilot.reflected_unevenness for case in cases))
    data = {
        "quick": quick,
        "unevenness": uneven,
        **_conclusions(runs, learnt),
        "points": [vars(p) for p in points],
    }
    summary, sections = model_page.summary(points), model_page.sections(points, data)
    title = "What to model: speed against accuracy"
    return summary, write_trade(folder, "model", title, summary, sections, data, gl=gl)


def _case(place: Path, size: tuple[int, int]) -> Case:
    scene = load_scene(place)
    time_said = "off+1s" if scene.schedule.off_s is not None else scene.times[0]
    pilot = look(scene, [scene.schedule.parse_time(time_said)], size)
    return Case(scene.file.parent.name, scene, time_said, size, pilot)


def _one_scene(
    device: Device, case: Case, samples: int, quick: bool
) -> tuple[list[Run], list[Point], dict[str, Any]]:
    plain = whole(case.scene)
    # The first picture pays for what is loaded and compiled.
    _run(device, case, _with_gi(plain, method=REFERENCE, samples=1))
    truth = _run(device, case, _with_gi(plain, method=REFERENCE, samples=samples, full=True))
    once = _run(device, case, _with_gi(plain, method=REFERENCE, samples=samples))
    bare = _run(device, case, plain)
    runs = [truth, once, bare]
    points = [
        _point(truth, truth, "reflections", "all"),
        _point(once, truth, "reflections", "1"),
        _point(bare, truth, "reflections", "0"),
    ]
    known: dict[str, Any] = {"gi": [], "noise": [], "texels": [], "paths": _path_costs(device, case, plain)}

    traced = {1: once.picture}
    for method, parameters in _ways(quick):
        n = parameters.get("bounces", 1)
        if n not in traced:
            traced[n] = _run(
                device, case, _with_gi(plain, method=REFERENCE, samples=samples, bounces=n)
            ).picture
        choices = _with_gi(plain, method=method, **parameters)
        run = _run(device, case, choices)
        runs.append(run)
        points.append(_point(run, truth, "gi", _said(method, parameters)))
        reflected_so = float((traced[n] - bare.picture).mean())
        off = float(np.abs(run.picture - traced[n]).mean())
        known["gi"].append(
            {
                "method": method,
                "parameters": parameters,
                "error": off / reflected_so if reflected_so > 0 else 0.0,
                **_parts_s(device, case, choices, plain),
            }
        )
    reflected = float((truth.picture - bare.picture).mean())
    for n in SAMPLES[: 2 if quick else None]:
        # Of another seed than the truth, so that nothing cancels.
        run = _run(device, case, _with_gi(plain, method=REFERENCE, samples=n, full=True, seed=1))
        runs.append(run)
        points.append(_point(run, truth, "gi", f"reference, {n} samples"))
        if reflected > 0:
            # The truth is a mean of as many samples itself: both their noises are in the difference.
            noise = np.abs(run.picture - truth.picture).mean() / reflected
            known["noise"].append(float(noise / np.sqrt(1 / n + 1 / samples)))
    for dimension, setting, choices in _reductions(case, plain):
        run = _run(device, case, choices)
        runs.append(run)
        # Held against the same without reflections: what is left out alone.
        points.append(_point(run, bare, dimension, setting))
        if dimension == "texels":
            known["texels"].append((_width_px(case, choices), points[-1].error))
    return runs, points, known


def _path_costs(device: Device, case: Case, plain: Choices) -> dict[str, dict[str, float]]:
    """Return what paths cost, by each variant of Mitsuba that this machine has: `PATH_FEATURES` in s."""
    parameters = RenderParameters(
        case.size,
        case.scene.supersampling,
        stepping=Stepping(plain.solver, plain.step_s),
        transport=TransportParameters(REFERENCE),
    )
    with device.scope():
        renderer = Renderer(device, case.scene, parameters)
        if not isinstance(renderer.transport, Reference):
            return {}
        renderer.light(case.scene.schedule.parse_time(case.time))
        meshes, camera = renderer.transport.meshes(), renderer.gbuffer.camera
    clock = _clock(device)

    def seconds(variant: str, samples: int, runs: int = REPEATS) -> float:
        least = np.inf
        for _ in range(runs):
            begin = clock()
            trace(
                meshes,
                [camera],
                case.size,
                reflections=UNLIMITED,
                samples=samples,
                direct=False,
                grid=case.scene.supersampling,
                variant=variant,
            )
            least = min(least, clock() - begin)
        return least

    pictures = -(-case.scene.transport.n // 3)
    costs = {}
    for variant in dict.fromkeys((usual_variant(), SCALAR)):
        # A number of paths that no cache on this machine knows is compiled for, as that of most plans is.
        fresh = 2 * TIMED_SAMPLES[0] + time.time_ns() % 997
        start = max(seconds(variant, fresh, 1) - seconds(variant, fresh), 0.0) if variant == LLVM else 0.0
        few, many = (seconds(variant, n) for n in TIMED_SAMPLES)
        path = max(many - few, 0.0) / np.ptp(TIMED_SAMPLES) / pictures / (case.size[0] * case.size[1])
        picture = few / pictures - path * TIMED_SAMPLES[0] * case.size[0] * case.size[1]
        values = (start, max(picture, 0.0), path)
        costs[variant] = dict(zip(PATH_FEATURES, map(float, values), strict=True))
    return costs


def _parts_s(device: Device, case: Case, choices: Choices, plain: Choices) -> dict[str, float]:
    """Return what glow's way adds to a picture's time: once, and for each pixel, of pictures of two sizes."""
    w, h = case.size
    sizes = ((w, h), (2 * w, 2 * h))
    small, large = (
        _run(device, replace(case, size=size), choices).seconds
        - _run(device, replace(case, size=size), plain).seconds
        for size in sizes
    )
    s_per_pixel = max((large - small) / (3 * w * h), 0.0)
    return {"once_s": max(small - s_per_pixel * w * h, 0.0), "s_per_pixel": s_per_pixel}


def _ways(quick: bool) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield every way but the path tracer, with several settings and numbers of reflections if it knows more."""
    for method in METHODS:
        if method == REFERENCE:
            continue
        settings, bounces = SETTINGS.get(method, ([{"directions": TransportParameters.directions}], (1,)))
        for setting, reflections in itertools.product(settings[: 2 if quick else None], bounces):
            yield method, {**setting, "bounces": reflections}


def _reductions(case: Case, plain: Choices) -> Iterator[tuple[str, str, Choices]]:
    for n, (bands, _) in fewest_bands(case.scene, case.pilot).items():
        yield "bands", str(n), replace(plain, bands_nm=tuple(bands.edges_nm.tolist()))
    largest = max((s.atlas_texels for s in plain.surfaces.values()), default=0)
    texels = 8
    while texels < largest:
        surfaces = {
            k: replace(s, atlas_texels=min(texels, s.atlas_texels)) for k, s in plain.surfaces.items()
        }
        yield "texels", str(texels), replace(plain, surfaces=surfaces)
        texels *= 2
    best = {k: fewer_states(case.pilot, s) for k, s in case.pilot.sampled.items()}
    most = max((max(options) for options in best.values()), default=1)
    for n in range(1, most):
        states: dict[str, Surface] = dict(plain.surfaces)
        for k, options in best.items():
            name = case.scene.drawables[k].name
            states[name] = replace(states[name], states=options[min(n, max(options))][0])
        yield "states", f"at most {n}", replace(plain, surfaces=states)
    for state_format in ("f16", "unorm16", "f32c"):
        yield "state format", state_format, replace(plain, state_format=state_format)


def _width_px(case: Case, choices: Choices) -> float:
    """Return the width of a texel in pixels, of the surface whose texels are the widest."""
    widths = [
        case.pilot.side_px[k] / np.sqrt(PACKED) / choices.surfaces[d.name].atlas_texels
        for k, d in enumerate(case.scene.drawables)
        if d.phosphor is not None
    ]
    return float(max(widths))


def _with_gi(choices: Choices, **gi: Any) -> Choices:
    TransportParameters(**gi)
    return replace(choices, gi=gi)


def _said(method: str, parameters: dict[str, Any]) -> str:
    return ", ".join([method, *(f"{v} {k}" for k, v in parameters.items())])


def _clock(device: Device) -> Callable[[], float]:
    """Return what tells time in s."""
    software = any(name in device.renderer.lower() for name in SOFTWARE_RENDERERS)
    return time.process_time if software else time.perf_counter


def _run(device: Device, case: Case, choices: Choices) -> Run:
    clock = _clock(device)
    begin = clock()
    frames = render_choices(case.scene, choices, [case.time], case.size, device=device)
    took = clock() - begin
    return Run(case, choices, frames[0].xyz.astype(np.float64), took)


def _point(run: Run, against: Run, dimension: str, setting: str) -> Point:
    error = radiance_error(run.picture, against.picture, 1.0)
    return Point(run.case.name, dimension, setting, error, run.seconds)


def _conclusions(runs: Sequence[Run], learnt: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return what the planner reads: the worst scene counts for errors, and the whole for costs."""
    gi: dict[str, dict[str, Any]] = {}
    for known in learnt:
        for way in known["gi"]:
            key = _said(way["method"], way["parameters"])
            worst = gi.setdefault(key, dict(way))
            for field in ("error", "once_s", "s_per_pixel"):
                worst[field] = max(worst[field], way[field])
    texels = [(x, e) for known in learnt for x, e in known["texels"] if e > 1e-6 and x > 0]
    error, power = _power_law(texels)
    return {
        "texels": {"error": error, "power": power},
        "gi": list(gi.values()),
        "path_noise": max((n for known in learnt for n in known["noise"]), default=1.0),
        "costs_s": _fit_costs(runs),
        "paths_s": {
            variant: {
                f: float(np.mean([known["paths"][variant][f] for known in learnt])) for f in PATH_FEATURES
            }
            for variant in learnt[0]["paths"]
        },
    }


def _power_law(points: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return c and p such that no error exceeds c x^p, with the p that fits best."""
    if len(points) < 2:
        return 1.0, 1.0
    x, e = np.log(np.array(points)).T
    power = float(np.clip(np.polyfit(x, e, 1)[0], 0.5, 3.0))
    return float(np.exp((e - power * x).max())), power


def _fit_costs(runs: Sequence[Run]) -> dict[str, float]:
    """Return s for each feature, of pictures without transport: least squares of the relative error, none below 0."""
    from scipy.optimize import nnls

    rows, seconds = [], []
    for run in runs:
        if run.choices.gi["method"] == NONE:
            # One moment of darkness: light came on, and went off.
            count = features(run.choices, Work(run.case.size, run.case.scene.supersampling, 1, 1, 2))
            rows.append([count[name] for name in FEATURES])
            seconds.append(run.seconds)
    A, b = np.array(rows), np.array(seconds)
    scale = np.maximum(A.max(axis=0), 1e-300)
    solution, _ = nnls(A / b[:, None] / scale, np.ones(len(b)))
    return {name: float(s) for name, s in zip(FEATURES, solution / scale, strict=True)}
