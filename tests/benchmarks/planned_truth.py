"""The truth that plans are held against: all bands, all states, glow followed to its end, and noise that is known.

Two levels (Giles 2008): many paths in few bands, and few paths of the same chances in all bands and in few, whose
difference is what the few bands leave out. The sum is the mean of paths in all bands, at a third of their cost. Each
level is done in two halves of other seeds: half the difference of the two sums is the noise of their mean. What has
been followed is kept in a file, so that more can be added later.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.bands import Bands
from phoslab.model_plan import Choices
from phoslab.render.device import Device
from phoslab.render.planning import render_choices
from phoslab.render.planning.bounds import Bound
from phoslab.render.planning.reduced import whole
from phoslab.render.scene import Scene

Array = NDArray[np.float64]

FIRST_SEED = 1000  # those of plans are 0
FIRST_SAMPLES = (32, 16)


@dataclass
class Level:
    """One of the two sums.

    Args:
        plus, minus: the choices whose pictures are added, and taken off.
        halves: (2, h, w, 3) XYZ, the means of so many paths a pixel each.
        seed: the next that has not been used.
    """

    plus: Choices
    minus: Choices | None
    seed: int
    halves: Array
    samples: int = 0
    seconds: float = 0.0

    @property
    def worth(self) -> float:
        """What as many paths again would take off the square of the noise, a second."""
        return float(np.abs(self.halves[0] - self.halves[1]).mean() ** 2 / self.seconds)


class Truth:
    """The picture of a scene at one time, which gets better the longer one waits.

    Args:
        few: the bands of most paths.
        file: where it is kept.
    """

    def __init__(
        self, device: Device, scene: Scene, moment: float, size: tuple[int, int], few: Bands, file: Path
    ) -> None:
        self._device, self._scene, self._moment, self._size, self._file = device, scene, moment, size, file
        kept: dict[str, Any] = dict(np.load(file)) if file.exists() else {}
        self._edges_nm = kept.get("few_nm", few.edges_nm)
        every = whole(scene)
        coarse = replace(every, bands_nm=tuple(self._edges_nm.tolist()))
        nothing = np.zeros((2, size[1], size[0], 3))
        self.levels = [
            Level(coarse, None, FIRST_SEED, nothing),
            Level(every, coarse, 2 * FIRST_SEED, nothing),
        ]
        if kept:
            for k, level in enumerate(self.levels):
                level.halves, (level.seed, level.samples) = kept[f"halves{k}"], kept[f"counts{k}"].tolist()
                level.seconds = float(kept[f"seconds{k}"])

    @property
    def halves(self) -> Array:
        """(2, h, w, 3) XYZ, each with a noise of its own."""
        return np.asarray(self.levels[0].halves + self.levels[1].halves)

    @property
    def picture(self) -> Array:
        """(h, w, 3) XYZ."""
        return np.asarray(self.halves.mean(axis=0))

    @property
    def seconds(self) -> float:
        """How long it took."""
        return sum(level.seconds for level in self.levels)

    def noise(self, bound: Bound, exposure: float) -> float:
        """Return how far off the picture is, in the unit of a bound."""
        # The halves differ by sqrt(2) of the noise of one, which is sqrt(2) of that of their mean.
        return bound.error(*self.halves, exposure) / 2

    def follow(self, bound: Bound, noise: float, limit_s: float, exposure: float) -> None:
        """Follow paths until the noise is below `noise`, in the unit of `bound`, or so much time has passed."""
        begin = time.perf_counter()
        for level, samples in zip(self.levels, FIRST_SAMPLES, strict=True):
            if level.samples == 0:
                self._add(level, samples)
        while True:
            reached = self.noise(bound, exposure)
            level = max(self.levels, key=lambda each: each.worth)
            if reached <= noise or time.perf_counter() - begin > limit_s:
                break
            more = round(level.samples * min(1.0, (reached / noise) ** 2 - 0.9))
            self._add(level, max(16, min(more, 512)))
        np.savez(
            self._file,
            few_nm=self._edges_nm,
            **{f"halves{k}": level.halves for k, level in enumerate(self.levels)},
            **{f"counts{k}": np.array([x.seed, x.samples]) for k, x in enumerate(self.levels)},
            **{f"seconds{k}": np.array(level.seconds) for k, level in enumerate(self.levels)},
        )

    def _add(self, level: Level, samples: int) -> None:
        begin = time.perf_counter()
        more = []
        for seed in (level.seed, level.seed + 1):
            picture = self._traced(level.plus, samples, seed)
            more.append(
                picture if level.minus is None else picture - self._traced(level.minus, samples, seed)
            )
        total = level.samples + samples
        level.halves = (level.samples * level.halves + samples * np.array(more)) / total
        level.samples, level.seed = total, level.seed + 2
        level.seconds += time.perf_counter() - begin

    def _traced(self, choices: Choices, samples: int, seed: int) -> Array:
        gi = {"method": "reference", "samples": samples, "full": True, "seed": seed}
        frames = render_choices(
            self._scene, replace(choices, gi=gi), [self._moment], self._size, device=self._device
        )
        return frames[0].xyz.astype(np.float64)
