"""Go on with a measurement after a crash, a pulled cable, Ctrl-C or a power cut.

What was finished is not done again, and nothing is overwritten. A decay that was interrupted is kept and measured anew
in the same session; an excitation series goes on at its next exposure, after the sample has rested in the dark.
"""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "go on with an interrupted measurement"
EXAMPLE = "phoslab resume sessions/star"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder of a session, or of measure all")
    parser.add_argument(
        "--rig", type=Path, metavar="RIG.toml", help="another rig file than it was begun with"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")


def run(args: argparse.Namespace) -> int:
    from dataclasses import replace

    from phoslab.app import campaign as campaigns
    from phoslab.errors import PhoslabError

    campaign = campaigns.Campaign.load(args.folder)
    if args.rig is not None:
        from phoslab.instruments.rig import Rig

        if campaign.source.rig is None:
            raise PhoslabError(
                "was simulated",
                file=args.folder,
                remedy="Leave --rig out: it goes on on the simulated bench.",
            )
        campaign = replace(campaign, source=replace(campaign.source, rig=Rig.load(args.rig)))
    return campaigns.measured(campaign, json=args.json, resume=True)
