"""Measure speed against accuracy on this machine, and write it down for people and for the planner."""

from __future__ import annotations

import argparse
from pathlib import Path

from phoslab.app.sample_scenes import find_scene
from phoslab.errors import PhoslabError

HELP = "measure speed against accuracy on this machine"
EXAMPLE = "phoslab trade solver -o trade-solver --quick"

TRADES = ("solver", "fit", "gi", "model")


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("trade", choices=TRADES, help="what to measure")
    parser.add_argument(
        "-o", "--output", required=True, type=Path, metavar="DIR", help="folder to write into"
    )
    parser.add_argument(
        "--scene",
        action="append",
        type=Path,
        metavar="SCENE",
        help="model: a scene to measure on (may be repeated)",
    )
    parser.add_argument("--quick", action="store_true", help="fewer settings and runs: a minute or so")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")


def run(args: argparse.Namespace) -> int:
    import importlib
    import json

    from phoslab.app.progress import progress_bar

    trade = importlib.import_module(f"phoslab.app.trades.{args.trade}")
    of_scenes = {"scenes": [find_scene(s) for s in args.scene]} if args.scene else {}
    if of_scenes and args.trade != "model":
        raise PhoslabError(
            f"has no meaning for {args.trade!r}", field="--scene", remedy="Leave it out, or measure `model`."
        )
    with progress_bar("measuring", quiet=args.json) as progress:
        summary, written = trade.measure(args.output, quick=args.quick, progress=progress, **of_scenes)
    if args.json:
        print(json.dumps({"summary": summary, "files": [str(p) for p in written]}))
    else:
        print("\n".join(summary))
        print(f"The page: {written[0].resolve()}")
    return 0
