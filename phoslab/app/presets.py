"""List the measured materials that ship with phoslab."""

from __future__ import annotations

import argparse

HELP = "list the measured materials that ship with phoslab"
EXAMPLE = "phoslab presets"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")


def run(args: argparse.Namespace) -> int:
    import json

    import numpy as np

    from phoslab import presets

    materials = {name: presets.preset(name) for name in presets.names()}
    if args.json:
        print(
            json.dumps({name: json.loads(m.to_json()) for name, m in materials.items()}, ensure_ascii=False)
        )
        return 0
    print(f"{'name':12s} {'states':>6s}  {'kr [1/s]':14s} {'glows most at':16s} excitation")
    for name, m in materials.items():
        rates = ", ".join(f"{kr:g}" for kr in m.kr_per_s)
        peak = m.bands.label(int(np.argmax(m.kr_per_s @ m.emission)))
        measured = "never measured" if np.isnan(m.ke_m2_per_J).all() else "measured"
        print(f"{name:12s} {m.n_states:6d}  {rates:14s} {peak:16s} {measured}")
    print("\nSource: " + str(m.provenance["citation"]).rsplit(",", 1)[0] + ", Tables 8.1 and A.1.")
    print("Use one as `preset:NAME` in a scene, or write it out with `phoslab export NAME --to csv -o FILE`.")
    return 0
