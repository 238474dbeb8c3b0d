"""The options of `phoslab render` that say how glow reaches other surfaces, and the ways of --gi that know each."""

from __future__ import annotations

import argparse
import re
from typing import TYPE_CHECKING

from phoslab.errors import PhoslabError

if TYPE_CHECKING:
    from phoslab.render import TransportParameters

# What the renderer knows by name, so that bad usage needs no renderer to be found out. A test compares them.
METHODS = ("none", "dss", "dss-z", "tiles", "reference")
DEFAULT = "tiles"

MOST_SAMPLES = 1 << 20

_ALL = METHODS[1:]
_FAST = ("tiles", "dss", "dss-z")
# By its name in the arguments: the ways that know an option, the parameter of transport that it is.
_OPTIONS = {
    "directions": (("tiles", "dss-z"), "directions"),
    "guided": (("tiles", "dss-z"), "guided"),
    "filter": (("tiles", "dss-z"), "filter_px"),
    "cell": (_FAST, "cell"),
    "detail": (("tiles",), "detail"),
    "surfel": (("dss", "dss-z"), "surfel"),
    "epsilon": (("dss", "dss-z"), "epsilon"),
    "levels": (("dss", "dss-z"), "levels"),
    "samples": (("reference",), "samples"),
    "full_transport": (("reference",), "full"),
    "bounces": (_ALL, "bounces"),
    "lamp_bounces": (_FAST, "lamps"),
    "glow_excites": (_FAST, "excites"),
}
NAMES = ("gi", *_OPTIONS)


def declare(parser: argparse.ArgumentParser) -> None:
    """Declare them. What is not given is None."""
    parser.add_argument(
        "--gi",
        choices=METHODS,
        help="how glow lights other surfaces: tiles (default): reflected once, gathered from cells of the surfaces; "
        "none: not at all; dss: splatted from surfels, nothing blocks; dss-z: the same with what blocks; "
        "reference: reflected once, by the path tracer Mitsuba",
    )
    parser.add_argument(
        "--directions",
        metavar="N",
        type=_count,
        help="directions in which a pixel of tiles or dss-z looks for glow (default 8)",
    )
    parser.add_argument(
        "--guided",
        metavar="SHARE",
        type=float,
        help="share of the directions of tiles and dss-z that aim at what may send light (default 0.875 for tiles that "
        "gather what glows alone, else 0.5)",
    )
    parser.add_argument(
        "--filter",
        metavar="PX",
        type=int,
        choices=(0, 2, 4, 8),
        help="pixels to each side over which tiles and dss-z share them (default 4)",
    )
    parser.add_argument(
        "--cell",
        metavar="SHARE",
        type=float,
        help="radius of the smallest cells of tiles, and of all but reference that reflect several times, over the "
        "scene's (default 0.025)",
    )
    parser.add_argument(
        "--detail",
        metavar="RATIO",
        type=float,
        help="radius over distance that no larger cell of tiles exceeds (default 0.3)",
    )
    parser.add_argument(
        "--surfel",
        metavar="SHARE",
        type=float,
        help="radius of the surfels of dss and dss-z on the screen, over half its height (default 0.02)",
    )
    parser.add_argument(
        "--epsilon",
        metavar="SHARE",
        type=float,
        help="share of the frame's glow at which a surfel's first shell ends, of dss and dss-z (default 0.02)",
    )
    parser.add_argument(
        "--levels",
        metavar="N",
        type=int,
        help="levels of the framebuffer of dss and dss-z, each reaching twice as far (default 0: across the scene)",
    )
    parser.add_argument(
        "--samples", metavar="N", type=_count, help="light paths a pixel of reference (default 256)"
    )
    parser.add_argument(
        "--full-transport",
        action="store_true",
        default=None,
        help="let reference follow light to its end instead of for one reflection",
    )
    parser.add_argument(
        "--bounces",
        metavar="N",
        type=_count,
        help="reflections of glow on its way to the camera, 1 (default) to 64; by any --gi",
    )
    parser.add_argument(
        "--lamp-bounces",
        action="store_true",
        default=None,
        help="let surfaces light and charge others with what they reflect of the lamps, too; not by reference",
    )
    parser.add_argument(
        "--glow-excites",
        action="store_true",
        default=None,
        help="let the light of phosphors charge phosphors, step by step; not by reference",
    )


def transport(args: argparse.Namespace) -> TransportParameters:
    """Return what the arguments say of glow transport; what they leave out is the renderer's own default.

    Raises:
        PhoslabError: an option is for other ways than that of --gi, or contradicts another.
    """
    from phoslab.render import TransportParameters

    method = args.gi or DEFAULT
    given = {name: getattr(args, name) for name in _OPTIONS if getattr(args, name) is not None}
    for name in given:
        ways, _ = _OPTIONS[name]
        if method not in ways:
            raise PhoslabError(
                f"is for --gi {', '.join(ways)}, and this is {method}",
                field=flag(name),
                remedy=f"Leave it out, or add --gi {ways[0]}.",
            )
    if given.get("full_transport") and "bounces" in given:
        raise PhoslabError(
            "ends light that --full-transport follows to its end",
            field="--bounces",
            remedy="Leave one of them out.",
        )
    return TransportParameters(method, **{_OPTIONS[name][1]: value for name, value in given.items()})


def flag(name: str) -> str:
    """Return an option as it is typed."""
    return f"--{name.replace('_', '-')}"


def _count(text: str) -> int:
    if not re.fullmatch(r"\d{1,7}", text, re.ASCII) or not 1 <= int(text) <= MOST_SAMPLES:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 1 to {MOST_SAMPLES}")
    return int(text)
