"""Spectra through the LVF against the truth: colour filters, ColorChecker patches (Nalbach 2017, Fig. 8.8), glows.

    python tests/benchmarks/spectra.py FOLDER

FOLDER holds, or is given, a `flats` session and an `lvf` session of the simulated bench with all 263 known filters, of
which the calibration sees 14, and an `emission` session of each of the bench's paints. Their glows are solved as they
are, and with noise added, a share of the brightest value along the strip. Errors are root mean squares over
420..680 nm, relative to the spectrum's own; coverage is the share of wavelengths there at which the truth lies within 1
and 2 of the stated standard errors.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from phoslab.app.cli import main
from phoslab.app.simulation import FILTERS
from phoslab.fitting import lvf
from phoslab.fitting.filters import transmission
from phoslab.fitting.find_strip import follow_strip
from phoslab.fitting.spectrum import NM, Spectrum, reconstruct
from phoslab.fitting.strip_light import read_light
from phoslab.instruments.bench import darkroom, lights
from phoslab.instruments.bench.dng import write_dng
from phoslab.instruments.bench.paints import paint
from phoslab.raw import preview
from phoslab.session import Frame, Session

PAINTS = ("blue", "green", "orange", "pink", "purple", "red", "white", "yellow")
SEEN = (NM >= 420) & (NM <= 680)


@dataclass
class Part:
    """Some frames of a session."""

    path: Path
    frames: tuple[Frame, ...]

    def frames_of(self, role: str) -> tuple[Frame, ...]:
        return tuple(f for f in self.frames if f.role == role)


def miss(found: Spectrum, truth: np.ndarray) -> tuple[float, np.ndarray]:
    """Relative error, and how many standard errors each wavelength is off; spectra are relative, so scaled to fit."""
    scale = (found.value @ truth) / (found.value @ found.value)
    off = (scale * found.value - truth)[SEEN]
    relative = float(np.sqrt(np.mean(off**2) / np.mean(truth[SEEN] ** 2)))
    return relative, np.abs(off / (scale * found.standard_error[SEEN]))


def patches(folder: Path) -> tuple[Part, list[str]]:
    """Frames of the checker's patches under the LED through the strip, straight from the bench's physics."""
    room = darkroom.Darkroom(2)
    names = list(darkroom._checker())
    rng = np.random.default_rng(1)
    frames = []

    def shoot(role: str, t_s: float, exposure_s: float) -> None:
        path = folder / f"{len(frames):04d}.dng"
        light = (
            room.camera.on_pixels(room.expose(t_s, exposure_s))
            if role != "dark"
            else np.zeros(room.camera.shape)
        )
        values = room.camera.numbers(light, exposure_s=exposure_s, iso=100, f_number=2.8284, rng=rng)
        settings = {"exposure_s": exposure_s, "iso": 100, "f_number": 2.8284}
        write_dng(
            path, values, room.camera.sensor, **settings, taken="2026:01:01 00:00:00", description="bench"
        )
        frames.append(Frame(path, path.name, role, t_s, exposure_s, 100.0, 2.8284, ""))

    room.door.drive(0.0, 1.0, 0.3)
    for k, name in enumerate(names):
        room.place(600.0 * (k + 1), darkroom.Stage(f"patch:{name}", "camera", "none", "led"))
        shoot(name, 600.0 * (k + 1) + 500.0, 1 / 32)
    for _ in range(4):
        shoot("dark", 0.0, 1 / 32)
    return Part(folder, tuple(frames)), names


def glows(folder: Path, calibration: lvf.Calibration) -> None:
    """Spectra of glowing paints whose unevenness is not known, at several levels of noise."""
    found: dict[str, dict[str, tuple[float, np.ndarray]]] = {}
    for k, name in enumerate(PAINTS):
        path = folder / f"glow-{name}"
        if not path.exists():
            command = ["measure", "emission", "--simulate", name, "-o", str(path), "--charge", "600"]
            main([*command, "--seed", str(20 + k), "--json"])
        session = Session.open(path)
        frames = [f for f in session.frames_of("emission") if f.start_s >= (session.lamp_off_s or 0.0)]
        strip, _ = follow_strip(preview(frames[0].path), calibration.strip)
        for share in (0.0, 1 / 100, 1 / 30, 1 / 10):
            lights_of, _ = read_light(
                session, frames if share == 0 else frames[:1], strip, calibration.settings
            )
            light, rng = lights_of[0], np.random.default_rng([k, round(1e4 * share)])
            noise = share * float(light.signal.max())
            noisy = replace(
                light,
                signal=light.signal + rng.normal(0, noise, light.signal.shape) if share else light.signal,
                sigma=np.hypot(light.sigma, noise),
            )
            kind = f"glows with noise of {share:.0%} of the brightest" if share else "glows"
            truth = paint(name).emission(NM)
            found.setdefault(kind, {})[name] = miss(reconstruct(noisy, calibration), truth)
    for kind, misses in found.items():
        report(kind, misses)


def report(kind: str, misses: dict[str, tuple[float, np.ndarray]]) -> None:
    errors = {name: relative for name, (relative, _) in misses.items()}
    off = np.concatenate([standard for _, standard in misses.values()])
    worst = max(errors, key=lambda name: errors[name])
    print(
        f"{kind}: {len(errors)} spectra, median error {np.median(list(errors.values())):.1%}, "
        f"90 % below {np.quantile(list(errors.values()), 0.9):.1%}, worst {errors[worst]:.1%} ({worst}); "
        f"coverage {np.mean(off < 1):.0%} and {np.mean(off < 2):.0%}"
    )


def run(folder: Path) -> None:
    for plan, options in (("flats", []), ("lvf", ["--filters", ",".join(lights.filter_names())])):
        if not (folder / plan).exists():
            main(["measure", plan, "--simulate", "green", "-o", str(folder / plan), "--json", *options])
    session = Session.open(folder / "lvf")
    everything = {f.role.removeprefix("filter:") for f in session.frames_of("filter:")}
    with tempfile.TemporaryDirectory() as temporary:
        # The calibration is to see few: lvf._known_filters says which are known to it.
        known = lvf._known_filters
        lvf._known_filters = lambda s, w: {n: c for n, c in known(s, w).items() if n in FILTERS}
        calibration = lvf.calibrate([folder / "lvf", folder / "flats"])
        led = lights.led()(NM)
        flat, _ = read_light(
            session, session.frames_of("flat"), calibration.strip, calibration.settings, scattered=False
        )
        evenness = lvf.shading(flat[0])
        misses = {}
        for name in sorted(everything - set(FILTERS)):
            lights_of, _ = read_light(
                session, session.frames_of(f"filter:{name}"), calibration.strip, calibration.settings
            )
            curve = transmission(name)
            if lights_of and curve is not None:
                found = reconstruct(lights_of[0], calibration, evenness)
                misses[name] = miss(found, led * np.interp(NM, *curve))
        report("colour filters", misses)
        part, names = patches(Path(temporary))
        reflectance = darkroom._checker()
        misses = {}
        for name in names:
            lights_of, _ = read_light(part, part.frames_of(name), calibration.strip, calibration.settings)
            found = reconstruct(lights_of[0], calibration, evenness)
            misses[name] = miss(found, led * np.interp(NM, darkroom.NM, reflectance[name]))
        report("ColorChecker", misses)
    glows(folder, calibration)


if __name__ == "__main__":
    run(Path(sys.argv[1]))
