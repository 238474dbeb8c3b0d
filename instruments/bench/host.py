"""The program that measures on the bench, so that what goes wrong with it can go wrong by name, too."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

FULL_BYTES = 4096
"""How much of a file a program can still write when its disk is full: less than a frame, less than a journal."""

RIVAL = "rival.json"
"""In the bench's folder: what the second program was told."""


class Host:
    """The process that connected the camera last. Without one, nothing happens.

    Args:
        folder: of the bench.
        session: that is measured here, if that is known.
    """

    def __init__(self, folder: Path, session: str | None) -> None:
        self._folder, self._session = folder, session
        self._pid, self._handle = -1, -1

    def connected(self, pid: int) -> None:
        """Remember a process, by a handle that never comes to mean another one."""
        if self._handle >= 0:
            os.close(self._handle)
        self._pid, self._handle = pid, -1
        with contextlib.suppress(OSError):  # it has ended already
            self._handle = os.pidfd_open(pid)

    def send(self, number: signal.Signals) -> None:
        """Send it a signal."""
        if self._handle >= 0:
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._handle, number)

    def fill_disk(self) -> None:
        """Let the kernel refuse whatever it writes to a file beyond `FULL_BYTES`, as long as it runs."""
        if self._handle >= 0:
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._handle, 0)  # is it still this process?
                _, most = resource.prlimit(self._pid, resource.RLIMIT_FSIZE)
                resource.prlimit(self._pid, resource.RLIMIT_FSIZE, (FULL_BYTES, most))

    def start_rival(self, port: Path) -> None:
        """Start a second program that wants its session and its port; it leaves word in `RIVAL`."""
        code = (
            "import json, sys; sys.path[:] = json.loads(sys.argv.pop(1)); "
            "from phoslab.instruments.bench.rival import main; main(*sys.argv[1:])"
        )
        words = [str(self._folder / RIVAL), str(port), *([self._session] if self._session else [])]
        subprocess.Popen(
            [sys.executable, "-P", "-c", code, json.dumps(sys.path), *words],
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )
