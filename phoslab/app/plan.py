"""Say what of a scene has to be modelled for a picture that is no more wrong than you allow, and what it costs.

SCENE is a scene.toml, the folder that holds one, or the name of a sample scene. The error counts against the same
scene with everything on and glow followed to its end: `2%` is mean |a - b| / mean b of the radiance, `1dE` the mean
CIEDE2000, `0.05flip` the mean FLIP.
A plan can be saved, edited and followed: phoslab render SCENE --plan plan.json.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from phoslab.app import sample_scenes
from phoslab.errors import PhoslabError, found_in
from phoslab.files import check_writable

if TYPE_CHECKING:
    from phoslab.model_plan import ModelPlan

HELP = "plan what to model for a bound on the error"
EXAMPLE = "phoslab plan cornell --max-error 5% --at off+1s -o plan.json"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("scene", metavar="SCENE", type=Path, help=sample_scenes.HELP)
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--max-error", metavar="BOUND", help="how wrong a picture may be: 2%%, 1dE or 0.05flip")
    what.add_argument(
        "--plan", metavar="FILE", type=Path, help="judge this plan, perhaps an edited one, instead"
    )
    parser.add_argument("--at", metavar="TIMES", help="as of phoslab render (default: the scene's times)")
    parser.add_argument("--size", metavar="WxH", help="size of the picture in pixels (default: the scene's)")
    parser.add_argument(
        "--trade", metavar="FILE", type=Path, help="what phoslab trade model measured (default: what ships)"
    )
    parser.add_argument("-o", "--out", metavar="FILE", type=Path, help="save the plan as JSON")
    parser.add_argument("--json", action="store_true", help="print the plan as JSON")


def run(args: argparse.Namespace) -> int:
    """Plan, print, save."""
    from phoslab.model_plan import read_plan
    from phoslab.render.planning import check_plan, make_plan

    if args.out is not None:
        if args.out.suffix.lower() != ".json":
            raise PhoslabError("is no .json", file=args.out, remedy="A plan is JSON: name a file plan.json.")
        check_writable(args.out)
    scene = sample_scenes.find_scene(args.scene)
    wrong = None
    if args.plan is not None:
        if args.at is not None or args.size is not None:
            raise PhoslabError(
                "stands in the plan already", field="--at or --size", remedy="Leave it out, or plan anew."
            )
        with found_in(args.plan):
            plan, wrong = check_plan(scene, read_plan(args.plan), trade=args.trade)
    else:
        plan = make_plan(scene, args.max_error, _times(args.at), size=_size(args.size), trade=args.trade)
    if args.out is not None:
        plan.save(args.out)
    if args.json:
        print(plan.to_json(), end="")
    else:
        print("\n".join(table(plan)))
        if args.out is not None:
            print(f"The plan: {args.out}")
    if wrong:
        with found_in(args.plan):
            raise wrong
    return 0


def table(plan: ModelPlan) -> list[str]:
    """Return the plan as lines for a person."""
    from phoslab.model_plan import OUTSIDE
    from phoslab.render.planning.bounds import parse_bound

    bound = parse_bound(plan.bound)
    rows = [("decision", "choice", "adds", "", "takes", "why")]
    for term in plan.terms:
        said = "?" if term.error is None else "0" if term.error == 0 else bound.say(term.error)
        adds = f"({said})" if term.kind == OUTSIDE else said
        takes = _duration(term.seconds) if term.seconds > TAKES_LITTLE * plan.predicted_s else ""
        rows.append(
            (term.name, term.choice, adds, _KIND.get(term.kind, "") if term.error else "", takes, term.why)
        )
    widths = [max(len(row[k]) for row in rows) for k in range(5)]
    lines = [
        "  ".join(f"{cell:<{w}}" for cell, w in zip(row, (*widths, 0), strict=True)).rstrip() for row in rows
    ]
    outside = any(term.kind == OUTSIDE for term in plan.terms)
    (w, h), n = plan.size, len(plan.times)
    pictures = f"{n} picture{'s' if n != 1 else ''} of {w} x {h}"
    start_s = plan.predicted_s - sum(term.seconds for term in plan.terms)
    begin = f", {_duration(start_s)} of it to begin" if start_s > TAKES_LITTLE * plan.predicted_s else ""
    return [
        *lines,
        "",
        f"Together {bound.say(plan.predicted_error)} are predicted of the {bound} allowed; about "
        f"{_duration(plan.predicted_s)} for {pictures}{begin}.",
        "`<` marks what an error cannot be more than, `~` an estimate. Times are of all processors together, where",
        "these draw, and count from when phoslab is loaded and has planned.",
        *(
            [
                "In brackets: what neither the plan models nor the picture that it is held against: no bound counts it."
            ]
            if outside
            else []
        ),
        *(f"note: {note}" for note in plan.notes),
    ]


# Of all that is predicted: shares of the time below that are not shown.
TAKES_LITTLE = 0.01

_KIND = {"bound": "<", "estimate": "~"}


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.2g} s" if seconds < 10 else f"{seconds:.0f} s"
    return f"{seconds / 60:.2g} min" if seconds < 7200 else f"{seconds / 3600:.2g} h"


def _times(text: str | None) -> list[str] | None:
    if text is None:
        return None
    return list(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(p.isascii() and p.isdigit() and 1 <= int(p) <= 16384 for p in parts):
        raise PhoslabError(
            f"{text!r} is no width x height",
            field="--size",
            remedy="Write it as 640x480, each from 1 to 16384.",
        )
    return int(parts[0]), int(parts[1])
