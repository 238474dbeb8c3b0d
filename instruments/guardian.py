"""A process beside the host that switches a lamp off when the host dies or hangs, for boards without a watchdog.

Started by relays.py as `python -m phoslab.instruments.guardian SOCKET PORT OFF`: SOCKET and PORT are file descriptors
that it inherits, OFF is what the board wants to hear, in hexadecimal. It inherits the port open, since opening it
again may be refused, or toggle lines that reset a board.

Each line from the host, `KEEP SECONDS`, says how long the lamp may stay on from now; `KEEP 0`: it is off. When that
time is over, or the socket ends (which it does however the host dies), it switches off. It says `READY` at its start
and `OFF` when it has switched off, and ends with the socket. It takes no notice of Ctrl-C.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import termios
import time

LONGEST_KEEP_S = 2.0


def watch(socket: int, port: int, off: bytes) -> None:
    """Guard the lamp until the host closes `socket`, or dies."""
    rest, until_s = b"", None
    os.write(socket, b"READY\n")
    while True:
        wait_s = None if until_s is None else max(0.0, until_s - time.monotonic())
        ready, _, _ = select.select([socket], [], [], wait_s)
        if not ready:
            switch_off(port, off)
            until_s = None
            with contextlib.suppress(OSError):
                os.write(socket, b"OFF\n")
            continue
        try:
            data = os.read(socket, 4096)
        except OSError:
            data = b""
        if not data:
            break
        *lines, rest = (rest + data).split(b"\n")
        for line in lines:
            keep_s = min(float(line.split()[1]), LONGEST_KEEP_S)
            until_s = time.monotonic() + keep_s if keep_s > 0 else None
    switch_off(port, off)


def switch_off(port: int, off: bytes) -> None:
    """Say it three times: a board that hears half a command waits for the rest of it, and has no other way to answer.

    What the host has written and the line has not yet carried may be an ON: it is thrown away.
    """
    with contextlib.suppress(OSError, termios.error):
        termios.tcflush(port, termios.TCOFLUSH)
        for _ in range(3):
            os.write(port, off)
            termios.tcdrain(port)
            time.sleep(0.02)


def main(arguments: list[str]) -> None:
    """Run; see the module."""
    socket, port, off = int(arguments[0]), int(arguments[1]), bytes.fromhex(arguments[2])
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # it ends when the host does, with the lamp off, and not before
    watch(socket, port, off)


if __name__ == "__main__":
    main(sys.argv[1:])
