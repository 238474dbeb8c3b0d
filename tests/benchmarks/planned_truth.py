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
from phoslab.colorimetry import xyz_matrix
from phoslab.model_plan import Choices
from phoslab.render.device import Device
from phoslab.render.glow_transport import TransportParameters
from phoslab.render.path_tracer import UNLIMITED, trace
from phoslab.render.phosphor_state import Stepping
from phoslab.render.planning.bounds import Bound
from phoslab.render.planning.reduced import apply, whole
from phoslab.render.reference import Reference
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.render.scene import Scene

Array = NDArray[np.float64]

FIRST_SEED = 1000  # those of plans are 0

# Paths a pixel at once, of the two levels: the same each time, since another number is compiled anew.
AT_ONCE = (128, 32)


class Traced:
    """Pictures of a scene at one time in some bands, of any number of paths."""

    def __init__(
        self, device: Device, scene: Scene, choices: Choices, moment: float, size: tuple[int, int]
    ) -> None:
        self._scene, self._choices, self._moment, self._size = apply(scene, choices), choices, moment, size
        self._device, self._straight, self._meshes = device, np.zeros(0), []

    def picture(self, samples: int, seed: int) -> Array:
        """Return (h, w, 3) XYZ."""
        if not self._straight.size:
            self._draw()
        radiance = self._straight
        if self._meshes:
            radiance = radiance + trace(
                self._meshes,
                [self._camera],
                self._size,
                reflections=UNLIMITED,
                samples=samples,
                seed=seed,
                direct=False,
                grid=self._scene.supersampling,
            )
        return np.asarray(radiance @ xyz_matrix(self._scene.transport), dtype=np.float64)

    def _draw(self) -> None:
        """Draw what is not traced."""
        parameters = RenderParameters(
            self._size,
            self._scene.supersampling,
            stepping=Stepping(self._choices.solver, self._choices.step_s),
            transport=TransportParameters(Reference.name, samples=AT_ONCE[1]),
        )
        with self._device.scope():
            renderer = Renderer(self._device, self._scene, parameters)
            self._straight = renderer.frame(self._moment).radiance.astype(np.float64)
            self._camera = renderer.gbuffer.camera
            if isinstance(renderer.transport, Reference) and renderer.transport.reflected is not None:
                self._straight -= renderer.transport.reflected
                self._meshes = renderer.transport.meshes()


@dataclass
class Level:
    """One of the two sums.

    Args:
        plus, minus: whose pictures are added, and taken off.
        halves: (2, h, w, 3) XYZ, the means of so many paths a pixel each.
        seed: the next that has not been used.
        at_once: paths a pixel that are added.
    """

    plus: Traced
    minus: Traced | None
    seed: int
    at_once: int
    halves: Array
    samples: int = 0
    seconds: float = 0.0

    @property
    def worth(self) -> float:
        """What as many paths again would take off the square of the noise, a second of processors."""
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
        self._file = file
        kept: dict[str, Any] = dict(np.load(file)) if file.exists() else {}
        self._edges_nm = kept.get("few_nm", few.edges_nm)
        every = whole(scene)
        coarse, fine = (
            Traced(device, scene, replace(every, bands_nm=tuple(edges.tolist())), moment, size)
            for edges in (self._edges_nm, scene.transport.edges_nm)
        )
        nothing = np.zeros((2, size[1], size[0], 3))
        self.levels = [
            Level(coarse, None, FIRST_SEED, AT_ONCE[0], nothing),
            Level(fine, coarse, 2 * FIRST_SEED, AT_ONCE[1], nothing),
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
        """What it took, of all processors."""
        return sum(level.seconds for level in self.levels)

    def noise(self, bound: Bound, exposure: float) -> float:
        """Return how far off the picture is, in the unit of a bound."""
        # The halves differ by sqrt(2) of the noise of one, which is sqrt(2) of that of their mean.
        return bound.error(*self.halves, exposure) / 2

    def follow(self, bound: Bound, noise: float, limit_s: float, exposure: float) -> None:
        """Follow paths until the noise is below `noise`, in the unit of `bound`, or processors took so long."""
        begin = time.process_time()
        for level in self.levels:
            if level.samples == 0:
                self._add(level)
        while True:
            reached = self.noise(bound, exposure)
            level = max(self.levels, key=lambda each: each.worth)
            if reached <= noise or time.process_time() - begin > limit_s:
                break
            self._add(level)
        np.savez(
            self._file,
            few_nm=self._edges_nm,
            **{f"halves{k}": level.halves for k, level in enumerate(self.levels)},
            **{f"counts{k}": np.array([x.seed, x.samples]) for k, x in enumerate(self.levels)},
            **{f"seconds{k}": np.array(level.seconds) for k, level in enumerate(self.levels)},
        )

    def _add(self, level: Level) -> None:
        begin, samples = time.process_time(), level.at_once
        more = []
        for seed in (level.seed, level.seed + 1):
            picture = level.plus.picture(samples, seed)
            more.append(picture if level.minus is None else picture - level.minus.picture(samples, seed))
        total = level.samples + samples
        level.halves = (level.samples * level.halves + samples * np.array(more)) / total
        level.samples, level.seed = total, level.seed + 2
        level.seconds += time.process_time() - begin
