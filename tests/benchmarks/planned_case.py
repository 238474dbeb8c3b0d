"""A scene, a bound, and the truth that the plan's picture is held against."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from planned_truth import Truth

from phoslab.model_plan import Choices, ModelPlan
from phoslab.render.device import Device
from phoslab.render.frames import auto_exposure
from phoslab.render.planning import decisions
from phoslab.render.planning.bounds import Bound
from phoslab.render.planning.costs import load_costs
from phoslab.render.planning.drawn import render_choices
from phoslab.render.planning.pilot import look
from phoslab.render.planning.planner import Planner, Request
from phoslab.render.planning.spectrum_terms import fewest_bands
from phoslab.render.scene import Scene


@dataclass(frozen=True)
class Took:
    """Time on the clock, and of all processors together, in s: the latter counts on a machine that is shared."""

    wall_s: float
    cpu_s: float


class Timer:
    """Counts from when it is made."""

    def __init__(self) -> None:
        self._began = time.perf_counter(), time.process_time()

    def took(self) -> Took:
        """Return what has passed."""
        return Took(time.perf_counter() - self._began[0], time.process_time() - self._began[1])


# Of the bound: what the noise of a truth may be.
KNOWN = 0.2


class Case:
    """A scene at one time, a bound, and the truth.

    Args:
        file: where the truth is kept.
        trade: as of `phoslab plan`.
    """

    def __init__(
        self,
        device: Device,
        scene: Scene,
        time: str,
        bound: Bound,
        size: tuple[int, int],
        file: Path,
        trade: Path | None,
    ) -> None:
        self._device, self.scene, self.time, self.bound = device, scene, time, bound
        moment = scene.schedule.parse_time(time)
        self.request = Request(scene, size, (time,), (moment,), bound)
        self.costs = load_costs(trade)
        few = fewest_bands(self.scene, look(self.scene, [moment], size))
        narrow = few[min(n for n in few if n >= min(3, max(few)))][0]
        self.truth = Truth(device, self.scene, moment, size, narrow, file)

    def learn(self, limit_s: float) -> bool:
        """Follow paths for the truth; return whether it is known then."""
        self.truth.follow(self.bound, KNOWN * self.bound.value, limit_s, self.exposure)
        return self.noise <= KNOWN * self.bound.value

    @property
    def exposure(self) -> float:
        """What brings luminance to display white."""
        return auto_exposure(self.truth.picture.astype(np.float32)) if self.truth.levels[0].samples else 1.0

    @property
    def noise(self) -> float:
        """Of the truth, in the bound's unit."""
        return self.truth.noise(self.bound, self.exposure)

    def plan(self) -> tuple[Planner, ModelPlan, Took]:
        """Plan; return how long it took, too."""
        timer = Timer()
        planner = Planner(self.request, self.costs, self._device)
        plan = decisions.plan(planner)
        return planner, plan, timer.took()

    def run(self, choices: Choices) -> tuple[float, Took]:
        """Return the true error in the bound's unit, and the time."""
        timer = Timer()
        frames = render_choices(
            self.scene, choices, self.request.moments, self.request.size, device=self._device
        )
        took = timer.took()
        return self.bound.error(frames[0].xyz, self.truth.picture, self.exposure), took
