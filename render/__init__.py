"""Rendering: a scene and times in, band radiance and pictures out.

>>> import phoslab                                                # doctest: +SKIP
>>> frames = phoslab.render.render("scenes/fading", ["off-1s", "off+1s"])   # doctest: +SKIP
>>> frames.write("glow.png")                                      # doctest: +SKIP
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from os import PathLike

from phoslab.errors import PhoslabError
from phoslab.render.device import Device
from phoslab.render.fade_basis import FadeBasis as FadeBasis
from phoslab.render.fade_basis import faded_stretches, fading_rates
from phoslab.render.frame import Frame as Frame
from phoslab.render.frames import Frames as Frames
from phoslab.render.glow_methods import find_method
from phoslab.render.glow_transport import NONE
from phoslab.render.glow_transport import TransportParameters as TransportParameters
from phoslab.render.memory import check_room, picture_bytes
from phoslab.render.phosphor_state import Stepping, check_work
from phoslab.render.renderer import Renderer, RenderParameters
from phoslab.render.scene import Scene as Scene
from phoslab.render.scene import load_scene as load_scene
from phoslab.render.schedule import check_time
from phoslab.render.solvers import DEFAULT, DEFAULT_IN_VARYING_LIGHT, find_solver
from phoslab.render.state_formats import find_format


def render(
    scene: Scene | str | PathLike[str],
    times: Sequence[str | float] | None = None,
    *,
    solver: str | None = None,
    step_s: float = 1 / 60,
    state_format: str = "f32",
    transport: TransportParameters | None = None,
    size: tuple[int, int] | None = None,
    supersampling: int | None = None,
    debug: Sequence[str] = (),
    progress: Callable[[int, int], None] | None = None,
    device: Device | None = None,
) -> Frames:
    """Render a scene at the given times (Nalbach 2017, 8.5).

    Args:
        scene: a `Scene`, or the path of a scene.toml or of its folder.
        times: seconds, or text as in a scene file (`off+80s`); None: those of the scene.
        solver: a name in `phoslab.render.solvers.SOLVERS`; None: "exact", or "exact2" where a light of the scene
            varies continuously. These two take any stretch of constant light in one step.
        step_s: the step in s, wherever one step does not span a stretch.
        state_format: a name in `phoslab.render.state_formats.FORMATS`.
        transport: whether, and how, glow reaches other surfaces; None: it does not.
        size: (width, height) in pixels; None: the scene's.
        supersampling: samples along the side of a pixel; None: the scene's.
        debug: names of passes whose results are to come with the frames.
        progress: called with (frames done, frames in all).
        device: the OpenGL device to use; None: one of its own, released at the end.

    Returns:
        One frame a time, in the order asked for.

    Raises:
        PhoslabError: the scene, a time, the solver, the format or the way of glow transport is wrong, the solver
            does not bear its step, or there is no OpenGL.
    """
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    if solver is None:
        solver = DEFAULT if scene.schedule.piecewise_constant else DEFAULT_IN_VARYING_LIGHT
    find_solver(solver)
    find_format(state_format)
    if transport is not None and transport.method != NONE:
        find_method(transport.method)
    if not 0 < step_s < float("inf"):
        raise PhoslabError(f"is {step_s:g}", field="the step", remedy="Give a positive number of seconds.")
    labels = [t if isinstance(t, str) else f"{t:.12g}" for t in (scene.times if times is None else times)]
    moments = [
        scene.schedule.parse_time(t) if isinstance(t, str) else check_time(float(t), f"{t:g}")
        for t in times or labels
    ]
    parameters = RenderParameters(
        size=size or scene.size,
        supersampling=supersampling or scene.supersampling,
        stepping=Stepping(solver, step_s, state_format),
        transport=transport or TransportParameters(),
        debug=tuple(debug),
    )
    check_work(scene.schedule, max(moments), parameters.stepping)
    w, h = parameters.size
    needed = picture_bytes(parameters.size, parameters.supersampling, scene.transport.n, len(moments))
    check_room(needed, f"a picture of {w} x {h} pixels")
    if not labels:
        raise PhoslabError("is empty", field="the list of times", remedy="Give one time or more.")
    if device is None:
        with Device() as own:
            return _render(own, scene, labels, moments, parameters, progress)
    with device.scope():
        return _render(device, scene, labels, moments, parameters, progress)


def _render(
    device: Device,
    scene: Scene,
    labels: Sequence[str],
    moments: Sequence[float],
    parameters: RenderParameters,
    progress: Callable[[int, int], None] | None,
) -> Frames:
    renderer = Renderer(device, scene, parameters)
    frames: dict[int, Frame] = {}
    # What only fades is rendered once for each rate, where light is followed to other surfaces: elsewhere a frame
    # costs little more than the sum.
    stretches: dict[int, list[int]] = {}
    if (
        renderer.transport is not None
        and not parameters.debug
        and find_solver(parameters.stepping.solver).closed_form
    ):
        stretches = {min(s, key=moments.__getitem__): s for s in faded_stretches(scene, list(moments))}
    later = {k for first, stretch in stretches.items() for k in stretch if k != first}
    # In ascending order, since the state only runs forwards.
    for k in sorted(set(range(len(moments))) - later, key=moments.__getitem__):
        if k in stretches:
            basis = renderer.fade_basis(moments[k])
        for j in stretches.get(k, [k]):
            frames[j] = (
                renderer.faded_frame(basis, moments[j], labels[j])
                if k in stretches
                else renderer.frame(moments[j], labels[j])
            )
            if progress is not None:
                progress(len(frames), len(moments))
    return Frames(
        tuple(frames[k] for k in range(len(moments))),
        scene=os.fsencode("/".join(scene.file.resolve().parts[-2:])).decode("utf-8", "replace"),
        solver=parameters.stepping.solver,
        exposures=scene.exposures,
    )


def render_fade_basis(
    scene: Scene,
    time: str | float,
    *,
    transport: TransportParameters | None = None,
    size: tuple[int, int] | None = None,
    state_format: str = "f32",
) -> FadeBasis:
    """Render what a scene in the dark fades from: one picture for each distinct rate (see `fade_basis.py`).

    Args:
        time: from when on; a light may have been on before, but none is from then.
        transport, size, state_format: as for `render`.

    Raises:
        PhoslabError: a light is on at that time, a rate varies over a surface, or as `render`.
    """
    find_format(state_format)
    t_s = scene.schedule.parse_time(time) if isinstance(time, str) else check_time(time, f"{time:g}")
    fading_rates(scene, t_s)
    solver = DEFAULT if scene.schedule.piecewise_constant else DEFAULT_IN_VARYING_LIGHT
    parameters = RenderParameters(
        size=size or scene.size,
        supersampling=scene.supersampling,
        stepping=Stepping(solver, state_format=state_format),
        transport=transport or TransportParameters(),
    )
    with Device() as device:
        return Renderer(device, scene, parameters).fade_basis(t_s)
