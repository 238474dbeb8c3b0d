"""The spectrum of the lamp or of a glowing sample, from a session through the calibrated linear variable filter.

The table that it writes serves as a spectrum in scenes, too: wavelength in nm, value, standard error.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from phoslab.fitting.spectrum import Spectrum

HELP = "the spectrum of a lamp or emission session"
EXAMPLE = (
    "phoslab spectrum sessions/star/04-emission --lvf lvf.json -o star.csv --flat sessions/star/05-decay"
)


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("session", type=Path, metavar="SESSION", help="folder of a lamp or emission session")
    parser.add_argument("--lvf", required=True, type=Path, metavar="FILE", help="calibration to use")
    parser.add_argument("-o", "--output", required=True, type=Path, metavar="FILE.csv", help="table to write")
    parser.add_argument(
        "--flat",
        type=Path,
        metavar="SESSION",
        help="the same scene without the filter (flats for a lamp, decay for a sample): how evenly it is lit",
    )
    parser.add_argument("--plot", type=Path, metavar="FILE.svg", help="also draw it")
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="also write a report to read")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")


def run(args: argparse.Namespace) -> int:
    import json

    import numpy as np

    from phoslab.app.progress import progress_bar
    from phoslab.bands import Bands
    from phoslab.files import check_outside, write_text
    from phoslab.fitting.lvf_file import load
    from phoslab.fitting.spectrum import MISSES, measure_spectrum

    sessions = [s for s in (args.session, args.flat) if s is not None]
    extra = [p for p in (args.plot, args.report) if p is not None]
    check_outside([args.output, *extra], sessions)
    calibration, digest = load(args.lvf)
    with progress_bar("decoding frames", quiet=args.json) as progress:
        result = measure_spectrum(args.session, calibration, flat=args.flat, progress=progress)
    write_text(args.output, _table(result, args.lvf.name, digest))
    plot = _plot(result) if extra else ""
    if args.plot:
        write_text(args.plot, plot)
    bands = Bands.uniform()
    means, errors = result.band_means(bands)
    if args.report:
        from phoslab.app.pages import render

        page = render(
            "spectrum.html",
            name=result.session[0],
            what="the lamp's spectrum" if result.plan == "lamp" else "the spectrum of a glow",
            result=result,
            plot=plot,
            misses=MISSES,
            n_positions=int(np.isfinite(result.measured).any(axis=1).sum()),
            bands=[(bands.label(j), f"{means[j]:.4f} ± {errors[j]:.4f}") for j in range(bands.n)],
            calibration=args.lvf.name,
            digest=digest,
        )
        write_text(args.report, page)
    if args.json:
        print(
            json.dumps(
                {
                    "spectrum": str(args.output),
                    "plot": str(args.plot) if args.plot else None,
                    "report": str(args.report) if args.report else None,
                    "peak_nm": result.peak_nm,
                    "band_edges_nm": bands.edges_nm.tolist(),
                    "band_means": means.tolist(),
                    "band_standard_error": errors.tolist(),
                    "shift_px": result.shift_px,
                    "misfit": result.scaled_misfit,
                    "warnings": list(result.warnings),
                    "notes": list(result.notes),
                }
            )
        )
        return 0
    lines = ["[[Spectrum]]", f"    session     {result.session[0]} ({result.plan})  {result.session[1][:12]}"]
    lines.append(f"    calibration {args.lvf.name}  {digest[:12]}")
    end = result.end_nm
    beyond = (
        "" if end is None else f"; the end, {end:.0f} nm, is as high within its error: it may go on rising"
    )
    lines.append(f"    peak        {result.peak_nm:.1f} nm{beyond}")
    lines.append(
        f"    misfit      {result.scaled_misfit:.2f} of what noise and calibration explain; 1 is right"
    )
    lines.append(f"    strip       moved by {result.shift_px:+.2f} px along itself since the calibration")
    lines.append("[[Band means]]  (1 at the spectrum's highest)")
    for j in range(bands.n):
        lines.append(f"    {bands.label(j):14s}  {means[j]:.4f} ± {errors[j]:.4f}")
    if result.simulated:
        lines.append(f"    {result.simulated}")
    if result.warnings:
        lines.append("[[Warnings]]")
        lines += [f"    - {w}" for w in result.warnings]
    if result.notes:
        lines.append("[[Notes]]")
        lines += [f"    - {n}" for n in result.notes]
    print("\n".join(lines))
    print(f"Wrote {', '.join(str(p) for p in (args.output, *extra))}")
    return 0


def _table(result: Spectrum, calibration: str, digest: str) -> str:
    lines = [
        f"# session {result.session[0]} ({result.plan}) sha256 {result.session[1]}",
        f"# calibration {calibration} sha256 {digest}",
        f"# relative spectral radiance, 1 at its highest; that is {result.scale:.6g} in the camera's unit",
    ]
    if result.simulated:
        lines.append(f"# {result.simulated}")
    lines.append("# wavelength_nm,value,standard_error")
    for nm, value, error in zip(result.nm, result.value, result.standard_error, strict=True):
        lines.append(f"{nm:g},{value:.6g},{error:.3g}")
    return "\n".join(lines) + "\n"


def _plot(result: Spectrum) -> str:
    """The spectrum with its band; what each position showed, with what the spectrum predicts; and the difference."""
    import numpy as np
    from matplotlib.figure import Figure

    from phoslab.app.figures import CHANNEL_COLOURS, svg
    from phoslab.fitting.lvf import POSITIONS_NM

    figure = Figure(figsize=(8, 8), layout="constrained")
    upper, lower, missed = figure.subplots(3, 1, sharex=True, height_ratios=[2, 2, 1])
    band = 2 * result.standard_error
    upper.plot(result.nm, result.value, color="#2455a4")
    upper.fill_between(
        result.nm, np.maximum(result.value - band, 0), result.value + band, color="#2455a4", alpha=0.2, lw=0
    )
    upper.set_ylim(0, 1.3)
    upper.set_ylabel("relative spectral radiance\n(band: 2 standard errors)")
    top = np.nanmax(result.measured)
    for c, (name, colour) in enumerate(CHANNEL_COLOURS.items()):
        lower.plot(POSITIONS_NM, result.measured[:, c] / top, "o", ms=3, color=colour, label=name)
        lower.plot(POSITIONS_NM, result.predicted[:, c] / top, color=colour, lw=1)
        miss = 100 * (result.measured[:, c] - result.predicted[:, c]) / top
        missed.plot(POSITIONS_NM, miss, "o-", ms=3, lw=0.6, color=colour)
    missed.axhline(0, color="0.4", lw=0.8)
    missed.set_ylabel("missed [% of the largest]")
    missed.set_xlabel("wavelength, or a position's middle [nm]")
    lower.set_ylabel("signal, as a share of the largest\n(points: measured, lines: predicted)")
    lower.legend(title="camera's colours", frameon=False, fontsize=8)
    for axes in (upper, lower, missed):
        axes.grid(alpha=0.25)
    return svg(figure)
