"""Calibrate the linear variable filter: which wavelength passes where, and how much of each.

Takes a session of the plan `lvf` and, beside it, one of `flats`, from which the camera's settings are told. What the
sessions do not carry is said, and the rest is delivered.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from phoslab.fitting.lvf import Calibration
    from phoslab.fitting.wavelength_map import Feature

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
            parts=_parts(calibration),
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


def _report(c: Calibration) -> str:
    """What was found, as text."""
    lines = []
    for part in _parts(c):
        lines.append(f"[[{part.title}]]")
        width = max(len(name) for name, _ in part.rows)
        lines += [f"    {name:{width}}  {value}" for name, value in part.rows]
    if c.simulated:
        lines.append(f"    {c.simulated}")
    if c.warnings:
        lines.append("[[Warnings]]")
        lines += [f"    - {w}" for w in c.warnings]
    return "\n".join(lines)


_KNOWN_NM = 1.0
"""An error of wavelength that is small beside what passes at one place, some 24 nm."""


@dataclass(frozen=True)
class _Part:
    """Numbers of one kind: (name, value) each, and what they mean."""

    title: str
    rows: list[tuple[str, str]]
    meaning: str


def _parts(c: Calibration) -> list[_Part]:
    """What was found, in numbers."""
    return [_filter(c), _wavelengths(c), _transmission(c), _camera(c)]


def _filter(c: Calibration) -> _Part:
    rows = [("session", f"{name} ({plan})  {digest[:12]}") for name, plan, digest in c.sessions]
    rows.append(("width", f"{c.strip.width_px:.1f} px"))
    rows.append(("turned by", f"{c.strip.angle_deg:.2f} degrees"))
    rows.append(("slant", f"{c.strip.slant:+.3f}"))
    return _Part(
        "Linear variable filter",
        rows,
        "Where the strip lies in the picture. Slant: by how many pixels along the strip a line of one wavelength moves "
        "for each pixel across it.",
    )


def _wavelengths(c: Calibration) -> _Part:
    import numpy as np

    from phoslab.fitting.lvf import POSITIONS_NM

    error = c.map.standard_error_nm(c.places_px)
    known = POSITIONS_NM[error <= _KNOWN_NM]
    reach = f"{known.min():g} to {known.max():g} nm" if known.size else "nowhere"
    rows = [(f"known to {_KNOWN_NM:g} nm", reach)]
    for nm in (400, 450, 500, 550, 600, 650, 700):
        k = int(np.flatnonzero(POSITIONS_NM == nm)[0])
        place = f"at {c.places_px[k]:.2f} px  ± {error[k]:.2f} nm"
        rows.append((f"{nm} nm", "not on the strip" if np.isnan(c.places_px[k]) else place))
    for f in c.map.features:
        rows.append((f"mercury {f.name} nm", _line(c, f) if f.seen else "not seen"))
    rows.append(("passes", f"{c.map.width_nm:.1f} nm at 550 nm, in proportion to the wavelength elsewhere"))
    return _Part(
        "Wavelengths",
        rows,
        "Places are pixels along the strip from the picture's middle, ± is one standard error of the wavelength there; "
        "between the wavelengths named first it is small beside the width. Mercury's lines were found that far from "
        "where these wavelengths, which rest on them and on the other lights, put them: more than two standard errors "
        "are farther than it should be. The width is of the light that passes at one place, at half of its height.",
    )


def _line(c: Calibration, f: Feature) -> str:
    """How far a line of mercury was found off, beside the error of the wavelength there."""
    import numpy as np

    error = float(c.map.standard_error_nm(c.map.place(np.array([_middle(f)])))[0])
    verdict = "as it should be" if abs(f.off_nm) <= 2 * error else "farther than it should be"
    return f"found {f.off_nm:+.2f} nm off, ± {error:.2f} nm: {verdict}"


def _middle(f: Feature) -> float:
    """The wavelength of a line of mercury, or the middle of two that blend."""
    lines = [float(x) for x in f.name.split("+")]
    return sum(lines) / len(lines)


def _transmission(c: Calibration) -> _Part:
    import numpy as np

    from phoslab.fitting.lvf import POSITIONS_NM

    if c.curves is None:
        return _Part(
            "Transmission", [("curves", "none")], "There is no light of known spectrum to tell them from."
        )
    there = int(np.isfinite(c.curves.curve).all(axis=1).sum())
    unit = "from 0 (none passes) to 1 (all)" if c.absolute else "relative: how much is not known"
    return _Part(
        "Transmission",
        [
            ("curves", f"{there} of {POSITIONS_NM.size} positions, {unit}"),
            ("light", f"white LED, taken for {c.light}; alone and behind {len(c.filters)} filters"),
            ("misfit", f"{100 * c.curves.misfit:.2f} % of each position's brightest signal"),
        ],
        "How much of each wavelength passes at each position, and how far these curves are from what the camera saw. "
        "They rest on the LED's spectrum: an illuminant is one of CIE's, typical and not measured. --led names "
        "another.",
    )


_SETTING = {"exposure_s": "exposure time in s", "iso": "ISO", "f_number": "f-number"}


def _camera(c: Calibration) -> _Part:
    import numpy as np

    red, _, blue = c.map.gains
    rows = [("sensitivity", f"{c.sensitivities.name}; red x {red:.3f}, blue x {blue:.3f}")]
    if c.settings_misfit is not None:
        (kind, value), (log, se) = max(c.settings.corrections.items(), key=lambda item: abs(item[1][0]))
        rows.append(
            (
                "settings",
                f"{len(c.settings.corrections)} corrected by overlaps, which then agree to "
                f"{100 * c.settings_misfit:.2f} %; most: {_SETTING[kind]} {value:g}, which gives "
                f"{100 * abs(np.expm1(log)):.1f} ± {100 * se:.1f} % {'less' if log < 0 else 'more'} than its number",
            )
        )
    for iso, n in sorted(c.noise.items()):
        text = (
            f"{n.gain[0]:.4g} ± {n.gain[1]:.2g} DN per electron, read noise {n.read_dn[0]:.3g} ± {n.read_dn[1]:.1g} DN "
            f"({n.read_dn[0] / n.gain[0]:.1f} electrons)"
        )
        if n.dark_dn_per_s is not None:
            text += f", dark current {n.dark_dn_per_s[0]:.2g} ± {n.dark_dn_per_s[1]:.1g} DN/s"
        rows.append((f"ISO {iso:g}", text))
    return _Part(
        "Camera",
        rows,
        "Its colours' sensitivities, and the factors on red and blue that the filter's frames ask for. Settings: what "
        "exposure times, ISO and apertures really are, from frames whose settings overlap; all frames are corrected by "
        "that. Noise is from pairs of frames; DN are the camera's raw numbers.",
    )


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
            at = float(c.map.place(np.array([_middle(f)]))[0])
            upper.plot(at, float(np.interp(at, s, nm - straight)) + f.off_nm, "o", ms=5, color="#c0392b")
            # At the top, clear of dots and band.
            upper.annotate(
                f.name.replace("+", "\n"),
                (at, 1),
                xycoords=("data", "axes fraction"),
                xytext=(0, -4),
                textcoords="offset points",
                fontsize=7,
                ha="center",
                va="top",
            )
    upper.margins(y=0.15)
    upper.set_xlabel("place along the strip, from the picture's middle [px]")
    upper.set_ylabel("wavelength less a straight line [nm]\n(band: 2 standard errors; dots: mercury)")
    if c.curves is not None:
        for k in range(0, POSITIONS_NM.size, 2):
            curve, band = c.curves.curve[k], 2 * c.curves.standard_error[k]
            if np.isfinite(curve).all():
                colour = f"C{k // 2 % 10}"
                lower.plot(GRID_NM, curve, color=colour, lw=1)
                lower.annotate(
                    f"{POSITIONS_NM[k]:g}",
                    (GRID_NM[np.argmax(curve)], float(curve.max())),
                    xytext=(0, 6),
                    textcoords="offset points",
                    fontsize=7,
                    color=colour,
                    ha="center",
                )
                lower.fill_between(
                    GRID_NM, np.maximum(curve - band, 0), curve + band, color=colour, alpha=0.2, lw=0
                )
        lower.set_ylim(0, 1.1 * lower.get_ylim()[1])
    lower.set_xlim(390, 710)
    lower.set_xlabel("wavelength [nm]")
    lower.set_ylabel("transmission" if c.absolute else "transmission [relative]")
    for axes in (upper, lower):
        axes.grid(alpha=0.25)
    return svg(figure)
