"""A scene, rendered as some choices model it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from phoslab.model_plan import Choices
from phoslab.render import Frames, render
from phoslab.render.device import Device
from phoslab.render.planning.reduced import apply, transport_parameters
from phoslab.render.scene import Scene


def render_choices(
    scene: Scene,
    choices: Choices,
    times: Sequence[str | float] | None,
    size: tuple[int, int] | None,
    *,
    supersampling: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    device: Device | None = None,
) -> Frames:
    """Render a scene as some choices model it."""
    return render(
        apply(scene, choices),
        times,
        solver=choices.solver,
        step_s=choices.step_s,
        state_format=choices.state_format,
        transport=transport_parameters(choices),
        size=size,
        supersampling=supersampling,
        progress=progress,
        device=device,
    )
