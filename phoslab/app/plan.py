"""Say what of a scene has to be modelled for a picture that is no more wrong than you allow, and what it costs.

SCENE is a scene.toml, or the folder that holds one. The error counts against the same scene with everything on and glow
followed to its end: `2%` is mean |a - b| / mean b of the radiance, `1dE` the mean CIEDE2000, `0.05flip` the mean FLIP.
A plan can be saved, edited and followed: phoslab render SCENE --plan plan.json.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from phoslab.errors import PhoslabError
from phoslab.files import check_writable

if TYPE_CHECKING:
    from phoslab.model_plan import ModelPlan

HELP = "plan what to model for a bound on the error"
EXAMPLE = "phoslab plan scenes/cornell --max-error 5% --at off+1s -o plan.json"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("scene", metavar="SCENE", type=Path, help="a scene.toml, or its folder")
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
        check_writable(args.out)
    wrong = None
    if args.plan is not None:
        if args.at is not None or args.size is not None:
            raise PhoslabError(
                "stands in the plan already", field="--at or --size", remedy="Leave it out, or plan anew."
            )
        plan, wrong = check_plan(args.scene, read_plan(args.plan), trade=args.trade)
    else:
        plan = make_plan(args.scene, args.max_error, _times(args.at), size=_size(args.size), trade=args.trade)
    if args.out is not None:
        plan.save(args.out)
    if args.json:
        print(plan.to_json(), end="")
    else:
        print("\n".join(table(plan)))
        if args.out is not None:
            print(f"The plan: {args.out}")
    if wrong:
        raise PhoslabError(wrong, file=args.plan, remedy="Mend it, or plan anew with --max-error.")
    return 0


def table(plan: ModelPlan) -> list[str]:
    """Return the plan as lines for a person."""
    from phoslab.model_plan import OUTSIDE
    from phoslab.render.planning.bounds import parse_bound

    bound = parse_bound(plan.bound)
    rows = [("decision", "choice", "adds", "", "why")]
    for term in plan.terms:
        said = bound.say(term.error)
        adds = (
            ("0" if term.error == 0 else said) if term.kind != OUTSIDE else f"({said if term.error else '?'})"
        )
        rows.append((term.name, term.choice, adds, _KIND.get(term.kind, "") if term.error else "", term.why))
    widths = [max(len(row[k]) for row in rows) for k in range(4)]
    lines = [
        "  ".join(f"{cell:<{w}}" for cell, w in zip(row, (*widths, 0), strict=True)).rstrip() for row in rows
    ]
    outside = any(term.kind == OUTSIDE for term in plan.terms)
    (w, h), n = plan.size, len(plan.times)
    pictures = f"{n} picture{'s' if n != 1 else ''} of {w} x {h}"
    return [
        *lines,
        "",
        f"Together {bound.say(plan.predicted_error)} are predicted of the {bound} allowed; "
        f"about {_duration(plan.predicted_s)} for {pictures}.",
        "`<` marks a bound that cannot be passed, `~` an estimate from samples or from other scenes.",
        *(["What stands in brackets is in no plan: no bound counts it."] if outside else []),
        *(f"note: {note}" for note in plan.notes),
    ]


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
