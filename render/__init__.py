"""Rendering: a scene and times in, band radiance and pictures out.

>>> import phoslab                                                # doctest: +SKIP
>>> frames = phoslab.render.render("sample_data/scenes/fading", ["off-1s", "off+1s"])   # doctest: +SKIP
>>> frames.write("glow.png")                                      # doctest: +SKIP
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
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
from phoslab.render.pose import check_motion
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
    labels = [t if isinstance(t, str) else f"{t:.12g}" for t in (scene.times if times is None else times)]
    moments = [
        scene.schedule.parse_time(t) if isinstance(t, str) else check_time(float(t), f"{t:g}")
        for t in times or labels
    ]
    if not labels:
        raise PhoslabError("is empty", field="the list of times", remedy="Give one time or more.")
    parameters = _parameters(
        scene,
        max(moments),
        len(moments),
        stepping=Stepping(_solver(scene, solver), step_s, state_format),
        transport=transport,
        size=size,
        supersampling=supersampling,
        debug=debug,
    )
    # In ascending order, since the state only runs forwards.
    order = sorted(range(len(moments)), key=moments.__getitem__)
    frames: dict[int, Frame] = {}
    with Device() if device is None else _scope_of(device) as drawn_on:
        each = _render(drawn_on, scene, [moments[k] for k in order], [labels[k] for k in order], parameters)
        for k, frame in zip(order, each, strict=True):
            frames[k] = frame
            if progress is not None:
                progress(len(frames), len(moments))
    return Frames(
        tuple(frames[k] for k in range(len(moments))),
        scene=_source(scene),
        solver=parameters.stepping.solver,
        exposures=scene.exposures,
    )


def render_film(
    scene: Scene,
    out: str | PathLike[str],
    from_s: float,
    to_s: float,
    fps: float = 30.0,
    *,
    solver: str | None = None,
    step_s: float | None = None,
    state_format: str = "f32",
    transport: TransportParameters | None = None,
    size: tuple[int, int] | None = None,
    supersampling: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[str, ...]:
    """Render a stretch of a scene's time into an .mp4, one picture each 1 / fps s.

    Lamps go on and off, what the file's animation moves moves, and materials charge and fade meanwhile. A stretch of
    darkness in which nothing moves is a sum of the pictures of its fade basis.

    Args:
        out: the file, whole or absent.
        from_s, to_s: in s of the schedule; a picture at `from_s`, none at `to_s`.
        fps: pictures a second.
        step_s: the step in s while light varies or anything moves; None: one a picture.
        solver, state_format, transport, size, supersampling, progress: as for `render`.

    Returns:
        Warnings.

    Raises:
        PhoslabError: the stretch is empty or too long, or as `render`.
    """
    from phoslab.render.film import Film, film_times

    moments = film_times(check_time(from_s, f"{from_s:g}"), check_time(to_s, f"{to_s:g}"), fps)
    parameters = _parameters(
        scene,
        moments[-1],
        1,
        stepping=Stepping(_solver(scene, solver), step_s or 1 / fps, state_format),
        transport=transport,
        size=size,
        supersampling=supersampling,
        debug=(),
    )
    with Device() as device, Film(out, parameters.size, fps, scene.exposures) as film:
        labels = [f"{t:.12g}" for t in moments]
        for k, frame in enumerate(_render(device, scene, moments, labels, parameters), start=1):
            film.show(frame)
            if progress is not None:
                progress(k, len(moments))
    return film.warnings


@contextmanager
def _scope_of(device: Device) -> Iterator[Device]:
    with device.scope():
        yield device


def _solver(scene: Scene, solver: str | None) -> str:
    if solver is None:
        return DEFAULT if scene.schedule.piecewise_constant else DEFAULT_IN_VARYING_LIGHT
    find_solver(solver)
    return solver


def _parameters(
    scene: Scene,
    until_s: float,
    n_kept: int,
    *,
    stepping: Stepping,
    transport: TransportParameters | None,
    size: tuple[int, int] | None,
    supersampling: int | None,
    debug: Sequence[str],
) -> RenderParameters:
    """Check what was asked for before anything is made."""
    find_format(stepping.state_format)
    if transport is not None and transport.method != NONE:
        find_method(transport.method)
    if not 0 < stepping.step_s < float("inf"):
        raise PhoslabError(
            f"is {stepping.step_s:g}", field="the step", remedy="Give a positive number of seconds."
        )
    parameters = RenderParameters(
        size=size or scene.size,
        supersampling=supersampling or scene.supersampling,
        stepping=stepping,
        transport=transport or TransportParameters(),
        debug=tuple(debug),
    )
    check_work(scene.schedule, until_s, stepping)
    check_motion(scene, until_s, stepping.step_s)
    w, h = parameters.size
    needed = picture_bytes(parameters.size, parameters.supersampling, scene.transport.n, n_kept)
    check_room(needed, f"a picture of {w} x {h} pixels")
    return parameters


def _source(scene: Scene) -> str:
    return os.fsencode("/".join(scene.file.resolve().parts[-2:])).decode("utf-8", "replace")


def _render(
    device: Device,
    scene: Scene,
    moments: Sequence[float],
    labels: Sequence[str],
    parameters: RenderParameters,
) -> Iterator[Frame]:
    """Yield the frames at moments that ascend."""
    renderer = Renderer(device, scene, parameters)
    # What only fades is rendered once for each rate, where light is followed to other surfaces: elsewhere a frame
    # costs little more than the sum.
    faded: dict[int, int] = {}
    if (
        renderer.transport is not None
        and renderer.transport.linear
        and not parameters.debug
        and not renderer.exciting
        and find_solver(parameters.stepping.solver).closed_form
    ):
        stretches = faded_stretches(scene, list(moments))
        faded = {k: stretch[0] for stretch in stretches for k in stretch}
    basis: FadeBasis | None = None
    for k, (t_s, label) in enumerate(zip(moments, labels, strict=True)):
        if k not in faded:
            yield renderer.frame(t_s, label)
            continue
        if faded[k] == k:
            basis = renderer.fade_basis(t_s)
        assert basis is not None
        yield renderer.faded_frame(basis, t_s, label)


def fade_basis_warnings(transport: TransportParameters) -> tuple[str, ...]:
    """Return what to know of a fade basis whose glow was transported so."""
    if transport.method == NONE or find_method(transport.method).linear:
        return ()
    return (
        f"{transport.method} follows light as far as it is bright: pictures from this basis are within some per cent "
        "of those rendered at their time, and not the same",
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
        renderer = Renderer(device, scene, parameters)
        if renderer.exciting:
            raise PhoslabError(
                "does more than fade",
                field="glow that excites (--glow-excites)",
                remedy="Render frame by frame, or without it.",
            )
        return renderer.fade_basis(t_s)
