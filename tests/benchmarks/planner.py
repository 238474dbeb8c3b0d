"""How often a plan holds its bound, and how near it is to the cheapest: python tests/benchmarks/planner.py [-n 40]

Scenes are drawn from seeds (tests/render/planned_scenes.py). The truth has the material's own bands, all states, the
reference solver, and glow followed to its end by the path tracer with so many paths that their noise is a fifth of the
bound. A scene whose truth takes more than `--most` paths is passed over, and counted. `--sweep N` runs, for the first N
scenes, the plans of a grid in the order of their predicted cost until one holds the bound: that one is the cheapest.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from phoslab.errors import PhoslabError
from phoslab.model_plan import Choices
from phoslab.render import load_scene
from phoslab.render.device import Device
from phoslab.render.planning import render_choices, transport_terms
from phoslab.render.planning.bounds import parse_bound
from phoslab.render.planning.costs import load_costs
from phoslab.render.planning.planner import Planner, Request
from phoslab.render.planning.reduced import whole
from phoslab.render.planning.spectrum_terms import fewest_bands


def _drawn_scenes() -> Any:
    path = Path(__file__).parent.parent / "render" / "planned_scenes.py"
    spec = importlib.util.spec_from_file_location("planned_scenes", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["planned_scenes"] = module
    spec.loader.exec_module(module)
    return module


def grid(planner: Planner) -> list[Choices]:
    """Return the plans of the sweep: ways to transport glow, bands, texels."""
    plain = whole(planner.request.scene)
    bands = fewest_bands(planner.request.scene, planner.pilot)
    kept = [bands[n] for n in sorted({max(bands), min(n for n in bands if n >= min(6, max(bands)))})]
    return [
        replace(
            plain,
            bands_nm=tuple(b.edges_nm.tolist()),
            surfaces={
                k: replace(s, atlas_texels=max(16, s.atlas_texels // t)) for k, s in plain.surfaces.items()
            },
            gi=way.gi,
        )
        for way in transport_terms.ways(planner.pilot, planner.request.bound, planner.costs)
        for (b, _), t in itertools.product(kept, (1, 4))
    ]


def run(device: Device, planner: Planner, choices: Choices, truth: Any) -> tuple[float, float]:
    """Return the true error in the bound's unit, and the time in s."""
    request = planner.request
    begin = time.perf_counter()
    frames = render_choices(request.scene, choices, request.moments, request.size, device=device)
    return request.bound.error(frames[0].xyz, truth), time.perf_counter() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-n", type=int, default=40)
    parser.add_argument("--first", type=int, default=1000, help="the first seed")
    parser.add_argument("--side", type=int, default=64)
    parser.add_argument("--most", type=float, default=1e8, help="paths of a truth")
    parser.add_argument("--sweep", type=int, default=0)
    args = parser.parse_args()
    drawn_scenes, costs, size = _drawn_scenes(), load_costs(), (args.side, args.side)
    held, ratios, shares, passed_over = [], [], [], 0
    with Device() as device, tempfile.TemporaryDirectory() as work:
        for seed in range(args.first, args.first + args.n):
            drawn = drawn_scenes.draw(Path(work) / str(seed), seed)
            scene, bound = load_scene(drawn.folder), parse_bound(drawn.bound)
            moment = scene.schedule.parse_time(drawn.time)
            begin = time.perf_counter()
            try:
                planner = Planner(Request(scene, size, (drawn.time,), (moment,), bound), costs)
                plan = planner.plan()
            except PhoslabError as error:
                print(f"{seed} {bound} at {drawn.time}: {error}", flush=True)
                continue
            planning = time.perf_counter() - begin
            lamp, glow, bounces = planner.pilot.means()
            share = float(bounces.sum() / (lamp + glow + bounces.sum(axis=0)).sum())
            samples = int(np.ceil((5 * costs.path_noise * share / (bound.value / 100)) ** 2)) + 16
            if samples * size[0] * size[1] > args.most:
                passed_over += 1
                print(f"{seed} {bound}: a truth of {samples} paths a pixel is passed over", flush=True)
                continue
            gi = {"method": "reference", "samples": samples, "full": True}
            truth = render_choices(scene, replace(whole(scene), gi=gi), [moment], size, device=device)[0].xyz

            error, took = run(device, planner, plan.choices, truth)
            held.append(error <= bound.value)
            shares.append(planning / took)
            says = "holds" if held[-1] else "BREAKS"
            print(
                f"{seed} {bound} at {drawn.time}: {says}, {error:.3g} (predicted {plan.predicted_error:.3g}), "
                f"{took:.2f} s (predicted {plan.predicted_s:.2f}), planned in {planning:.2f} s: "
                + "; ".join(f"{t.name} {t.choice}" for t in plan.terms[:7]),
                flush=True,
            )
            if len(held) <= args.sweep:
                for choices in sorted(grid(planner), key=planner.predict_s):
                    of_grid, least = run(device, planner, choices, truth)
                    if of_grid <= bound.value:
                        took = min(took, run(device, planner, plan.choices, truth)[1])
                        ratios.append(took / min(least, run(device, planner, choices, truth)[1]))
                        print(
                            f"    over the cheapest of the grid: {ratios[-1]:.2f}, {choices.gi}", flush=True
                        )
                        break
    print(f"the bound held in {sum(held)} of {len(held)}; passed over: {passed_over}")
    print(f"planning over rendering: median {median(shares):.2f}")
    if ratios:
        print(f"cost over the cheapest of the grid: median {median(ratios):.2f}, worst {max(ratios):.2f}")


if __name__ == "__main__":
    main()
