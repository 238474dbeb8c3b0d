"""Takes a plan's frames: each at its moment, saved whole, or lost in a way that the plan can go on from."""

from __future__ import annotations

import math
import shutil
from collections import deque
from dataclasses import asdict
from pathlib import Path
from statistics import median

import numpy as np

from phoslab import raw
from phoslab.errors import PhoslabError
from phoslab.instruments.devices import AlarmError, DeviceError, Exposure
from phoslab.instruments.history import lost, reply_of
from phoslab.instruments.plans.steps import Shoot, Shot
from phoslab.instruments.waiting import Waiting

CAMERA_S = 60.0
"""How long a camera may take for what it is told, beyond its exposure."""

LAGS = 5
"""From how many shutters it is learnt how long one takes to open."""

LOST_IN_A_ROW = 5
"""So many lost frames in a row are no accident."""


class Shooting:
    """The camera's part of a run.

    Args:
        waiting: for moments and for the camera.
    """

    def __init__(self, waiting: Waiting) -> None:
        self.lab, self.recorder, self._waiting = waiting.lab, waiting.recorder, waiting
        self._exposure: Exposure | None = None
        self._lags_s: deque[float] = deque(maxlen=LAGS)
        self._lost = 0

    def begin_anew(self) -> None:
        """Forget what the camera was set to, and how many frames were lost."""
        self._exposure, self._lost = None, 0

    def shoot(self, step: Shoot, number: int) -> Shot:
        """Take a frame, and note it under its step's number.

        Raises:
            DeviceError: it could not be taken, and must not be missing; or too many were lost.
        """
        can_be_lost = step.late_s is not None
        for last in (False, True):
            try:
                shot = self._expose(step, number)
            except AlarmError:
                raise
            except DeviceError as error:
                self.lab.watcher.trouble(str(error))
                self.recorder.note(f"a frame ({step.role}) was lost: {error}")
                self._lost += 1
                if self._lost >= LOST_IN_A_ROW or (last and not can_be_lost):
                    raise
                self._restage_camera()
                if can_be_lost:
                    self.lab.watcher.shot(step.role, lost(step))
                    return lost(step)
                continue
            self._lost = 0
            return shot
        raise AssertionError("unreachable")

    def _expose(self, step: Shoot, number: int) -> Shot:
        """Have all ready beforehand, wait for the moment, take the frame."""
        lab, exposure = self.lab, step.exposure
        self._waiting.check_lamp()
        self._check_disk()
        self._waiting.allow(exposure.exposure_s + CAMERA_S)
        if exposure != self._exposure:
            command = self.recorder.command("camera", "set", asdict(exposure))
            self._exposure = None
            self.recorder.answered(
                command, lambda: self._waiting.for_status(lab.camera.set(exposure), CAMERA_S)
            )
            self.recorder.ack(command, ok=True)
            self._exposure = exposure
        command = self.recorder.command("camera", "capture", {**asdict(exposure), "step": number})
        if step.at_s is not None:
            # The median: one shutter that opened late does not make the next one open early.
            lag_s = median(self._lags_s) if self._lags_s else 0.0
            self._waiting.until(step.at_s - lag_s, f"until the next frame ({step.role})")
            late_s = self.recorder.mono_s() - step.at_s
            if step.late_s is not None and late_s > max(step.late_s, 0.1):
                reply = f"left out: its moment passed {late_s:.1f} s ago"
                self.recorder.ack(command, ok=False, reply=reply)
                lab.watcher.trouble(f"a frame ({step.role}) is {reply}")
                return lost(step)
        self._waiting.allow(exposure.exposure_s + CAMERA_S)
        lab.watcher.doing(
            f"exposing {exposure.exposure_s:g} s ({step.role})", lab.clock.mono_s() + exposure.exposure_s
        )
        shot: Shot = self.recorder.answered(command, lambda: self._frame(step))
        self.recorder.ack(command, ok=True, reply=reply_of(shot))
        lab.watcher.shot(step.role, shot)
        return shot

    def _frame(self, step: Shoot) -> Shot:
        lab, exposure = self.lab, step.exposure
        triggered_s = self.recorder.mono_s()
        self._waiting.for_status(lab.camera.trigger(), exposure.exposure_s + CAMERA_S)
        start = lab.camera.read()["start"]
        start_s = min(float(start["value"]) + self.recorder.offset_s, self.recorder.mono_s())
        uncertainty = lab.camera.read().get("start_uncertainty")
        name = self.recorder.frame(
            self._save,
            role=step.role,
            at_mono_s=start_s,
            at_device_s=start["device_s"],
            exposure_s=exposure.exposure_s,
            iso=exposure.iso,
            f_number=exposure.f_number,
            planned_mono_s=step.at_s,
            start_uncertainty_s=None if uncertainty is None else float(uncertainty["value"]),
            suffix=lab.camera.suffix,
        )
        self._lags_s.append(min(max(start_s - triggered_s, 0.0), 1.0))
        path = self.recorder.path / "frames" / name
        lab.frame_bytes = max(path.stat().st_size, lab.frame_bytes if lab.frame_bytes < 10_000_000 else 0)
        level, saturated = measure_level(path)
        return Shot(name, exposure, start_s, level, saturated)

    def _save(self, path: Path) -> None:
        """Fetch the frame; a camera keeps it until that has worked."""
        for remaining in (2, 1, 0):
            self._waiting.allow(CAMERA_S)
            try:
                self.lab.camera.save(path)
                return
            except DeviceError as error:
                if not remaining:
                    raise
                self.lab.watcher.trouble(str(error))
                self._waiting.sleep(self.recorder.mono_s() + 0.5)
            except OSError as error:
                raise PhoslabError(
                    f"could not be written ({error.strerror or error})",
                    file=path,
                    remedy="Make room on the disk, then go on with phoslab resume.",
                ) from error

    def _restage_camera(self) -> None:
        self._exposure = None
        self.lab.return_of(self.lab.camera)

    def _check_disk(self) -> None:
        free = shutil.disk_usage(self.recorder.path).free
        if free < 2 * self.lab.frame_bytes:
            raise PhoslabError(
                f"has {free / 1e6:.0f} MB free, too little for another frame",
                field="the disk",
                file=self.recorder.path,
                remedy="Make room, then go on with phoslab resume.",
            )


def measure_level(path: Path) -> tuple[float, float]:
    """Return how bright a frame's brightest parts are, as a share of saturation, and the share that is saturated.

    The brightest parts: what half a percent of the picture exceeds, in the brightest colour; not the very brightest
    pixel, which is noise or hot.

    Raises:
        DeviceError: it is no RAW frame, or damaged.
    """
    try:
        picture = raw.preview(path)
    except PhoslabError as error:
        raise DeviceError(
            f"delivered what is no RAW frame: {error.problem}",
            field="the camera",
            remedy="Set it to RAW alone (not JPEG, not RAW + JPEG).",
        ) from error
    level = float(np.nanpercentile(np.nanmax(picture.image, axis=-1), 99.5))
    return (level if math.isfinite(level) else math.nan), float(picture.saturated.mean())
