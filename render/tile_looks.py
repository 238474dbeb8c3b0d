"""Which pixels look in how many directions: all in some, and in more those that share light with few others.

The filter brings together what the pixels of a surface meet. Along edges, in corners and where shadows end a pixel
shares with few, and the noise of its own directions stays: of `cornell` at 512² and 8 directions, 5 % of the pixels had
two thirds of the error.
"""

from __future__ import annotations

from dataclasses import dataclass

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.render.device import Device
from phoslab.render.directions import mixed_points, strata
from phoslab.render.glow_transport import TransportParameters
from phoslab.render.memory import check_room

# A pixel shares little where so much of what the filter would add up is there; and how many may be seen to, of all.
LITTLE, MOST = 0.35, 1 / 8
# Of those: directions beside the others, and no more than so many.
MORE, MOST_MORE = 4, 128
# The share of directions that aim at what glows, where each point has its turn: of `corridor` at 8 directions half of
# the error that 1/2 leaves is gone.
AIMED = 7 / 8


@dataclass(eq=False)
class Looks:
    """Pixels and the directions in which each of them looks.

    Attributes:
        directions, aimless: of each; those that do not aim come first.
        strata: of equal width along each side of the unit square, in each of which lies one of a pattern's points, at
            most: of the aimless, and of those that aim.
        points: a buffer of (pattern², directions, 2) points of the unit square.
        pixels: a buffer of their numbers, row by row from the lowest; `count` of them.
        hits: a buffer of what each direction meets.
    """

    directions: int
    aimless: int
    strata: tuple[int, int]
    points: moderngl.Buffer
    pixels: moderngl.Buffer
    hits: moderngl.Buffer
    count: int = 0

    @classmethod
    def of(
        cls, device: Device, most: int, directions: int, parameters: TransportParameters, draw: int = 0
    ) -> Looks:
        """Make room for `most` pixels; looks of another `draw` go into none of the same directions."""
        check_room(most * directions * 8, "what a picture's directions hit")
        # What surfaces reflect of each other is everywhere.
        aimed = parameters.aimed(directions, usual=1 / 2 if parameters.sends_on else AIMED)
        pattern = max(1, parameters.filter_px)
        points = mixed_points(pattern, directions - aimed, aimed, draw)
        return cls(
            directions,
            directions - aimed,
            (strata(pattern, directions - aimed), strata(pattern, aimed)),
            device.buffer(points.astype(np.float32)),
            device.buffer(np.zeros(most, dtype=np.uint32)),
            device.buffer(np.zeros((most * directions, 2), dtype=np.uint32)),
        )

    @property
    def defines(self) -> dict[str, int]:
        """As the shaders have them."""
        aimless, aimed = self.strata
        return {
            "DIRECTIONS": self.directions,
            "AIMLESS": self.aimless,
            "AIMLESS_STRATA": aimless,
            "AIMED_STRATA": aimed,
        }

    def take(self, pixels: NDArray[np.intp]) -> None:
        """Let these look."""
        self.count = len(pixels)
        if self.count:
            self.pixels.write(pixels.astype(np.uint32).tobytes())


def in_order(size: tuple[int, int], tile: int, pattern: int) -> NDArray[np.intp]:
    """Return the numbers of all pixels, tile by tile, and within each those that look the same way after each other."""
    y, x = (v.ravel() for v in np.indices(size[::-1]))
    return np.lexsort((x % pattern, y % pattern, x // tile, y // tile))


def that_share_little(shares: NDArray[np.float32], order: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the numbers of the pixels that are to look in more directions, in order.

    Args:
        shares: by the number of each pixel: 0 where nothing is seen.
    """
    seen = shares[shares > 0]
    if not seen.size:
        return order[:0]
    most = int(MOST * shares.size)
    least = np.partition(seen, most)[most] if seen.size > most else np.inf
    return order[(shares[order] > 0) & (shares[order] < min(LITTLE, least))]
