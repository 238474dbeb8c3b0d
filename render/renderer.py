"""The renderer: an explicit list of passes, from light to pixels.

shadow_map        depth of every light's views            once, and per move
atlas_geometry    what lies under each texel              once, and per move of a drawable; per phosphor
atlas_irradiance  K-band light on each texel              once, and per move; per phosphor and course of light
excitation        a_i of each texel                       once, and per move; per phosphor and course of light
phosphor_step     the state at the picture's time         per picture and change of light, or step; per phosphor
gbuffer           what the camera sees                    once, and per move of a drawable or the camera
direct_light      reflected lamp light                    per picture
glow              light of the phosphors                  per picture, per phosphor
atlas_glow        light that the phosphors send           per picture, per phosphor
glow_transport    what surfaces reflect of that           per picture; by the way of `glow_methods` that was asked for
resolve           samples to pixels                       per picture

While a drawable or a light moves and there is light, the state goes from one step to the next, under the light of the
step's middle; in the dark it does not matter where things are.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import moderngl
import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.render.atlas_geometry import AtlasGeometry, AtlasGeometryParameters
from phoslab.render.atlas_glow import AtlasGlow
from phoslab.render.atlas_irradiance import AtlasIrradiance
from phoslab.render.cell_light import Lamps
from phoslab.render.device import Device
from phoslab.render.direct_light import DirectLight
from phoslab.render.excitation import Excitation
from phoslab.render.fade_basis import FadeBasis, fading_rates
from phoslab.render.frame import Frame
from phoslab.render.gbuffer import GBuffer, GBufferParameters
from phoslab.render.glow import Glow
from phoslab.render.glow_methods import find_method
from phoslab.render.glow_transport import NONE, GlowTransport, Surroundings, TransportParameters
from phoslab.render.gltf import GltfCamera
from phoslab.render.gpu_scene import upload
from phoslab.render.light_course import Segment
from phoslab.render.passes import Pass, Picture, side_by_side
from phoslab.render.phosphor_state import PhosphorState, Stepping
from phoslab.render.phosphor_step import PhosphorStep
from phoslab.render.pose import moves_lit, moving_s, pose_at
from phoslab.render.resolve import Resolve, ResolveParameters
from phoslab.render.scene import Scene
from phoslab.render.shadow_map import ShadowMap, ShadowMapParameters
from phoslab.render.surface_light import SurfaceLight, exciting_glow

PASSES = (
    ShadowMap,
    AtlasGeometry,
    AtlasIrradiance,
    Excitation,
    PhosphorStep,
    GBuffer,
    DirectLight,
    Glow,
    AtlasGlow,
    Resolve,
)

# What can be looked at: every pass, and whichever way glow is transported.
TRANSPORT = "glow_transport"
DEBUG_NAMES = (*(p.name for p in PASSES), TRANSPORT)
# What the ways of deep screen space show besides, each by its own name.
TRANSPORT_VIEWS = ("surfels", "levels", "shells", "directions", "hits")


@dataclass(frozen=True)
class RenderParameters:
    """How a scene is rendered.

    Args:
        size: (width, height) of the picture in pixels.
        supersampling: samples along the side of a pixel.
        stepping: solver and step of the states.
        transport: whether, and how, glow reaches other surfaces.
        debug: names of passes whose results come with every frame.
    """

    size: tuple[int, int]
    supersampling: int
    stepping: Stepping = field(default_factory=Stepping)
    transport: TransportParameters = field(default_factory=TransportParameters)
    shadow_map: ShadowMapParameters = field(default_factory=ShadowMapParameters)
    atlas_geometry: AtlasGeometryParameters = field(default_factory=AtlasGeometryParameters)
    debug: Sequence[str] = ()

    def __post_init__(self) -> None:
        for name in self.debug:
            if name not in (*DEBUG_NAMES, *TRANSPORT_VIEWS):
                raise PhoslabError(
                    f"{name!r} is unknown",
                    field="the pass",
                    remedy=f"Use any of: {', '.join((*DEBUG_NAMES, *TRANSPORT_VIEWS))}.",
                )


class Renderer:
    """Renders one scene at any times; what does not change between them is kept."""

    def __init__(self, device: Device, scene: Scene, parameters: RenderParameters) -> None:
        self._device, self.scene, self.parameters = device, scene, parameters
        n_bands = scene.transport.n
        w, h = parameters.size
        samples = (w * parameters.supersampling, h * parameters.supersampling)
        self.drawables = upload(device, scene)
        self.shadow_map = ShadowMap(device, scene.lights, self.drawables, n_bands, parameters.shadow_map)
        self.gbuffer = GBuffer(device, self.drawables, GBufferParameters(samples))
        self.direct_light = DirectLight(device, self.shadow_map, samples, n_bands)
        self.glow = Glow(device, n_bands)
        self.resolve = Resolve(device, n_bands, ResolveParameters(parameters.size, parameters.supersampling))
        self.lamps = Lamps(self.shadow_map)
        self.glow_light, self.exciting = exciting_glow(scene, parameters.transport)
        self.states = self._make_states(device)
        self.transport = self._make_transport(device)
        self.surface_light = SurfaceLight.of(
            device, self.transport, self.glows, self.states, parameters.transport
        )
        self._anchor_s = 0.0
        # For which times things are in place, and light falls on the atlases: None is for none.
        self._placed_s: float | None = None
        self._excited_s: float | None = None
        # Where things stand, and what the camera saw last.
        self._stands: tuple[bytes, ...] | None = None
        self._seen: tuple[bytes, ...] | None = None
        # Since when it has been dark where glow was last looked for: None while a light is on.
        self._dark_since_s: float | None = None
        self._windows: Sequence[GltfCamera] = ()
        self._moving_s, self._moves_lit = moving_s(scene), moves_lit(scene)
        self.prepare()

    def _make_states(self, device: Device) -> list[PhosphorState]:
        n_bands = self.scene.transport.n
        states = []
        for drawable in self.drawables:
            if drawable.material is None:
                continue
            atlas = AtlasGeometry(device, drawable, self.parameters.atlas_geometry)
            states.append(
                PhosphorState(
                    device,
                    drawable,
                    atlas,
                    AtlasIrradiance(device, self.shadow_map, atlas.size, n_bands),
                    n_bands,
                    self.scene.schedule,
                    self.parameters.stepping,
                    lit_by_glow=self.exciting,
                )
            )
        return states

    def _make_transport(self, device: Device) -> GlowTransport | None:
        p = self.parameters
        needed = p.transport.method != NONE and bool(self.states)
        lit = needed or AtlasGlow.name in p.debug
        self.glows = [
            AtlasGlow(device, s.drawable, s.atlas, self.scene.transport.n) for s in self.states if lit
        ]
        self.surroundings = Surroundings(
            self.scene,
            self.drawables,
            [state.atlas for state in self.states],
            self.glows,
            self.gbuffer,
            p.size,
            p.supersampling,
            self.lamps,
        )
        if not needed:
            return None
        return find_method(p.transport.method)(device, self.surroundings, p.transport)

    def prepare(self) -> None:
        """Run the passes whose results hold while nothing moves."""
        self._place(0.0)
        self._excite(0.0)
        for state in self.states:
            state.reset()
        for state in self.states:
            state.strictest_per_s = max(other.largest_rate_per_s for other in self.states)

    def _place(self, t_s: float) -> None:
        """Put everything where it is at `t_s`."""
        t_s = float(np.clip(t_s, *self._moving_s))
        if t_s == self._placed_s:
            return
        first = self._placed_s is None
        self._placed_s = t_s
        self._pose = pose_at(self.scene, t_s)
        if self._pose.stands != self._stands:
            self._stands = self._pose.stands
            for drawable, model_to_world in zip(self.drawables, self._pose.models, strict=True):
                drawable.place(model_to_world)
            for state in self.states:
                state.atlas.run()
        if first or self._moves_lit:
            self.shadow_map.place(self._pose.lights)
            self.shadow_map.run()

    def _excite(self, t_s: float) -> None:
        """Find the excitation under the lights where everything is at `t_s`."""
        t_s = float(np.clip(t_s, *self._moving_s)) if self._moves_lit else 0.0
        if t_s != self._excited_s:
            self._place(t_s)
            if self.surface_light is not None:
                self.surface_light.place()
            for state in self.states:
                state.excite(None if self.surface_light is None else self.surface_light.of_lamps)
            self._excited_s = t_s

    def _see(self, t_s: float) -> None:
        """Find what the camera sees at `t_s`, and which way glow takes; the states are those of then."""
        self._place(t_s)
        since = self.scene.schedule.dark_since_s(t_s)
        moved = self._pose.seen != self._seen
        if moved:
            self.gbuffer.run(*(self._windows or [self._pose.camera]))
        if self.transport is not None and (moved or (self.transport.aims and since != self._dark_since_s)):
            self.prepare_transport(t_s)
        self._seen, self._dark_since_s = self._pose.seen, since

    def prepare_transport(self, t_s: float) -> None:
        """Find which way glow takes to what the camera sees: what holds until something moves, or a light is switched.

        In the dark it is found for what glowed when it went dark, so that all pictures of one night have the same ways.
        """
        assert self.transport is not None
        since = self.scene.schedule.dark_since_s(t_s)
        if self.transport.aims:
            for glow, state in zip(self.glows, self.states, strict=True):
                if since is None:
                    glow.clear()
                else:
                    glow.run((state.anchor if since < t_s else state.shown).value)
        self.transport.prepare()

    def frame(self, t_s: float, label: str | None = None) -> Frame:
        """Render the scene at `t_s` seconds; forwards in time is cheaper than backwards.

        Raises:
            PhoslabError: the solver would overshoot.
        """
        factors = self.scene.schedule.factors(t_s)
        self.bring_states_to(t_s)
        self._see(t_s)
        self._draw(factors, [state.shown.value for state in self.states])
        return self._make_frame(t_s, label, self.resolve.read(), self._debug_views(factors))

    def light(self, t_s: float) -> None:
        """Find what the phosphors send at `t_s`, without a picture."""
        self.bring_states_to(t_s)
        self._see(t_s)
        for glow, state in zip(self.glows, self.states, strict=True):
            glow.run(state.shown.value)

    def look_through(self, cameras: Sequence[GltfCamera]) -> None:
        """See through other cameras than the scene's, side by side in parts of equal width; none: through the scene's.

        Not for ways of glow that read "camera".
        """
        self._windows, self._seen = cameras, None

    def reflected(self, t_s: float) -> NDArray[np.float32]:
        """Render (h, w, K) the glow that surfaces reflect at `t_s`, alone, where it is transported."""
        assert self.transport is not None
        self.light(t_s)
        self.lamps.factors = {}
        radiance = self.direct_light.radiance
        self.direct_light.run(self.gbuffer, self.drawables, self.lamps.factors)
        self.transport.run(radiance)
        self.resolve.run(radiance)
        return self.resolve.read()

    def _draw(self, factors: Mapping[str, float], states: Sequence[moderngl.Texture]) -> None:
        """Draw what the lights and the phosphors in these states give, down to pixels."""
        radiance = self.direct_light.radiance
        self.lamps.factors = factors
        self.direct_light.run(self.gbuffer, self.drawables, factors)
        for phosphor, r in zip(self.states, states, strict=True):
            self.glow.run(self.gbuffer, phosphor.drawable, r, radiance)
        if self.glows:
            for glow, r in zip(self.glows, states, strict=True):
                glow.run(r)
        if self.transport is not None:
            self.transport.run(radiance)
        self.resolve.run(radiance)

    def _make_frame(
        self,
        t_s: float,
        label: str | None,
        radiance: NDArray[np.float32],
        debug: Mapping[str, Picture] | None = None,
    ) -> Frame:
        return Frame(
            time_s=t_s,
            label=f"{t_s:g}" if label is None else label,
            bands=self.scene.transport,
            radiance=radiance,
            warnings=self._warnings(t_s),
            debug=debug or {},
        )

    def fade_basis(self, t_s: float) -> FadeBasis:
        """Render what fades at each rate, from `t_s` on; see `fade_basis.py`.

        Raises:
            PhoslabError: a light is on at `t_s`, or a rate varies over a surface.
        """
        rates = fading_rates(self.scene, t_s)
        self.bring_states_to(t_s)
        self._see(t_s)
        pictures = []
        for rate in rates:
            with self._device.scope():
                only = [state.only_at_rate(rate) for state in self.states]
                self._draw({}, [texture.value for texture in only])
            pictures.append(self.resolve.read())
        return FadeBasis(t_s, rates, np.array(pictures), self.scene.transport)

    def faded_frame(self, basis: FadeBasis, t_s: float, label: str | None = None) -> Frame:
        """Return the frame at `t_s`, from a basis of this scene: the states stay where they are."""
        return self._make_frame(t_s, label, basis.at(t_s))

    def bring_states_to(self, t_s: float) -> None:
        """Advance the phosphors, or go back to time 0 and advance, so that each shows its state at `t_s`."""
        if t_s < self._anchor_s:
            if self._moves_lit:
                self._excite(0.0)
            for state in self.states:
                state.reset()
            self._anchor_s = 0.0
        for state in self.states:
            state.show_anchor()
        for segment in self.scene.schedule.segments(self._anchor_s, t_s):
            for part, lit_s in self._moves(segment):
                self._excite(lit_s)
                if self.exciting:
                    assert self.surface_light is not None
                    self.surface_light.of_glow(self.states)
                self._anchor_s = part.end_s
                for state in self.states:
                    if part.end_s < t_s:
                        state.advance(part)
                    else:
                        self._anchor_s = state.show(part)

    def _moves(self, segment: Segment) -> Iterator[tuple[Segment, float]]:
        """Yield the parts of a segment through which light falls as at one time, and that time: all of it, or steps.

        The parts lie on a grid that does not depend on where a picture is taken, so that a picture is the same
        whichever came before.
        """
        begin, end = (0.0, math.inf) if self.exciting else self._moving_s
        step = self.parameters.stepping.step_s
        if not self.exciting and (not self._moves_lit or segment.dark):
            yield segment, self._excited_s or 0.0
            return
        first = max(0, math.floor((segment.start_s - begin) / step) - 1)
        last = math.ceil((min(segment.end_s, end) - begin) / step)
        inner = [*(begin + k * step for k in range(first, last)), end]
        edges = [t for t in inner if begin <= t <= end and segment.start_s < t < segment.end_s]
        for low, high in itertools.pairwise([segment.start_s, *dict.fromkeys(edges), segment.end_s]):
            # The middle of the whole step of the grid, of which the part may be the beginning.
            cell = math.floor((low + high) / 2 / step - begin / step)
            yield replace(segment, start_s=low, end_s=high), begin + (cell + 0.5) * step

    def _warnings(self, t_s: float) -> tuple[str, ...]:
        """What the scene warns of, and every material that is seen beyond what its data support."""
        warnings = [*self.scene.warnings, *self.glow_light]
        if self.parameters.transport.method != NONE and not self.states:
            warnings.append("nothing in the scene is phosphorescent, so that no glow is to be transported")
        dark = self.scene.schedule.dark_for_s(t_s)
        for state in self.states:
            valid = state.phosphor.material.valid_s
            if dark is not None and valid is not None and dark > valid[1]:
                warnings.append(
                    f"{dark:g} s after the light is beyond the {valid[1]:g} s that the data of "
                    f"{state.phosphor.material.name!r} support"
                )
        return tuple(dict.fromkeys(warnings))

    def _debug_views(self, factors: Mapping[str, float]) -> dict[str, Picture]:
        """Return the views of the passes asked for, by `PASS.VIEW`; those of all phosphors in one picture."""
        if AtlasIrradiance.name in self.parameters.debug:
            for state in self.states:
                state.light.run(state.atlas, factors)
        sources: dict[str, Sequence[Pass | PhosphorState | GlowTransport]] = {
            ShadowMap.name: [self.shadow_map],
            AtlasGeometry.name: [s.atlas for s in self.states],
            AtlasIrradiance.name: [s.light for s in self.states],
            Excitation.name: [s.excitation for s in self.states],
            PhosphorStep.name: self.states,
            GBuffer.name: [self.gbuffer],
            DirectLight.name: [self.direct_light],
            Glow.name: [self.direct_light],
            AtlasGlow.name: self.glows,
            TRANSPORT: [] if self.transport is None else [self.transport],
            Resolve.name: [self.resolve],
        }
        views: dict[str, Picture] = {}
        asked = [name for name in self.parameters.debug if name in TRANSPORT_VIEWS]
        made = {} if self.transport is None or not asked else self.transport.debug_views()
        for name in asked:
            if name not in made:
                raise PhoslabError(
                    f"is nothing that --gi {self.parameters.transport.method} makes",
                    field=f"the view {name!r}",
                    remedy="Use --gi dss or dss-z; directions and hits are those of dss-z.",
                )
            views[f"{TRANSPORT}.{name}"] = made[name]
        for name in self.parameters.debug:
            if name in asked:
                continue
            each = [source.debug_views() for source in sources[name]]
            for view in each[0] if each else ():
                views[f"{name}.{view}"] = side_by_side([v[view] for v in each])
        return views
