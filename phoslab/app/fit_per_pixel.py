"""`phoslab fit SESSION --per-pixel -o maps`: a folder with a material that varies over its surface.

One for each of several sessions, on this machine or on the workers of a dask scheduler.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from phoslab.fitting.engine import Fits
    from phoslab.fitting.pixel_maps import PixelMaps

_LARGEST_PREVIEW = 1600


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of maps to those of `fit`."""
    maps = parser.add_argument_group("maps")
    maps.add_argument(
        "--per-pixel",
        action="store_true",
        help="fit every pixel by itself, and write a folder (-o) with a material.json, the maps that it names, and a "
        "report; the number of states is that of the whole sample",
    )
    maps.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="fit on the workers of a dask scheduler that runs already, such as tcp://127.0.0.1:8786; beyond this "
        "machine only tls://",
    )
    maps.add_argument(
        "--bin",
        type=_side,
        default=1,
        metavar="N",
        help="average N x N cells of the colour pattern for a pixel of the maps: less noise, fewer pixels (default: 1)",
    )


def _side(text: str) -> int:
    if not text.isdigit() or not 1 <= int(text) <= 256:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 1 to 256")
    return int(text)


def run(args: argparse.Namespace) -> int:
    """Fit each sample as a whole, then every pixel; write a folder for each, whole or not at all."""
    from phoslab.errors import PhoslabError

    if not args.per_pixel:
        field = "--scheduler" if args.scheduler else "--bin"
        raise PhoslabError("is for maps", field=field, remedy="Add --per-pixel, or leave it out.")
    targets = _targets(args)
    summaries = []
    with _engine(args.scheduler) as engine:
        for path, folder in targets.items():
            maps = _made(args, path, folder, engine)
            if args.json:
                summaries.append(_summary(maps, folder))
            else:
                print(maps.report())
                print(f"Wrote {folder} with {', '.join(sorted(p.name for p in folder.iterdir()))}")
    if args.json:
        print(json.dumps(summaries[0] if len(summaries) == 1 else summaries))
    return 0


def _targets(args: argparse.Namespace) -> dict[Path, Path]:
    """Return the folder of maps for each session, or folder of sessions; refuse what cannot be written."""
    from phoslab.errors import PhoslabError
    from phoslab.files import check_writable

    for path in args.session:
        if path.is_file():
            raise PhoslabError(
                "is a table, which has no pixels",
                file=path,
                remedy="Name the folder of a decay session.",
            )
    if args.preset is None and args.lvf is None and not any(_is_campaign(p) for p in args.session):
        raise PhoslabError(
            "is missing",
            field="--preset",
            remedy="Name the material that lends excitation rates and spectrum (see `phoslab presets`); or a folder of "
            "sessions in which they were measured, with --lvf.",
        )
    if args.output is None:
        raise PhoslabError("is missing", field="-o", remedy="Name the folder to write.")
    if args.report is not None:
        raise PhoslabError(
            "is written into the folder of the maps",
            field="--report",
            remedy="Leave it out with --per-pixel.",
        )
    several = len(args.session) > 1
    targets = {p: args.output / p.resolve().name if several else args.output for p in args.session}
    if len(set(targets.values())) < len(args.session):
        raise PhoslabError(
            "have the same name, by which their folders of maps are told apart",
            field="two sessions",
            remedy="Fit them one by one, each with its own -o.",
        )
    for path, folder in targets.items():
        if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
            raise PhoslabError("is not a folder", file=folder, remedy="Name a new folder for the maps.")
        if folder.is_dir() and any(folder.iterdir()):
            raise PhoslabError(
                "holds something already", file=folder, remedy="Name a new folder for the maps."
            )
        if folder.resolve().is_relative_to(path.resolve()):
            raise PhoslabError(
                "lies in the session, which is never written to",
                file=folder,
                remedy="Name a folder elsewhere.",
            )
        check_writable(folder / "material.json")
    return targets


def _is_campaign(path: Path) -> bool:
    return path.is_dir() and not (path / "session.toml").exists()


def _engine(address: str | None) -> contextlib.AbstractContextManager[Fits]:
    from phoslab.fitting import engine

    return contextlib.nullcontext(engine.here) if address is None else engine.on_scheduler(address)


def _made(args: argparse.Namespace, path: Path, folder: Path, engine: Fits) -> PixelMaps:
    """Fit one, and put its folder there at once."""
    from phoslab.errors import PhoslabError
    from phoslab.files import umask

    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".phoslab-", dir=folder.parent) as scratch:
            maps = _fit(args, path, Path(scratch), engine)
            # A folder of its own, so that a rename puts all of it there at once.
            made = Path(scratch) / "maps"
            made.mkdir()
            _write(maps, made)
            made.chmod(0o777 & ~umask())
            made.replace(folder)
    except OSError as error:
        raise PhoslabError(
            f"cannot be written ({error.strerror or error})",
            file=folder,
            remedy="Check the disk and its free space.",
        ) from error
    return maps


def _fit(args: argparse.Namespace, path: Path, scratch: Path, engine: Fits) -> PixelMaps:
    from phoslab.app.progress import progress_bar
    from phoslab.fitting import fit_session
    from phoslab.fitting.gather import gather
    from phoslab.fitting.pixel_maps import fit_maps

    session = gather([path]).get("decay")
    with progress_bar("the sample as a whole", quiet=args.json) as progress:
        whole = fit_session(
            [path],
            lvf=args.lvf,
            preset=args.preset,
            states=args.states if args.states == "auto" else int(args.states),
            name=args.name,
            progress=progress,
        )
    assert session is not None  # fit_session has refused it
    # One bar, in percent: frames are the first half, rows of pixels the second.
    with progress_bar("its pixels", quiet=args.json) as percent:
        return fit_maps(
            session,
            whole,
            scratch,
            side=args.bin,
            engine=engine,
            decoded=lambda done, total: percent(50 * done // total, 100),
            fitted=lambda done, total: percent(50 + 50 * done // total, 100),
        )


def _summary(maps: PixelMaps, folder: Path) -> dict[str, Any]:
    def plain(row: dict[str, float]) -> dict[str, float | None]:
        return {k: v if math.isfinite(v) else None for k, v in row.items()}

    return {
        "material": str(folder / "material.json"),
        "report": str(folder / "report.html"),
        "shape": list(maps.shape),
        "states": maps.whole.fit.n_states,
        "kr_per_s": [plain(row) for row in maps.spread()],
        "counts": maps.counts(),
        "warnings": [*maps.whole.warnings, *maps.warnings()],
    }


def _write(maps: PixelMaps, folder: Path) -> None:
    """Write maps, previews and report."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    from phoslab.app.report import data_uri, write_report
    from phoslab.files import write_text
    from phoslab.fitting.pixel_maps import write_maps

    write_maps(maps, folder)
    write_report(folder / "sample.html", maps.whole)
    environment = Environment(
        loader=PackageLoader("phoslab.app", "."), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    page = environment.get_template("fit_per_pixel.html").render(
        maps=maps,
        counts=maps.counts(),
        spread=maps.spread(),
        pictures=[(data_uri(folder / name), caption) for name, caption in _previews(maps, folder)],
    )
    write_text(folder / "report.html", page)


def _previews(maps: PixelMaps, folder: Path) -> list[tuple[str, str]]:
    """Draw the maps, each with its scale, and name the files with what they show."""
    import numpy as np

    fits, fit = maps.fits, maps.whole.fit
    drawn = []
    for i in range(fit.n_states):
        has = maps.fitted & (fits.amplitude[:, i] > 0)
        for name, values, unit, caption in (
            (f"kr{i + 1}", fits.kr_per_s, "1/s", f"kr[{i + 1}]: re-radiation rate"),
            (f"kr{i + 1}_error", fits.kr_error, "1/s", f"kr[{i + 1}]: its standard error"),
            (f"amplitude{i + 1}", fits.amplitude, "signal", f"A[{i + 1}]: light of that state at lamp-off"),
        ):
            shown = np.where(has & np.isfinite(values[:, i]), values[:, i], np.nan)
            _draw(folder / f"{name}.png", shown.reshape(maps.shape), f"{caption} [{unit}]")
            drawn.append((f"{name}.png", caption))
    _draw_flags(folder / "flags.png", maps)
    return [*drawn, ("flags.png", "what is to be said of each pixel")]


def _thinned(image: NDArray[Any]) -> NDArray[Any]:
    """Every n-th pixel of what is larger than a screen."""
    n = -(-max(image.shape) // _LARGEST_PREVIEW)
    return image[::n, ::n]


def _draw(path: Path, image: NDArray[Any], label: str) -> None:
    """Draw one map; its scale leaves out the outermost percent on each side."""
    import numpy as np
    from matplotlib.figure import Figure

    image = _thinned(image)
    known = image[np.isfinite(image)]
    low, high = np.percentile(known, [1, 99]) if known.size else (0.0, 1.0)
    figure = Figure(
        figsize=(5.2, 0.9 + 4.2 * min(2.0, image.shape[0] / image.shape[1])), layout="constrained"
    )
    axes = figure.subplots()
    axes.set_facecolor("0.88")
    shown = axes.imshow(image, vmin=low, vmax=high if high > low else low + 1e-30, interpolation="nearest")
    figure.colorbar(shown, ax=axes, label=label, extend="both")
    axes.set_xticks([])
    axes.set_yticks([])
    figure.savefig(path, dpi=110)


def _draw_flags(path: Path, maps: PixelMaps) -> None:
    """Draw the gravest flag of each pixel, by colour, with a legend that counts."""
    import numpy as np
    from matplotlib.colors import BoundaryNorm, ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    from phoslab.fitting.pixel_decay import Flag

    kinds = (
        (Flag.CLIPPED, "#e6a817", "some values saturated or hot, left out"),
        (Flag.MISFIT, "#8e44ad", "missed by more than noise"),
        (Flag.FEWER, "#2e86c1", "fewer states than the sample"),
        (Flag.UNDETERMINED, "#d35400", "rate not determined"),
        (Flag.UNCONVERGED, "#c0392b", "search did not end"),
        (Flag.DARK, "#111111", "too dark"),
        (Flag.MASKED, "#dddddd", "does not glow"),
    )
    image = np.zeros(maps.shape, np.int64)
    flags = maps.fits.flags.reshape(maps.shape)
    for k, (flag, _, _) in enumerate(kinds):
        image[flags & flag > 0] = k + 1
    colours = ["#7fbf7f", *(colour for _, colour, _ in kinds)]
    names = ["fitted, nothing to say", *(name for _, _, name in kinds)]
    n = np.bincount(image.ravel(), minlength=len(names))
    image = _thinned(image)
    figure = Figure(
        figsize=(5.2, 0.6 + 0.25 * (n > 0).sum() + 4.8 * min(2.0, image.shape[0] / image.shape[1])),
        layout="constrained",
    )
    axes = figure.subplots()
    axes.imshow(
        image,
        cmap=ListedColormap(colours),
        norm=BoundaryNorm(np.arange(len(colours) + 1) - 0.5, len(colours)),
        interpolation="nearest",
    )
    axes.set_xticks([])
    axes.set_yticks([])
    figure.legend(
        handles=[
            Patch(color=c, label=f"{name}: {k:,}") for c, name, k in zip(colours, names, n, strict=True) if k
        ],
        loc="outside lower center",
        frameon=False,
    )
    figure.savefig(path, dpi=110)
