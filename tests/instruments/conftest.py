"""The boards that tests of the rig run on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from boards import SIMULATED, BoardProcess, build_firmware


@pytest.fixture(scope="session")
def firmware(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The command that runs the firmware under simavr; skips, and says why, without the tools."""
    return build_firmware(tmp_path_factory.mktemp("firmware"))


@pytest.fixture(params=["simulated", "firmware"])
def board(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[BoardProcess]:
    """A controller that has just been switched on: the simulated one, then the firmware under simavr."""
    command = SIMULATED if request.param == "simulated" else request.getfixturevalue("firmware")
    running = BoardProcess(command, tmp_path / "rig-port")
    yield running
    running.close()
