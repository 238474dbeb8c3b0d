"""A bluesky lab can drive the rig: its RunEngine counts and moves lamp and door."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from boards import BoardProcess, eventually

from phoslab.instruments.controller import RigController

bluesky = pytest.importorskip("bluesky", reason="no bluesky: pip install 'phoslab[test]'")


@pytest.fixture
def rig(board: BoardProcess) -> Iterator[RigController]:
    rig = RigController(board.port)
    yield rig
    rig.lamp.unstage()
    rig.door.unstage()


def test_bluesky_counts_and_moves_lamp_and_door(board: BoardProcess, rig: RigController) -> None:
    from bluesky import RunEngine
    from bluesky import plan_stubs as bps
    from bluesky import plans as bp
    from bluesky import preprocessors as bpp

    documents: list[tuple[str, dict[str, Any]]] = []
    lamp, door = rig.lamp, rig.door

    @bpp.stage_decorator([lamp, door])
    @bpp.run_decorator()
    def charge_and_look() -> Any:
        yield from bps.mv(lamp, "on")
        yield from bps.trigger_and_read([lamp, door])
        yield from bps.mv(lamp, "off")
        yield from bps.mv(door, "open")
        yield from bps.trigger_and_read([lamp, door])

    engine = RunEngine({})
    engine.subscribe(lambda name, document: documents.append((name, document)))
    engine(charge_and_look())
    engine(bp.count([lamp, door], num=2))

    events = [document["data"] for name, document in documents if name == "event"]
    assert [(event["lamp"], event["door"]) for event in events] == [
        ("on", "closed"),
        ("off", "open"),
        ("off", "open"),
        ("off", "open"),
    ]
    keys = next(document["data_keys"] for name, document in documents if name == "descriptor")
    assert keys["lamp_uncertainty"]["units"] == "s"
    stops = [document["exit_status"] for name, document in documents if name == "stop"]
    assert stops == ["success", "success"]
    assert eventually(lambda: board.level("lamp") == 0)


def test_a_failure_in_a_plan_leaves_the_lamp_off(board: BoardProcess, rig: RigController) -> None:
    from bluesky import RunEngine
    from bluesky import plan_stubs as bps
    from bluesky import preprocessors as bpp
    from bluesky.utils import FailedStatus

    board.do("door stuck")

    @bpp.stage_decorator([rig.lamp, rig.door])
    @bpp.run_decorator()
    def plan() -> Any:
        yield from bps.mv(rig.lamp, "on")
        yield from bps.mv(rig.door, "open")

    with pytest.raises(FailedStatus):
        RunEngine({})(plan())
    assert eventually(lambda: board.level("lamp") == 0)
