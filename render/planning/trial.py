"""What a quick way to transport glow errs by in one scene: some windows of its picture, held to paths.

What was measured elsewhere is that of the worst scene. Where a plan would trace paths for minutes, a little of that
time tells what the quick way does here: in windows that are spread over the picture, as fine as the picture is, since
a filter blurs more where pixels are larger, and so large that a filter's reach does not end in their middles, which are
compared. Paths that end after as many reflections as the quick way has are traced twice, so that their noise is known,
and taken off; and in rounds, each of more of them, so that no more are traced than tell whether it will do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab.colorimetry import xyz_matrix
from phoslab.model_plan import Choices
from phoslab.render.device import Device
from phoslab.render.glow_methods import find_method
from phoslab.render.glow_transport import TransportParameters
from phoslab.render.gltf import GltfCamera
from phoslab.render.path_tracer import LLVM, trace, usual_variant
from phoslab.render.phosphor_state import Stepping
from phoslab.render.planning.pilot import Pilot
from phoslab.render.planning.probe import SIGMAS, SUPERSAMPLING, most_reflected
from phoslab.render.planning.reduced import apply, transport_parameters
from phoslab.render.reference import Reference
from phoslab.render.renderer import Renderer, RenderParameters

Array = NDArray[np.float64]

# Windows along each side of the picture, pixels along the side of one (whole tiles of `tiles`), and of its middle.
# Errors differ more between windows than in them: many small ones tell more than few large ones.
WINDOWS, SIDE, MIDDLE = 8, 16, 8

# Paths a pixel of each round, which add up; and the most at once: Mitsuba compiles for every number of paths anew,
# which takes as long as half a dozen small runs of what it compiled before.
ROUNDS = (64, 256, 1024, 4096)
AT_ONCE = 256

# Fewer windows than these that see reflected light tell nothing of its errors.
LEAST_LIT = 16.0


@dataclass(frozen=True)
class Estimate:
    """What a way errs by: mean |a - b| / mean b of reflected light.

    Args:
        square: of that, noise taken off; it may be negative.
        spread: its standard error.
        noise: of what it was held to, in the same unit.
    """

    square: float
    spread: float
    noise: float

    @property
    def at_most(self) -> float:
        """That which one of 40 exceeds."""
        return math.sqrt(max(self.square, 0.0) + SIGMAS * self.spread)

    @property
    def at_least(self) -> float:
        """That which one of 40 falls below. Nothing while there is more noise: few large errors look like more then."""
        least = math.sqrt(max(self.square - SIGMAS * self.spread, 0.0))
        return least if least > self.noise else 0.0


def estimate(quick: Array, one: Array, other: Array) -> Estimate | None:
    """Return what a way errs by, held to two pictures of other noise.

    Squares of errors and of noise add where both are alike. Where errors are the same everywhere and noise is larger,
    a fifth too little is found.

    Args:
        quick, one, other: (n, m) light, n samples of the picture, such as windows, of m values each.

    Returns:
        None where too few of them are lit.
    """
    truth = (one + other) / 2
    light = truth.mean(axis=1)
    lit = light.sum() ** 2 / max(float((light**2).sum()), 1e-300)
    if light.sum() <= 0 or lit < LEAST_LIT:
        return None
    brightness = light / light.mean()
    # The difference of two has sqrt(2) of the noise of one, which is sqrt(2) of that of their mean.
    off, noise = (np.abs(d).mean(axis=1) / light.mean() for d in (quick - truth, (one - other) / 2))
    of_each = 2 * off.mean() * (off - off.mean() * brightness)
    of_each -= 2 * noise.mean() * (noise - noise.mean() * brightness)
    spread = math.sqrt((of_each**2).sum() * lit / (lit - 1)) / len(of_each)
    return Estimate(float(off.mean() ** 2 - noise.mean() ** 2), spread, float(noise.mean()))


class Trial:
    """Windows of a picture by quick ways to transport glow, beside more and more paths.

    Where paths begin anywhere in a pixel (without LLVM), what edges differ by counts as a way's error.

    Args:
        pilot: at whose moment with the most reflected glow they are compared.
        size: (width, height) of the whole picture.
        quick: as for `draw`: what the scene is modelled by for the paths, and how often its light is reflected.
        device: what they are drawn on.

    Attributes:
        paths: that were followed, for each pixel of each of the two pictures.

    Raises:
        PhoslabError: Mitsuba is not installed.
    """

    def __init__(self, pilot: Pilot, size: tuple[int, int], quick: Choices, device: Device) -> None:
        self._device, self._scene = device, pilot.scene
        self._moment = float(pilot.moments[most_reflected(pilot)])
        self._wide, self._wide_size = windows(pilot.scene.camera, size)
        self._cameras, self._size = windows(pilot.scene.camera, size, MIDDLE)
        self._reflections = transport_parameters(quick).bounces
        with device.scope():
            renderer = self._renderer(quick, TransportParameters(Reference.name))
            assert isinstance(renderer.transport, Reference)
            renderer.light(self._moment)
            self._meshes = renderer.transport.meshes()
            self._to_xyz = xyz_matrix(renderer.scene.transport)
        # Where paths begin in the same places each time, light that comes straight is the same each time, too.
        self._subtracts = usual_variant() != LLVM
        self._straight: Array | float = 0.0
        if not self._subtracts:
            self._straight = self._trace(SUPERSAMPLING**2, 0, reflections=0, direct=True)
        self._traced: list[Array | float] = [0.0, 0.0]
        self.paths = 0

    def _renderer(self, quick: Choices, transport: TransportParameters) -> Renderer:
        """Return what draws all windows side by side."""
        width, height = self._wide_size
        parameters = RenderParameters(
            (len(self._wide) * width, height),
            SUPERSAMPLING,
            stepping=Stepping(quick.solver, quick.step_s, quick.state_format),
            transport=transport,
        )
        renderer = Renderer(self._device, apply(self._scene, quick), parameters)
        renderer.look_through(self._wide)
        return renderer

    def draw(self, quick: Choices) -> Array:
        """Return XYZ of the windows' middles by a way.

        Args:
            quick: how the scene is modelled, by a way that `can_try` allows; some surface glows. Bands that are few do,
                since light of all goes the same ways. All of one trial have the same bands, and as many reflections.
        """
        with self._device.scope():
            renderer = self._renderer(quick, transport_parameters(quick))
            return self._middles(renderer.reflected(self._moment) @ self._to_xyz)

    def _middles(self, picture: Array) -> Array:
        """Return (h, n w, K) the middles of windows of a picture."""
        width, height = self._size
        parts = picture.reshape(picture.shape[0], len(self._cameras), -1, picture.shape[-1])
        rim = (parts.shape[0] - height) // 2
        return parts[rim : rim + height, :, rim : rim + width].reshape(height, -1, picture.shape[-1])

    def follow(self, samples: int) -> None:
        """Trace so many more paths a pixel, for each of the two pictures."""
        for k in range(2):
            more = self._trace(
                samples, 2 * self.paths + k, reflections=self._reflections, direct=not self._subtracts
            )
            share = samples / (self.paths + samples)
            self._traced[k] += share * (more - self._straight - self._traced[k])
        self.paths += samples

    def _trace(self, samples: int, seed: int, **what: Any) -> Array:
        """Return XYZ of the windows' middles by so many paths a pixel."""
        radiance = trace(
            self._meshes,
            self._cameras,
            self._size,
            samples=samples,
            at_once=AT_ONCE,
            seed=seed,
            grid=SUPERSAMPLING,
            **what,
        )
        return np.asarray(radiance @ self._to_xyz, dtype=np.float64)

    def found(self, drawn: Array) -> Estimate | None:
        """Return what a way errs by that has drawn this, as far as is known; None: too little of the light is seen."""
        return estimate(*(self._by_part(np.asarray(picture)) for picture in (drawn, *self._traced)))

    def _by_part(self, picture: Array) -> Array:
        """Return (n, m) the windows, or as many parts of the only one, of equal size: what is over is left out."""
        if len(self._cameras) == 1:
            rows, columns = min(WINDOWS, picture.shape[0]), min(WINDOWS, picture.shape[1])
        else:
            rows, columns = 1, len(self._cameras)
        h, w = picture.shape[0] // rows, picture.shape[1] // columns
        parts = picture[: rows * h, : columns * w].reshape(rows, h, columns, w, -1)
        return parts.swapaxes(1, 2).reshape(rows * columns, -1)


def can_try(gi: Mapping[str, Any]) -> bool:
    """Whether a way can be tried: its light does not depend on where the camera is, nor on what lies around a rim."""
    reach = gi.get("filter_px", TransportParameters.filter_px)
    return "camera" not in find_method(gi["method"]).reads and reach <= (SIDE - MIDDLE) // 2


def trial_size(size: tuple[int, int], side: int = SIDE) -> tuple[int, int]:
    """Return the size of a picture with as many pixels as the windows of one of `size` have."""
    return size if min(_cell(size)) < SIDE else (WINDOWS * side, WINDOWS * side)


def windows(
    camera: GltfCamera, size: tuple[int, int], side: int = SIDE
) -> tuple[list[GltfCamera], tuple[int, int]]:
    """Return cameras that see windows of a picture, spread evenly and at random, and the size of each.

    One whose pixels are as large as those in the window's middle looks straight at it. A small picture is one window.

    Args:
        size: (width, height) of the picture.
        side: pixels along the side of what is seen of a window, around its middle.
    """
    cell = _cell(size)
    if min(cell) < SIDE:
        return [camera], size
    focal_px = size[1] / 2 / math.tan(camera.yfov_rad / 2)
    rng = np.random.default_rng(0)
    found = []
    for row, column in np.ndindex(WINDOWS, WINDOWS):
        corner = np.array([column, row]) * cell + rng.random(2) * (np.array(cell) - SIDE)
        x, y = corner + SIDE / 2 - np.array(size) / 2
        forward = np.array([x, -y, -focal_px]) / math.hypot(x, y, focal_px)
        right = np.cross(forward, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        turn = np.eye(4)
        turn[:3, :3] = [right, np.cross(right, forward), -forward]
        # A pixel far from the middle is seen under a smaller angle: its area falls with the cosine's third power.
        own_focal_px = focal_px / (focal_px / math.hypot(x, y, focal_px)) ** 1.5
        found.append(
            replace(
                camera,
                world_to_view=turn @ camera.world_to_view,
                yfov_rad=2 * math.atan(side / 2 / own_focal_px),
            )
        )
    return found, (side, side)


def _cell(size: tuple[int, int]) -> tuple[float, float]:
    return size[0] / WINDOWS, size[1] / WINDOWS
