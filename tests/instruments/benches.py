"""A simulated bench to test with, and all that hangs on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from phoslab.instruments.bench import rig
from phoslab.instruments.cameras.simulated import SimulatedCamera
from phoslab.instruments.devices import Exposure
from phoslab.instruments.simulated import BenchClock, Hands, Link


@dataclass
class Laboratory:
    """A running bench with a clock, hands and a camera that is not staged yet."""

    bench: rig.Bench
    clock: BenchClock
    hands: Hands
    camera: SimulatedCamera
    link: Link

    def state(self) -> dict[str, Any]:
        """What is true: light of the lamp, how far the door is open, exposures."""
        return self.link.ask("state")


def laboratory(bench: rig.Bench) -> Laboratory:
    """Connect to a bench."""
    link = Link(bench.socket)
    clock = BenchClock(bench.folder, link)
    return Laboratory(
        bench,
        clock,
        Hands(Link(bench.socket)),
        SimulatedCamera(Link(bench.socket, "camera"), clock),
        link,
    )


SHORT = Exposure(0.1, 400.0, 2.8)
