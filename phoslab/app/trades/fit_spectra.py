"""Spectra through the linear variable filter against the truth: colour filters, ColorChecker patches, glows.

Errors are root mean squares over 420..680 nm, relative to the spectrum's own; a spectrum is relative, so it is scaled
to the truth first. Coverage is the share of wavelengths there at which the truth lies within one and two of the stated
standard errors.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from phoslab.app.trades.fit_bench import FILTERS, SEED, Recorded
from phoslab.fitting import lvf
from phoslab.fitting.filters import transmission
from phoslab.fitting.find_strip import follow_strip
from phoslab.fitting.lvf import Calibration
from phoslab.fitting.lvf_file import load
from phoslab.fitting.spectrum import Spectrum, reconstruct
from phoslab.fitting.strip_equations import NM
from phoslab.fitting.strip_light import read_light
from phoslab.instruments.bench import darkroom, lights
from phoslab.instruments.bench.bench import STATEMENT
from phoslab.instruments.bench.darkroom import Darkroom, Stage
from phoslab.instruments.bench.dng import write_dng
from phoslab.instruments.bench.samples import sample
from phoslab.raw import preview
from phoslab.session import Frame, Session

Array = NDArray[np.float64]

SEEN = (NM >= 420) & (NM <= 680)
NOISES = (0.0, 1 / 100, 1 / 30, 1 / 10)
"""Of a glow's first frame, as a share of the brightest value along the strip; 0: all frames as they are."""

_EXPOSURE_S, _ISO, _F_NUMBER = 1 / 32, 100, 2.8284


@dataclass(frozen=True)
class Miss:
    """How far a spectrum is off: relative error, and (n,) how many standard errors at each wavelength."""

    name: str
    error: float
    off: Array


@dataclass(frozen=True)
class Misses:
    """Those of one kind of light."""

    kind: str
    found: tuple[Miss, ...]

    @property
    def worst(self) -> Miss:
        """The one that is farthest off."""
        return max(self.found, key=lambda m: m.error)

    def quantile(self, share: float) -> float:
        """The error that this share of the spectra stays below."""
        return float(np.quantile([m.error for m in self.found], share))

    def within(self, n: float) -> float:
        """Share of wavelengths at which the truth lies within `n` standard errors."""
        return float(np.mean(np.concatenate([m.off for m in self.found]) < n))


def measure(recorded: Recorded, samples: Sequence[str], tick: Callable[[int], None]) -> list[Misses]:
    """Measure filters and patches, if the rig's own sessions are there, and the glows of `samples` at each noise."""
    calibration, _ = load(recorded.lvf)
    found = []
    if recorded.has_rig:
        filters, evenness = _filters(recorded, calibration)
        tick(1)
        found = [filters, _patches(recorded, calibration, evenness)]
        tick(1)
    glows: list[list[Miss]] = [[] for _ in NOISES]
    for k, name in enumerate(samples):
        for noise, several in zip(NOISES, glows, strict=True):
            rng = np.random.default_rng([SEED, k, round(1e4 * noise)])
            several.append(_glow(recorded.record(name), name, calibration, noise, rng))
        tick(1)
    names = ["as recorded", *(f"{n:.0%} of noise" for n in NOISES[1:])]
    return found + [Misses(f"glows, {n}", tuple(m)) for n, m in zip(names, glows, strict=True)]


def _missed(name: str, found: Spectrum, truth: Array) -> Miss:
    scale = (found.value @ truth) / (found.value @ found.value)
    off = (scale * found.value - truth)[SEEN]
    error = float(np.sqrt(np.mean(off**2) / np.mean(truth[SEEN] ** 2)))
    return Miss(name, error, np.abs(off / (scale * found.standard_error[SEEN])))


def _filters(recorded: Recorded, calibration: Calibration) -> tuple[Misses, Array | None]:
    """An LED through colour filters that the calibration has not seen; and how evenly it lights the strip."""
    session = Session.open(recorded.rig / FILTERS)
    strip, _ = follow_strip(preview(session.frames_of("led")[0].path), calibration.strip)
    flats = session.frames_of("flat")
    flat, _ = read_light(session, flats, strip, calibration.settings, scattered=False)
    evenness = lvf.shading(flat[0])
    seen, _ = read_light(session, session.frames_of("filter:"), strip, calibration.settings)
    led, misses = lights.led()(NM), []
    for light in seen:
        name = light.role.removeprefix("filter:")
        curve = transmission(name)
        if curve is not None:
            found = reconstruct(light, calibration, evenness)
            misses.append(_missed(name, found, led * np.interp(NM, *curve)))
    return Misses("colour filters", tuple(misses)), evenness


def _patches(recorded: Recorded, calibration: Calibration, evenness: Array | None) -> Misses:
    """The patches of a ColorChecker under the LED (Nalbach 2017, Fig. 8.8), each large, where the grey card lies."""
    checker, led, misses = darkroom.checker(), lights.led()(NM), []
    with tempfile.TemporaryDirectory() as scratch:
        session = replace(Session.open(recorded.rig / FILTERS), frames=_photographs(Path(scratch), checker))
        for name in checker:
            (light,), _ = read_light(
                session, session.frames_of(name), calibration.strip, calibration.settings
            )
            truth = led * np.interp(NM, darkroom.NM, checker[name])
            misses.append(_missed(name, reconstruct(light, calibration, evenness), truth))
    return Misses("ColorChecker patches", tuple(misses))


def _photographs(folder: Path, patches: Mapping[str, Array]) -> tuple[Frame, ...]:
    """A frame of each patch through the strip, its name for its role, and four dark ones."""
    room, rng, frames = Darkroom(SEED), np.random.default_rng(SEED), []
    room.door.drive(0.0, 1.0, 0.3)
    # Ten minutes each: an LED that has just been placed is not warm.
    for k, role in enumerate([*patches, *["dark"] * 4], start=1):
        if role in patches:
            room.place(600.0 * k, Stage(f"patch:{role}", "camera", "none", "led"))
            light = room.camera.on_pixels(room.expose(600.0 * k + 500.0, _EXPOSURE_S))
        else:
            light = np.zeros(room.camera.shape)
        path = folder / f"{k:04d}.dng"
        write_dng(
            path,
            room.camera.numbers(light, exposure_s=_EXPOSURE_S, iso=_ISO, f_number=_F_NUMBER, rng=rng),
            room.camera.sensor,
            exposure_s=_EXPOSURE_S,
            iso=_ISO,
            f_number=_F_NUMBER,
            taken="2026:01:01 00:00:00",
            description=STATEMENT,
        )
        frames.append(Frame(path, path.name, role, 600.0 * k, _EXPOSURE_S, _ISO, _F_NUMBER, ""))
    return tuple(frames)


def _glow(folder: Path, name: str, calibration: Calibration, noise: float, rng: Generator) -> Miss:
    """The glow of a sample, whose unevenness is not known."""
    session = Session.open(folder / "emission")
    frames = [f for f in session.frames_of("emission") if f.start_s >= (session.lamp_off_s or 0.0)]
    strip, _ = follow_strip(preview(frames[0].path), calibration.strip)
    (light,), _ = read_light(session, frames[:1] if noise else frames, strip, calibration.settings)
    sigma = noise * float(light.signal.max())
    noisy = replace(
        light,
        signal=light.signal + (rng.normal(0, sigma, light.signal.shape) if noise else 0.0),
        sigma=np.hypot(light.sigma, sigma),
    )
    return _missed(name, reconstruct(noisy, calibration), sample(name).emission(NM))
