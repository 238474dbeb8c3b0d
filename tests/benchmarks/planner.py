"""How often a plan holds its bound, how near it is to the cheapest, and what it saves: every measure of planning.md.

    PYTHONPATH=. python tests/benchmarks/planner.py -o DIR

hold      scenes drawn from seeds (tests/render/planned_scenes.py), bounds in %
dE, flip  the first few of them with bounds in other units
sweep     for the first few whose truth is known, plans of a grid in the order of their predicted cost until one holds
          the bound: that is the cheapest. Those that are predicted to err by more than four bounds are not run.
samples   the sample scenes (`planned_samples.py`)

The truth has the material's own bands, all states, the reference solver, and glow followed to its end by so many paths
that their noise is a fifth of the bound (`planned_truth.py`). Truths and results are kept in DIR; the same command goes
on from there, and does again what had no truth before (`--limit S`: so many s of processors for a truth in one run).
What is not known by then is said to be unknown. Results are those of the code that first found them: take another DIR
for other code.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import planned_samples
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

# What is predicted to err by more than so many bounds is not in the sweep.
HOPELESS = 4.0

PARTS = ("hold", "dE", "flip", "sweep", "samples")


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
    for gi in transport_terms.settings(planner.pilot, planner.costs):
        if gi.get("samples") in transport_terms.SAMPLES[1::2]:
            continue
        if planner.way(gi).error > HOPELESS * planner.request.bound.value:
            continue
        for (bands, _), t in itertools.product(kept, (1, 4)):
            surfaces = {
                k: replace(s, atlas_texels=max(16, s.atlas_texels // t)) for k, s in plain.surfaces.items()
            }
            yield replace(plain, bands_nm=tuple(bands.edges_nm.tolist()), surfaces=surfaces, gi=gi)


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


def noise_alone(seed: int, case: Case) -> dict[str, Any]:
    """Return how well a truth is known."""
    return {"seed": seed, "bound": str(case.bound), "time": case.time, "noise": case.noise}


def sweep(seed: int, case: Case) -> dict[str, Any]:
    """Return how the chosen plan's time compares with that of the cheapest of the grid that holds the bound."""
    planner, plan, _ = case.plan()
    about = {"seed": seed, "bound": str(case.bound), "time": case.time}
    tried = sorted(grid(planner), key=planner.predict_s)
    for count, choices in enumerate(tried, start=1):
        error, least = case.run(choices)
        if error <= case.bound.value:
            # Each once more, since what is run first compiles.
            took = min(case.run(plan.choices)[1].cpu_s for _ in range(2))
            least_s = min(least.cpu_s, case.run(choices)[1].cpu_s)
            found = {"ratio": took / least_s, "cheapest": choices.gi, "chosen": plan.choices.gi}
            return {**about, **found, "tried": count, "of": len(tried)}
    return {**about, "ratio": None, "tried": len(tried), "of": len(tried)}


def say(result: dict[str, Any]) -> str:
    """Return a result as a line."""
    head = f"{result['seed']} {result['bound']} at {result['time']}: "
    if "refused" in result:
        return head + result["refused"]
    if "ratio" in result:
        ratio = (
            "none of the grid holds" if result["ratio"] is None else f"{result['ratio']:.2f} of the cheapest"
        )
        return f"{head}{ratio}, which was number {result['tried']} of {result['of']}"
    noise = f"noise of the truth {result['noise']:.2g}"
    if "error" not in result:
        return head + noise
    verdict = "holds" if result["error"] <= parse_bound(result["bound"]).value else "BREAKS"
    terms = "; ".join(f"{name} {choice}" for name, (choice, _) in result["terms"].items())
    return (
        f"{head}{verdict}{'' if known(result) else ' (truth unknown)'}, {result['error']:.3g} (predicted "
        f"{result['predicted']:.3g}, {noise}), {result['cpu_s']:.2f} s of processors (predicted "
        f"{result['predicted_s']:.2f}), planned in {result['planning_cpu_s']:.2f} s: {terms}"
    )


def summary(book: Book) -> list[str]:
    """Return what all results come to."""
    lines = [line for part in ("hold", "dE", "flip") if book.of(part) for line in held(part, book.of(part))]
    ratios = [r["ratio"] for r in book.of("sweep") if r["ratio"] is not None]
    if ratios:
        lines.append(
            f"sweep: time of processors over that of the cheapest of the grid: median {median(ratios):.2f}, worst "
            f"{max(ratios):.2f}, of {len(ratios)} scenes"
        )
    return [*lines, *planned_samples.table(book.of("samples"))]


def held(part: str, results: list[dict[str, Any]]) -> list[str]:
    """Return how many bounds held, and what planning took."""
    made = [r for r in results if "refused" not in r]
    sure = [r for r in made if known(r)]
    over = [r["error"] / parse_bound(r["bound"]).value for r in sure]
    lines = [
        f"{part}: the bound held in {sum(x <= 1 for x in over)} of {len(sure)} whose truth is known; "
        f"{len(made) - len(sure)} unknown, {len(results) - len(made)} refused"
    ]
    unknown = [r for r in made if r not in sure]
    if unknown:
        # Noise of paths in the plan and in the truth is independent: their squares add.
        alone = [
            max(r["error"] ** 2 - r["noise"] ** 2, 0.0) ** 0.5 / parse_bound(r["bound"]).value
            for r in unknown
        ]
        lines.append(
            f"{part}: of the unknown, {sum(a <= 1 for a in alone)} hold once the truth's own noise is taken off, as "
            f"squares; the worst is at {max(alone):.2f} of its bound"
        )
    if made:
        within = sum(r["planning_cpu_s"] <= max(1.0, 0.1 * r["cpu_s"]) for r in made)
        loose = median(r["predicted"] / max(r["error"], 1e-12) for r in made)
        lines.append(
            f"{part}: planning took {median(r['planning_cpu_s'] for r in made):.2f} s of processors in the median, "
            f"{max(r['planning_cpu_s'] for r in made):.2f} s at most; within 1 s or a tenth of the picture in {within} "
            f"of {len(made)}; predicted over true error: median {loose:.2f}"
        )
    return lines


class Book:
    """Results by part and name, kept in a file."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._kept = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}

    def of(self, part: str) -> list[dict[str, Any]]:
        """Return the results of a part."""
        return list(self._kept.get(part, {}).values())

    def done(self, part: str, name: str) -> bool:
        """Whether there is nothing more to learn."""
        result = self._kept.get(part, {}).get(name)
        return result is not None and ("noise" not in result or known(result))

    def add(self, part: str, name: str, result: dict[str, Any]) -> None:
        """Keep a result."""
        self._kept.setdefault(part, {})[name] = result
        self._file.write_text(json.dumps(self._kept, indent=1), encoding="utf-8")


def known(result: dict[str, Any]) -> bool:
    """Whether the noise of the truth is small beside the bound."""
    return bool(result["noise"] <= KNOWN * parse_bound(result["bound"]).value)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, required=True, help="a folder for truths and results")
    parser.add_argument("-n", type=int, default=40, help="scenes of hold")
    parser.add_argument("--few", type=int, default=5, help="scenes of dE and of flip")
    parser.add_argument("--swept", type=int, default=8, help="scenes of sweep")
    parser.add_argument("--first", type=int, default=9000, help="the first seed")
    parser.add_argument("--side", type=int, default=64, help="of drawn scenes, in pixels")
    parser.add_argument("--limit", type=float, default=600, help="s of processors for one truth in one run")
    parser.add_argument("--parts", default=",".join(PARTS), help="of what is above (default: all)")
    parser.add_argument("--truths", action="store_true", help="follow paths for the truths of hold alone")
    parser.add_argument("--trade", type=Path, help="as of phoslab plan")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    book, parts = Book(args.out / "results.json"), args.parts.split(",")
    seeds = range(args.first, args.first + args.n)

    def each(part: str, some: Sequence[int], unit: str, run: Callable[[int, Case], dict[str, Any]]) -> None:
        for seed in some:
            if book.done(part, str(seed)):
                continue
            case = drawn_case(device, args.out, seed, (args.side, args.side), unit, args.trade)
            case.learn(args.limit)
            result = run(seed, case)
            print(f"{part}: {say(result)}", flush=True)
            if not args.truths:
                book.add(part, str(seed), result)

    with Device() as device:
        if "hold" in parts:
            each("hold", seeds, "%", noise_alone if args.truths else hold)
        for unit in {"dE", "flip"} & set(parts):
            each(unit, seeds[: args.few], unit, hold)
        if "sweep" in parts:
            held = [r["seed"] for r in book.of("hold") if "noise" in r and known(r)]
            each("sweep", held[: args.swept], "%", sweep)
        if "samples" in parts:
            planned_samples.run(device, args.out, book, args.limit, args.trade)
    print("\n".join(summary(book)))


if __name__ == "__main__":
    main()
