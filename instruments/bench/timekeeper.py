"""The bench's one clock: simulated time that flows as real time does, and jumps when it is told to.

It lives in a small file that hosts map into their memory (`phoslab.instruments.simulated.BenchClock`), so that it
can be read without asking, and goes on even when the bench has been killed.
"""

from __future__ import annotations

import mmap
import os
import time
from datetime import datetime
from pathlib import Path

from phoslab.instruments.simulated import TIME, TIME_FILE


class Timekeeper:
    """Simulated time, in s since the bench was started.

    Args:
        folder: where the time file is made.
        start: what the wall clock shows at first.
        mono_s: what the monotonic clock shows at first.
    """

    def __init__(self, folder: Path, start: datetime, mono_s: float = 0.0) -> None:
        path = folder / TIME_FILE
        path.write_bytes(bytes(TIME.size))
        handle = os.open(path, os.O_RDWR)
        try:
            self._shared = mmap.mmap(handle, TIME.size)
        finally:
            os.close(handle)
        self._count = 0
        self._zero, self._ahead = time.monotonic(), mono_s
        self._start, self._step = start.timestamp() - mono_s, 0.0
        self._publish()

    def now_s(self) -> float:
        """Simulated time."""
        return time.monotonic() - self._zero + self._ahead

    def wall_s(self) -> float:
        """What the wall clock shows, in s since 1970."""
        return self._start + self.now_s() + self._step

    def jump_to(self, mono_s: float) -> None:
        """Let it be `mono_s`, if that is still to come."""
        self._ahead += max(0.0, mono_s - self.now_s())
        self._publish()

    def set_wall(self, by_s: float) -> None:
        """Set the wall clock forward by `by_s`, or back; simulated time does not notice."""
        self._step += by_s
        self._publish()

    def _publish(self) -> None:
        # Odd while it changes: who reads meanwhile reads again.
        for count in (self._count + 1, self._count + 2):
            self._shared[:] = TIME.pack(count, self._zero, self._ahead, self._start, self._step)
        self._count += 2
