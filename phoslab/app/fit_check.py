"""`phoslab fit CHECK-SESSION`: whether what the model takes for granted is true of a sample."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path


def is_check(paths: Sequence[Path]) -> bool:
    """Whether a session of the plan `check` is all that is named."""
    from phoslab.errors import PhoslabError
    from phoslab.session import Session

    try:
        return len(paths) == 1 and Session.open(paths[0]).header.plan == "check"
    except PhoslabError:
        return False  # the fit says what is wrong with it


def run(args: argparse.Namespace) -> int:
    """Judge the session and print the verdicts."""
    import json

    from phoslab.app.progress import progress_bar
    from phoslab.errors import PhoslabError, printable
    from phoslab.files import check_outside, write_text
    from phoslab.fitting.assumptions import check_assumptions
    from phoslab.fitting.lvf_file import load
    from phoslab.fitting.verdict import report
    from phoslab.session import Session

    path = args.session[0]
    if args.preset is not None or args.bootstrap or args.extrapolate:
        raise PhoslabError(
            "is a check session, which gives verdicts and no material",
            file=path,
            field="--preset, --bootstrap or --extrapolate",
            remedy="Leave them out; the verdicts are printed, -o writes them as JSON, --report as a page.",
        )
    outputs = [p for p in (args.output, args.report) if p is not None]
    check_outside(outputs, args.session)
    calibration = load(args.lvf)[0] if args.lvf is not None else None
    session = Session.open(path)
    with progress_bar("decoding frames", quiet=args.json) as progress:
        verdicts = check_assumptions(session, calibration, progress)
    content = json.dumps(
        {"session": str(path), "assumptions": [v.to_dict() for v in verdicts]}, allow_nan=False
    )
    if args.output:
        write_text(args.output, content + "\n")
    name = printable(session.header.sample_name)
    if args.report:
        from phoslab.app.pages import render
        from phoslab.fitting.verdict import CHANCE, TOLERATED

        page = render(
            "verdicts.html",
            name=name,
            verdicts=verdicts,
            chance=CHANCE,
            tolerated=TOLERATED,
            simulated=(session.header.simulated or {}).get("statement"),
        )
        write_text(args.report, page)
    if args.json:
        print(content)
    else:
        print(report(verdicts, name), end="")
        if outputs:
            print(f"Wrote {' and '.join(str(p) for p in outputs)}")
    return 0
