"""How far a session has come: the parts of its plan that were finished, and what each of their steps was answered.

The runner writes a command `part` to the device `plan` where a part begins and its acknowledgement where it ends, and
in every command the number of its step within the part. So the journal alone says where to go on: a plan is gone
through again, and the steps of finished parts are answered from here instead of being taken.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from phoslab.errors import PhoslabError
from phoslab.instruments.devices import Exposure
from phoslab.instruments.plans.steps import Cold, Door, Lamp, Shoot, Shot, Stage, Step
from phoslab.journal import Event

PLAN = "plan"
"""The device to which parts are commands."""

Answers = dict[int, Any]


@dataclass
class History:
    """What was done.

    Args:
        done: answers of the steps of each finished part, by name.
        attempts: how often each part was begun.
        states: how lamp and door were last seen.
    """

    done: dict[str, Answers] = field(default_factory=dict)
    attempts: dict[str, int] = field(default_factory=dict)
    states: dict[str, str] = field(default_factory=dict)

    @classmethod
    def read(cls, events: Iterable[Event]) -> History:
        """Take it from the lines of a journal."""
        history = cls()
        part, begun, answers = "", -1, Answers()
        steps: dict[int, int] = {}
        for event in events:
            fields = event.fields
            if event.event == "command":
                if fields["device"] == PLAN and fields["name"] == "part":
                    part, begun, answers, steps = str(fields["arguments"]["part"]), event.seq, Answers(), {}
                    history.attempts[part] = history.attempts.get(part, 0) + 1
                elif "step" in fields["arguments"]:
                    steps[event.seq] = int(fields["arguments"]["step"])
            elif event.event == "ack" and fields["ok"]:
                if fields["command"] == begun:
                    history.done[part] = answers
                elif fields["command"] in steps:
                    answers[steps[fields["command"]]] = fields["reply"]
            elif event.event == "edge":
                history.states[fields["device"]] = fields["to"]
        return history

    def answer(self, part: str, number: int, step: Step) -> Any:
        """What step `number` of a finished part was answered.

        Raises:
            PhoslabError: the session was recorded by a plan that took other steps.
        """
        try:
            reply: Any = self.done[part].get(number)
            match step:
                case Cold():
                    return bool(reply["cold"])
                case Lamp() | Door():
                    return float(reply["at_mono_s"])
                case Shoot():
                    return _shot(step, reply)
                case Stage():
                    return None
        except (TypeError, KeyError, ValueError) as error:
            raise PhoslabError(
                f"did not have the step {step!r} as number {number}",
                field=f"the part {part!r} of the journal",
                remedy="It was recorded by another version of phoslab: measure into a new folder.",
            ) from error
        return None


def reply_of(shot: Shot) -> dict[str, Any]:
    """What the journal keeps of a frame's answer."""
    return {
        "frame": shot.frame,
        "start_mono_s": round(shot.start_s, 6),
        "level": None if math.isnan(shot.level) else round(shot.level, 5),
        "saturated": round(shot.saturated, 5),
    }


def _shot(step: Shoot, reply: Any) -> Shot:
    if reply is None:  # lost: its command was never acknowledged
        return lost(step)
    level = reply["level"]
    return Shot(
        reply["frame"],
        step.exposure,
        float(reply["start_mono_s"]),
        math.nan if level is None else float(level),
        float(reply["saturated"]),
    )


def lost(step: Shoot) -> Shot:
    """The answer for a frame that is not there."""
    exposure: Exposure = step.exposure
    return Shot(None, exposure, step.at_s or 0.0, math.nan, 0.0)
