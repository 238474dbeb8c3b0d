"""Render a scene with glow-in-the-dark materials: lamp light, then what is left in the dark.

SCENE is a scene.toml, the folder that holds one, or the name of a sample scene. OUT ends in .png (as a display shows
it) or .exr (radiance in spectral bands, and XYZ); several times give OUT with the time in its name. An OUT that ends in
.basis.exr holds how the scene fades from one time in the dark on; given as SCENE, it gives the picture at any later
time without rendering. One that ends in .mp4 is a film of the time from --from to --to, with all that the scene's
animation moves.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from phoslab import times
from phoslab.app import glow_options, sample_scenes
from phoslab.app.progress import progress_bar
from phoslab.errors import PhoslabError, found_in
from phoslab.files import check_writable

if TYPE_CHECKING:
    from phoslab.render import Scene, TransportParameters

HELP = "render a scene at given times"
EXAMPLE = "phoslab render fading -o glow.png --at off-1s,off+1s,off+80s"

# What the renderer knows by name, so that bad usage needs no renderer to be found out. A test compares them.
SUFFIXES = (".png", ".exr", ".mp4")
FILM = ".mp4"
BASIS = ".basis.exr"
SOLVERS = ("euler", "substep", "exact", "exact2", "rk23")
FORMATS = ("f32", "f16", "unorm16", "f32c")
PASSES = (
    *("shadow_map", "atlas_geometry", "atlas_irradiance", "excitation", "phosphor_step"),
    *("gbuffer", "direct_light", "glow", "atlas_glow", "resolve", "glow_transport"),
)
VIEWS = ("surfels", "levels", "shells", "directions", "hits")

# Pixels along a side, as in a scene file.
LARGEST_SIDE = 16384

# While glow excites: it changes as slowly as materials fade.
GLOW_STEP_S = 0.25

T = TypeVar("T")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("scene", metavar="SCENE", type=Path, help=sample_scenes.HELP)
    parser.add_argument(
        "-o", "--out", metavar="OUT", type=_picture, required=True, help="a .png, .exr or .mp4 to write"
    )
    parser.add_argument(
        "--at",
        metavar="TIMES",
        type=_each(_time),
        help="seconds, or off+80s, off-1s; comma between (default: the scene's)",
    )
    parser.add_argument(
        "--from", dest="begin", metavar="TIME", type=_time, help="where a film begins (default 0)"
    )
    parser.add_argument("--to", dest="end", metavar="TIME", type=_time, help="where a film ends")
    parser.add_argument("--fps", metavar="N", type=_positive, help="pictures of a film a second (default 30)")
    parser.add_argument(
        "--solver",
        choices=SOLVERS,
        help="exact: any stretch of constant light in one step (default); exact2: the same, and the mean light of "
        "each step where it varies (default in a scene with such a light); euler (the paper's), substep, rk23: "
        "step by step",
    )
    parser.add_argument(
        "--step",
        metavar="S",
        type=_positive,
        help="length of a step in s while light varies or things move (default 1/60; of a film, one a picture; "
        "0.25 where glow excites)",
    )
    parser.add_argument(
        "--state-format",
        choices=FORMATS,
        help="what holds the state between light changes: f32 (default), f16, unorm16, f32c (compensated)",
    )
    glow_options.declare(parser)
    parser.add_argument(
        "--size", metavar="WxH", type=_size, help="size of the picture in pixels (default: the scene's)"
    )
    parser.add_argument(
        "--debug",
        metavar="PASS,...",
        type=_each(_pass),
        default=[],
        help="also write what these passes made, beside OUT",
    )
    parser.add_argument(
        "--max-error",
        metavar="BOUND",
        help="model just enough: 2%%, 1dE or 0.05flip; see `phoslab plan`, which says what that leaves out",
    )
    parser.add_argument("--plan", metavar="FILE", type=Path, help="render by a plan that phoslab plan saved")
    parser.add_argument(
        "--trade",
        metavar="FILE",
        type=Path,
        help="what --max-error knows of this machine (phoslab trade model)",
    )
    parser.add_argument("--json", action="store_true", help="print files and warnings as JSON")


def run(args: argparse.Namespace) -> int:
    """Render, write, and say what was written."""
    from phoslab.render import fade_basis_warnings, load_scene, render, render_fade_basis

    check_writable(args.out)
    _check_film(args)
    if _is_basis(args.scene):
        return _say(args, *_from_basis(args))
    args.scene = sample_scenes.find_scene(args.scene)
    scene = load_scene(args.scene)
    if args.max_error is not None or args.plan is not None:
        return _say(args, *_by_plan(args, scene))
    _refuse(_given(args, ("trade",)), "is for plans", "Leave it out, or add --max-error BOUND.")
    transport = glow_options.transport(args)
    args.state_format = args.state_format or FORMATS[0]
    if args.out.suffix.lower() == FILM:
        return _say(args, [args.out], _film(args, scene, transport))
    if _is_basis(args.out):
        _refuse(
            _given(args, ("solver", "step", "debug")),
            "cannot be chosen for a fade basis",
            "Leave it out, or name an OUT that ends in .exr alone.",
        )
        basis = render_fade_basis(
            scene, *_one_time(args.at), transport=transport, size=args.size, state_format=args.state_format
        )
        folder = args.scene if args.scene.is_dir() else args.scene.parent
        basis.write(
            args.out, scene=folder.resolve().name, off_s=scene.schedule.off_s, exposures=scene.exposures
        )
        return _say(args, [args.out], [*scene.warnings, *fade_basis_warnings(transport)])
    with progress_bar("rendering") as progress:
        frames = render(
            scene,
            args.at,
            solver=args.solver,
            step_s=args.step or (GLOW_STEP_S if args.glow_excites else 1 / 60),
            state_format=args.state_format,
            transport=transport,
            size=args.size,
            debug=args.debug,
            progress=progress,
        )
    return _say(args, frames.write(args.out), frames.warnings)


def _by_plan(args: argparse.Namespace, scene: Scene) -> tuple[list[Path], Sequence[str]]:
    """Render as a plan says, one that is made now or one that was saved."""
    from phoslab.model_plan import read_plan
    from phoslab.render.planning import check_plan, make_plan, render_plan

    _refuse_what_a_plan_decides(args)
    warnings = []
    if args.plan is not None:
        with found_in(args.plan):
            plan, wrong = check_plan(scene, read_plan(args.plan), trade=args.trade)
        warnings = [wrong.problem] if wrong else []
    else:
        plan = make_plan(scene, args.max_error, args.at, size=args.size, trade=args.trade)
    with progress_bar("rendering") as progress:
        frames = render_plan(scene, plan, progress=progress, warnings=warnings)
    return frames.write(args.out), [*frames.warnings, *plan.notes]


def _refuse_what_a_plan_decides(args: argparse.Namespace) -> None:
    """Refuse options that a plan answers itself: to take neither silently is better than to take one."""
    saved = ("max_error", "at", "size") if args.plan is not None else ()
    decided = (*saved, "solver", "step", "state_format", *glow_options.NAMES, "debug")
    _refuse(
        {**_given(args, decided), BASIS: _is_basis(args.out)},
        "is decided by the plan, or cannot be had with one",
        "Leave it out, or render without --max-error and --plan.",
    )


def _refuse_what_a_basis_knows(args: argparse.Namespace) -> None:
    """Refuse options that say how to render, where nothing is rendered: a bound, say, would not be held."""
    rendered = ("max_error", "plan", "trade", "size", "solver", "step", "state_format", "debug")
    _refuse(
        _given(args, (*rendered, *glow_options.NAMES)),
        "belongs to rendering, and a fade basis is rendered already",
        "Leave it out, or name the scene in place of the basis.",
    )
    if _is_basis(args.out):
        raise PhoslabError(
            "would be pictures of a basis, not a basis",
            file=args.out,
            remedy="Name an OUT that ends in .png or .exr alone, or copy the file.",
        )


def _is_basis(path: Path) -> bool:
    return path.name.lower().endswith(BASIS)


def _given(args: argparse.Namespace, names: Sequence[str]) -> dict[str, bool]:
    """Return by option whether it was given."""
    return {glow_options.flag(name): getattr(args, name) not in (None, []) for name in names}


def _refuse(given: Mapping[str, bool], problem: str, remedy: str) -> None:
    """Refuse the first option that was given."""
    for option, is_given in given.items():
        if is_given:
            raise PhoslabError(problem, field=option, remedy=remedy)


def _check_film(args: argparse.Namespace) -> None:
    """Refuse what belongs to a film without one, and the other way round."""
    film = args.out.suffix.lower() == FILM
    asked = [
        name for name, value in (("--from", args.begin), ("--to", args.end), ("--fps", args.fps)) if value
    ]
    if asked and not film:
        raise PhoslabError(
            "belongs to a film", field=asked[0], remedy=f"Name an OUT that ends in {FILM}, or use --at."
        )
    if film and (args.at or args.debug):
        name = "--at" if args.at else "--debug"
        raise PhoslabError("belongs to single pictures", field=name, remedy="Use --from and --to for a film.")
    if film and args.end is None:
        raise PhoslabError("is missing", field="--to", remedy="Say when the film ends, such as --to off+10s.")
    if film and _is_basis(args.scene):
        raise PhoslabError("holds single pictures", file=args.scene, remedy="Name the scene for a film.")


def _film(args: argparse.Namespace, scene: Scene, transport: TransportParameters) -> Sequence[str]:
    from phoslab.render import render_film

    begin, end = (scene.schedule.parse_time(t) for t in (args.begin or "0", args.end))
    with progress_bar("rendering", quiet=args.json) as progress:
        return render_film(
            scene,
            args.out,
            begin,
            end,
            args.fps or 30.0,
            solver=args.solver,
            step_s=args.step,
            state_format=args.state_format,
            transport=transport,
            size=args.size,
            progress=progress,
        )


def _one_time(at: list[str] | None) -> list[str]:
    if at is not None and len(at) != 1:
        raise PhoslabError(
            "names several times", field="--at", remedy="A fade basis begins at one time in the dark."
        )
    return at or ["off"]


def _from_basis(args: argparse.Namespace) -> tuple[list[Path], Sequence[str]]:
    """Write the pictures that a fade basis gives at the times asked for."""
    from phoslab.render.fade_basis import frames_of

    _refuse_what_a_basis_knows(args)
    frames = frames_of(args.scene, args.at)
    return frames.write(args.out), frames.warnings


def _say(args: argparse.Namespace, written: Sequence[Path], warnings: Sequence[str]) -> int:
    if args.json:
        print(json.dumps({"files": [str(path) for path in written], "warnings": list(warnings)}))
    else:
        for path in written:
            print(path)
        for warning in warnings:
            print(f"warning: {warning}")
    return 0


def _picture(text: str) -> Path:
    path = Path(text)
    if path.suffix.lower() not in SUFFIXES:
        raise argparse.ArgumentTypeError(f"{text!r} is no file name that ends in {' or '.join(SUFFIXES)}")
    return path


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,5})[xX](\d{1,5})", text, re.ASCII)
    if match is None or not all(1 <= int(side) <= LARGEST_SIDE for side in match.groups()):
        raise argparse.ArgumentTypeError(
            f"{text!r} is no width x height such as 640x480, each from 1 to {LARGEST_SIDE}"
        )
    return int(match[1]), int(match[2])


def _positive(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not 0 < number < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is no positive number")
    return number


def _time(text: str) -> str:
    try:
        times.parse_time(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{error}. {times.REMEDY}") from None
    return text


def _pass(text: str) -> str:
    if text not in (*PASSES, *VIEWS):
        raise argparse.ArgumentTypeError(f"{text!r} is no pass (choose from {', '.join((*PASSES, *VIEWS))})")
    return text


def _each(parse: Callable[[str], T]) -> Callable[[str], list[T]]:
    """Return the parser of a list with commas between; what is given twice counts once."""

    def parse_all(text: str) -> list[T]:
        parts = [part.strip() for part in text.split(",") if part.strip()]
        if not parts:
            raise argparse.ArgumentTypeError(f"{text!r} names nothing")
        return list(dict.fromkeys(parse(part) for part in parts))

    return parse_all
