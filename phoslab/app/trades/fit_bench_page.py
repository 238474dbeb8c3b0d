"""The page of the fit trade, further down: single pixels, and what begins at RAW frames of the bench."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

import numpy as np
from numpy.typing import NDArray

from phoslab.app.trades.fit_frames import EveryPixel, Reduced
from phoslab.app.trades.fit_materials import AT_S, Excited, Judged
from phoslab.app.trades.fit_page import Part
from phoslab.app.trades.fit_pixels import Beside, Pixels
from phoslab.app.trades.fit_process import Took
from phoslab.app.trades.fit_spectra import Misses
from phoslab.app.trades.page import Section, Table

Array = NDArray[np.float64]

# What has been promised.
FITS_PER_S = 100_000
DELTA_E = 2.0
LEVEL, RISE = 0.02, 0.05
DECODES = 1.3

_PAPER = {"1": 13.16, "2": 5.46}
"""Mean ΔE00 of Nalbach 2017, by the number of states."""


def pixels(rows: Sequence[Pixels], peers: Sequence[Beside]) -> Part:
    """How fast every pixel is fitted."""
    speed = Table(
        "pixels",
        f"{rows[0].n:,} pixels, the case above; medians of {len(rows[0].fits_per_s)} runs and their range (promised: "
        f"{FITS_PER_S:,} a second on two cores, every rate within 10 %).",
        (
            "fit",
            "starts",
            "fits a second",
            "a second of one processor",
            "both rates within 10 %",
            "worst rate off by",
            "scatter / Cramer-Rao bound",
        ),
        [
            *(
                (
                    "phoslab",
                    r.start,
                    f"{median(r.fits_per_s):,.0f} ({min(r.fits_per_s):,.0f} to {max(r.fits_per_s):,.0f})",
                    f"{r.fits_per_cpu_s:,.0f}",
                    f"{r.within:.2%}",
                    f"{r.worst:.1%}",
                    ", ".join(f"{s:.3f}" for s in r.scatter),
                )
                for r in rows
            ),
            *(
                (p.peer, "a guess", "-", f"{p.fits_per_cpu_s:,.0f}", f"{p.within:.0%}", "-", "-")
                for p in peers
            ),
        ],
    )
    text = [
        "Every pixel of a photographed sample is fitted by itself, three channels together, from no guess. The peers "
        "are given rates near the truth; flimlib takes all pixels in one call, one channel of each."
    ]
    answer = (
        f"Per pixel: {max(median(r.fits_per_s) for r in rows):,.0f} fits a second by the clock, "
        f"{max(r.fits_per_cpu_s for r in rows):,.0f} a second of one processor"
        + "".join(f", {p.peer} {p.fits_per_cpu_s:,.0f}" for p in peers)
        + f"; both rates within 10 % in {min(r.within for r in rows):.2%}."
    )
    data = {
        "pixels": [
            {**vars(r), "fits_per_s": list(r.fits_per_s), "scatter": r.scatter.tolist()} for r in rows
        ],
        "pixels_peers": [vars(p) for p in peers],
    }
    return Part(answer, Section("How fast is a fit of every pixel?", text, [speed]), data)


def spectra(kinds: Sequence[Misses]) -> Part:
    """How well unknown spectra are found."""
    table = Table(
        "spectra",
        "Relative error (root mean square over 420 to 680 nm), and share of wavelengths at which the truth lies within "
        "one and two of the stated standard errors (68 and 95 % if these are right).",
        ("light", "spectra", "median", "90 % below", "worst", "within 1", "within 2"),
        [
            (
                m.kind,
                f"{len(m.found)}",
                f"{m.quantile(0.5):.1%}",
                f"{m.quantile(0.9):.1%}",
                f"{m.worst.error:.1%} ({m.worst.name})",
                f"{m.within(1):.0%}",
                f"{m.within(2):.0%}",
            )
            for m in kinds
        ],
    )
    text = [
        "Light of the bench through the linear variable filter, whose calibration has seen 14 colour filters. "
        "Filters: an LED through each one that it has not seen. Patches under the same LED (Nalbach 2017, Fig. 8.8). "
        "Glows of samples, whose spectra have corners and whose unevenness is not known; and their first frame with "
        "noise added, as a share of the brightest value along the strip."
    ]
    answer = "Spectra: " + "; ".join(
        f"{m.kind} off by {m.quantile(0.5):.1%}, the worst, {m.worst.name}, by {m.worst.error:.1%}"
        for m in kinds
        if "noise" not in m.kind
    )
    data = [
        {
            "kind": m.kind,
            "spectra": len(m.found),
            "median": m.quantile(0.5),
            "below_90_percent": m.quantile(0.9),
            "worst": m.worst.error,
            "worst_name": m.worst.name,
            "within_1": m.within(1),
            "within_2": m.within(2),
        }
        for m in kinds
    ]
    return Part(f"{answer}.", Section("Are spectra right?", text, [table]), {"spectra": data})


def materials(judged: Sequence[Judged]) -> Part:
    """Whether materials from RAW frames look and charge like the samples."""
    asked = list(judged[0].seen)
    paints = [j for j in judged if j.name != "two-states"] or judged
    mean = {k: float(np.mean([j.seen[k].delta_e for j in paints])) for k in asked}
    words = {k: f"{k} state{'s' if k != '1' else ''}" for k in asked} | {"auto": "automatic"}
    pictures = Table(
        "pictures",
        f"ΔE00 between fitted material and photographs; means over {', '.join(f'{t:g}' for t in AT_S)} s after the "
        f"lamp (promised for the automatic fit: below {DELTA_E:g}).",
        ("sample", *(words[k] for k in asked), "its states", "at each moment", "unit adjusted by"),
        [
            *(
                (
                    j.name,
                    *(f"{j.seen[k].delta_e.mean():.1f}" for k in asked),
                    f"{j.seen['auto'].n_states}",
                    ", ".join(f"{d:.1f}" for d in j.seen["auto"].delta_e),
                    f"{j.seen['auto'].factor - 1:+.1%}",
                )
                for j in judged
            ),
            ("mean of those that hold traps", *(f"{mean[k]:.1f}" for k in asked), "-", "-", "-"),
            ("Nalbach 2017", *(f"{_PAPER[k]:.1f}" if k in _PAPER else "-" for k in asked), "-", "-", "-"),
        ],
    )
    charging = Table(
        "levels",
        f"The excitation of the automatic fit, places brighter than a tenth of the brightest (promised where the "
        f"sample follows the model: level within {LEVEL:.0%}, rise within {RISE:.0%}).",
        (
            "sample",
            "level missed by, median",
            "worst place",
            "half rise, measured [s]",
            "modelled, of that",
            "share of excitation, bands 1 to 3",
            "truth",
        ),
        [
            (
                j.name,
                f"{j.excited.level:.1%}",
                f"{j.excited.level_worst:.1%}",
                f"{j.excited.rise_s:.1f}",
                f"{j.excited.rise_ratio:.2f}",
                _shares(j.excited.share),
                _shares(j.excited.true_share),
            )
            for j in judged
        ],
    )
    text = [
        "Each sample of the bench is measured by the plans of `measure all`, and its material fitted from the RAW "
        "frames with its own spectrum and excitation rates. A rested sample is then charged anew and seen without "
        "noise, at moments that no fit has seen, while the material is charged by the same lamp and seen through the "
        "camera's sensitivities (Nalbach 2017, Fig. 8.13). One factor for the three pictures of a sample is adjusted, "
        "the camera's unit.",
        "two-states follows the model: its equations, of rates 0.2 and 0.02 1/s under a lamp that saturates 1.5 times "
        "as fast, were integrated by LSODA. The others hold traps of many depths, and electrons are caught again: "
        "there the level is met first, and the rise is too fast. The share of a band is its part of what the whole "
        "lamp stores, beside its part of the electrons that the lamp sets free.",
    ]
    exact = {j.name: j.excited for j in judged}.get("two-states")
    answer = _followed(exact) if exact else ""
    if paints is not judged:
        off = [j.excited.level for j in paints]
        answer += (
            f"Pictures that no fit has seen: a mean ΔE00 of {mean['auto']:.1f} ("
            + ", ".join(f"{words[k]}: {mean[k]:.1f}" for k in asked if k != "auto")
            + f"); the level of paint, which does not follow, is missed by {min(off):.1%} to {max(off):.1%} (medians)."
        )
    data = [
        {
            "sample": j.name,
            "pictures": {
                k: {"states": s.n_states, "delta_e": s.delta_e.tolist(), "factor": s.factor}
                for k, s in j.seen.items()
            },
            "excitation": {
                **vars(j.excited),
                "rate_error": None if j.excited.rate_error is None else j.excited.rate_error.tolist(),
                "share": j.excited.share.tolist(),
                "true_share": j.excited.true_share.tolist(),
            },
        }
        for j in judged
    ]
    title = "Do materials from RAW frames glow and charge like the samples?"
    return Part(answer.strip(), Section(title, text, [pictures, charging]), {"materials": data})


def _followed(exact: Excited) -> str:
    off = np.abs(exact.rate_error).max() if exact.rate_error is not None else float("nan")
    return (
        f"A sample that follows the model, from RAW frames: rates within {off:.1%}, level missed by {exact.level:.1%} "
        f"(worst place {exact.level_worst:.1%}), half the rise after {exact.rise_ratio:.2f} of the measured time. "
    )


def _shares(share: Array) -> str:
    return ", ".join(f"{s:.3f}" for s in share[:3])


def commands(frames: int, size_bytes: int, rows: Sequence[tuple[str, Took]]) -> Part:
    """What a whole campaign takes from RAW to report."""
    table = Table(
        "commands",
        "What a person types; memory is that of all its processes together, at most.",
        ("command", "time [s]", "of processors [s]", "memory [MB]"),
        [(name, f"{t.clock_s:.1f}", f"{t.cpu_s:.1f}", f"{t.held_bytes / 1e6:.0f}") for name, t in rows],
    )
    text = [f"{frames} frames of the bench, {size_bytes / 1e6:.0f} MB, from RAW to the report."]
    answer = f"From {frames} RAW frames to a report: " + ", ".join(
        f"phoslab {name} {t.clock_s:.0f} s and {t.held_bytes / 1e6:.0f} MB" for name, t in rows
    )
    data = {
        "frames": frames,
        "bytes": size_bytes,
        "commands": [
            {"command": n, "clock_s": t.clock_s, "cpu_s": t.cpu_s, "held_bytes": t.held_bytes}
            for n, t in rows
        ],
    }
    return Part(f"{answer}.", Section("What does a campaign take?", text, [table]), {"campaign": data})


def frames(reduced: Sequence[Reduced], every: EveryPixel, compressed: bool) -> Part:
    """What large frames take."""
    reduction = Table(
        "reduction",
        f"A decay session reduced, beside rawpy alone decoding the same files one after the other; medians of "
        f"{len(reduced[0].ratio)} turns (promised: {DECODES:g} times the decode, and memory that does not grow with "
        "the number of frames).",
        (
            "frames",
            "megapixels",
            "decode [ms a frame]",
            "reduction [ms a frame]",
            "times, by the clock",
            "of processors",
            "memory [MB]",
        ),
        [
            (
                f"{r.frames}",
                f"{r.pixels / 1e6:.2g}",
                f"{1e3 * r.decode_s:.0f}",
                f"{1e3 * r.reduce_s:.0f}",
                f"{median(r.ratio):.2f} ({min(r.ratio):.2f} to {max(r.ratio):.2f})",
                f"{r.cpu_ratio:.2f}",
                f"{r.held_bytes / 1e6:.0f}",
            )
            for r in reduced
        ],
    )
    maps = Table(
        "maps",
        "phoslab fit --per-pixel, all processes together.",
        ("frames", "megapixels", "pixels fitted", "states", "time [s]", "of processors [s]", "memory [MB]"),
        [
            (
                f"{every.frames}",
                f"{every.pixels / 1e6:.2g}",
                f"{every.fitted:,}",
                f"{every.states}",
                f"{every.clock_s:.0f}",
                f"{every.cpu_s:.0f}",
                f"{every.held_bytes / 1e6:.0f}",
            )
        ],
    )
    said = (
        "Frames are lossless JPEG, as cameras write them."
        if compressed
        else "imagecodecs is not installed (pip install phoslab[peers]), so frames are not compressed: they decode in "
        "no time, and the ratio says little."
    )
    text = [f"{said} The reduction decodes two frames at a time, in workers of its own."]
    answer = (
        "Reduction over bare decode: "
        + ", ".join(f"{median(r.ratio):.2f} ({r.frames} frames of {r.pixels / 1e6:.2g} Mpx)" for r in reduced)
        + f"; every pixel of {every.pixels / 1e6:.2g} Mpx in {every.held_bytes / 1e9:.1f} GB."
    )
    data = {
        "compressed": compressed,
        "reduction": [{**vars(r), "ratio": list(r.ratio)} for r in reduced],
        "every_pixel": vars(every),
    }
    return Part(
        answer, Section("What do large frames take?", text, [reduction, maps]), {"large_frames": data}
    )
