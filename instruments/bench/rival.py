"""A second program that wants the session and the port of the first: it has to be refused both, and to disturb nothing.

It does what `phoslab resume` would, and the session shows it where that is not refused: a line that says `resume`, a
lamp that a greeting has switched off.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from phoslab.errors import PhoslabError
from phoslab.files import write_text
from phoslab.instruments.controller import RigController
from phoslab.instruments.recorder import Recorder
from phoslab.instruments.system_clock import SystemClock


def main(word: str, port: str, session: str | None = None) -> None:
    """Try both, and write to the file `word` what was said to each: a refusal, or nothing."""

    def take_session() -> None:
        if session is not None:
            Recorder.resume(session, SystemClock()).abandon()

    def take_port() -> None:
        controller = RigController(port)
        controller.lamp.stage()
        controller.lamp.unstage()

    said = {"session": _refusal(take_session), "port": _refusal(take_port)}
    write_text(Path(word), json.dumps(said) + "\n")


def _refusal(take: Callable[[], None]) -> str:
    try:
        take()
    except PhoslabError as error:
        return str(error)
    return ""
