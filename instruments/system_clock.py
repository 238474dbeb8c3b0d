"""The clocks of this computer."""

from __future__ import annotations

import time
from datetime import UTC, datetime


class SystemClock:
    """This computer's clocks, with no rig controller."""

    def mono_s(self) -> float:
        """Seconds since the computer started, by the clock that nobody can set."""
        return time.monotonic()

    def device_s(self) -> float | None:
        """None: there is no controller."""
        return None

    def wall(self) -> datetime:
        """Now, in UTC."""
        return datetime.now(UTC)

    def sleep_until(self, mono_s: float) -> None:
        """Sleep until `time.monotonic()` says so."""
        time.sleep(max(0.0, mono_s - time.monotonic()))
