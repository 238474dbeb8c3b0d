"""What a bound saves on the sample scenes: python tests/benchmarks/planned_samples.py -o DIR [--side 512] [--limit S]

Each scene is rendered with everything on (all bands and states, glow followed to its end by as many paths as the
command takes by default), and by plans for some bounds: their time, and their true error against `planned_truth.py`,
whose noise is shown beside it. Truths are kept in DIR, and the same command goes on from there.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

from planned_case import Case

from phoslab.errors import PhoslabError
from phoslab.render import load_scene
from phoslab.render.device import Device
from phoslab.render.planning.bounds import parse_bound
from phoslab.render.planning.reduced import whole

SCENES = Path(__file__).parent.parent.parent / "sample_data" / "scenes"
NAMES = ("occluder", "fading", "confetti", "cornell", "corridor")
BOUNDS = ("5%", "2%", "1%")
EVERYTHING = {"method": "reference", "samples": 256, "full": True}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, required=True, help="a folder for truths and results")
    parser.add_argument("--side", type=int, default=512)
    parser.add_argument("--limit", type=float, default=3600, help="s for one truth in one run")
    parser.add_argument("--most", type=float, default=600, help="s: longer plans are not run")
    parser.add_argument("--scenes", default=",".join(NAMES))
    parser.add_argument("--trade", type=Path, help="as of phoslab plan")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    size, rows = (args.side, args.side), []
    with Device() as device:
        for name in args.scenes.split(","):
            scene = load_scene(SCENES / name)
            moment = "off+1s" if scene.schedule.off_s is not None else scene.times[0]
            file = args.out / f"{name}-{args.side}.npz"
            finest = parse_bound(BOUNDS[-1])
            case = Case(device, scene, moment, finest, size, file, args.trade)
            case.learn(args.limit)
            head = f"{name} at {moment}, {args.side}²"
            error, took = case.run(replace(whole(scene), gi=EVERYTHING))
            print(
                f"{head}, everything: {error:.2g} % in {took.wall_s:.1f} s (truth within {case.noise:.2g} %)",
                flush=True,
            )
            rows.append(
                {"scene": name, "bound": None, "error": error, "seconds": took.wall_s, "noise": case.noise}
            )
            for bound in BOUNDS:
                case = Case(device, scene, moment, parse_bound(bound), size, file, args.trade)
                try:
                    _, plan, planning = case.plan()
                except PhoslabError as refused:
                    print(f"{head}, {bound}: {refused}", flush=True)
                    continue
                said = ", ".join(f"{k} {v}" for k, v in plan.choices.gi.items())
                if plan.predicted_s > args.most:
                    print(f"{head}, {bound}: {said} would take {plan.predicted_s:.0f} s", flush=True)
                    continue
                error, took = case.run(plan.choices)
                print(
                    f"{head}, {bound}: {error:.2g} % (predicted {plan.predicted_error:.2g}) in {took.wall_s:.1f} s "
                    f"(predicted {plan.predicted_s:.1f}), planned in {planning.wall_s:.2f} s: {said}",
                    flush=True,
                )
                rows.append(
                    {
                        "scene": name,
                        "bound": bound,
                        "error": error,
                        "seconds": took.wall_s,
                        "gi": plan.choices.gi,
                    }
                )
    (args.out / f"samples-{args.side}.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
