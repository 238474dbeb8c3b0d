"""Fit a material to recorded sessions, or rates to a decay table (CSV)."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phoslab.app import fit_check, fit_per_pixel

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from phoslab.fitting.extrapolation import Beyond
    from phoslab.fitting.result import FitResult

HELP = "fit a material to recorded sessions, or rates to a decay table"
EXAMPLE = (
    "phoslab fit sessions/star --lvf lvf.json -o star.json --report star.html\n"
    "  phoslab fit sample_data/sessions/green-decay --preset green -o green.json\n"
    "  phoslab fit sample_data/sessions/green-decay --preset green --per-pixel -o maps\n"
    "  phoslab fit decay.csv --states auto --json\n"
    "  phoslab fit CHECK-SESSION --lvf lvf.json"
)


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "session",
        nargs="+",
        type=Path,
        metavar="SESSION|TABLE.csv",
        help="folders of sessions (decay, emission, excitation, lamp, flats, lvf), or the folder that `phoslab measure "
        "all` wrote: each is taken by its plan; or a check session, to judge what the model takes for granted; or a "
        "CSV table with the columns t_s (since lamp-off), optionally exposure_s, one a channel, optionally "
        "CHANNEL_sigma",
    )
    parser.add_argument(
        "--lvf",
        type=Path,
        metavar="FILE",
        help="calibration of the linear variable filter (default: from a session of the plan lvf among those)",
    )
    parser.add_argument(
        "--preset",
        type=_preset,
        metavar="NAME",
        help="material that lends what was not measured: excitation rates and the spectrum's shape",
    )
    parser.add_argument(
        "--states",
        default="auto",
        choices=["auto", "1", "2", "3", "4"],
        help="number of exponentials (default: auto, which tries 1 to 3 for sessions and 1 to 4 for a table)",
    )
    parser.add_argument("--name", help="name of the material (default: the sample's)")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="material file to write; for a table, a JSON file of the fit",
    )
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="also write a report to read")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")
    parser.add_argument("--bootstrap", type=_count, default=0, metavar="N", help="add a bootstrap of N draws")
    parser.add_argument(
        "--extrapolate",
        type=_times,
        default=(),
        metavar="S,S,...",
        help="continue the fit to these times after lamp-off, with the band that the data allow",
    )
    fit_per_pixel.configure(parser)
    table = parser.add_argument_group("tables")
    table.add_argument(
        "--offset",
        default="auto",
        choices=["auto", "none", "fit"],
        help="a constant in every channel: chosen by the data, none, or always (default: auto)",
    )
    table.add_argument(
        "--noise",
        default="auto",
        choices=["auto", "constant", "photon", "relative"],
        help="how noise goes with the signal where the table gives no sigma (default: the likeliest)",
    )


def _preset(name: str) -> str:
    from phoslab import presets

    if name not in presets.names():
        raise argparse.ArgumentTypeError(f"{name!r} is unknown; use one of: {', '.join(presets.names())}")
    return name


def _count(text: str) -> int:
    if not text.isdigit() or not 100 <= int(text) <= 1_000_000:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of draws from 100 to 1000000")
    return int(text)


def _times(text: str) -> tuple[float, ...]:
    try:
        times = tuple(float(part) for part in text.split(","))
    except ValueError:
        times = (-1.0,)
    if not all(0 <= t < 1e9 for t in times):
        raise argparse.ArgumentTypeError(f"{text!r} is no list of times in seconds, like 600,3600")
    return times


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
    _check_inputs(args.session)
    if args.per_pixel or args.bin != 1 or args.scheduler is not None:
        return fit_per_pixel.run(args)
    if any(path.is_file() for path in args.session):
        return _fit_table(args)
    if fit_check.is_check(args.session):
        return fit_check.run(args)
    return _fit_session(args)


def _check_inputs(inputs: list[Path]) -> None:
    """Refuse a name that is not there, whatever else is missing."""
    import os

    from phoslab.errors import PhoslabError

    for path in inputs:
        if not os.path.lexists(path):
            raise PhoslabError(
                "does not exist", file=path, remedy="Name a session's folder, or a decay table."
            )


def _needs(args: argparse.Namespace, option: str, what: str) -> None:
    from phoslab.errors import PhoslabError

    if getattr(args, option) is None:
        name = "-o" if option == "output" else f"--{option}"
        raise PhoslabError("is missing", field=name, remedy=what)


def _fit_table(args: argparse.Namespace) -> int:
    import json
    import os

    # Before numpy is loaded: matrices of a hundred rows gain nothing from threads and lose by them.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from phoslab.errors import PhoslabError, printable
    from phoslab.files import write_text

    if len(args.session) != 1:
        raise PhoslabError(
            f"names {len(args.session)} inputs", field="the fit", remedy="Name one table, or one session."
        )
    if args.lvf is not None or args.preset is not None:
        raise PhoslabError(
            "is for sessions",
            file=args.session[0],
            field="--lvf or --preset",
            remedy="A table is fitted without.",
        )
    _check_outputs([p for p in (args.output, args.report) if p is not None], args.session)
    from phoslab.fitting.table_fit import fit_table
    from phoslab.fitting.table_report import report

    result = fit_table(
        args.session[0],
        states=args.states if args.states == "auto" else int(args.states),
        offset=args.offset,
        noise_law=args.noise,
        bootstrap=args.bootstrap,
        extrapolate_s=args.extrapolate,
    )
    content = json.dumps(result.to_dict(), allow_nan=False)
    if args.output:
        write_text(args.output, content + "\n")
    if args.report:
        from phoslab.app.table_page import write_page

        write_page(args.report, result, args.session[0].name)
    if args.json:
        print(content)
    else:
        print(report(result, printable(args.session[0].name)))
        if written := [str(p) for p in (args.output, args.report) if p is not None]:
            print(f"Wrote {' and '.join(written)}")
    return 0


def _fit_session(args: argparse.Namespace) -> int:
    import json
    from dataclasses import replace

    from phoslab.app.progress import progress_bar

    _needs(args, "output", "Name the material file to write.")
    inputs = [*args.session, *([args.lvf] if args.lvf is not None else [])]
    _check_outputs([p for p in (args.output, args.report) if p is not None], inputs)
    from phoslab.fitting import extrapolation, fit_session
    from phoslab.fitting.intervals import bootstrap_intervals

    with progress_bar("decoding frames", quiet=args.json) as progress:
        result = fit_session(
            args.session,
            lvf=args.lvf,
            preset=args.preset,
            states=args.states if args.states == "auto" else int(args.states),
            name=args.name,
            progress=progress,
        )
    beyonds = [extrapolation.beyond(result.fit, t_s) for t_s in args.extrapolate]
    warned = extrapolation.warnings(beyonds, result.fit.data)
    result = replace(result, warnings=(*result.warnings, *warned))
    bootstrap = bootstrap_intervals(result.fit, args.bootstrap, seed=0) if args.bootstrap else None
    result.material.save(args.output)
    if args.report:
        from phoslab.app.report import write_report

        write_report(args.report, result)
    if args.json:
        print(json.dumps(_session_answer(args, result, bootstrap, beyonds)))
    else:
        print(result.report())
        if bootstrap is not None:
            print("[[rates by bootstrap, 95 %]]")
            for i, (low, high) in enumerate(bootstrap):
                print(f"  kr[{i + 1}] [1/s]           {low:.4g} .. {high:.4g}")
        for line in extrapolation.lines(beyonds, result.fit.data.channels):
            print(line)
        print(f"Wrote {args.output}" + (f" and {args.report}" if args.report else ""))
    return 0


def _session_answer(
    args: argparse.Namespace,
    result: FitResult,
    bootstrap: NDArray[np.float64] | None,
    beyonds: Sequence[Beyond],
) -> dict[str, Any]:
    """Return what `--json` prints; what is not determined is null."""
    from phoslab.fitting.written import for_json

    fit, material = result.fit, result.material
    product_only = material.provenance["product_only"]
    return {
        "material": str(args.output),
        "report": str(args.report) if args.report else None,
        "states": fit.n_states,
        "kr_per_s": fit.kr_per_s.tolist(),
        "kr_standard_error": for_json(fit.kr_standard_error),
        "interval95_per_s": for_json(result.interval95),
        "bootstrap95_per_s": None if bootstrap is None else bootstrap.tolist(),
        "extrapolated": [b.to_dict() for b in beyonds],
        "chi2": fit.chi2,
        "dof": fit.dof,
        "ke_m2_per_J": for_json(material.ke_m2_per_J),
        "ke_upper_limit": None if material.ke_upper_limit is None else for_json(material.ke_upper_limit),
        "emission": material.emission.tolist(),
        "standard_error": material.standard_error,
        "only_product_of_ke_and_emission": [i in product_only for i in range(fit.n_states)],
        "band_edges_nm": material.bands.edges_nm.tolist(),
        "assumed": result.assumed,
        "missing": list(result.missing),
        "warnings": list(result.warnings),
        "notes": list(result.notes),
    }
