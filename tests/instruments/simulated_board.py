"""The simulated controller in a process of its own, on a pseudo-terminal; takes the commands of firmware_board.c.

It lives in real time. Run as `python simulated_board.py`.
"""

from __future__ import annotations

import contextlib
import os
import pty
import select
import sys
import time
import tty

from phoslab.instruments.bench.board import Board
from phoslab.instruments.bench.controller import Drive, SimulatedController

STEP_S = 0.001


def say(text: str) -> None:
    print(text, flush=True)


class SpokenBoard(Board):
    """Tells what its pins do."""

    def _pin(self, name: str, value: int) -> None:
        if self._said.get(name) != value:
            self._said[name] = value
            say(f"pin {name} {int(value)} {time.monotonic():.6f} {self.clock_us()}")

    def __post_init__(self) -> None:
        self._said: dict[str, int] = {"lamp": 0, "main": 0, "alarm": 0, "motor": 0}
        super().__post_init__()

    def set_lamp(self, on: bool) -> None:
        super().set_lamp(on)
        self._pin("lamp", on)

    def set_main(self, on: bool) -> None:
        super().set_main(on)
        self._pin("main", on)

    def set_alarm(self, on: bool) -> None:
        super().set_alarm(on)
        self._pin("alarm", on)

    def drive_door(self, to: Drive) -> None:
        super().drive_door(to)
        self._pin("motor", {"OPEN": 1, "CLOSE": -1, None: 0}[to])


class Line:
    """The pseudo-terminal, plugged in or not."""

    def __init__(self) -> None:
        self.ends: tuple[int, int] | None = None
        self.plug()

    def plug(self) -> None:
        if self.ends is None:
            self.ends = pty.openpty()
            tty.setraw(self.ends[1])
            os.set_blocking(self.ends[0], False)
            say(f"port {os.ttyname(self.ends[1])}")

    def unplug(self) -> None:
        for end in self.ends or ():
            os.close(end)
        self.ends = None


def obey(words: list[str], board: SpokenBoard, controller: SimulatedController, line: Line) -> None:
    match words:
        case ["relay", how]:
            board.stuck_relay = how == "stuck"
        case ["main", how]:
            board.stuck_main = how == "stuck"
        case ["lamp", how]:
            board.dead_lamp = how == "dead"
        case ["door", how]:
            board.stuck_door = how == "stuck"
        case ["push", where]:
            board.door = float(where)
        case ["garble-replies" | "lose-replies" | "garble-requests" | "lose-requests" as fault, n]:
            setattr(controller.faults, fault.replace("-", "_"), int(n))
        case ["unplug"]:
            line.unplug()
        case ["plug"]:
            line.plug()
        case ["reset"]:
            controller.reset("EXTERNAL")
        case ["time"]:
            say(f"pin time 0 {time.monotonic():.6f} {board.clock_us()}")
        case ["hang"]:
            time.sleep(0.25)
            controller.reset("WATCHDOG")
        case _:
            sys.exit(2)
    say(f"done {words[0]}")


def main() -> None:
    board = SpokenBoard()
    controller = SimulatedController(board)
    line = Line()
    os.set_blocking(0, False)
    commands = b""
    while True:
        ready, _, _ = select.select([0, *(line.ends or ())[:1]], [], [], STEP_S)
        if 0 in ready:
            read = os.read(0, 4096)
            if not read:
                return  # whoever started us has gone
            *whole, commands = (commands + read).split(b"\n")
            for command in whole:
                obey(command.decode().split(), board, controller, line)
        if line.ends and line.ends[0] in ready:
            with contextlib.suppress(OSError):
                controller.receive(os.read(line.ends[0], 4096))
        controller.poll()
        out = controller.take()
        if line.ends and out:
            with contextlib.suppress(BlockingIOError):
                os.write(line.ends[0], out)


if __name__ == "__main__":
    main()
