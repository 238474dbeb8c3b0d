"""A sample that is not the same everywhere: two paints, mixed in shares that vary over its surface.

Grains of two phosphors lie side by side and do not exchange electrons: each decays as it would alone, and a place shows
both in proportion. So the truth of any place is known: `share` of the second paint's light, the rest of the first's.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from phoslab.instruments.bench.bench import Bench
from phoslab.instruments.bench.sample import Sample

Array = NDArray[np.float64]


def left_to_right(shape: tuple[int, int], begin: float = 0.4, end: float = 0.55) -> Array:
    """(h, w) share of the second paint: none on the left, all on the right, and between them a ramp."""
    x = (np.arange(shape[1]) + 0.5) / shape[1]
    return np.broadcast_to(np.clip((x - begin) / (end - begin), 0.0, 1.0), shape).copy()


@dataclass
class InlaidBench(Bench):
    """A bench whose sample has a second paint in it.

    Args:
        second: that paint; its colour is taken to be the first's.
        share: (h, w) of the second; by default `left_to_right`.
    """

    second: Sample = field(default_factory=lambda: Sample(name="slow", depth_eV=0.77))
    share: Array | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self._twin = Bench(self.seed, self.second, self.lamp, self.camera)
        self._share = left_to_right(self.camera.shape) if self.share is None else self.share

    def switch_lamp(self, on: bool) -> float:
        """Switch the lamp, which shines on both; return when."""
        self._twin.switch_lamp(on)
        return super().switch_lamp(on)

    def wait(self, duration_s: float) -> float:
        """Let time pass for both; return the light of the first (integral over time)."""
        self._second_light = self._twin.wait(duration_s)
        return super().wait(duration_s)

    def true_lights(self, times_s: Array) -> tuple[Array, Array]:
        """Return what places of the first and of the second paint alone gave at times since lamp-off, (n,) each."""
        return self.true_light(times_s), self._twin.true_light(times_s)

    def _shine(self, duration_s: float) -> Array:
        first = self.wait(duration_s)
        return self._shape * ((1 - self._share) * first + self._share * self._second_light)
