"""Calibrate the linear variable filter: which wavelength passes where, and how much of each.

Takes a session of the plan `lvf` and, beside it, one of `flats`, from which the camera's settings are told. What the
sessions do not carry is said, and the rest is delivered.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from phoslab.fitting.lvf import Calibration

HELP = "calibrate the linear variable filter"
EXAMPLE = "phoslab calibrate sessions/star/01-flats sessions/star/03-lvf -o lvf.json --plot lvf.svg"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "session",
        nargs="+",
        type=Path,
        metavar="SESSION",
        help="folders of an lvf session and of a flats session",
    )
    parser.add_argument(
        "-o", "--output", required=True, type=Path, metavar="FILE", help="calibration to write"
    )
    parser.add_argument(
        "--led",
        metavar="NAME",
        help="the white LED's spectrum, as illuminant:LED-B3 (default: the rig file's)",
    )
    parser.add_argument(
        "--camera",
        metavar="NAME",
        help="spectral sensitivities: a name of colour-science, or a rawtoaces JSON file (default: the session's)",
    )
    parser.add_argument("--plot", type=Path, metavar="FILE.svg", help="also draw wavelengths and curves")
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="also write a report to read")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")


def run(args: argparse.Namespace) -> int:
    import json

    from phoslab.app.progress import progress_bar
    from phoslab.files import check_outside, write_text
    from phoslab.fitting.lvf import calibrate
    from phoslab.fitting.lvf_file import save

    extra = [p for p in (args.plot, args.report) if p is not None]
    check_outside([args.output, *extra], args.session)
    with progress_bar("decoding frames", quiet=args.json) as progress:
        calibration = calibrate(args.session, led=args.led, camera=args.camera, progress=progress)
    save(calibration, args.output)
    if args.plot:
        write_text(args.plot, _plot(calibration))
    if args.report:
        from phoslab.app.pages import render

        page = render(
            "calibration.html",
            calibration=calibration,
            plot=_plot(calibration),
            text=_report(calibration, warnings=False),
        )
        write_text(args.report, page)
    if args.json:
        print(json.dumps(_numbers(calibration, args)))
    else:
        print(_report(calibration))
        print(f"Wrote {', '.join(str(p) for p in (args.output, *extra))}")
    return 0


def _numbers(c: Calibration, args: argparse.Namespace) -> dict[str, object]:
    import numpy as np

    error = c.map.standard_error_nm(c.places_px)
    return {
        "calibration": str(args.output),
        "plot": str(args.plot) if args.plot else None,
        "report": str(args.report) if args.report else None,
        "wavelength_error_nm": [None if np.isnan(e) else float(e) for e in error],
        "mercury": [
            {"line_nm": f.name, "seen": f.seen, "off_nm": f.off_nm if f.seen else None}
            for f in c.map.features
        ],
        "curves": c.curves is not None,
        "absolute": c.absolute,
        "curves_misfit": None if c.curves is None else c.curves.misfit,
        "filters": list(c.filters),
        "settings_misfit": c.settings_misfit,
        "warnings": list(c.warnings),
    }


def _report(c: Calibration, *, warnings: bool = True) -> str:
    """What was found, in words and numbers."""
    import numpy as np

    from phoslab.fitting.lvf import POSITIONS_NM

    error = c.map.standard_error_nm(c.places_px)
    lines = ["[[Linear variable filter]]"]
    lines += [f"    session     {name} ({plan})  {digest[:12]}" for name, plan, digest in c.sessions]
    lines.append(
        f"    strip       {c.strip.width_px:.1f} px wide, turned by {c.strip.angle_deg:.2f} degrees; "
        f"slant {c.strip.slant:+.3f}"
    )
    lines.append("[[Wavelengths]]")
    for nm in (400, 450, 500, 550, 600, 650, 700):
        k = int(np.flatnonzero(POSITIONS_NM == nm)[0])
        if np.isnan(c.places_px[k]):
            lines.append(f"    {nm} nm      not on the strip")
        else:
            lines.append(f"    {nm} nm      at {c.places_px[k]:8.2f} px  ± {error[k]:.2f} nm")
    for f in c.map.features:
        lines.append(
            f"    mercury {f.name}: " + (f"{f.off_nm:+.2f} nm off the map" if f.seen else "not seen")
        )
    lines.append(
        f"    band        {c.map.width_nm:.1f} nm wide at 550 nm, in proportion to the wavelength elsewhere"
    )
    lines.append("[[Transmission]]")
    if c.curves is None:
        lines.append("    no curves")
    else:
        there = int(np.isfinite(c.curves.curve).all(axis=1).sum())
        lines.append(
            f"    curves      {there} of {POSITIONS_NM.size} positions, "
            f"{'shares of light' if c.absolute else 'relative'}"
        )
        lines.append(f"    light       {c.light}, alone and behind {len(c.filters)} filters")
        lines.append(f"    misfit      {100 * c.curves.misfit:.2f} % of each position's brightest signal")
    lines.append("[[Camera]]")
    lines.append(
        f"    sensitivity {c.sensitivities.name}; red x {c.map.gains[0]:.3f}, blue x {c.map.gains[2]:.3f}"
    )
    if c.settings_misfit is not None:
        worst = max(c.settings.corrections.items(), key=lambda item: abs(item[1][0]))
        (kind, value), (log, se) = worst
        lines.append(
            f"    settings    {len(c.settings.corrections)} from overlaps (misfit {100 * c.settings_misfit:.2f} %); "
            f"farthest off: {kind} {value:g}, {100 * np.expm1(log):+.1f} ± {100 * se:.1f} %"
        )
    for iso, n in sorted(c.noise.items()):
        electrons = n.read_dn[0] / n.gain[0]
        lines.append(
            f"    ISO {iso:<8g}{n.gain[0]:.4g} ± {n.gain[1]:.2g} DN per electron, read noise {n.read_dn[0]:.3g} ± "
            f"{n.read_dn[1]:.1g} DN ({electrons:.1f} electrons)"
            + (
                ""
                if n.dark_dn_per_s is None
                else f", dark current {n.dark_dn_per_s[0]:.2g} ± {n.dark_dn_per_s[1]:.1g} DN/s"
            )
        )
    if c.simulated:
        lines.append(f"    {c.simulated}")
    if c.warnings and warnings:
        lines.append("[[Warnings]]")
        lines += [f"    - {w}" for w in c.warnings]
    return "\n".join(lines)


def _plot(c: Calibration) -> str:
    """The wavelength at each place with its error, and the curves with their bands."""
    import numpy as np
    from matplotlib.figure import Figure

    from phoslab.app.figures import svg
    from phoslab.fitting.lvf import POSITIONS_NM
    from phoslab.fitting.lvf_curves import GRID_NM

    figure = Figure(figsize=(8, 7), layout="constrained")
    upper, lower = figure.subplots(2, 1)
    s = np.linspace(*c.strip.ends_px, 400)
    nm, error = c.map.nm(s), c.map.standard_error_nm(s)
    shown = (nm > 390) & (nm < 710)
    straight = np.polyval(np.polyfit(s[shown], nm[shown], 1), s)
    upper.plot(s[shown], (nm - straight)[shown], color="#2455a4")
    upper.fill_between(
        s[shown],
        (nm - straight - 2 * error)[shown],
        (nm - straight + 2 * error)[shown],
        color="#2455a4",
        alpha=0.2,
        lw=0,
    )
    for f in c.map.features:
        if f.seen:
            line = float(np.mean([float(x) for x in f.name.split("+")]))
            at = float(c.map.place(np.array([line]))[0])
            upper.plot(at, float(np.interp(at, s, nm - straight)) + f.off_nm, "o", ms=5, color="#c0392b")
            upper.annotate(
                f.name, (at, 0), xytext=(0, 4), textcoords="offset points", fontsize=7, rotation=90
            )
    upper.set_xlabel("place along the strip [px]")
    upper.set_ylabel("wavelength less a straight line [nm]\n(band: 2 standard errors; dots: mercury)")
    if c.curves is not None:
        for k in range(0, POSITIONS_NM.size, 2):
            curve, band = c.curves.curve[k], 2 * c.curves.standard_error[k]
            if np.isfinite(curve).all():
                colour = f"C{k // 2 % 10}"
                lower.plot(GRID_NM, curve, color=colour, lw=1)
                lower.fill_between(
                    GRID_NM, np.maximum(curve - band, 0), curve + band, color=colour, alpha=0.2, lw=0
                )
        lower.set_ylim(0, None)
    lower.set_xlim(390, 710)
    lower.set_xlabel("wavelength [nm]")
    lower.set_ylabel("transmission" if c.absolute else "transmission [relative]")
    for axes in (upper, lower):
        axes.grid(alpha=0.25)
    return svg(figure)
