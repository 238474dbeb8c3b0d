"""The main job, on recorded sample data: sessions become a material, the material glows in a picture."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "fit the sample sessions, render the sample scene, write one report"
EXAMPLE = "phoslab demo -o phoslab-demo"

TIMES = ("off-1s", "off+1s", "off+80s")
CAPTIONS = ("Lamp on, one second before it goes off", "1 s after", "80 s after")
SCENE_NOTE = (
    "The pawn is the material that was fitted here. The others are published single-exponential paints: moon white, "
    "ball blue, vase pink, star yellow, ring green, cube purple, cone orange, knot red. How bright they are beside "
    "each other is not known (relative calibration); the pawn's factor lets it start like the green ring."
)


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("phoslab-demo"), metavar="DIR", help="folder to write into"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")


def run(args: argparse.Namespace) -> int:
    import json
    import shutil
    from importlib.resources import as_file, files

    from phoslab import render
    from phoslab.app.progress import progress_bar
    from phoslab.app.report import Picture, write_report
    from phoslab.files import check_writable, replacing
    from phoslab.fitting import fit_session

    out: Path = args.output
    for name in ("report.html", "material.json", "scene/scene.toml"):
        check_writable(out / name)
    samples = files("phoslab.sample_data")
    with (
        as_file(samples / "sessions" / "green") as sessions,
        progress_bar("decoding frames", quiet=args.json) as progress,
    ):
        result = fit_session([sessions], lvf=sessions / "lvf.json", progress=progress)
    result.material.save(out / "material.json")

    # The scene names material.json, beside it: in the copy, that is the material just fitted.
    scene_folder = out / "scene"
    with as_file(samples / "scenes" / "fading") as scene:
        for file in sorted(p for p in scene.rglob("*") if p.is_file() and p.name != "material.json"):
            with replacing(scene_folder / file.relative_to(scene)) as temporary:
                shutil.copyfile(file, temporary)
    result.material.save(scene_folder / "material.json")
    with progress_bar("rendering", quiet=args.json) as progress:
        frames = render.render(scene_folder, TIMES, progress=progress)
    pictures = frames.write(out / "glow.png")

    report = out / "report.html"
    shown = [frames.exposure_of(frame) for frame in frames.frames]
    captions = [
        caption if exposure == shown[0] else f"{caption}, shown {exposure / shown[0]:.0f} times brighter"
        for caption, exposure in zip(CAPTIONS, shown, strict=True)
    ]
    notes = [SCENE_NOTE, *frames.warnings]
    write_report(report, result, [Picture(p, c) for p, c in zip(pictures, captions, strict=True)], notes)
    if args.json:
        print(
            json.dumps(
                {
                    "report": str(report),
                    "material": str(out / "material.json"),
                    "pictures": [*map(str, pictures)],
                }
            )
        )
    else:
        print(result.report())
        print(f"The report, with pictures: {report.resolve()}")
    return 0
