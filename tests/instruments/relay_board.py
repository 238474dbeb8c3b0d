"""A relay board on a pseudo-terminal: takes the bytes of an LCUS-1 or KMTronic board, and tells when it switches.

Run as `python relay_board.py KIND`; commands as in firmware_board.c, as far as a relay board has use for them.
"""

from __future__ import annotations

import os
import pty
import select
import sys
import time
import tty

# As the makers' sheets have them, and on purpose not as instruments/relays.py has them.
FRAMES = {
    "lcus-1": {b"\xa0\x01\x01\xa2": 1, b"\xa0\x01\x00\xa1": 0},
    "kmtronic": {b"\xff\x01\x01": 1, b"\xff\x01\x00": 0},
}
STATUS = {"kmtronic": b"\xff\x01\x03"}


def plug() -> tuple[int, int]:
    master, slave = pty.openpty()
    tty.setraw(slave)
    print(f"port {os.ttyname(slave)}", flush=True)
    return master, slave


def main() -> None:
    frames, status = FRAMES[sys.argv[1]], STATUS.get(sys.argv[1])
    length = len(next(iter(frames)))
    line: tuple[int, int] | None = plug()
    state, received, commands, dumb = 0, b"", b"", False
    while True:
        ready, _, _ = select.select([0, *(line or ())[:1]], [], [])
        if 0 in ready:
            read = os.read(0, 4096)
            if not read:
                return
            *whole, commands = (commands + read).split(b"\n")
            for command in whole:
                if command == b"unplug" and line is not None:
                    for end in line:
                        os.close(end)
                    line = None
                elif command == b"plug" and line is None:
                    line = plug()
                elif command == b"reset" and state:  # its supply was weak for a moment
                    state = 0
                    print(f"pin lamp 0 {time.monotonic():.6f} 0", flush=True)
                elif command.startswith(b"dumb"):
                    dumb = command == b"dumb on"
                elif command == b"time":
                    print(f"pin time 0 {time.monotonic():.6f} 0", flush=True)
                print(f"done {command.decode()}", flush=True)
        if line is not None and line[0] in ready:
            received += os.read(line[0], 4096)
            while len(received) >= length:
                to = frames.get(received[:length])
                if received[:length] == status:
                    if not dumb:
                        os.write(line[0], next(frame for frame, to in frames.items() if to == state))
                    received = received[length:]
                    continue
                received = received[length if to is not None else 1 :]
                if to is not None and to != state:
                    state = to
                    print(f"pin lamp {state} {time.monotonic():.6f} 0", flush=True)


if __name__ == "__main__":
    main()
