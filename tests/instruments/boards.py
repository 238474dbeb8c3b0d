"""Rig controllers to test with: firmware under simavr, and the simulated one, each on a pseudo-terminal."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

import pytest

import phoslab
from phoslab.instruments.devices import DeviceError

HERE = Path(__file__).parent
SIMAVR_PACKAGES = "gcc-avr avr-libc simavr libsimavr-dev libelf-dev gcc make"


@dataclass(frozen=True)
class Pin:
    """That an output changed: to what, when by this machine's clock and by the board's."""

    name: str
    value: int
    mono_s: float
    board_us: int


class BoardProcess:
    """A running board: `port` is where its line is, `do` makes something happen to it, `pin` waits for an output.

    Args:
        command: to start it.
        link: a link that points at its line, as /dev/serial/by-id does; it follows the line to another path.
    """

    def __init__(self, command: list[str], link: Path) -> None:
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1, env=same_phoslab()
        )
        self.kind = ""
        self.pid = self._process.pid
        self.port = str(link)
        self.paths: list[str] = []
        self.pins: list[Pin] = []
        self._done: list[str] = []
        self._pulse_us = 0
        self._changed = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self._wait(lambda: bool(self.paths), "its port")

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            kind, _, rest = line.strip().partition(" ")
            with self._changed:
                if kind == "port":
                    self.paths.append(rest)
                    link = Path(self.port)
                    link.unlink(missing_ok=True)
                    link.symlink_to(rest)
                elif kind == "pin":
                    name, value, mono, board = rest.split()
                    self.pins.append(Pin(name, int(value), float(mono), int(board)))
                elif kind == "pulse":
                    self._pulse_us = int(rest)
                elif kind == "done":
                    self._done.append(rest)
                self._changed.notify_all()

    def _wait(self, condition: Callable[[], bool], what: str, timeout_s: float = 10.0) -> None:
        with self._changed:
            assert self._changed.wait_for(condition, timeout_s), f"no sign of {what} within {timeout_s:g} s"

    def do(self, command: str) -> None:
        """Carry out one of the commands of firmware_board.c."""
        assert self._process.stdin is not None
        n = len(self._done)
        if command == "unplug":
            Path(self.port).unlink()
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()
        self._wait(lambda: len(self._done) > n, f"{command!r} done")

    def pulse_us(self) -> int:
        """Width of the last pulse for the servo (firmware only)."""
        self.do("pulse")
        return self._pulse_us

    def pin(self, name: str, value: int, *, after: int = 0, timeout_s: float = 10.0) -> Pin:
        """Wait for an output to go to `value`, not counting the first `after` changes of all pins; return when."""

        def found() -> Pin | None:
            return next((pin for pin in self.pins[after:] if (pin.name, pin.value) == (name, value)), None)

        self._wait(lambda: found() is not None, f"{name} at {value}", timeout_s)
        pin = found()
        assert pin is not None
        return pin

    def now_s(self) -> float:
        """The board's clock, which a slow machine slows as well: how long something took must be asked of it."""
        self.do("time")
        return next(pin.board_us for pin in reversed(self.pins) if pin.name == "time") * 1e-6

    def level(self, name: str) -> int:
        """The output as it is."""
        return next((pin.value for pin in reversed(self.pins) if pin.name == name), 0)

    def close(self) -> None:
        """End it."""
        with contextlib.suppress(OSError):
            assert self._process.stdin is not None
            self._process.stdin.close()
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join(5)


def same_phoslab() -> dict[str, str]:
    """The environment in which another Python finds the phoslab that is tested here."""
    return {**os.environ, "PYTHONPATH": str(Path(phoslab.__file__).parent.parent)}


def build_firmware(folder: Path, config: str = "") -> list[str]:
    """Compile firmware and simulator into `folder`; return the command that runs them. Skips without the tools."""
    missing = [tool for tool in ("avr-gcc", "avr-nm", "gcc", "make") if shutil.which(tool) is None]
    if not Path("/usr/include/simavr/sim_avr.h").exists():
        missing.append("simavr's headers")
    if missing:
        pytest.skip(f"no {', '.join(missing)}: apt-get install {SIMAVR_PACKAGES}")
    with as_file(files("phoslab.instruments") / "firmware") as sources:
        make = ["make", "-s", "-f", str(sources / "Makefile"), f"OUT={folder}", f"CONFIG={config}"]
        _run(*make, f"{folder}/rig.elf")
    simulator = folder / "firmware_board"
    _run("gcc", "-O2", "-Wall", "-Wextra", "-Werror", "-o", str(simulator), str(HERE / "firmware_board.c"),
         "-lsimavr", "-lsimavrparts", "-lelf", "-lutil")  # fmt: skip
    symbols = [line.split() for line in _run("avr-nm", str(folder / "rig.elf")).splitlines()]
    hang = next(address for address, *_, name in symbols if name == "_exit")
    return [str(simulator), str(folder / "rig.elf"), hang]


def _run(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


SIMULATED = [sys.executable, str(HERE / "simulated_board.py")]


def raises_soon(call: Callable[[], object], match: str, timeout_s: float = 8.0) -> DeviceError:
    """Call again and again until it raises a DeviceError, as it must; return that."""

    def repeat() -> None:
        end = time.monotonic() + timeout_s
        while time.monotonic() < end:
            call()
            time.sleep(0.01)

    with pytest.raises(DeviceError, match=match) as raised:
        repeat()
    return raised.value


def eventually(condition: Callable[[], object], timeout_s: float = 5.0) -> bool:
    """Wait until `condition()` holds; return whether it came to hold."""
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.005)
    return bool(condition())
