"""The ways to transport glow, by name.

none       surfaces glow and light nothing
dss        surfels of what glows, splatted; nothing blocks light
dss-z      surfels of all surfaces, and of those that a pixel's directions meet the nearest
tiles      cells of the surfaces, chosen for each tile of the picture, and the nearest in each of some directions
reference  paths, in Mitsuba 3
"""

from __future__ import annotations

from phoslab.errors import look_up
from phoslab.render.bounced_z_buffer import BouncedZBuffer
from phoslab.render.deep_screen_space import DeepScreenSpace
from phoslab.render.glow_transport import NONE, GlowTransport
from phoslab.render.reference import Reference
from phoslab.render.tiles import Tiles

METHODS: dict[str, type[GlowTransport]] = {
    DeepScreenSpace.name: DeepScreenSpace,
    BouncedZBuffer.name: BouncedZBuffer,
    Tiles.name: Tiles,
    Reference.name: Reference,
}

NAMES = (NONE, *METHODS)


def find_method(name: str) -> type[GlowTransport]:
    """Return the way `name` to transport glow.

    Raises:
        PhoslabError: there is none of that name.
    """
    return look_up(METHODS, name, "glow transport")
