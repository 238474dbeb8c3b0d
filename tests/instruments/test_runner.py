"""What a plan cannot see for itself: a lamp that shines while everybody waits in the dark."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from boards import SIMULATED, BoardProcess

from phoslab.app.live import Silent
from phoslab.instruments import waiting
from phoslab.instruments.controller import RigController
from phoslab.instruments.devices import AlarmError
from phoslab.instruments.interrupts import Interrupts
from phoslab.instruments.laboratory import Laboratory
from phoslab.instruments.plans.steps import Lamp, Part, Plan, Wait
from phoslab.instruments.recorder import Recorder
from phoslab.instruments.runner import Runner
from phoslab.instruments.system_clock import SystemClock
from phoslab.session import Session

HEADER = {
    "plan": {"name": "check", "parameters": {}},
    "sample": {"name": "none"},
    "camera": {"make": "a", "model": "b"},
    "software": {"phoslab": "0"},
}


class Nothing:
    """In the place of a camera and a hand that these plans do not need."""

    name = "nothing"

    def stop(self, *, success: bool = False) -> None: ...


def test_a_relay_that_sticks_ends_a_rest_in_the_dark_long_before_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(waiting, "LOOK_S", 0.5)
    board = BoardProcess(SIMULATED, tmp_path / "rig-port")
    clock = SystemClock()
    rig = RigController(board.port, settle_s=0.3)

    def rest() -> Plan:
        yield Part("rest")
        yield Lamp("on")
        board.do("relay stuck")
        yield Lamp("off")
        yield Wait(3600.0, "resting in the dark")

    try:
        rig.lamp.stage()
        rig.door.stage()
        nobody = Nothing()
        lab = Laboratory(rig.lamp, rig.door, nobody, clock, nobody, Silent(), Interrupts())  # type: ignore[arg-type] # neither is asked
        began = time.monotonic()
        recorder = Recorder(tmp_path / "s", HEADER, clock)
        with pytest.raises(AlarmError, match="SHINES"), recorder:
            Runner(lab, recorder).run(rest)
        # 0.3 s to settle, half a second between looks: a minute is for a busy machine, and far from the hour.
        assert time.monotonic() - began < 60
        assert not Session.open(tmp_path / "s").complete
    finally:
        rig.lamp.unstage()
        rig.door.unstage()
        board.close()
