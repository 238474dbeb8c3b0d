"""The simulated laboratory: lamp, door, sample and camera on one simulated clock.

The door stands between sample and camera. `record_decay` runs the decay plan on it with the real recorder;
everything that happens is a function of the bench and its seed, so the same seed gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phoslab import __version__
from phoslab.bands import Bands
from phoslab.instruments.bench.camera import Camera
from phoslab.instruments.bench.lamp import Lamp
from phoslab.instruments.bench.sample import Sample
from phoslab.instruments.recorder import Recorder

Array = NDArray[np.float64]

STATEMENT = "SIMULATED by the phoslab bench: no light was measured."

# Where halogen light and phosphors both have something to say.
_BANDS = Bands.uniform(200, 360.0, 760.0)

F_NUMBER = 2.8
LADDER = ((0.125, 100), (0.25, 100), (0.5, 100), (1.0, 100), (2.0, 100), (2.0, 200), (2.0, 400), (2.0, 800))
"""Exposure time in s and ISO: each step takes twice the signal of the one before."""


class SimulatedClock:
    """A clock that stands still until somebody waits. The controller's clock runs 20 ppm fast."""

    def __init__(self, start: datetime = datetime(2026, 1, 15, 18, 0, tzinfo=UTC)) -> None:
        self._start = start
        self.now_s = 0.0

    def mono_s(self) -> float:
        """Seconds since the bench was made."""
        return self.now_s

    def device_s(self) -> float:
        """The controller's clock at this moment."""
        return self.device_at(self.now_s)

    def device_at(self, mono_s: float) -> float:
        """The controller's clock at a moment of the monotonic clock."""
        return 12.5 + mono_s * (1 + 20e-6)

    def wall(self) -> datetime:
        """The start plus what has passed."""
        return self._start + timedelta(seconds=self.now_s)

    def sleep_until(self, mono_s: float) -> None:
        """Jump there; the bench's own devices do not notice: see `Bench.wait`."""
        self.now_s = max(self.now_s, mono_s)


@dataclass
class Bench:
    """Lamp, door, sample and camera. Making one puts a sample in that was kept dark.

    Args:
        seed: of the camera's noise.
    """

    seed: int
    sample: Sample = field(default_factory=Sample)
    lamp: Lamp = field(default_factory=Lamp)
    camera: Camera = field(default_factory=Camera)

    def __post_init__(self) -> None:
        self.clock = SimulatedClock()
        self.state = self.sample.empty
        self.state_at_lamp_off: Array | None = None
        self.door_open = False
        self._lamp_on = False
        self._lamp_off_at_s = -np.inf
        self._n_frames = 0
        self._full_drive_per_s = self.sample.drive_per_s(self.lamp.irradiance(_BANDS), _BANDS)
        self._shape = star(self.camera.shape)
        self._colour = self.camera.response(self.sample.emission)

    def switch_lamp(self, on: bool) -> float:
        """Switch the lamp; return when."""
        if self._lamp_on and not on:
            self._lamp_off_at_s, self.state_at_lamp_off = self.clock.now_s, self.state
        self._lamp_on = on
        return self.clock.now_s

    def move_door(self, to_open: bool) -> float:
        """Open or close the door; return when it has stopped."""
        self.wait(0.28)
        self.door_open = to_open
        return self.clock.now_s

    def wait(self, duration_s: float) -> float:
        """Let time pass; return the light that the sample gave (integral over time)."""
        total, end_s = 0.0, self.clock.now_s + duration_s
        dark_at_s = self._lamp_off_at_s + self.lamp.fade_s
        # The lamp's end cuts the way in two: the solver takes long steps in the dark.
        for stop_s in sorted({min(max(dark_at_s, self.clock.now_s), end_s), end_s}):
            begin_s = self.clock.now_s
            lit = self._lamp_on or begin_s < dark_at_s
            drive = partial(self._drive, begin_s) if lit else None
            self.state, light = self.sample.advance(self.state, stop_s - begin_s, drive)
            total += light
            self.clock.now_s = stop_s
        return total

    def expose(self, path: Path, exposure_s: float, iso: int) -> NDArray[np.uint16]:
        """Take a frame now and save it; return the visible values (h, w). It takes `exposure_s`."""
        taken = self.clock.wall().strftime("%Y:%m:%d %H:%M:%S")
        picture = self._shine(exposure_s)
        self._n_frames += 1
        return self.camera.expose(
            path,
            picture * float(self.door_open),
            self._colour,
            exposure_s=exposure_s,
            iso=iso,
            f_number=F_NUMBER,
            taken=taken,
            description=STATEMENT,
            rng=np.random.default_rng([self.seed, self._n_frames]),
        )

    def _shine(self, duration_s: float) -> Array:
        """Let time pass; return (h, w) the light that the sample gave meanwhile."""
        return self._shape * self.wait(duration_s)

    def true_light(self, times_s: Array) -> Array:
        """(n,) what the sample gave at ascending times after the lamp was switched off."""
        if self.state_at_lamp_off is None:
            raise RuntimeError("the lamp has not been switched off yet")
        fade_s = self.lamp.fade_s

        def fade(since_off_s: float) -> float:
            return self._full_drive_per_s * self.lamp.level(since_off_s)

        # In two pieces for the same reason as in `wait`.
        fading, dark = times_s[times_s < fade_s], times_s[times_s >= fade_s]
        light = self.sample.afterglow(self.state_at_lamp_off, np.append(fading, fade_s), fade)[:-1]
        state, _ = self.sample.advance(self.state_at_lamp_off, fade_s, fade)
        if dark.size:
            light = np.concatenate([light, self.sample.afterglow(state, dark - fade_s)])
        return light

    def _drive(self, begin_s: float, since_s: float) -> float:
        """Excitation in 1/s, `since_s` after `begin_s`."""
        since_off_s = begin_s + since_s - self._lamp_off_at_s
        return self._full_drive_per_s * (1.0 if self._lamp_on else self.lamp.level(since_off_s))


def star(shape: tuple[int, int]) -> Array:
    """(h, w) how bright each pixel of the sample is, 0..1: a five-pointed star, thicker to one side."""
    fine = 4
    h, w = shape
    y, x = np.mgrid[0 : h * fine, 0 : w * fine] / fine
    dy, dx = (y - 0.52 * h) / h, (x - 0.47 * w) / h
    radius, angle = np.hypot(dy, dx), np.arctan2(dx, -dy)
    inside = radius < 0.32 * (1 + 0.28 * np.cos(5 * angle))
    light = inside * (0.93 + 0.2 * dx + 0.1 * dy)
    return np.asarray(light.reshape(h, fine, w, fine).mean(axis=(1, 3)))


def record_decay(
    folder: Path,
    bench: Bench,
    *,
    charge_s: float = 5400.0,
    interval_s: float = 5.0,
    n_frames: int = 37,
    n_darks: int = 3,
    largest_signal: float = 0.6,
) -> None:
    """Record the decay plan (Nalbach 2017, 8.4.4) on the bench: charge, lamp off, door open, a frame every 5 s.

    Exposure time and ISO follow the fading light, so that the brightest pixels stay below `largest_signal`
    of full scale; dark frames with the door closed follow, some for each setting that was used.

    Args:
        folder: of the session.
        charge_s: how long the lamp shines.
        interval_s: from frame to frame.
        n_frames: of the decay.
        n_darks: for each setting.
        largest_signal: share of full scale.

    Raises:
        PhoslabError: the folder holds something.
    """
    header = {
        "operator": "nobody",
        "room_temperature_C": bench.sample.temperature_C,
        "plan": {
            "name": "decay",
            "parameters": {
                "charge_s": charge_s,
                "interval_s": interval_s,
                "n_frames": n_frames,
                "n_darks": n_darks,
                "largest_signal": largest_signal,
            },
        },
        "sample": {"name": bench.sample.name, "note": STATEMENT},
        "rig": {
            "name": "bench",
            "lamp_temperature_K": bench.lamp.temperature_K,
            "lamp_fade_s": bench.lamp.fade_s,
        },
        "camera": {
            "make": bench.camera.sensor.make,
            "model": bench.camera.sensor.model,
            "sensitivities": bench.camera.sensitivities,
        },
        "lens": {"name": "simulated"},
        "software": {"phoslab": __version__},
        "simulated": {"statement": STATEMENT, "seed": bench.seed},
    }
    with Recorder(folder, header, bench.clock) as recorder:
        recorder.note(STATEMENT)
        _switch_lamp(recorder, bench, True)
        bench.wait(charge_s)
        off_s = _switch_lamp(recorder, bench, False)
        bench.wait(bench.lamp.fade_s)
        _move_door(recorder, bench, True)
        step, used = 0, []
        first_s = bench.clock.now_s
        for k in range(n_frames):
            bench.wait(first_s + k * interval_s - bench.clock.now_s)
            used.append(step)
            values = _frame(recorder, bench, "decay", *LADDER[step])
            step = _next_step(bench, values, step, largest_signal)
        _move_door(recorder, bench, False)
        recorder.note(f"dark frames from {bench.clock.now_s - off_s:.1f} s after lamp-off")
        for step in sorted(set(used)):
            for _ in range(n_darks):
                _frame(recorder, bench, "dark", *LADDER[step])


def _next_step(bench: Bench, values: NDArray[np.uint16], step: int, largest_signal: float) -> int:
    """The longest setting at which light like that of the last frame, which only fades, stays low enough."""
    full = bench.camera.full_scale_dn
    # Not the very brightest pixel, which is noise.
    signal = (float(np.percentile(values, 99.5)) - np.mean(bench.camera.sensor.black)) / full
    while step + 1 < len(LADDER) and 2 * signal <= largest_signal:
        step, signal = step + 1, 2 * signal
    return step


def _switch_lamp(recorder: Recorder, bench: Bench, on: bool) -> float:
    return _set(recorder, bench, "lamp", "on" if on else "off", lambda: bench.switch_lamp(on))


def _move_door(recorder: Recorder, bench: Bench, to_open: bool) -> float:
    return _set(recorder, bench, "door", "open" if to_open else "closed", lambda: bench.move_door(to_open))


def _set(recorder: Recorder, bench: Bench, device: str, to: str, act: Callable[[], float]) -> float:
    """Command, act, acknowledge and record the edge; return when it happened."""
    command = recorder.command(device, "set", {"to": to})
    at_s = act()
    recorder.ack(command, ok=True, reply="OK")
    recorder.edge(device, to, at_mono_s=at_s, at_device_s=bench.clock.device_at(at_s))
    return at_s


def _frame(recorder: Recorder, bench: Bench, role: str, exposure_s: float, iso: int) -> NDArray[np.uint16]:
    start_s = bench.clock.now_s
    command = recorder.command(
        "camera", "capture", {"exposure_s": exposure_s, "iso": iso, "f_number": F_NUMBER}
    )
    taken: list[NDArray[np.uint16]] = []
    recorder.frame(
        lambda path: taken.append(bench.expose(path, exposure_s, iso)),
        role=role,
        at_mono_s=start_s,
        at_device_s=bench.clock.device_at(start_s),
        exposure_s=exposure_s,
        iso=iso,
        f_number=F_NUMBER,
    )
    recorder.ack(command, ok=True)
    return taken[0]
