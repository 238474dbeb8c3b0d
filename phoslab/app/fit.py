"""Fit a material to a recorded decay session."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "fit a material to a recorded session"
EXAMPLE = "phoslab fit sample_data/sessions/green-decay --preset green -o green.json --report green.html"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("session", nargs="+", type=Path, metavar="SESSION", help="folder of a decay session")
    parser.add_argument(
        "--preset",
        required=True,
        type=_preset,
        metavar="NAME",
        help="material that lends what a decay does not tell: excitation rates and the spectrum's shape",
    )
    parser.add_argument(
        "--states",
        default="auto",
        choices=["auto", "1", "2", "3"],
        help="number of exponentials (default: auto)",
    )
    parser.add_argument("--name", help="name of the material (default: the sample's)")
    parser.add_argument(
        "-o", "--output", required=True, type=Path, metavar="FILE", help="material file to write"
    )
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="also write a report to read")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")


def _preset(name: str) -> str:
    from phoslab import presets

    if name not in presets.names():
        raise argparse.ArgumentTypeError(f"{name!r} is unknown; use one of: {', '.join(presets.names())}")
    return name


def _check_outputs(outputs: list[Path], sessions: list[Path]) -> None:
    """Refuse, before any work, what cannot be written, or would overwrite one output or the measurement."""
    from phoslab.errors import PhoslabError
    from phoslab.files import check_writable

    for k, output in enumerate(outputs):
        check_writable(output)
        where = output.resolve()
        if where in [other.resolve() for other in outputs[:k]]:
            raise PhoslabError("is named twice", file=output, remedy="Name different files.")
        if any(where.is_relative_to(session.resolve()) for session in sessions):
            raise PhoslabError(
                "lies in the session, which is never written to", file=output, remedy="Name a file elsewhere."
            )


def run(args: argparse.Namespace) -> int:
    import json
    import math

    from phoslab.app.progress import progress_bar

    _check_outputs([p for p in (args.output, args.report) if p is not None], args.session)
    from phoslab.fitting import fit_session

    with progress_bar("decoding frames", quiet=args.json) as progress:
        result = fit_session(
            args.session,
            preset=args.preset,
            states=args.states if args.states == "auto" else int(args.states),
            name=args.name,
            progress=progress,
        )
    result.material.save(args.output)
    if args.report:
        from phoslab.app.report import write_report

        write_report(args.report, result)
    if args.json:
        print(
            json.dumps(
                {
                    "material": str(args.output),
                    "report": str(args.report) if args.report else None,
                    "states": result.fit.n_states,
                    "kr_per_s": result.fit.kr_per_s.tolist(),
                    "kr_standard_error": [
                        e if math.isfinite(e) else None for e in result.fit.kr_standard_error.tolist()
                    ],
                    "chi2": result.fit.chi2,
                    "dof": result.fit.dof,
                    "assumed": result.assumed,
                    "warnings": list(result.warnings),
                }
            )
        )
    else:
        print(result.report())
        print(f"Wrote {args.output}" + (f" and {args.report}" if args.report else ""))
    return 0
