"""Takes a plan's steps on the rig, and writes each to the session before and after.

The lamp is what can do harm. It is on only between the steps that say so and never while a hand is asked for; every
wait renews the promise (`Lamp.allow_until`) that keeps it on, so that a plan that hangs lets it go out; and however
the run ends, `stop` of lamp, door and camera comes last.

What fails is dealt with by what it costs. A frame of a fading light that is lost stays lost, and the series goes on.
Any other failure of a device spoils its part: the devices are made ready again, for which a cable may be plugged in
again, and the part begins anew, three times at most. An alarm is not mended but told: nothing goes on.
"""

from __future__ import annotations

import contextlib
import math
import shutil
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import median
from typing import Any, Protocol

import numpy as np

from phoslab import raw
from phoslab.errors import PhoslabError
from phoslab.instruments.devices import (
    AlarmError,
    Camera,
    Clock,
    DeviceError,
    DeviceTimeoutError,
    Exposure,
    Reading,
    Status,
)
from phoslab.instruments.devices import Door as DoorDevice
from phoslab.instruments.devices import Lamp as LampDevice
from phoslab.instruments.history import PLAN, History, lost, reply_of
from phoslab.instruments.interrupts import Interrupts
from phoslab.instruments.operator import Operator, instructions
from phoslab.instruments.plans.steps import (
    Cold,
    Dark,
    Door,
    Lamp,
    Part,
    Plan,
    Shoot,
    Shot,
    Stage,
    Step,
    Wait,
)
from phoslab.instruments.recorder import Recorder

ATTEMPTS = 3
"""How often a part is begun in one run before the plan gives up."""

GRACE_S = 10.0
"""By how much a step may overrun before the lamp goes out."""

LAMP_S, DOOR_S, CAMERA_S = 10.0, 15.0, 60.0
"""How long lamp, door, and camera beyond its exposure, may take for what they are told."""

SLICE_S = 0.25
"""How often a wait asks whether it shall end, in s of the real clock."""

LOOK_S = 5.0
"""How often a long wait looks at the lamp, in s of the real clock."""

LAGS = 5
"""From how many shutters it is learnt how long one takes to open."""

LOST_IN_A_ROW = 5
"""So many lost frames in a row are no accident."""

RETURN_S = 60.0
"""How long a device that is gone is waited for, in s of the real clock."""

COLD_AFTER_S = 600.0
"""A light that has been off for this long has to warm up again."""

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

    lamp: LampDevice
    door: DoorDevice
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


class Runner:
    """Runs one plan into one session.

    Args:
        lab: the devices.
        recorder: the session, begun or resumed.
        history: of a resumed session.
    """

    def __init__(self, lab: Laboratory, recorder: Recorder, history: History | None = None) -> None:
        self.lab, self.recorder, self.history = lab, recorder, history or History()
        self._exposure: Exposure | None = None
        self._began_s = recorder.mono_s()
        self._dark_since_s = self._began_s  # nobody knows what shone on the sample before
        self._lamp_on = False
        self._edges = dict(self.history.states)
        self._lags_s: deque[float] = deque(maxlen=LAGS)
        self._lost = 0
        self._looked = time.monotonic()

    def run(self, plan: Callable[[], Plan]) -> None:
        """Run to the end; a part whose devices fail is begun again.

        Raises:
            PhoslabError: it cannot be done.
            KeyboardInterrupt: a signal asked for an end.
        """
        failures: dict[str, int] = {}
        try:
            while True:
                try:
                    self._go(plan())
                    return
                except _PartError as error:
                    failures[error.part] = failures.get(error.part, 0) + 1
                    cause = error.cause
                    if isinstance(cause, AlarmError) or failures[error.part] >= ATTEMPTS:
                        raise cause from None
                    self._recover(error.part, cause)
        finally:
            self._make_safe()

    def _make_safe(self) -> None:
        """Lamp off, door and camera stopped; the lamp's edge is recorded if that can be."""
        self.lab.safe()
        if self._lamp_on:
            self._lamp_on, self._dark_since_s = False, self.recorder.mono_s()
            with contextlib.suppress(PhoslabError, KeyError):
                reading = self.lab.lamp.read()[self.lab.lamp.name]
                if reading["value"] == "off":
                    self._edge("lamp", "off", reading)

    def _go(self, steps: Plan) -> None:
        """Go through the plan once; raise _PartError where a device fails."""
        part, number, begun = "", 0, -1
        answer: Any = None
        try:
            while True:
                try:
                    step = steps.send(answer)
                except StopIteration:
                    self._end_part(begun)
                    return
                number += 1
                if isinstance(step, Part):
                    self._end_part(begun)
                    part, number, answer, begun = step.name, 0, None, -1
                    if part not in self.history.done:
                        begun = self._begin_part(part)
                elif begun < 0:
                    answer = self.history.answer(part, number, step)
                else:
                    try:
                        answer = self._take(step, number)
                    except DeviceError as error:
                        raise _PartError(part, error) from error
        finally:
            steps.close()

    def _begin_part(self, name: str) -> int:
        self.lab.interrupts.check()
        attempt = self.history.attempts.get(name, 0) + 1
        self.history.attempts[name] = attempt
        self.lab.watcher.part(name)
        self._answers: dict[int, Any] = {}
        self._part = name
        return self.recorder.command(PLAN, "part", {"part": name, "attempt": attempt})

    def _end_part(self, begun: int) -> None:
        if begun >= 0:
            self.recorder.ack(begun, ok=True)
            self.history.done[self._part] = self._answers

    # ---- steps

    def _take(self, step: Step, number: int) -> Any:
        self.lab.interrupts.check()
        match step:
            case Stage():
                self._set_stage(step, number)
            case Cold(light):
                return self._cold(light, number)
            case Lamp(to):
                return self._lamp(to, number)
            case Door(to):
                return self._door(to, number)
            case Wait(duration_s, why, since_s):
                self._wait((self.recorder.mono_s() if since_s is None else since_s) + duration_s, why)
            case Dark(duration_s):
                self._wait(self._dark_since_s + duration_s, "resting in the dark")
            case Shoot():
                return self._shoot(step, number)
        return None

    def _set_stage(self, wanted: Stage, number: int) -> None:
        lab = self.lab
        todo = instructions(lab.stage, wanted)
        if not todo:
            return
        if self._lamp_on:  # no hand and no eye near it while it is on
            self._switch("off")
        arguments = {**asdict(wanted), "instructions": todo, "step": number}
        command = self.recorder.command("hand", "place", arguments)
        lab.watcher.doing("waiting for a hand")
        before, lab.stage = lab.stage, None
        lab.operator.do(todo, wanted, lab.interrupts.check)
        lab.stage = wanted
        if before is not None and before.light != wanted.light:
            lab.warm_since_s.pop(wanted.light, None)
        self._acknowledge(command, number, None)

    def _cold(self, light: str, number: int) -> bool:
        lab = self.lab
        command = self.recorder.command(PLAN, "cold", {"light": light, "step": number})
        since_s = lab.warm_since_s.get(light)
        # The LED and the mercury lamp stay on as long as the bench stands so.
        cold = since_s is None or (light == "lamp" and lab.clock.mono_s() - since_s > COLD_AFTER_S)
        lab.warm_since_s[light] = lab.clock.mono_s()
        self._acknowledge(command, number, {"cold": cold})
        return cold

    def _lamp(self, to: str, number: int) -> float:
        return self._move(self.lab.lamp, "lamp", to, number, lambda: self._switch(to))

    def _door(self, to: str, number: int) -> float:
        return self._move(self.lab.door, "door", to, number, lambda: self._swing(to))

    def _move(
        self, device: LampDevice | DoorDevice, kind: str, to: str, number: int, act: Callable[[], float]
    ) -> float:
        """Command lamp or door and return when it changed.

        In the dark a failure is mended on the spot, if it can be, and the command given again: what went before need
        not be done anew because a cable was out. What fails twice in a row there is for a person to look at.
        """
        for first in (True, False):
            command = self.recorder.command(kind, "set", {"to": to, "step": number})
            try:
                at_s: float = self._answered(command, act)
            except AlarmError:
                raise
            except DeviceError as error:
                if self._lamp_on or to == "on":
                    raise
                if not first:
                    raise AlarmError(error.problem, remedy=error.remedy, field=error.field) from error
                self.lab.watcher.trouble(str(error))
                self._return_of(device)
                continue
            self._acknowledge(command, number, {"at_mono_s": round(at_s, 6)})
            return at_s
        raise AssertionError("unreachable")

    def _switch(self, to: str) -> float:
        lab = self.lab
        on = to == "on"
        if on:
            self._allow(LAMP_S)
        self._until_done(lab.lamp.set("on" if on else "off"), LAMP_S)
        reading = lab.lamp.read()[lab.lamp.name]
        if reading["value"] != to:
            raise AlarmError(
                f"is {reading['value']} although it was switched {to}",
                field=lab.lamp.name,
                remedy="Pull its plug; then look for a stuck relay or a dead lamp.",
            )
        at_s = self._edge("lamp", to, reading)
        if self._lamp_on or on:
            self._dark_since_s = self.recorder.mono_s()
            lab.warm_since_s["lamp"] = lab.clock.mono_s()
        self._lamp_on = on
        return at_s

    def _swing(self, to: str) -> float:
        lab = self.lab
        self._allow(DOOR_S)
        self._until_done(lab.door.set("open" if to == "open" else "closed"), DOOR_S)
        reading = lab.door.read()[lab.door.name]
        if reading["value"] != to:
            raise DeviceError(
                f"is {reading['value']} although it was told to be {to}",
                field=lab.door.name,
                remedy="Look what is in its way, and whether its end switches close.",
            )
        return self._edge("door", to, reading)

    def _edge(self, device: str, to: str, reading: Reading) -> float:
        """Record that lamp or door changed, once, even if another process has seen it; return when."""
        # A controller's clock is mapped to ours to a millisecond or so: the moment may come out a little late.
        at_s = min(reading["mono_s"] + self.recorder.offset_s, self.recorder.mono_s())
        # What was so before this run has no moment in the session: the clock may have been set in between.
        at_s = max(at_s, self._began_s)
        if self._edges.get(device) != to:
            self.recorder.edge(device, to, at_mono_s=at_s, at_device_s=reading["device_s"])
            self._edges[device] = to
            self.lab.watcher.state(device, to)
        return at_s

    # ---- frames

    def _shoot(self, step: Shoot, number: int) -> Shot:
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
        self._check_lamp()
        self._check_disk()
        self._allow(exposure.exposure_s + CAMERA_S)
        if exposure != self._exposure:
            command = self.recorder.command("camera", "set", asdict(exposure))
            self._exposure = None
            self._answered(command, lambda: self._until_done(lab.camera.set(exposure), CAMERA_S))
            self.recorder.ack(command, ok=True)
            self._exposure = exposure
        command = self.recorder.command("camera", "capture", {**asdict(exposure), "step": number})
        if step.at_s is not None:
            # The median: one shutter that opened late does not make the next one open early.
            lag_s = median(self._lags_s) if self._lags_s else 0.0
            self._wait(step.at_s - lag_s, f"until the next frame ({step.role})")
            late_s = self.recorder.mono_s() - step.at_s
            if step.late_s is not None and late_s > max(step.late_s, 0.1):
                reply = f"left out: its moment passed {late_s:.1f} s ago"
                self.recorder.ack(command, ok=False, reply=reply)
                lab.watcher.trouble(f"a frame ({step.role}) is {reply}")
                return lost(step)
        self._allow(exposure.exposure_s + CAMERA_S)
        lab.watcher.doing(
            f"exposing {exposure.exposure_s:g} s ({step.role})", lab.clock.mono_s() + exposure.exposure_s
        )
        shot: Shot = self._answered(command, lambda: self._frame(step))
        self._acknowledge(command, number, reply_of(shot))
        lab.watcher.shot(step.role, shot)
        return shot

    def _frame(self, step: Shoot) -> Shot:
        lab, exposure = self.lab, step.exposure
        triggered_s = self.recorder.mono_s()
        self._until_done(lab.camera.trigger(), exposure.exposure_s + CAMERA_S)
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
            self._allow(CAMERA_S)
            try:
                self.lab.camera.save(path)
                return
            except DeviceError as error:
                if not remaining:
                    raise
                self.lab.watcher.trouble(str(error))
                self._sleep(self.recorder.mono_s() + 0.5)
            except OSError as error:
                raise PhoslabError(
                    f"could not be written ({error.strerror or error})",
                    file=path,
                    remedy="Make room on the disk, then go on with phoslab resume.",
                ) from error

    def _restage_camera(self) -> None:
        self._exposure = None
        self._return_of(self.lab.camera)

    # ---- waiting, and what goes wrong

    def _wait(self, until_s: float, why: str) -> None:
        if until_s > self.recorder.mono_s():
            self.lab.watcher.doing(why, until_s - self.recorder.offset_s)
            self._sleep(until_s)

    def _sleep(self, until_s: float) -> None:
        """Wait in slices, between which a signal is heard and the lamp's promise renewed."""
        lab, slice_s = self.lab, SLICE_S
        while (left_s := until_s - self.recorder.mono_s()) > 0:
            lab.interrupts.check()
            if left_s > 2.0 and time.monotonic() - self._looked > LOOK_S:
                self._check_lamp()  # a relay that sticks hours before the next frame must not wait for it
            step_s = min(left_s, slice_s)
            self._allow(step_s)
            before_s = time.monotonic()
            lab.clock.sleep_until(lab.clock.mono_s() + step_s)
            if time.monotonic() - before_s < step_s / 4:
                slice_s *= 8  # a simulated clock jumps, and should not have to do so in small steps
        lab.interrupts.check()

    def _until_done(self, status: Status, at_most_s: float) -> None:
        """Wait for a status; the time-out counts on the real clock, since something real has to answer."""
        end_s = time.monotonic() + at_most_s
        while not status.done and time.monotonic() < end_s:
            status.exception(timeout=SLICE_S)
            self.lab.interrupts.check()
        if not status.done:
            raise DeviceTimeoutError(status.device, status.command, at_most_s)
        status.wait(0)

    def _allow(self, at_least_s: float) -> None:
        if self._lamp_on or at_least_s == LAMP_S:
            self.lab.lamp.allow_until(self.lab.clock.mono_s() + at_least_s + GRACE_S)

    def _check_lamp(self) -> None:
        """The lamp must be what the plan thinks it is; a lamp that is off may be out of reach for a while."""
        lamp = self.lab.lamp
        self._looked = time.monotonic()
        try:
            now = lamp.read()[lamp.name]["value"]
        except AlarmError:
            raise
        except DeviceError as error:
            if self._lamp_on:
                raise
            # A frame needs the camera only, and a fading light does not wait.
            self.lab.watcher.trouble(str(error))
            with contextlib.suppress(PhoslabError):
                lamp.stage()
            return
        if (now == "on") != self._lamp_on:
            kind = AlarmError if now == "on" else DeviceError
            raise kind(
                f"is {now} although the plan has switched it {'on' if self._lamp_on else 'off'}",
                field=lamp.name,
                remedy="Pull its plug, then look for a stuck relay."
                if now == "on"
                else "Something switched it off: its controller was reset, or a limit was reached.",
            )

    def _check_disk(self) -> None:
        free = shutil.disk_usage(self.recorder.path).free
        if free < 2 * self.lab.frame_bytes:
            raise PhoslabError(
                f"has {free / 1e6:.0f} MB free, too little for another frame",
                field="the disk",
                file=self.recorder.path,
                remedy="Make room, then go on with phoslab resume.",
            )

    def _answered(self, command: int, act: Callable[[], Any]) -> Any:
        """Do something for a command; if it fails, acknowledge that before the error goes on."""
        try:
            return act()
        except DeviceError as error:
            self.recorder.ack(command, ok=False, reply=str(error))
            raise

    def _acknowledge(self, command: int, number: int, reply: Any) -> None:
        self.recorder.ack(command, ok=True, reply=reply)
        self._answers[number] = reply

    def _recover(self, part: str, error: DeviceError) -> None:
        """Bring the devices back after a failure, so that a part can begin again."""
        lab = self.lab
        self.recorder.note(f"the part {part!r} failed and begins again: {error}")
        lab.watcher.trouble(f"{error} ({part!r} begins again)")
        self._make_safe()
        self._exposure, self._lost = None, 0
        for device in (lab.lamp, lab.door, lab.camera):
            self._return_of(device)

    def _return_of(self, device: LampDevice | DoorDevice | Camera) -> None:
        """Stage a device again; wait for one that is gone.

        Raises:
            PhoslabError: it did not come back.
        """
        end_s = time.monotonic() + RETURN_S
        while True:
            self.lab.interrupts.check()
            try:
                device.stage()
                return
            except AlarmError:
                raise
            except PhoslabError as error:  # not only a DeviceError: a port that is not there is none
                if time.monotonic() > end_s:
                    raise
                self.lab.watcher.trouble(f"waiting for the {device.name}: {error}")
                time.sleep(0.5)


class _PartError(Exception):
    """A part failed by a device."""

    def __init__(self, part: str, cause: DeviceError) -> None:
        super().__init__(str(cause))
        self.part, self.cause = part, cause


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
