"""What a plan is made of: parts, and steps that something else takes for it.

A plan is a generator. It yields steps, and is sent what came of each: the moment at which the lamp changed, the frame
that was taken. It never touches a device. Who takes the steps decides what they are:

    runner.py       takes them on the rig and writes them to the session
    rehearsal.py    only adds up their time (`--dry-run`)
    history.py      answers them from the journal, as far as a session came before it was interrupted

so a plan is written once, and what is announced, done and resumed cannot differ.

A `Part` opens the smallest stretch that must be done in one go: a decay with its charge, one exposure through the LVF
with the dark before it. A part that was interrupted is done again from its beginning; one that was done, never.
Its steps state what they need of the bench (`Stage`), so that a part works wherever a session is taken up.

All times are in s of the session's monotonic clock.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any, Literal

from phoslab.instruments.devices import Exposure
from phoslab.instruments.plans.ladder import Ladder


@dataclass(frozen=True)
class Part:
    """What follows, up to the next part, is done in one go or again.

    Args:
        name: unique within the plan, for people and for the journal.
    """

    name: str


@dataclass(frozen=True)
class Stage:
    """How the bench must stand. Answered by None; a hand is asked only for what differs.

    Args:
        target: what lies under the camera: "sample", "sample 2" ..., "card".
        lvf: where the linear variable filter is: "none", "camera" (before the lens), "sample" (on it).
        filter: name of the colour filter, "none" without. It stands in the light's way to the target.
        light: what lights the target: "lamp" (the rig's), "led", "mercury".
        angle_deg: by which the sample is turned to the camera.
        progress: where in a series this stands, for people: "filter 37 of 108".
    """

    target: str
    lvf: Literal["none", "camera", "sample"] = "none"
    filter: str = "none"
    light: Literal["lamp", "led", "mercury"] = "lamp"
    angle_deg: float = 0.0
    progress: str = ""


@dataclass(frozen=True)
class Cold:
    """Ask whether a light has yet to warm up. Answered by a bool."""

    light: Literal["lamp", "led", "mercury"]


@dataclass(frozen=True)
class Lamp:
    """Switch the lamp. Answered by the moment at which it changed."""

    to: Literal["on", "off"]


@dataclass(frozen=True)
class Door:
    """Move the door. Answered by the moment at which it arrived."""

    to: Literal["open", "closed"]


@dataclass(frozen=True)
class Wait:
    """Let time pass. Answered by None.

    Args:
        duration_s: from now, or from `since_s`.
        why: for people ("charging").
        since_s: a moment in the past.
    """

    duration_s: float
    why: str
    since_s: float | None = None


@dataclass(frozen=True)
class Dark:
    """Wait until what lies under the camera has been in the dark for long enough. Answered by None.

    Args:
        duration_s: since the lamp last shone on it, in this part or any before, finished or not.
    """

    duration_s: float


@dataclass(frozen=True)
class Shoot:
    """Take a frame. Answered by a `Shot`.

    Args:
        role: see phoslab.journal.ROLES.
        exposure: the camera's settings.
        at_s: when the shutter shall open; None: as soon as it can.
        late_s: how late it may be; a later frame is left out. None: however late.
        rehearsed: level that a rehearsal takes for granted.
    """

    role: str
    exposure: Exposure
    at_s: float | None = None
    late_s: float | None = None
    rehearsed: float = 0.45


@dataclass(frozen=True)
class Shot:
    """A frame that was taken, or None where it was lost.

    Args:
        frame: its name in the session; None: it was lost or left out, and `level` is NaN.
        exposure: the settings.
        start_s: when the shutter opened.
        level: the brightest parts' signal, as a share of saturation.
        saturated: share of the frame that is saturated.
    """

    frame: str | None
    exposure: Exposure
    start_s: float
    level: float
    saturated: float


@dataclass(frozen=True)
class Setup:
    """What a plan knows of the rig that it will run on.

    Args:
        ladder: settings that the camera may use.
        fade_s: how long the lamp's light takes to fade after it is switched off.
        door_s: how long the door moves.
        cycle_s: what a frame takes beyond its exposure.
        warm_up_s: at most how long a light is given to become stable.
        lux_lx: illuminance at the sample; 0 if nobody measured it.
        filters: names of the filters that are there.
    """

    ladder: Ladder
    fade_s: float = 0.32
    door_s: float = 0.28
    cycle_s: float = 2.0
    warm_up_s: float = 900.0
    lux_lx: float = 0.0
    filters: tuple[str, ...] = ()


Step = Part | Stage | Cold | Lamp | Door | Wait | Dark | Shoot
Plan = Generator[Step, Any, None]
