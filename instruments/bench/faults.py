"""What can go wrong on the bench, by name, and when.

camera-busy@12        at the 12th exposure
stuck-door@90s        90 s of simulated time after the bench was started
clock-step            now
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from phoslab.errors import PhoslabError

KINDS = {
    "camera-busy": "the camera is busy and refuses three commands",
    "camera-gone": "the camera is away for a second, and has to be connected anew",
    "card-full": "the card is full until the camera is connected anew",
    "truncated-download": "the next frame comes only in part, once",
    "late-shutter": "the next shutter opens 0.7 s late",
    "serial-unplug": "the controller's cable is out for a second, and comes back under another path",
    "garbled-ack": "the controller's next reply arrives with a wrong character",
    "lost-ack": "the controller's next reply does not arrive",
    "controller-reset": "the controller is reset",
    "stuck-door": "the door does not move until it is repaired",
    "stuck-relay": "the lamp's relay does not open again until it is repaired",
    "clock-step": "somebody sets the wall clock an hour forward",
    "disk-full": "the measuring program can write no frame and no line any more",
    "ctrl-c": "somebody presses Ctrl-C",
    "kill": "the measuring program is killed (kill -9)",
    "second-process": "another program wants the same session and the same port",
}

_SPEC = re.compile(r"([a-z-]+)(?:@(\d+)|@(\d+(?:\.\d+)?)s)?")


@dataclass(frozen=True)
class Fault:
    """A fault that is to happen.

    Args:
        kind: one of `KINDS`.
        exposure: with which exposure, counted from 1.
        at_s: at which moment. With neither: at once.
    """

    kind: str
    exposure: int | None = None
    at_s: float | None = None


def parse(text: str) -> Fault:
    """Return the fault that a text like "camera-busy@12" names.

    Raises:
        PhoslabError: it names none.

    >>> parse("camera-busy@12")
    Fault(kind='camera-busy', exposure=12, at_s=None)
    >>> parse("stuck-door@90s").at_s
    90.0
    """
    found = _SPEC.fullmatch(text)
    if found is None or found[1] not in KINDS or found[2] == "0":
        raise PhoslabError(
            f"{text!r} names no fault",
            field="--fault",
            remedy=f"Say NAME@12 (with the 12th exposure) or NAME@90s, with one of {', '.join(KINDS)}.",
        )
    return Fault(found[1], int(found[2]) if found[2] else None, float(found[3]) if found[3] else None)
