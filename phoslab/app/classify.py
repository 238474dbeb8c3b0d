"""Estimate the class of a photoluminescent sign from its decay: a table of luminance, or a material."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "luminance decay against the classes of safety signs"
EXAMPLE = "phoslab classify decay.csv --unit mcd/m2 --lux 1000 --minutes 5"

_MCD = {"mcd/m2": 1.0, "cd/m2": 1000.0}


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("decay", type=Path, metavar="MATERIAL.json|DECAY.csv", help="what glows")
    parser.add_argument(
        "--unit",
        choices=[*_MCD, "relative"],
        default="relative",
        help="of a table's values (default: relative, which tells ratios only)",
    )
    parser.add_argument("--channel", help="the table's column of luminance (default: its only one)")
    parser.add_argument("--lux", type=_positive, help="illuminance that charged the sample, in lx")
    parser.add_argument("--minutes", type=_positive, help="how long it was charged")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"{text!r} is no positive number")
    return value


def run(args: argparse.Namespace) -> int:
    import json

    import numpy as np
    from numpy.typing import NDArray

    from phoslab.errors import PhoslabError, printable
    from phoslab.fitting import photometric_class as pc

    Array = NDArray[np.float64]
    if args.decay.is_dir():
        raise PhoslabError(
            "is a folder, and a class is told from a material or a table of luminance",
            file=args.decay,
            remedy=f"If sessions lie in it, fit them first: `phoslab fit {args.decay} -o material.json`, then "
            "`phoslab classify material.json`.",
        )
    if str(args.decay).startswith("preset:"):
        raise PhoslabError(
            "is a preset, and these are calibrated only relatively: they have no class",
            field=str(args.decay),
            remedy="Name a material file or a table of luminance.",
        )
    is_material = args.decay.suffix == ".json"
    if is_material:
        from phoslab.kinetics import emitted_radiance
        from phoslab.material import Material
        from phoslab.photometry import luminance

        material = Material.load(args.decay)
        if loose := material.provenance.get("product_only"):
            which = ", ".join(str(i + 1) for i in loose)
            raise PhoslabError(
                f"does not tell how full state {which} was when the lamp went off: how bright the sample is when every "
                "state is full, as after a standard's charge, is not known",
                file=args.decay,
                field="provenance.product_only",
                remedy="Classify a decay that was measured after the standard's charge; what else would tell stands in "
                "the report of the fit.",
            )
        absolute = material.calibration == "absolute"
        if material.valid_s is None:
            raise PhoslabError(
                "does not say how far its data reach",
                file=args.decay,
                field="valid_s",
                remedy="Give [first, last] in s.",
            )

        def glow_of_material(t_s: Array) -> Array:
            full = np.exp(-np.outer(t_s, material.kr_per_s))  # r(0) = 1: the material says no other
            return np.asarray(1e3 * luminance(emitted_radiance(material, full), material.bands))

        glow = pc.Glow(glow_of_material, *material.valid_s)
        flags: tuple[str, ...] = ()
        note = "every state full when the light went off; the glow is the material's own"
    else:
        from phoslab.fitting.screening import screen
        from phoslab.fitting.table import read_table

        screened = screen(read_table(args.decay))
        data, flags = screened.data, screened.flags
        channel = _channel(args.channel, data.channels, args.decay)
        absolute = args.unit != "relative"
        glow = pc.measured(data, channel, _MCD.get(args.unit, 1.0), sigma_given=screened.sigma_given)
        flags += pc.in_the_noise(data, channel)
        note = f"measured values of {data.channels[channel]}, straight lines in log L over log t between them"
    excitation = pc.Excitation(args.lux, None if args.minutes is None else 60 * args.minutes)
    start = float(glow.luminance_mcd(np.array([glow.first_s]))[0])
    ratios = {f"{m:g} min": v / start for m, v in glow.at(pc.MINUTES).items()}
    verdicts = pc.classify(glow, excitation) if absolute else []
    # The label says nothing of the light before it: of another charging it would pass for the standard's.
    unlike_din = pc.differs(pc.DIN, excitation)
    label = pc.din_label(glow) if absolute and not unlike_din else None
    if args.json:
        print(
            json.dumps(
                {
                    "absolute": absolute,
                    "reaches_s": glow.last_s,
                    "start_s": glow.first_s,
                    "of_the_start": ratios,
                    "verdicts": [{**vars(v), "luminance_mcd": dict(v.luminance_mcd)} for v in verdicts],
                    "din_67510_style": label,
                    "din_67510_condition": pc.DIN.unchecked if label else None,
                    "flags": list(flags),
                    "note": pc.SOURCE,
                },
                allow_nan=False,
            )
        )
        return 0
    print(printable(f"{args.decay.name}: {note}; data reach {glow.span}"))
    if not absolute:
        shares = (
            ", ".join(f"{share:.2%} at {when}" for when, share in ratios.items())
            or f"none at {', '.join(f'{m:g}' for m in pc.MINUTES[:-1])} or {pc.MINUTES[-1]:g} min"
        )
        print(
            "Calibrated only relatively: no class can be given, only shares of the glow at "
            f"{glow.first_s:.3g} s, the first that the data support: {shares}."
        )
        print(
            'A material needs "calibration": "absolute", see "Relative and absolute" in docs/model.md; or classify a '
            "table of a luminance meter."
            if is_material
            else "For a table of luminance say --unit mcd/m2."
        )
    for v in verdicts:
        measured = ", ".join(f"{x:.3g} at {m:g} min" for m, x in v.luminance_mcd.items())
        held = f"{v.verdict}{', ' * bool(v.condition)}{v.condition}"
        print(f"  {v.standard:16} {held}: {v.reason}" + (f"  [mcd/m2: {measured}]" if measured else ""))
    if absolute:
        said = (
            f"not comparable: {unlike_din}"
            if unlike_din
            else f"{label}, {pc.DIN.unchecked}: {pc.DIN_LEGEND}"
            if label
            else f"insufficient data: they reach {glow.span}; 10 or 60 min are needed"
        )
        print(f"  {pc.DIN.name:16} {said}")
    if any(v.verdict == "not comparable" for v in verdicts):
        print(
            "Say how the sample was charged with --lux and --minutes."
            if args.lux is None or args.minutes is None
            else "Where the charging differs no class is told: charge as that standard does, and measure again."
        )
    for flag in flags:
        print(f"  {flag}")
    print(pc.SOURCE)
    return 0


def _channel(name: str | None, channels: tuple[str, ...], file: Path) -> int:
    from phoslab.errors import PhoslabError

    if name is None and len(channels) == 1:
        return 0
    choices = f"one of: {', '.join(channels)}"
    if name is None:
        raise PhoslabError(
            f"has {len(channels)} channels",
            file=file,
            remedy=f"Say with --channel which is the luminance, {choices}.",
        )
    if name not in channels:
        raise PhoslabError(f"has no channel {name!r}", file=file, remedy=f"Use --channel with {choices}.")
    return channels.index(name)
