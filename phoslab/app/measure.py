"""Measure a sample: run a plan on the rig, or on the simulated bench, into a session that can be fitted.

Whatever fails meanwhile, what was recorded stays, the lamp goes off, and `phoslab resume` goes on.
`phoslab measure PLAN --help` names the plan's own parameters; docs/measuring.md explains them.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phoslab import plan_parameters
from phoslab.errors import PhoslabError

if TYPE_CHECKING:
    from phoslab.app.campaign import Campaign

HELP = "run a measurement plan on the rig or the simulated bench"
EXAMPLE = "phoslab measure decay --rig rig.toml -o sessions/star --until 3600 --spacing log"


def configure(parser: argparse.ArgumentParser) -> None:
    plans = parser.add_subparsers(metavar="PLAN", dest="plan", required=True)
    for name, kind in plan_parameters.PLANS.items():
        doc = " ".join((kind.__doc__ or "").split())
        plan = plans.add_parser(name, help=doc, description=doc)
        _add_common(plan)
        group = plan.add_argument_group("parameters of the plan")
        for about in dataclasses.fields(kind):
            group.add_argument(
                plan_parameters.option(about.name),
                dest=f"p_{about.name}",
                metavar=_metavar(about),
                type=_reader(name, about.name),
                default=None,
                help=f"{about.metadata['help']} (default: {about.default if about.default != '' else 'none'})",
            )
    every = plans.add_parser(
        "all",
        help="all that a material needs, in the order with the fewest hand movements",
        description=f"A folder of sessions: {', '.join(plan_parameters.CAMPAIGN)}.",
    )
    _add_common(every)
    every.add_argument(
        "--only", metavar="PLAN,...", help=f"some plans of {', '.join(plan_parameters.PLANS)}, in that order"
    )
    every.add_argument(
        "--set",
        dest="settings",
        action="append",
        default=[],
        metavar="PLAN.PARAMETER=VALUE",
        help="a parameter by the name that session.toml has (decay.until_s=3600); may be repeated",
    )


def _add_common(parser: argparse.ArgumentParser) -> None:
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--rig", type=Path, metavar="RIG.toml", help="the rig file (docs/formats-rig.md)")
    where.add_argument(
        "--simulate",
        metavar="SAMPLE",
        help="on the simulated bench, with a sample of this name: a preset's colour, broad or two-states",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="a new folder for what is measured")
    parser.add_argument("--sample", metavar="NAME", help="name of the sample (default: the folder's)")
    parser.add_argument(
        "--seed", type=int, default=None, metavar="N", help="of the simulated noise (default: 0)"
    )
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="NAME@N",
        help="let something go wrong on the simulated bench (docs/simulation.md names the faults); may be repeated",
    )
    parser.add_argument("--dry-run", action="store_true", help="print the time line; touch no device")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")


def _reader(plan: str, name: str) -> Callable[[str], Any]:
    """Reads an option's text as its parameter, so that a wrong one is bad usage."""

    def read(text: str) -> Any:
        try:
            return getattr(plan_parameters.parameters(plan, {name: _typed(text)}), name)
        except PhoslabError as error:
            raise argparse.ArgumentTypeError(f"{text!r}: {error.remedy}") from None

    return read


def _metavar(about: dataclasses.Field[Any]) -> str:
    if about.metadata["choices"]:
        return "|".join(about.metadata["choices"])
    unit = {"_s": "S", "eg": "DEG,...", "lx": "LX"}.get(about.name[-2:], "N")
    return (
        unit if not isinstance(about.default, str) else ("S,..." if about.name.endswith("_s") else "NAME,...")
    )


def run(args: argparse.Namespace) -> int:
    from phoslab.app import campaign as campaigns

    campaign = _campaign(args)
    if args.dry_run:
        return _rehearse(campaign, args.json)
    campaigns.begin(campaign)
    return campaigns.measured(campaign, json=args.json)


def _campaign(args: argparse.Namespace) -> Campaign:
    """What the arguments ask for."""
    from phoslab.app.campaign import Campaign, Entry
    from phoslab.app.laboratory import Source
    from phoslab.instruments.rig import Rig

    if args.rig is not None and (args.fault or args.seed is not None):
        raise PhoslabError(
            "are for the simulated bench",
            field="--seed and --fault",
            remedy="Leave them out, or give --simulate instead of --rig.",
        )
    if args.output is None and not args.dry_run:
        raise PhoslabError("is missing", field="-o", remedy="Name a new folder for what is measured.")
    folder = args.output or Path("session")
    given: dict[str, dict[str, Any]] = {}
    if args.plan == "all":
        plans = plan_parameters.names(args.only) if args.only else plan_parameters.CAMPAIGN
        for text in args.settings:
            plan, name, value = _setting(text)
            given.setdefault(plan, {})[name] = value
        for plan in (*plans, *given):
            if plan not in plan_parameters.PLANS or plan not in plans:
                known = plans if plan in plan_parameters.PLANS else plan_parameters.PLANS
                raise PhoslabError(
                    f"names {plan!r}, which is no plan of this measurement",
                    field="--only or --set",
                    remedy=f"The plans are: {', '.join(known)}.",
                )
        folders = {plan: folder / f"{k:02d}-{plan}" for k, plan in enumerate(plans, start=1)}
    else:
        folders = {args.plan: folder}
        given[args.plan] = {
            name.removeprefix("p_"): value
            for name, value in vars(args).items()
            if name.startswith("p_") and value is not None
        }
    entries = tuple(
        Entry(path, plan, plan_parameters.parameters(plan, given.get(plan, {})))
        for plan, path in folders.items()
    )
    if args.simulate is not None:
        source = Source(None, _sample(args.simulate), args.seed or 0, tuple(args.fault))
    else:
        source = Source(Rig.load(args.rig))
    sample = args.sample or args.simulate or folder.resolve().name
    return Campaign(folder, entries, source, sample, several=args.plan == "all")


def _setting(text: str) -> tuple[str, str, Any]:
    key, _, value = text.partition("=")
    plan, _, name = key.partition(".")
    if not (plan and name and value):
        raise PhoslabError(
            f"is {text!r}", field="--set", remedy="Write PLAN.PARAMETER=VALUE, as in decay.until_s=3600."
        )
    return plan, name, _typed(value)


def _typed(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _sample(name: str) -> str:
    from phoslab import presets

    if name not in presets.names():  # the bench takes its time to load
        from phoslab.instruments.bench.samples import sample

        sample(name)
    return name


def _rehearse(campaign: Campaign, as_json: bool) -> int:
    import json

    from phoslab.instruments.rehearsal import duration

    line = campaign.rehearse()
    if as_json:
        entries = [{"at_s": round(e.at_s, 3), "text": e.text, "by_hand": e.by_hand} for e in line.entries]
        frames = dict(line.frames)
        print(
            json.dumps(
                {
                    "duration_s": round(line.duration_s, 3),
                    "frames": frames,
                    "hand_movements": line.hands,
                    "longest_lamp_on_s": round(line.longest_on_s, 3),
                    "time_line": entries,
                }
            )
        )
        return 0
    for entry in line.entries:
        clock = f"{int(entry.at_s // 3600):3d}:{int(entry.at_s // 60 % 60):02d}:{entry.at_s % 60:04.1f}"
        print(f"{clock}  {'-> ' if entry.by_hand else ''}{entry.text}")
    print(
        f"{duration(line.duration_s)} at most, {line.n_frames} frames, {line.hands} hand movements (marked ->); "
        f"the lamp is on for {duration(line.longest_on_s)} without a break."
    )
    return 0
