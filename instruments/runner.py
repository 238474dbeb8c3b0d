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
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from phoslab.errors import PhoslabError
from phoslab.instruments.devices import AlarmError, DeviceError, Reading
from phoslab.instruments.devices import Door as DoorDevice
from phoslab.instruments.devices import Lamp as LampDevice
from phoslab.instruments.history import PLAN, History, reply_of
from phoslab.instruments.laboratory import Laboratory
from phoslab.instruments.operator import instructions
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
from phoslab.instruments.shooting import Shooting
from phoslab.instruments.waiting import Waiting

ATTEMPTS = 3
"""How often a part is begun in one run before the plan gives up."""

LAMP_S, DOOR_S = 10.0, 15.0
"""How long lamp and door may take for what they are told."""

COLD_AFTER_S = 600.0
"""A light that has been off for this long has to warm up again."""


class Runner:
    """Runs one plan into one session.

    Args:
        lab: the devices.
        recorder: the session, begun or resumed.
        history: of a resumed session.
    """

    def __init__(self, lab: Laboratory, recorder: Recorder, history: History | None = None) -> None:
        self.lab, self.recorder, self.history = lab, recorder, history or History()
        self._waiting = Waiting(lab, recorder)
        self._shooting = Shooting(self._waiting)
        self._began_s = recorder.mono_s()
        self._dark_since_s = self._began_s  # nobody knows what shone on the sample before
        self._edges = dict(self.history.states)

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
        if self._waiting.lamp_on:
            self._waiting.lamp_on, self._dark_since_s = False, self.recorder.mono_s()
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
                self._waiting.until(
                    (self.recorder.mono_s() if since_s is None else since_s) + duration_s, why
                )
            case Dark(duration_s):
                self._waiting.until(self._dark_since_s + duration_s, "resting in the dark")
            case Shoot():
                return self._shoot(step, number)
        return None

    def _set_stage(self, wanted: Stage, number: int) -> None:
        lab = self.lab
        todo = instructions(lab.stage, wanted)
        if not todo:
            return
        if self._waiting.lamp_on:  # no hand and no eye near it while it is on
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
                at_s: float = self.recorder.answered(command, act)
            except AlarmError:
                raise
            except DeviceError as error:
                if self._waiting.lamp_on or to == "on":
                    raise
                if not first:
                    raise AlarmError(error.problem, remedy=error.remedy, field=error.field) from error
                self.lab.watcher.trouble(str(error))
                self.lab.return_of(device)
                continue
            self._acknowledge(command, number, {"at_mono_s": round(at_s, 6)})
            return at_s
        raise AssertionError("unreachable")

    def _switch(self, to: str) -> float:
        lab = self.lab
        on = to == "on"
        if on:
            self._waiting.allow(LAMP_S, switching=True)
        self._waiting.for_status(lab.lamp.set("on" if on else "off"), LAMP_S)
        reading = lab.lamp.read()[lab.lamp.name]
        if reading["value"] != to:
            raise AlarmError(
                f"is {reading['value']} although it was switched {to}",
                field=lab.lamp.name,
                remedy="Pull its plug; then look for a stuck relay or a dead lamp.",
            )
        at_s = self._edge("lamp", to, reading)
        if self._waiting.lamp_on or on:
            self._dark_since_s = self.recorder.mono_s()
            lab.warm_since_s["lamp"] = lab.clock.mono_s()
        self._waiting.lamp_on = on
        return at_s

    def _swing(self, to: str) -> float:
        lab = self.lab
        self._waiting.allow(DOOR_S)
        self._waiting.for_status(lab.door.set("open" if to == "open" else "closed"), DOOR_S)
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
        shot = self._shooting.shoot(step, number)
        if shot.frame is not None:
            self._answers[number] = reply_of(shot)
        return shot

    # ---- what goes wrong

    def _acknowledge(self, command: int, number: int, reply: Any) -> None:
        self.recorder.ack(command, ok=True, reply=reply)
        self._answers[number] = reply

    def _recover(self, part: str, error: DeviceError) -> None:
        """Bring the devices back after a failure, so that a part can begin again."""
        lab = self.lab
        self.recorder.note(f"the part {part!r} failed and begins again: {error}")
        lab.watcher.trouble(f"{error} ({part!r} begins again)")
        self._make_safe()
        self._shooting.begin_anew()
        for device in (lab.lamp, lab.door, lab.camera):
            lab.return_of(device)


class _PartError(Exception):
    """A part failed by a device."""

    def __init__(self, part: str, cause: DeviceError) -> None:
        super().__init__(str(cause))
        self.part, self.cause = part, cause
