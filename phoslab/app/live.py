"""What a person sees and answers while a plan runs: a live view in a terminal, plain lines elsewhere.

Everything goes to stderr; stdout is for what a program reads.
"""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from phoslab.errors import printable
from phoslab.instruments.devices import Clock
from phoslab.instruments.plans.ladder import HIGHEST, LOWEST, gain
from phoslab.instruments.plans.steps import Shot, Stage
from phoslab.instruments.rehearsal import duration

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

_BLOCKS = " ▁▂▃▄▅▆▇█"
_PLOT = (60, 8)
"""Columns and rows of the plot."""


class Silent:
    """A watcher that says nothing, for `--json` and tests."""

    def part(self, name: str) -> None:
        """See `Watcher`."""

    def doing(self, text: str, until_s: float | None = None) -> None:
        """See `Watcher`."""

    def state(self, device: str, state: str) -> None:
        """See `Watcher`."""

    def shot(self, role: str, shot: Shot) -> None:
        """See `Watcher`."""

    def trouble(self, text: str) -> None:
        """See `Watcher`."""


class Lines(Silent):
    """A line for each event that matters, where no terminal is (a log, a pipe)."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._began_s = clock.mono_s()

    def part(self, name: str) -> None:
        """Say that a part begins."""
        self._say(f"{name}:")

    def state(self, device: str, state: str) -> None:
        """Say what lamp or door did."""
        self._say(f"  {device} {state}")

    def shot(self, role: str, shot: Shot) -> None:
        """Say what was taken."""
        self._say(f"  {frame_line(role, shot)}")

    def trouble(self, text: str) -> None:
        """Say what went wrong."""
        self._say(f"  ! {text}")

    def _say(self, text: str) -> None:
        elapsed = self._clock.mono_s() - self._began_s
        print(printable(f"{elapsed:9.1f} s  {text}"), file=sys.stderr, flush=True)


class Live(Silent):
    """A panel that is drawn anew several times a second.

    Args:
        console: on stderr.
        clock: the plan's.
        title: what is measured.
        total_s: how long it takes, about.
    """

    def __init__(self, console: Console, clock: Clock, title: str, total_s: float) -> None:
        self._console, self._clock, self._title, self._total_s = console, clock, title, total_s
        self._began_s = clock.mono_s()
        self._part, self._text, self._role = "", "", ""
        self._until_s: float | None = None
        self._states = {"lamp": "?", "door": "?"}
        self._shot: Shot | None = None
        self._curve: list[tuple[float, float]] = []
        self._zero_s: float | None = None
        self._troubles: list[str] = []
        self._live: Any = None

    @contextmanager
    def shown(self) -> Iterator[None]:
        """Show the panel while the block lasts."""
        from rich.live import Live as Panel

        with Panel(console=self._console, get_renderable=self._draw, refresh_per_second=4) as self._live:
            yield

    @contextmanager
    def hidden(self) -> Iterator[None]:
        """Take it away meanwhile, for a question."""
        self._live.stop()
        try:
            yield
        finally:
            self._live.start()

    def part(self, name: str) -> None:
        """See `Watcher`."""
        self._part, self._curve, self._zero_s = name, [], None

    def doing(self, text: str, until_s: float | None = None) -> None:
        """See `Watcher`."""
        self._text, self._until_s = text, until_s

    def state(self, device: str, state: str) -> None:
        """See `Watcher`."""
        self._states[device] = state
        if (device, state) == ("lamp", "off"):
            self._zero_s, self._curve = None, []

    def shot(self, role: str, shot: Shot) -> None:
        """See `Watcher`."""
        self._role, self._shot = role, shot
        if shot.frame is not None and role in ("decay", "emission", "excitation"):
            self._zero_s = shot.start_s if self._zero_s is None else self._zero_s
            self._curve.append((shot.start_s - self._zero_s, shot.level / gain(shot.exposure)))

    def trouble(self, text: str) -> None:
        """See `Watcher`."""
        self._troubles = [*self._troubles[-2:], text]

    def _draw(self) -> RenderableType:
        from rich.console import Group
        from rich.panel import Panel
        from rich.text import Text

        now_s = self._clock.mono_s()
        elapsed_s = now_s - self._began_s
        rest = f" of about {duration(self._total_s)}" if self._total_s else ""
        until_s = self._until_s
        countdown = f", {duration(until_s - now_s)}" if until_s is not None and until_s > now_s else ""
        lamp, door = self._states["lamp"], self._states["door"]
        rows = [
            Text(f"elapsed {duration(elapsed_s)}{rest}   lamp ").append(
                lamp, "bold yellow" if lamp == "on" else ""
            )
            + Text(f"   door {door}"),
            Text(printable(self._part), "bold"),
            Text(printable(f"{self._text}{countdown}")),
        ]
        if self._shot is not None:
            rows.append(Text(printable(frame_line(self._role, self._shot))))
            rows.append(level_bar(self._shot.level))
        rows += [Text(line, "green") for line in plot(self._curve, *_PLOT)]
        rows += [Text(printable(f"! {text}"), "red") for text in self._troubles]
        return Panel(Group(*rows), title=printable(self._title), width=min(78, self._console.width))


def frame_line(role: str, shot: Shot) -> str:
    """One line about a frame.

    >>> from phoslab.instruments.devices import Exposure
    >>> frame_line("decay", Shot("0003.dng", Exposure(0.5, 200, 2.8), 7.0, 0.41, 0.0))
    '0003.dng decay 0.5 s ISO 200 f/2.8: 41 % of saturation'
    """
    e = shot.exposure
    settings = f"{e.exposure_s:g} s ISO {e.iso:g}" + (f" f/{e.f_number:g}" if e.f_number else "")
    if shot.frame is None:
        return f"a {role} frame of {settings} was lost"
    too = (
        " (too bright)"
        if shot.level > HIGHEST
        else " (dark)"
        if shot.level < LOWEST and role != "dark"
        else ""
    )
    return f"{shot.frame} {role} {settings}: {shot.level:.0%}".replace("%", " %") + f" of saturation{too}"


def level_bar(level: float) -> Any:
    """A bar from 0 to saturation, with the range in which a frame is well exposed."""
    from rich.text import Text

    width = 50
    n = 0 if level != level else max(0, min(width, round(level * width)))
    colour = "green" if LOWEST <= level <= HIGHEST else "red"
    low, high = round(LOWEST * width), round(HIGHEST * width)
    bar = Text()
    for k in range(width):
        mark = "|" if k in (low, high) else "·"
        bar.append("█" if k < n else mark, colour if k < n else "dim")
    return bar


def plot(curve: list[tuple[float, float]], columns: int, rows: int) -> list[str]:
    """Draw points as a small plot, the value on a logarithmic scale; nothing for fewer than two.

    >>> plot([(0, 1.0), (1, 0.1), (2, 0.01)], 3, 2)
    ['█  ', '██▁', '0 to 2 s, brightness falls from 1 to 0.01']
    """
    import math

    points = [(t, v) for t, v in curve if v > 0]
    if len(points) < 2:
        return []
    low, high = (math.log(f(v for _, v in points)) for f in (min, max))
    span_s = points[-1][0] - points[0][0] or 1.0
    heights = [0.0] * columns
    k = 0
    for column in range(columns):
        t = points[0][0] + span_s * column / max(columns - 1, 1)
        while k + 1 < len(points) and points[k + 1][0] <= t + 1e-9:
            k += 1
        heights[column] = (math.log(points[k][1]) - low) / (high - low or 1.0)
    lines = []
    for row in reversed(range(rows)):
        eighths = [max(1 if row == 0 else 0, min(8, round((h * rows - row) * 8))) for h in heights]
        lines.append("".join(_BLOCKS[n] for n in eighths))
    brightest, last = max(v for _, v in points), points[-1][1]
    return [
        *lines,
        f"{points[0][0]:.3g} to {points[-1][0]:.3g} s, brightness falls from {brightest:.3g} to {last:.3g}",
    ]


class Terminal:
    """The `Operator` at the terminal: reads what to do, does it, presses Enter.

    Args:
        live: the panel, which makes room for the question; None without.
    """

    def __init__(self, live: Live | None = None) -> None:
        self.live = live

    def do(self, texts: list[str], stage: Stage | None, check: Callable[[], None]) -> None:
        """Ask, and wait for Enter.

        Raises:
            PhoslabError: there is nobody to ask: the input has ended.
        """
        from contextlib import nullcontext

        with self.live.hidden() if self.live else nullcontext():
            print(file=sys.stderr)
            for text in texts:
                print(printable(f"  -> {text}"), file=sys.stderr)
            print(
                "  Then press Enter (Ctrl-C: stop here, resume later). ", end="", file=sys.stderr, flush=True
            )
            _wait_for_enter(check)


def _wait_for_enter(check: Callable[[], None]) -> None:
    from phoslab.errors import PhoslabError

    handle = sys.stdin.fileno() if sys.stdin is not None else -1
    while True:
        check()
        try:
            ready, _, _ = select.select([handle], [], [], 0.2)
            if not ready:
                continue
            typed = os.read(
                handle, 1
            )  # no further than the line's end: the next one is for the next question
        except (OSError, ValueError):
            typed = b""
        if b"\n" in typed:
            return
        if not typed:
            raise PhoslabError(
                "has ended, and a hand is needed",
                field="the input",
                remedy="Run it in a terminal; phoslab resume goes on from here.",
            )
