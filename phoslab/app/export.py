"""Write a material, or a preset, in a format that other software reads."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from phoslab.material import Material

HELP = "write a material in another format"
EXAMPLE = "phoslab export green --to csv -o green.csv"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("material", help="a material.json, or the name of a preset")
    parser.add_argument("--to", required=True, choices=sorted(FORMATS), help="format to write")
    parser.add_argument("-o", "--output", required=True, type=Path, metavar="FILE", help="file to write")


def run(args: argparse.Namespace) -> int:
    from phoslab import presets
    from phoslab.errors import PhoslabError
    from phoslab.files import write_text
    from phoslab.material import Material

    known = args.material in presets.names()
    if not known and args.output.resolve() == Path(args.material).resolve():
        raise PhoslabError("is the material itself", file=args.output, remedy="Name another file to write.")
    material = presets.preset(args.material) if known else Material.load(args.material)
    write_text(args.output, FORMATS[args.to](material))
    print(args.output)
    return 0


COLUMNS = (
    "state",
    "band_low_nm",
    "band_high_nm",
    "kr_per_s",
    "ke_m2_per_J",
    "emission_J_per_m2_sr_nm",
    "calibration",
)


def to_csv(material: Material) -> str:
    """Return one row a state and band, in long form, with units in the column names; empty: never measured."""
    import csv
    import io

    import numpy as np

    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    edges = material.bands.edges_nm.tolist()
    for i, kr in enumerate(material.kr_per_s.tolist()):
        for j in range(material.bands.n):
            ke = float(material.ke_m2_per_J[i, j])
            shown = "" if np.isnan(ke) else ke
            emission = float(material.emission[i, j])
            table.writerow([i, edges[j], edges[j + 1], kr, shown, emission, material.calibration])
    return text.getvalue()


FORMATS: dict[str, Callable[[Material], str]] = {"csv": to_csv}
