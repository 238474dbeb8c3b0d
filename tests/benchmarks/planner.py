"""How often a plan holds its bound, and how near it is to the cheapest: python tests/benchmarks/planner.py -o DIR

Scenes are drawn from seeds (tests/render/planned_scenes.py). The truth has the material's own bands, all states, the
reference solver, and glow followed to its end by so many paths that their noise is a fifth of the bound
(`planned_truth.py`). Truths and results are kept in DIR, and the same command goes on from there; `--limit S` gives a
truth so many seconds a run, and what is not known by then is said to be unknown. `--sweep N` runs, for the first N
scenes, all plans of a grid that are predicted to be cheaper than twice the chosen one, in the order of that cost, until
one holds the bound: that is the cheapest.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

from planned_case import KNOWN, Case

from phoslab.errors import PhoslabError
from phoslab.model_plan import Choices
from phoslab.render import load_scene
from phoslab.render.device import Device
from phoslab.render.planning import transport_terms
from phoslab.render.planning.bounds import Bound, parse_bound
from phoslab.render.planning.planner import Planner
from phoslab.render.planning.reduced import whole

# What a bound in % becomes in other units: as wide a range of what can be seen.
OTHER_UNITS = {"%": 1.0, "dE": 0.4, "flip": 0.008}


def drawn_scene(folder: Path, seed: int) -> Any:
    """Draw a scene of the tests."""
    if "planned_scenes" not in sys.modules:
        path = Path(__file__).parent.parent / "render" / "planned_scenes.py"
        spec = importlib.util.spec_from_file_location("planned_scenes", path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules["planned_scenes"] = module
        spec.loader.exec_module(module)
    return sys.modules["planned_scenes"].draw(folder, seed)


def grid(planner: Planner) -> Iterator[Choices]:
    """Yield the plans of the sweep: ways to transport glow (every second number of paths), all bands or six, texels."""
    plain = whole(planner.request.scene)
    most = max(planner.bands)
    kept = [planner.bands[n] for n in sorted({most, min(n for n in planner.bands if n >= min(6, most))})]
    noise = planner.path_noise
    for way in transport_terms.ways(planner.pilot, planner.request.bound, planner.costs, noise):
        if way.gi.get("samples") in transport_terms.SAMPLES[1::2]:
            continue
        for (bands, _), t in itertools.product(kept, (1, 4)):
            surfaces = {
                k: replace(s, atlas_texels=max(16, s.atlas_texels // t)) for k, s in plain.surfaces.items()
            }
            yield replace(plain, bands_nm=tuple(bands.edges_nm.tolist()), surfaces=surfaces, gi=way.gi)


def drawn_case(
    device: Device, folder: Path, seed: int, size: tuple[int, int], unit: str, trade: Path | None
) -> Case:
    """Return the case of a seed, with its bound in another unit perhaps."""
    drawn = drawn_scene(folder / str(seed), seed)
    in_percent = parse_bound(drawn.bound).value
    bound = Bound(float(f"{in_percent * OTHER_UNITS[unit]:.2g}"), unit)
    file = folder / f"{seed}-{size[0]}.npz"
    return Case(device, load_scene(drawn.folder), drawn.time, bound, size, file, trade)


def hold(seed: int, case: Case) -> dict[str, Any]:
    """Return what became of a plan."""
    about = {"seed": seed, "bound": str(case.bound), "time": case.time}
    try:
        _, plan, planning = case.plan()
    except PhoslabError as error:
        return {**about, "refused": str(error)}
    error, took = case.run(plan.choices)
    return {
        **about,
        "noise": case.noise,
        "error": error,
        "predicted": plan.predicted_error,
        "seconds": took.wall_s,
        "cpu_s": took.cpu_s,
        "predicted_s": plan.predicted_s,
        "planning_s": planning.wall_s,
        "planning_cpu_s": planning.cpu_s,
        "terms": {t.name: [t.choice, t.error] for t in plan.terms},
    }


def sweep(case: Case) -> dict[str, Any]:
    """Return how the chosen plan's time compares with that of the cheapest of the grid that holds the bound."""
    planner, plan, _ = case.plan()
    tried = sorted(grid(planner), key=planner.predict_s)
    for count, choices in enumerate(tried, start=1):
        error, least = case.run(choices)
        if error <= case.bound.value:
            # Each once more, since what is run first compiles.
            took = min(case.run(plan.choices)[1].cpu_s for _ in range(2))
            least_s = min(least.cpu_s, case.run(choices)[1].cpu_s)
            return {"ratio": took / least_s, "cheapest": choices.gi, "tried": count, "of": len(tried)}
    return {"ratio": None, "tried": len(tried), "of": len(tried)}


def say(result: dict[str, Any]) -> str:
    """Return a result as a line."""
    head = f"{result['seed']} {result['bound']} at {result['time']}: "
    if "refused" in result:
        return head + result["refused"]
    value = parse_bound(result["bound"]).value
    known = result["noise"] <= KNOWN * value
    verdict = "holds" if result["error"] <= value else "BREAKS"
    terms = "; ".join(f"{name} {choice}" for name, (choice, _) in result["terms"].items())
    return (
        f"{head}{verdict}{'' if known else ' (truth unknown)'}, {result['error']:.3g} "
        f"(predicted {result['predicted']:.3g}, noise of the truth {result['noise']:.2g}), {result['seconds']:.2f} s "
        f"(predicted {result['predicted_s']:.2f}), planned in {result['planning_s']:.2f} s: {terms}"
    )


def summary(results: list[dict[str, Any]]) -> list[str]:
    """Return what all results say together."""
    made = [r for r in results if "refused" not in r]
    known = [r for r in made if r["noise"] <= KNOWN * parse_bound(r["bound"]).value]
    held = [r for r in known if r["error"] <= parse_bound(r["bound"]).value]
    lines = [
        f"the bound held in {len(held)} of {len(known)} whose truth is known; "
        f"{len(made) - len(known)} unknown, {len(results) - len(made)} refused"
    ]
    unknown = [r for r in made if r not in known]
    if unknown:
        # Noise of paths in the plan and in the truth is independent: their squares add.
        alone = [
            max(r["error"] ** 2 - r["noise"] ** 2, 0.0) ** 0.5 / parse_bound(r["bound"]).value
            for r in unknown
        ]
        lines.append(
            f"of the unknown, {sum(a <= 1 for a in alone)} hold once the truth's own noise is taken off, as squares; "
            f"the worst is at {max(alone):.2f} of its bound"
        )
    if made:
        shares = [r["planning_cpu_s"] / r["cpu_s"] for r in made]
        within = sum(r["planning_cpu_s"] <= max(1.0, 0.1 * r["cpu_s"]) for r in made)
        lines.append(
            f"planning: median {median(r['planning_cpu_s'] for r in made):.2f} s of processors "
            f"({median(r['planning_s'] for r in made):.2f} s on the clock), {median(shares):.2f} of the picture; "
            f"within 1 s or a tenth of it in {within} of {len(made)}"
        )
    ratios = [r["sweep"]["ratio"] for r in made if "sweep" in r and r["sweep"]["ratio"] is not None]
    if ratios:
        lines.append(
            f"time of processors over the cheapest of the grid: median {median(ratios):.2f}, worst {max(ratios):.2f}, "
            f"of {len(ratios)} scenes"
        )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, required=True, help="a folder for truths and results")
    parser.add_argument("-n", type=int, default=40)
    parser.add_argument("--first", type=int, default=1000, help="the first seed")
    parser.add_argument("--side", type=int, default=64)
    parser.add_argument("--unit", choices=list(OTHER_UNITS), default="%")
    parser.add_argument("--limit", type=float, default=3600, help="s for one truth in one run")
    parser.add_argument("--sweep", type=int, default=0)
    parser.add_argument("--truths", action="store_true", help="follow paths for the truths alone")
    parser.add_argument("--kept", action="store_true", help="run nothing: say what was found before")
    parser.add_argument("--trade", type=Path, help="as of phoslab plan")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    results: list[dict[str, Any]] = []
    swept = 0
    name = f"results-{args.first}-{args.side}-{args.unit.replace('%', 'percent')}.json"
    if args.kept:
        print("\n".join(summary(json.loads((args.out / name).read_text(encoding="utf-8")))))
        return
    with Device() as device:
        for seed in range(args.first, args.first + args.n):
            case = drawn_case(device, args.out, seed, (args.side, args.side), args.unit, args.trade)
            known = case.learn(args.limit)
            if args.truths:
                share = case.noise / case.bound.value
                print(
                    f"{seed} {case.bound}: noise {share:.2f} of the bound, {case.truth.seconds:.0f} s",
                    flush=True,
                )
                continue
            result = hold(seed, case)
            if swept < args.sweep and known and "refused" not in result:
                result["sweep"] = sweep(case)
                swept += 1
            results.append(result)
            print(say(result), flush=True)
            (args.out / name).write_text(json.dumps(results, indent=1), encoding="utf-8")
    print("\n".join(summary(results)))


if __name__ == "__main__":
    main()
