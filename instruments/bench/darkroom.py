"""The bench's physics: what has happened to lamp, door and samples, and what a camera would have seen.

The past is written down (`courses.py`, and where hands have put things), and computed only when a frame is asked for.
So a command costs nothing, and everything is a function of the seed and of the commands with their times.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.instruments.bench import lights, scene
from phoslab.instruments.bench.camera import CANON, Camera
from phoslab.instruments.bench.courses import DoorCourse, LampCourse
from phoslab.instruments.bench.film import Film
from phoslab.instruments.bench.lvf import Lvf
from phoslab.instruments.bench.sample import Sample
from phoslab.instruments.bench.samples import rested
from phoslab.spectra import camera_sensitivities

Array = NDArray[np.float64]

NM = np.arange(360.0, 781.0)
"""Wavelengths at which light is computed."""

COLUMNS = 64
"""Places under the filter that are excited each by its own light; one more is for what the holder covers."""

_U = (np.arange(COLUMNS) + 0.5) / COLUMNS
_SHUTTER_STEP_S = 0.01
"""Pieces into which an exposure is cut while the door moves or the lamp fades."""

CARD_REFLECTANCE, PAINT_REFLECTANCE = 0.18, 0.75


@dataclass(frozen=True)
class Stage:
    """What hands have put where; see `phoslab.instruments.simulated.Hands.place`.

    Raises:
        PhoslabError: there is no such thing.
    """

    target: str = "sample"
    lvf: str = "none"
    filter: str = "none"
    light: str = "lamp"
    angle_deg: float = 0.0

    def __post_init__(self) -> None:
        targets = self.target in ("sample", "card", "checker", "nothing") or (
            self.piece > 0 if self.target.startswith("sample ") else self.target.startswith("patch:")
        )
        for name, good, known in (
            ("target", targets, "sample, sample 2, card, checker, patch:NAME, nothing"),
            ("lvf", self.lvf in ("none", "camera", "sample"), "none, camera, sample"),
            ("light", self.light in ("lamp", "led", "mercury"), "lamp, led, mercury"),
            ("angle_deg", -75 <= self.angle_deg <= 75, "-75 to 75"),
        ):
            if not good:
                raise PhoslabError(
                    f"is {getattr(self, name)!r}, which the bench has not got",
                    field=name,
                    remedy=f"Say one of: {known}.",
                )
        if self.filter != "none":
            lights.colour_filter(self.filter)
        if self.target.startswith("patch:"):
            _patch(self.target.removeprefix("patch:"))

    @property
    def piece(self) -> int:
        """Number of the sample that lies there, from 1 on; 0 if none does."""
        if self.target == "sample":
            return 1
        number = self.target.removeprefix("sample ")
        return int(number) if self.target.startswith("sample ") and number.isdigit() else 0


@dataclass(frozen=True)
class Room:
    """Temperatures.

    Args:
        temperature_C: of the room, at first.
        drift_C_per_h: how it changes.
        sensor_C, sensor_s: by how much the camera's sensor warms up after it is switched on, and the time constant.
    """

    temperature_C: float = 21.0
    drift_C_per_h: float = 0.15
    sensor_C: float = 5.0
    sensor_s: float = 900.0

    def at(self, t_s: float) -> float:
        """Temperature of the room."""
        return self.temperature_C + self.drift_C_per_h * t_s / 3600

    def sensor_at(self, t_s: float) -> float:
        """By how much the sensor is warmer than at first."""
        warm = self.sensor_C * (1 - math.exp(-max(t_s, 0.0) / self.sensor_s))
        return self.at(t_s) - self.temperature_C + warm


@dataclass(frozen=True)
class _Placed:
    at_s: float
    stage: Stage
    light_since_s: float
    strip: scene.Panel


@dataclass
class Darkroom:
    """Everything but the clock, the controller and the camera's body.

    Args:
        seed: of all that is random.
        sample: what the samples are made of; all have been in the dark for long.
        camera: lens and sensor.
        lvf, room: see there.
        lamp_K: colour temperature of the rig's lamp.
        born_s: the moment at which it begins, with a camera that has just been switched on.
    """

    seed: int
    sample: Sample = field(default_factory=Sample)
    camera: Camera = CANON
    lvf: Lvf = field(default_factory=Lvf)
    room: Room = field(default_factory=Room)
    lamp_K: float = 3000.0
    born_s: float = 0.0

    def __post_init__(self) -> None:
        self.lamp, self.door = LampCourse(), DoorCourse()
        self._placed = [_Placed(-math.inf, Stage(), self.born_s, scene.STRIP)]
        self._pieces: dict[int, tuple[float, Film]] = {}
        self._drives: dict[tuple[Stage, int], Array] = {}

    @property
    def stage(self) -> Stage:
        """What lies where now."""
        return self._placed[-1].stage

    @property
    def strip(self) -> scene.Panel:
        """Where the filter strip lies, or lay last."""
        return self._placed[-1].strip

    def place(self, at_s: float, stage: Stage) -> None:
        """Let hands put things so, at a moment that is not before the last."""
        last = self._placed[-1]
        since = last.light_since_s if stage.light == last.stage.light else at_s
        # No hand puts it down twice at the same spot. On the sample it lies against a stop.
        dx, dy = np.random.default_rng([self.seed, 7, len(self._placed)]).normal(0, 0.04, 2)
        moved = scene.Panel(
            scene.STRIP.x_mm + dx,
            scene.STRIP.y_mm + dy,
            scene.STRIP.width_mm,
            scene.STRIP.height_mm,
            scene.STRIP.turn_deg,
        )
        strip = last.strip if stage.lvf == last.stage.lvf else moved if stage.lvf == "camera" else scene.STRIP
        self._placed.append(_Placed(at_s, stage, since, strip))

    def expose(self, open_s: float, exposure_s: float) -> Array:
        """(h, w, 3) radiance in camera RGB that the lens gets, integrated over an exposure that is past.

        Exposures are to be asked for in the order in which they were made.
        """
        placed = self._placed_at(open_s)
        close_s = open_s + exposure_s
        glow: Array = np.zeros(1)
        reflected = 0.0
        moments = {*self.lamp.changes(open_s, close_s), *self.door.changes(open_s, close_s)}
        moments |= {p.at_s for p in self._placed if open_s < p.at_s < close_s}
        stops = [open_s, *sorted(moments), close_s]
        for begin, end in pairwise(stops):
            moving = self.door.share(begin) != self.door.share(end)
            changing = self._level(placed, begin) != self._level(placed, end)
            n = math.ceil((end - begin) / _SHUTTER_STEP_S) if moving else 1
            n = max(n, min(50, math.ceil((end - begin) / _SHUTTER_STEP_S))) if changing else n
            edges = np.linspace(begin, end, n + 1)
            for a, b in pairwise(edges):
                share = self.door.share((a + b) / 2)
                if share == 0.0:
                    continue
                reflected += share * self._level(placed, (a + b) / 2) * (b - a)
                if placed.stage.piece:
                    film = self._film(placed.stage.piece, a)
                    after, light = self._let_pass(placed.stage.piece, film, a, b)
                    self._pieces[placed.stage.piece] = (b, after)
                    glow = glow + share * light
        shake = float(np.mean([self.door.shake_mm(t) for t in np.linspace(open_s, close_s, 65)]))
        return self._picture(placed, glow, reflected, shake)

    def afterglow(self, piece: int, times_s: Sequence[float]) -> list[float]:
        """Return a piece's light at ascending moments that are past and dark, the mean of its places: the truth.

        It is computed from the beginning, and leaves what frames will show as it is.
        """
        film, now = rested(self.sample), self._first_seen(piece, times_s[0])
        values = []
        for at_s in times_s:
            if at_s > now:
                film, _ = self._let_pass(piece, film, now, at_s)
                now = at_s
            values.append(float(film.light(self._warmth(at_s)).mean()))
        return values

    # --- samples ------------------------------------------------------------------------------

    def _film(self, piece: int, at_s: float) -> Film:
        """A piece at a moment not before the last that was asked for."""
        since_s, film = self._pieces.get(piece, (-math.inf, rested(self.sample)))
        if since_s == -math.inf:
            since_s = self._first_seen(piece, at_s)
        if at_s > since_s:
            film, _ = self._let_pass(piece, film, since_s, at_s)
            self._pieces[piece] = (at_s, film)
        return film

    def _first_seen(self, piece: int, at_s: float) -> float:
        """When it was first put there: until then it has been in the dark."""
        return max(self.born_s, next((p.at_s for p in self._placed if p.stage.piece == piece), at_s))

    def _let_pass(self, piece: int, film: Film, begin_s: float, end_s: float) -> tuple[Film, Array]:
        moments = {*self.lamp.changes(begin_s, end_s)}
        moments |= {p.at_s for p in self._placed if begin_s < p.at_s < end_s}
        stops = [begin_s, *sorted(moments), end_s]
        total: Array = np.zeros(1)
        for a, b in pairwise(stops):
            placed = self._placed_at(a)
            drive = self._drive(placed, piece, a, b)
            if drive is not None and placed.stage.lvf == "sample":
                film = film.spread(COLUMNS + 1)
            film, light = film.advance(b - a, drive, lambda t, a=a: self._warmth(a + t))  # type: ignore[misc]
            total = total + light
        return film, total

    def _drive(
        self, placed: _Placed, piece: int, begin_s: float, end_s: float
    ) -> Callable[[float], Array] | None:
        """Excitation of a piece in 1/s over seconds from `begin_s`; None if it is in the dark."""
        if placed.stage.piece != piece:
            return None
        if placed.stage.light == "lamp" and self.lamp.dark(begin_s, end_s):
            return None
        full = self._full_drive(placed.stage)
        return lambda t: full * self._level(placed, begin_s + t)

    def _full_drive(self, stage: Stage) -> Array:
        """(1,) or (COLUMNS + 1,) excitation in 1/s by the full light."""
        key = (stage, 0)
        if key not in self._drives:
            spectrum = self.light(stage) * self.sample.excitation(NM)
            if stage.lvf == "sample":
                through = self.lvf.transmission(_U, NM) @ spectrum
                spectrum_sum = np.append(through, 0.0)
            else:
                spectrum_sum = np.array([spectrum.sum()])
            # Sample.drive_per_s averages over the 400 nm from 360 to 760.
            self._drives[key] = self.sample.excitation_per_s * spectrum_sum / 400.0
        return self._drives[key]

    def _warmth(self, t_s: float) -> float:
        """Temperature of what lies under the lamp, in °C."""
        return self.room.at(t_s) + self.lamp.warming(t_s)

    # --- light --------------------------------------------------------------------------------

    def _placed_at(self, t_s: float) -> _Placed:
        return next(p for p in reversed(self._placed) if p.at_s <= t_s)

    def _level(self, placed: _Placed, t_s: float) -> float:
        """The light's share of its full strength."""
        if placed.stage.light == "lamp":
            return self.lamp.level(t_s)
        # A mercury lamp needs minutes until all of it has evaporated, an LED until it is warm.
        cold, warm_s = {"led": (0.02, 200.0), "mercury": (0.7, 100.0)}[placed.stage.light]
        return 1 - cold * math.exp(-max(0.0, t_s - placed.light_since_s) / warm_s)

    def light(self, stage: Stage) -> Array:
        """(n_nm,) full light behind its colour filter."""
        source = {"lamp": lambda: lights.halogen(self.lamp_K), "led": lights.led, "mercury": lights.mercury}
        strength = {"lamp": 1.0, "led": 0.3, "mercury": 0.3}[stage.light]
        light = strength * source[stage.light]()(NM)
        return np.asarray(light if stage.filter == "none" else light * lights.colour_filter(stage.filter)(NM))

    @cached_property
    def sensitivity(self) -> Array:
        """(n_nm, 3) of red, green and blue pixels by `NM`; the green's sums to 1."""
        nm, known = camera_sensitivities(self.camera.sensitivities)
        fine = np.stack([np.interp(NM, nm, s, left=0, right=0) for s in known.T], axis=-1)
        return np.asarray(fine / fine[:, 1].sum())

    # --- pictures -----------------------------------------------------------------------------

    def _picture(self, placed: _Placed, glow: Array, reflected: float, shake_mm: float) -> Array:
        stage = placed.stage
        view = scene.View.of(self.camera.shape, angle_deg=stage.angle_deg, shift_mm=shake_mm)
        x, y = view.x_mm, view.y_mm
        right, down = placed.strip.across(x, y)
        strip = view.mean(placed.strip.covers(x, y))
        u = np.clip(view.mean(right + self.lvf.tilt * (down - 0.5)), 0.0, 1.0)
        picture = np.zeros((*self.camera.shape, 3))
        seen = strip if stage.lvf == "camera" else np.ones(self.camera.shape)
        if stage.piece and glow.any():
            where = view.mean(scene.SAMPLE.covers(x, y) * scene.coating(x, y))
            if glow.size > 1:
                # Light through the filter has left its columns on the sample, at the place it always lies.
                along, across = scene.STRIP.across(x, y)
                under = view.mean(scene.STRIP.covers(x, y))
                at = view.mean(along + self.lvf.tilt * (across - 0.5))
                where = where * (under * np.interp(at, _U, glow[:-1]) + (1 - under) * glow[-1])
            else:
                where = where * glow[0]
            # Paint that is nearly, but not quite, a Lambertian sender.
            where = where * (1 - 0.06 * np.sin(np.deg2rad(stage.angle_deg)) ** 2)
            picture += where[..., None] * self._seen(self.sample.emission(NM), stage, u)
        if reflected and stage.target != "nothing":
            light = self.light(stage) * reflected / np.pi
            lit = scene.lighting(x, y, stage.light)
            for cover, reflectance in self._surfaces(stage, x, y):
                where = view.mean(cover * lit)
                if stage.lvf == "sample":
                    where = where * strip
                picture += where[..., None] * self._seen(light * reflectance, stage, u, lit_through=True)
        return picture * seen[..., None]

    def _surfaces(self, stage: Stage, x: Array, y: Array) -> list[tuple[Array, Array]]:
        """What reflects: how it covers the rays, and its reflectance (n_nm,)."""
        if stage.piece:
            return [(scene.SAMPLE.covers(x, y), np.full(NM.size, PAINT_REFLECTANCE))]
        if stage.target == "card":
            return [(scene.CARD.covers(x, y), np.full(NM.size, CARD_REFLECTANCE))]
        if stage.target.startswith("patch:"):
            return [(scene.CARD.covers(x, y), _patch(stage.target.removeprefix("patch:")))]
        right, down = scene.CARD.across(x, y)
        inside = scene.CARD.covers(x, y)
        column, row = np.floor(right * 6), np.floor(down * 4)
        edge = (np.abs(right * 6 - column - 0.5) < 0.44) & (np.abs(down * 4 - row - 0.5) < 0.44)
        return [
            (inside * edge * (row * 6 + column == k), reflectance)
            for k, reflectance in enumerate(checker().values())
        ]

    def _seen(self, spectrum: Array, stage: Stage, u: Array, *, lit_through: bool = False) -> Array:
        """(3,) or (h, w, 3) camera RGB of a spectrum, through the filter if that is in its way."""
        if stage.lvf == "camera" or (stage.lvf == "sample" and lit_through):
            fine = np.linspace(0, 1, 513)
            table = self.lvf.transmission(fine, NM) @ (spectrum[:, None] * self.sensitivity)
            return np.stack([np.interp(u, fine, table[:, c]) for c in range(3)], axis=-1)
        return np.asarray(spectrum @ self.sensitivity)


def checker() -> dict[str, Array]:
    """Return the reflectance (n_nm,), by `NM`, of the 24 patches of a ColorChecker by name."""
    import colour

    patches: Any = colour.SDS_COLOURCHECKERS["BabelColor Average"]
    return {name: np.interp(NM, patches[name].wavelengths, patches[name].values) for name in patches}


def _patch(name: str) -> Array:
    known = checker()
    if name not in known:
        raise PhoslabError(
            f"is {name!r}, which no patch of the ColorChecker is called",
            field="target",
            remedy=f"Say patch: and one of {', '.join(known)}.",
        )
    return known[name]
