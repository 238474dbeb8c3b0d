"""What a plan runs on: the rig's devices, who does by hand what they cannot, and who looks on."""

from __future__ import annotations

import contextlib
import shutil
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from phoslab.errors import PhoslabError
from phoslab.instruments.devices import AlarmError, Camera, Clock, Door, Lamp
from phoslab.instruments.interrupts import Interrupts
from phoslab.instruments.operator import Operator
from phoslab.instruments.plans.steps import Shot, Stage

RETURN_S = 60.0
"""How long a device that is gone is waited for, in s of the real clock."""

DISK_RESERVE_BYTES = 16_000_000
"""What a session needs beside its frames, and then some."""


class Watcher(Protocol):
    """Who looks on while a plan runs: a terminal, or nobody."""

    def part(self, name: str) -> None:
        """A part begins."""

    def doing(self, text: str, until_s: float | None = None) -> None:
        """Something begins that ends at a moment of the clock, if that is known."""

    def state(self, device: str, state: str) -> None:
        """Lamp or door are now so."""

    def shot(self, role: str, shot: Shot) -> None:
        """A frame was taken, or lost."""

    def trouble(self, text: str) -> None:
        """Something went wrong that is dealt with."""


@dataclass
class Laboratory:
    """What a plan runs on.

    Args:
        lamp, door, camera, clock: see devices.py; staged by whoever made them.
        operator: does by hand what the rig cannot.
        watcher: looks on.
        interrupts: says when to stop.
        frame_bytes: size of a frame, as far as it is known.
        stage: how the bench stands; None if nobody knows.
    """

    lamp: Lamp
    door: Door
    camera: Camera
    clock: Clock
    operator: Operator
    watcher: Watcher
    interrupts: Interrupts
    frame_bytes: int = 30_000_000
    stage: Stage | None = None
    warm_since_s: dict[str, float] = field(default_factory=dict)

    def safe(self) -> None:
        """Switch the lamp off and stop door and camera, whatever state they are in; raises nothing."""
        for device in (self.lamp, self.door, self.camera):
            with contextlib.suppress(Exception):
                device.stop()

    def return_of(self, device: Lamp | Door | Camera) -> None:
        """Stage a device again; wait for one that is gone.

        Raises:
            PhoslabError: it did not come back.
        """
        end_s = time.monotonic() + RETURN_S
        while True:
            self.interrupts.check()
            try:
                device.stage()
                return
            except AlarmError:
                raise
            except PhoslabError as error:  # not only a DeviceError: a port that is not there is none
                if time.monotonic() > end_s:
                    raise
                self.watcher.trouble(f"waiting for the {device.name}: {error}")
                time.sleep(0.5)


def check_space(folder: Path, n_frames: int, frame_bytes: int) -> None:
    """Refuse a plan whose frames do not fit on the disk.

    Raises:
        PhoslabError: too little is free.
    """
    while not folder.exists():
        folder = folder.parent
    free, needed = shutil.disk_usage(folder).free, n_frames * frame_bytes + DISK_RESERVE_BYTES
    if free < needed:
        raise PhoslabError(
            f"has {free / 1e9:.2f} GB free, and {n_frames} frames need {needed / 1e9:.2f} GB",
            file=folder,
            field="the disk",
            remedy="Make room, or measure into a folder on another disk.",
        )
