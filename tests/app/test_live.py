"""What a person sees and answers: one Enter a question, a panel that makes room for it, a plot that falls."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Iterator
from datetime import UTC, datetime

import pytest
from rich.console import Console

from phoslab.app.live import Live, Terminal, frame_line, plot
from phoslab.errors import PhoslabError
from phoslab.instruments.devices import Door, Exposure
from phoslab.instruments.hand import HandDoor
from phoslab.instruments.plans.steps import Shot


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def mono_s(self) -> float:
        return self.now_s

    def device_s(self) -> None:
        return None

    def wall(self) -> datetime:
        return datetime(2026, 1, 1, tzinfo=UTC)

    def sleep_until(self, mono_s: float) -> None:
        self.now_s = mono_s


@pytest.fixture
def typing(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A handle to type into."""
    read, write = os.pipe()
    with os.fdopen(read) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        yield write
        os.close(write)


def test_each_question_takes_one_line(typing: int, capsys: pytest.CaptureFixture[str]) -> None:
    os.write(typing, b"yes\nand yes\n")
    terminal = Terminal()
    terminal.do(["Put the sample in place."], None, lambda: None)
    terminal.do(["Take the LVF away."], None, lambda: None)
    told = capsys.readouterr().err
    assert told.index("Put the sample in place.") < told.index("Take the LVF away.")


def test_a_question_that_nobody_can_answer_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    with open(os.devnull) as nothing:  # noqa: PTH123  # a stream is wanted
        monkeypatch.setattr("sys.stdin", nothing)
        with pytest.raises(PhoslabError, match="a hand is needed"):
            Terminal().do(["Put the sample in place."], None, lambda: None)


def test_a_signal_ends_a_question(typing: int) -> None:
    def stop() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Terminal().do(["Put the sample in place."], None, stop)


def test_the_panel_makes_room_for_a_question_and_comes_back(typing: int) -> None:
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, width=80)
    clock = Clock()
    live = Live(console, clock, "star: decay", 100.0)
    terminal = Terminal(live)
    with live.shown():
        os.write(typing, b"\n")
        terminal.do(["Put the sample in place."], None, lambda: None)
        live.part("charge and decay")
        live.state("lamp", "on")
        live.doing("charging", 60.0)
        live._live.refresh()
    told = screen.getvalue()
    assert "charge and decay" in told
    assert "charging, 60 s" in told


def test_the_panel_shows_level_lamp_door_trouble_and_the_curve() -> None:
    console = Console(file=io.StringIO(), width=80, record=True)
    live = Live(console, Clock(), "star: decay", 100.0)
    live.state("lamp", "off")
    live.state("door", "open")
    for k in range(5):
        live.shot("decay", Shot(f"{k:04d}.dng", Exposure(0.5, 100, 2.8), 5.0 * k, 0.6 * math.exp(-k), 0.0))
    live.trouble("camera is busy")
    console.print(live._draw())
    told = console.export_text()
    for words in (
        "lamp off",
        "door open",
        "0004.dng decay 0.5 s ISO 100 f/2.8",
        "0 to 20 s",
        "! camera is busy",
    ):
        assert words in told


def test_a_plot_falls_as_the_light_does() -> None:
    *rows, told = plot([(t, math.exp(-t)) for t in range(9)], 9, 4)
    assert len(rows) == 4
    filled = [sum(row[column] != " " for row in rows) for column in range(9)]
    assert filled == sorted(filled, reverse=True)
    assert filled[0] == 4
    assert filled[-1] == 1
    assert told.startswith("0 to 8 s")


def test_light_that_is_gone_or_alone_draws_nothing() -> None:
    assert plot([], 9, 4) == []
    assert plot([(0.0, 1.0)], 9, 4) == []
    assert plot([(0.0, 1.0), (1.0, 0.0)], 9, 4) == []


def test_a_lost_frame_and_a_saturated_one_are_said() -> None:
    exposure = Exposure(0.5, 100, None)
    assert "was lost" in frame_line("decay", Shot(None, exposure, 0.0, math.nan, 0.0))
    assert "too bright" in frame_line("decay", Shot("0000.dng", exposure, 0.0, 1.0, 0.3))


def test_a_door_by_hand_asks_only_when_it_must_move() -> None:
    asked: list[str] = []

    class Hand:
        def do(self, texts: list[str], stage: object, check: object) -> None:
            asked.extend(texts)
            clock.now_s += 2.0

    clock = Clock()
    door = HandDoor(Hand(), clock)
    assert isinstance(door, Door)
    door.stage()
    for wanted in ("closed", "closed", "open"):
        door.set(wanted).wait(1)  # type: ignore[arg-type] # a loop over what set takes
        assert door.read()["door"]["value"] == wanted
    assert asked == ["Close the door.", "Open the door."]
    assert door.read()["door"]["mono_s"] == 4.0
