"""Render a scene with glow-in-the-dark materials: lamp light, then what is left in the dark.

SCENE is a scene.toml, or the folder that holds one. OUT ends in .png (as a display shows it) or .exr (radiance in
spectral bands, and XYZ); several times give OUT with the time in its name.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from phoslab.errors import PhoslabError

if TYPE_CHECKING:
    from collections.abc import Callable

HELP = "render a scene at given times"
EXAMPLE = "phoslab render scenes/fading -o glow.png --at off-1s,off+1s,off+80s"

# Work that is shorter than this needs no progress bar.
SHORT_S = 1.0


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("scene", metavar="SCENE", type=Path, help="a scene.toml, or its folder")
    parser.add_argument(
        "-o", "--out", metavar="OUT", type=Path, required=True, help="a .png or .exr to write"
    )
    parser.add_argument(
        "--at", metavar="TIMES", help="seconds, or off+80s, off-1s; comma between (default: the scene's)"
    )
    parser.add_argument(
        "--solver",
        help="exact: any stretch of constant light in one step (default); exact2: the same, and the mean light of "
        "each step where it varies (default in a scene with such a light); euler (the paper's), substep, rk23: "
        "step by step",
    )
    parser.add_argument(
        "--step", metavar="S", type=float, default=1 / 60, help="length of a step in s (default 1/60)"
    )
    parser.add_argument(
        "--state-format",
        default="f32",
        help="what holds the state between light changes: f32 (default), f16, unorm16, f32c (compensated)",
    )
    parser.add_argument("--size", metavar="WxH", help="size of the picture in pixels (default: the scene's)")
    parser.add_argument(
        "--debug", metavar="PASS,...", default="", help="also write what these passes made, beside OUT"
    )
    parser.add_argument("--json", action="store_true", help="print files and warnings as JSON")


def run(args: argparse.Namespace) -> int:
    """Render, write, and say what was written."""
    from phoslab.render import load_scene, render
    from phoslab.render.frames import check_suffix

    check_suffix(args.out)
    size = _parse_size(args.size)
    scene = load_scene(args.scene)
    with _progress() as progress:
        frames = render(
            scene,
            None if args.at is None else [t.strip() for t in args.at.split(",") if t.strip()],
            solver=args.solver,
            step_s=args.step,
            state_format=args.state_format,
            size=size,
            debug=[name.strip() for name in args.debug.split(",") if name.strip()],
            progress=progress,
        )
    written = frames.write(args.out)
    if args.json:
        print(json.dumps({"files": [str(path) for path in written], "warnings": list(frames.warnings)}))
    else:
        for path in written:
            print(path)
        for warning in frames.warnings:
            print(f"warning: {warning}")
    return 0


def _parse_size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if match is None or "0" in match.groups():
        raise PhoslabError(f"is {text!r}", field="--size", remedy="Write width x height, such as 640x480.")
    return int(match[1]), int(match[2])


@contextmanager
def _progress() -> Iterator[Callable[[int, int], None]]:
    """Yield a callback that moves a bar with the time left, on stderr, shown once the work proves to be long."""
    from rich.console import Console
    from rich.progress import Progress, TimeRemainingColumn

    bar = Progress(
        *Progress.get_default_columns()[:-1],
        TimeRemainingColumn(),
        console=Console(file=sys.stderr),
        transient=True,
    )
    task = bar.add_task("rendering", total=None)
    show_late = threading.Timer(SHORT_S, bar.start)
    show_late.start()
    try:
        yield lambda done, total: bar.update(task, completed=done, total=total)
    finally:
        show_late.cancel()
        show_late.join()
        if bar.live.is_started:
            bar.stop()
