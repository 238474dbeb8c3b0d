"""The bench's camera as a host sees it over its cable: settings, a shutter, a card, and moods."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.instruments.bench.bench import STATEMENT
from phoslab.instruments.bench.darkroom import Darkroom
from phoslab.instruments.bench.dng import dng
from phoslab.instruments.bench.timekeeper import Timekeeper

Array = NDArray[np.float64]

# What the dial says, in third stops: from 2^-13 s to 2^5 s, from ISO 100 on, from f/2^1.5 on.
_EXPOSURES = (
    *(
        1 / n
        for n in (8000, 6400, 5000, 4000, 3200, 2500, 2000, 1600, 1250, 1000, 800, 640, 500, 400, 320, 250)
    ),
    *(1 / n for n in (200, 160, 125, 100, 80, 60, 50, 40, 30, 25, 20, 15, 13, 10, 8, 6, 5, 4)),
    *(
        0.3,
        0.4,
        0.5,
        0.6,
        0.8,
        1.0,
        1.3,
        1.6,
        2.0,
        2.5,
        3.2,
        4.0,
        5.0,
        6.0,
        8.0,
        10.0,
        13.0,
        15.0,
        20.0,
        25.0,
        30.0,
    ),
)
_ISOS = (
    100,
    125,
    160,
    200,
    250,
    320,
    400,
    500,
    640,
    800,
    1000,
    1250,
    1600,
    2000,
    2500,
    3200,
    4000,
    5000,
    6400,
)
_F_NUMBERS = (
    2.8,
    3.2,
    3.5,
    4.0,
    4.5,
    5.0,
    5.6,
    6.3,
    7.1,
    8.0,
    9.0,
    10.0,
    11.0,
    13.0,
    14.0,
    16.0,
    18.0,
    20.0,
    22.0,
)

CHOICES: dict[str, tuple[float, ...]] = {"exposure_s": _EXPOSURES, "iso": _ISOS, "f_number": _F_NUMBERS}


class CameraError(PhoslabError):
    """The camera refuses; `code` is what its protocol would call it."""

    def __init__(self, code: str, problem: str, remedy: str) -> None:
        super().__init__(problem, remedy=remedy)
        self.code = code


@dataclass(frozen=True)
class Shot:
    """A frame that is being made or lies on the card.

    Args:
        number: from 1 on.
        open_s: when its shutter opened, or will.
        settings: exposure_s, iso and f_number as the dial says.
        true: the same as they are.
    """

    number: int
    open_s: float
    settings: tuple[float, float, float]
    true: tuple[float, float, float]

    @property
    def close_s(self) -> float:
        """When its shutter closes."""
        return self.open_s + self.true[0]


def true_settings(serial: int) -> dict[str, dict[float, float]]:
    """What the numbers on the dials of this copy of the camera really mean: seconds, ISO, f-number.

    Third stops are what a camera means, whatever it writes on its dial, and it meets them only so well.
    """
    rng = np.random.default_rng([0xB0D7, serial])
    return {
        "exposure_s": dict(zip(_EXPOSURES, _off(2.0 ** (np.arange(-39, 16) / 3), 0.004, rng), strict=True)),
        "iso": dict(zip(_ISOS, _off(100 * 2.0 ** (np.arange(19) / 3), 0.015, rng), strict=True)),
        "f_number": dict(zip(_F_NUMBERS, _off(2.0 ** (np.arange(9, 28) / 6), 0.008, rng), strict=True)),
    }


@dataclass
class Body:
    """The camera's body.

    Args:
        room: what it looks at.
        keeper: simulated time.
        salt: makes the noise of one bench another than that of the next.
        card_frames: how many frames the card holds.
        lag_s, lag_jitter_s: from command to open shutter.
        readout_s: from closed shutter to a frame on the card.
    """

    room: Darkroom
    keeper: Timekeeper
    salt: int = 0
    card_frames: int = 500
    lag_s: float = 0.065
    lag_jitter_s: float = 0.003
    readout_s: float = 0.12
    settings: tuple[float, float, float] = (0.5, 100.0, 2.8)
    # What a fault has set.
    refusals: int = 0
    full: bool = False
    cut: bool = False
    late_s: float = 0.0
    card: dict[int, Shot] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.exposures = 0
        self._told = 0
        self._connection = 0
        self._away_until = 0.0
        self._files: dict[int, bytes] = {}
        self.true = true_settings(self.room.camera.serial)

    @property
    def last(self) -> Shot | None:
        """The last exposure that was made since it was connected, if its frame is still on the card."""
        return self.card.get(self.exposures)

    def go(self, for_s: float) -> None:
        """Be away for a while of real time; whoever was connected has to connect anew."""
        self._connection += 1
        self._away_until = time.monotonic() + for_s

    def connect(self) -> int:
        """Begin a conversation; return its number."""
        if time.monotonic() < self._away_until:
            raise CameraError("gone", "is not there", "Check its power and cable.")
        self._connection += 1
        self.full = False
        return self._connection

    def check(self, connection: int) -> None:
        """Refuse a conversation that has been broken off."""
        if connection != self._connection or time.monotonic() < self._away_until:
            raise CameraError("gone", "is not connected any more", "Check its power and cable.")

    def set(self, exposure_s: float, iso: float, f_number: float) -> None:
        """Turn the dials."""
        self._idle()
        wanted = {"exposure_s": exposure_s, "iso": iso, "f_number": f_number}
        found = {}
        for name, value in wanted.items():
            nearest = min(CHOICES[name], key=lambda known: abs(known - value))
            if abs(nearest - value) > 1e-6 * nearest:
                raise CameraError("value", f"cannot set {name} to {value:g}", f"The nearest is {nearest:g}.")
            found[name] = float(nearest)
        self.settings = (found["exposure_s"], found["iso"], found["f_number"])

    def expose(self) -> Shot:
        """Release the shutter."""
        self._idle()
        if self.full or len(self.card) >= self.card_frames:
            raise CameraError("full", "has a full card", "Empty it, or put in another one.")
        self.exposures += 1
        rng = np.random.default_rng([self.room.seed, self.salt, 1, self.exposures])
        lag_s = self.lag_s + self.late_s + self.lag_jitter_s * float(np.clip(rng.normal(), -3, 3))
        self.late_s = 0.0
        exposure_s, iso, f_number = self.settings
        true = (
            float(self.true["exposure_s"][exposure_s]),
            float(self.true["iso"][iso]),
            float(self.true["f_number"][f_number]),
        )
        shot = Shot(self.exposures, self.keeper.now_s() + lag_s, self.settings, true)
        self.card[shot.number] = shot
        return shot

    def abort(self) -> None:
        """Close the shutter and throw the frame away."""
        if self.last is not None and self.phase(self.last) != "ready":
            self._told = self.exposures
            self.card.pop(self.exposures)

    @property
    def about_to_open(self) -> bool:
        """Whether the shutter has been released, and nobody has been told yet that it opened."""
        return self.exposures > self._told

    def tell(self, shot: Shot) -> str:
        """`phase`, for a host."""
        phase = self.phase(shot)
        if phase != "lag":
            self._told = max(self._told, shot.number)
        return phase

    def phase(self, shot: Shot) -> str:
        """ "lag", "open", "busy" or "ready"."""
        now = self.keeper.now_s()
        if now < shot.open_s:
            return "lag"
        return "open" if now < shot.close_s else "busy" if now < shot.close_s + self.readout_s else "ready"

    def develop(self, number: int) -> bytes:
        """Return a frame's file. Slow: it is computed now, and all before it."""
        shot = self.card.get(number)
        if shot is None:
            raise CameraError("file", f"has no frame {number} on its card", "Take it again.")
        for earlier in sorted(n for n in self.card if n <= number and n not in self._files):
            self._files[earlier] = self._file(self.card[earlier])
        return self._files[number]

    def sent(self, content: bytes) -> bytes:
        """What of it arrives."""
        if not self.cut:
            return content
        self.cut = False
        return content[: len(content) * 2 // 3]

    def delete(self, number: int) -> None:
        """Remove a frame from the card."""
        if number in self.card and number not in self._files:
            self.develop(number)  # the physics of what follows goes on from it
        self.card.pop(number, None)
        self._files.pop(number, None)

    def _file(self, shot: Shot) -> bytes:
        exposure_s, iso, f_number = shot.true
        camera = self.room.camera
        picture = self.room.expose(shot.open_s, exposure_s)
        values = camera.numbers(
            camera.on_pixels(picture),
            exposure_s=exposure_s,
            iso=iso,
            f_number=f_number,
            rng=np.random.default_rng([self.room.seed, self.salt, 2, shot.number]),
            warmer_C=self.room.room.sensor_at(shot.open_s - self.room.born_s),
        )
        wall_s = self.keeper.wall_s() - self.keeper.now_s() + shot.open_s
        said_s, said_iso, said_f = shot.settings
        return dng(
            values,
            camera.sensor,
            exposure_s=said_s,
            iso=int(said_iso),
            f_number=said_f,
            taken=datetime.fromtimestamp(wall_s, UTC).strftime("%Y:%m:%d %H:%M:%S"),
            description=STATEMENT,
        )

    def _idle(self) -> None:
        if self.refusals:
            self.refusals -= 1
            raise CameraError("busy", "is busy", "Wait a moment and try again.")
        if self.last is not None and self.phase(self.last) != "ready":
            raise CameraError("busy", "is busy with an exposure", "Wait for its end.")


def _off(values: Array, by: float, rng: np.random.Generator) -> list[float]:
    return list(values * np.exp(np.clip(rng.normal(0, by, values.size), -2 * by, 2 * by)))
