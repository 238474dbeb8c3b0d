"""Light of surfaces that charges phosphors: what they reflect of lamps, and the glow of other phosphors.

What they reflect of a lamp is linear in it, so it joins the excitation of each course of light, and the state still
jumps to any time. Glow that excites depends on the state: there the state goes step by step, each step under the glow
of its beginning. The error falls with the step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from phoslab.errors import PhoslabError
from phoslab.render.atlas_gather import AtlasGather
from phoslab.render.atlas_glow import AtlasGlow
from phoslab.render.bounced_z_buffer import BouncedZBuffer
from phoslab.render.deep_screen_space import DeepScreenSpace
from phoslab.render.device import Device
from phoslab.render.glow_transport import GlowTransport, TransportParameters
from phoslab.render.lit_cells import LitCells
from phoslab.render.phosphor_state import PhosphorState
from phoslab.render.scene import Scene
from phoslab.render.tiles import Tiles

# A concentration that glow may bring and nobody would see.
NEGLIGIBLE = 1e-4
# The ways that know what surfaces send to each other.
FOLLOWING = (Tiles, DeepScreenSpace, BouncedZBuffer)


def exciting_glow(scene: Scene, parameters: TransportParameters) -> tuple[tuple[str, ...], bool]:
    """Return what to say of glow that is to excite, and whether it does.

    The bound is that of a texel whose whole hemisphere is filled with the brightest saturated material.

    Raises:
        PhoslabError: it was asked for with a way of transport that does not offer it.
    """
    if not (parameters.excites or parameters.lamps):
        return (), False
    names = [way.name for way in FOLLOWING]
    if parameters.method not in names:
        raise PhoslabError(
            f"charge and light surfaces by --gi {', '.join(names)} only",
            field="--glow-excites and --lamp-bounces",
            remedy=f"Add --gi {Tiles.name}.",
        )
    if not parameters.excites:
        return (), False
    optics = [d.phosphor.optics for d in scene.phosphors if d.phosphor is not None]
    if not optics:
        return ("glow excites nothing: nothing in the scene is phosphorescent",), False
    brightest = np.max(
        [(o.kr_per_s[..., None] * o.emission).sum(axis=2).max(axis=(0, 1)) for o in optics], axis=0
    )
    most = max(
        float((np.pi * (o.ke_width @ brightest) / np.maximum(o.kr_per_s, 1e-30)).max(initial=0.0))
        for o in optics
    )
    if most < NEGLIGIBLE:
        why = (
            "no material is excited (ke) in a band in which one glows"
            if most == 0.0
            else f"where a hemisphere is filled with it, it charges less than {NEGLIGIBLE:g} of saturation"
        )
        return (f"glow that excites was left out: {why}",), False
    return (), True


class SurfaceLight:
    """Brings the light of surfaces to the phosphors' atlases."""

    def __init__(
        self,
        device: Device,
        cells: LitCells,
        glows: Sequence[AtlasGlow],
        states: Sequence[PhosphorState],
        lamps: bool,
    ) -> None:
        self._device, self._cells, self._glows, self._states = device, cells, glows, states
        self._lamps = lamps
        self._gathers: dict[int, AtlasGather] = {}
        self._tree: object = None

    @classmethod
    def of(
        cls,
        device: Device,
        transport: GlowTransport | None,
        glows: Sequence[AtlasGlow],
        states: Sequence[PhosphorState],
        parameters: TransportParameters,
    ) -> SurfaceLight | None:
        """Return it where light of surfaces is to charge phosphors."""
        if not isinstance(transport, FOLLOWING) or not (parameters.lamps or parameters.excites):
            return None
        assert transport.lit_cells is not None
        return cls(device, transport.lit_cells, glows, states, parameters.lamps)

    def place(self) -> None:
        """Find what the atlases see of the cells where these have been made anew."""
        self._cells.place()
        tree = self._cells.tree
        if tree is self._tree:
            return
        assert tree is not None
        for gather in self._gathers.values():
            gather.release()
        self._tree = tree
        self._gathers = {
            state.drawable.number: AtlasGather(self._device, tree, state.atlas, self._cells.n_bands)
            for state in self._states
        }

    def of_lamps(self, state: PhosphorState, factors: Mapping[str, float]) -> None:
        """Add to the irradiance of a phosphor what surfaces reflect of the lamps."""
        cell_light = self._cells.cell_light
        if not self._lamps or cell_light is None or not any(factors.values()):
            return
        dark = np.zeros((len(cell_light.points), 4 * cell_light.layers))
        self._gathers[state.drawable.number].add(cell_light, cell_light.spread(dark, factors), state.light)

    def of_glow(self, states: Sequence[PhosphorState]) -> None:
        """Find how the glow of all phosphors, as they are now, excites each."""
        cell_light = self._cells.cell_light
        assert cell_light is not None
        for glow, state in zip(self._glows, states, strict=True):
            glow.run(state.shown.value)
        radiances = cell_light.spread(self._cells.cell_glow.emitted(), {})

        def shine(state: PhosphorState) -> None:
            self._gathers[state.drawable.number].add(cell_light, radiances, state.light)

        for state in states:
            state.excite_by_glow(shine)
