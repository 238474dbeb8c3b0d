"""Light that phosphorescent surfaces send and others reflect: what every way to compute it has in common.

A way is one class in one file and one line in `glow_methods.METHODS`. It is given the scene as the other passes have
it, and adds to the radiance of every sample what that sample reflects of the glow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol

import moderngl

from phoslab.errors import PhoslabError
from phoslab.render.atlas_geometry import AtlasGeometry
from phoslab.render.atlas_glow import AtlasGlow
from phoslab.render.cell_light import Lamps
from phoslab.render.device import Device
from phoslab.render.gbuffer import GBuffer
from phoslab.render.gpu_scene import GpuDrawable
from phoslab.render.passes import Picture
from phoslab.render.scene import Scene

NONE = "none"

# Of a pixel: at 512² already half a gigabyte of what they meet.
MOST_DIRECTIONS = 256
MOST_LEVELS = 10
FILTER_RADII = (0, 2, 4, 8)
MOST_BOUNCES = 64


@dataclass(frozen=True)
class TransportParameters:
    """How glow reaches other surfaces.

    Args:
        method: a name in `glow_methods.METHODS`, or "none".
        directions: in which a pixel looks for glow, 1 to 256 (tiles, dss-z).
        guided: the share of the directions that aim at what may send light (tiles, dss-z); None: 7/8 where tiles
            gather what glows alone, 1/2 otherwise.
        filter_px: pixels to each side over which neighbours share directions: 0, 2, 4 or 8 (tiles, dss-z).
        cell: the radius of the smallest cell, as a share of the scene's (tiles, and what sends light on: all but
            reference).
        detail: the radius over the distance that no cell exceeds, unless it is one of the smallest (tiles).
        surfel: the radius of a surfel on the screen, over half the picture's height (dss, dss-z).
        epsilon: the share of the frame's glow below which a surfel's first shell ends (dss, dss-z).
        levels: of the hierarchical framebuffer, each of which reaches twice as far; 0: as many as reach across the
            scene (dss, dss-z).
        samples: light paths a pixel (reference).
        seed: of their chances (reference): pictures of two seeds differ by their noise alone.
        full: follow light to the end, not for one reflection alone (reference).
        bounces: reflections on the way from a phosphor to the camera, at most (all).
        lamps: let surfaces light each other with what they reflect of the lamps, too (all but reference).
        excites: let the light of surfaces charge phosphors (all but reference).
    """

    method: str = NONE
    directions: int = 8
    guided: float | None = None
    filter_px: int = 4
    cell: float = 1 / 40
    detail: float = 0.3
    surfel: float = 0.02
    epsilon: float = 0.02
    levels: int = 0
    samples: int = 256
    seed: int = 0
    full: bool = False
    bounces: int = 1
    lamps: bool = False
    excites: bool = False

    def __post_init__(self) -> None:
        self._check("the number of directions", self.directions, 1, MOST_DIRECTIONS)
        if self.guided is not None:
            self._check("the share of guided directions", self.guided, 0.0, 1.0)
        self._check("the number of samples", self.samples, 1, 1 << 20)
        self._check("the seed", self.seed, 0, (1 << 20) - 1)
        self._check("the cells' radius", self.cell, 1e-3, 1.0)
        self._check("the cells' detail", self.detail, 1e-2, 1.0)
        self._check("the number of bounces", self.bounces, 1, MOST_BOUNCES)
        self._check("the surfels' radius", self.surfel, 1e-3, 1.0)
        self._check("epsilon", self.epsilon, 1e-5, 0.5)
        self._check("the number of levels", self.levels, 0, MOST_LEVELS)
        if self.filter_px not in FILTER_RADII:
            raise PhoslabError(
                f"is {self.filter_px} pixels",
                field="the filter's radius",
                remedy=f"Use one of: {', '.join(map(str, FILTER_RADII))}.",
            )

    def aimed(self, directions: int, usual: float) -> int:
        """How many of so many directions of a pixel aim, of which the way aims a usual share; one at least does not."""
        share = usual if self.guided is None else self.guided
        return min(round(directions * share), directions - 1)

    @property
    def follows_cells(self) -> bool:
        """Whether light goes from cell to cell before it goes to the camera."""
        return self.sends_on or self.excites

    @property
    def sends_on(self) -> bool:
        """Whether surfaces send on to others what they reflect."""
        return self.bounces > 1 or self.lamps

    @staticmethod
    def _check(field: str, value: float, low: float, high: float) -> None:
        if not low <= value <= high:
            raise PhoslabError(f"is {value:g}", field=field, remedy=f"Use {low:g} to {high:g}.")


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What glow meets: the scene as the renderer holds it.

    Args:
        drawables: everything that reflects and blocks.
        atlases: one a phosphor: what lies under its texels.
        glows: one a phosphor: what its texels send.
        gbuffer: what the camera sees.
        size: (width, height) of the picture in pixels.
        supersampling: samples along the side of a pixel.
        lamps: as they are at the picture's time.
    """

    scene: Scene
    drawables: Sequence[GpuDrawable]
    atlases: Sequence[AtlasGeometry]
    glows: Sequence[AtlasGlow]
    gbuffer: GBuffer
    size: tuple[int, int]
    supersampling: int
    lamps: Lamps


class GlowTransport(Protocol):
    """One way to bring glow to the surfaces that the camera sees.

    Attributes:
        reads: what of the scene, the G-buffer and the atlases it takes; "camera": it asks where that is.
        aims: whether it looks for what glows brightly: then it is prepared anew where it has gone dark.
        linear: whether the light of two glows is the sum of what each gives alone.
    """

    name: ClassVar[str]
    reads: ClassVar[tuple[str, ...]]
    aims: ClassVar[bool]
    linear: ClassVar[bool]

    def __init__(
        self, device: Device, surroundings: Surroundings, parameters: TransportParameters
    ) -> None: ...

    def prepare(self) -> None:
        """Do what holds while nothing moves: the G-buffer and the atlases are drawn. Done again after each move.

        Where it aims, the glows hold what is sent when it has gone dark; nothing while a light is on.
        """
        ...

    def run(self, radiance: moderngl.TextureArray) -> None:
        """Add to the samples of `radiance` what they reflect of the glows' radiance."""
        ...

    def debug_views(self) -> dict[str, Picture]:
        """Return pictures of what the last run made."""
        ...
