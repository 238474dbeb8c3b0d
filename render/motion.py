"""Where the nodes of a glTF file are at any time: its animations, all played together from 0 s of the schedule.

A node that is moved keeps its last key's place afterwards, and has its first key's before. What moves is rigid or
scaled as a whole; skins and morph targets are left aside.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Matrix = NDArray[np.float64]

LINEAR, STEP, CUBIC = "LINEAR", "STEP", "CUBICSPLINE"
PATHS = {"translation": 3, "rotation": 4, "scale": 3}


@dataclass(frozen=True, eq=False)
class Channel:
    """How one property of one node runs.

    Args:
        path: "translation", "rotation" (a quaternion x, y, z, w) or "scale".
        times_s: (n,) ascending.
        values: (n, k); of a cubic spline (n, 3, k): tangent in, value, tangent out.
        interpolation: "LINEAR", "STEP" or "CUBICSPLINE".
    """

    path: str
    times_s: Array
    values: Array
    interpolation: str = LINEAR

    def at(self, t_s: float) -> Array:
        """Return (k,) the value at a time."""
        t, v = self.times_s, self.values
        after = int(np.searchsorted(t, t_s, side="right"))
        if after in (0, len(t)):
            end = v[min(after, len(t) - 1)]
            return self._unit(end[1] if self.interpolation == CUBIC else end)
        k, span = after - 1, t[after] - t[after - 1]
        s = (t_s - t[k]) / span
        if self.interpolation == STEP:
            return self._unit(v[k])
        if self.interpolation == CUBIC:
            p, m, q, n = v[k, 1], v[k, 2] * span, v[after, 1], v[after, 0] * span
            return self._unit(
                (2 * s**3 - 3 * s**2 + 1) * p
                + (s**3 - 2 * s**2 + s) * m
                + (3 * s**2 - 2 * s**3) * q
                + (s**3 - s**2) * n
            )
        if self.path == "rotation":
            return slerp(v[k], v[after], s)
        return np.asarray((1 - s) * v[k] + s * v[after])

    def _unit(self, value: Array) -> Array:
        return value / np.linalg.norm(value) if self.path == "rotation" else value


def slerp(p: Array, q: Array, s: float) -> Array:
    """Return the unit quaternion at share `s` of the shorter way from `p` to `q` (Shoemake 1985)."""
    p, q = p / np.linalg.norm(p), q / np.linalg.norm(q)
    cosine = float(p @ q)
    q, cosine = (-q, -cosine) if cosine < 0 else (q, cosine)
    angle = np.arccos(min(cosine, 1.0))
    if angle < 1e-6:
        between = (1 - s) * p + s * q
    else:
        between = (np.sin((1 - s) * angle) * p + np.sin(s * angle) * q) / np.sin(angle)
    return np.asarray(between / np.linalg.norm(between))


@dataclass(frozen=True, eq=False)
class Place:
    """A node's place within its parent: translation, rotation (x, y, z, w) and scale."""

    translation: Array
    rotation: Array
    scale: Array

    def matrix(self) -> Matrix:
        """Return (4, 4)."""
        x, y, z, w = self.rotation / np.linalg.norm(self.rotation)
        local = np.eye(4)
        local[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
        local[:3, :3] *= self.scale
        local[:3, 3] = self.translation
        return local


@dataclass(frozen=True, eq=False)
class Motion:
    """The nodes of a scene, some of which move.

    Args:
        parents: of each node, by index, a parent before its children; None: it has none.
        fixed: (4, 4) a node's place within its parent, of those that no channel moves.
        places: where those that are moved rest.
        channels: what moves them.
    """

    parents: Mapping[int, int | None]
    fixed: Mapping[int, Matrix]
    places: Mapping[int, Place]
    channels: Mapping[int, tuple[Channel, ...]]

    @property
    def span_s(self) -> tuple[float, float]:
        """From the first key to the last: before and after, nothing moves."""
        keys = np.concatenate([c.times_s for channels in self.channels.values() for c in channels])
        return float(keys.min()), float(keys.max())

    def moved(self, index: int) -> bool:
        """Whether a node, or one that it hangs on, moves."""
        at: int | None = index
        while at is not None:
            if at in self.channels:
                return True
            at = self.parents[at]
        return False

    def at(self, t_s: float) -> dict[int, Matrix]:
        """Return (4, 4) from each node's own space to the world's, by index."""
        world: dict[int, Matrix] = {}
        for index, parent in self.parents.items():
            local = self._local(index, t_s)
            world[index] = local if parent is None else world[parent] @ local
        return world

    def _local(self, index: int, t_s: float) -> Matrix:
        if index not in self.channels:
            return self.fixed[index]
        rest = self.places[index]
        now = {"translation": rest.translation, "rotation": rest.rotation, "scale": rest.scale}
        now |= {channel.path: channel.at(t_s) for channel in self.channels[index]}
        return Place(**now).matrix()
