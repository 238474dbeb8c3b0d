"""Where drawables, lights and camera of a scene are at one time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.render.gltf import GltfCamera, check_placed
from phoslab.render.scene import Light, Scene

# One is some tens of ms: shadow maps, and what the lights give to every texel.
MOST_MOVES = 200_000


@dataclass(frozen=True, eq=False)
class Pose:
    """Args:
    models: (4, 4) each drawable's model to world.
    lights: of the scene, where they are.
    camera: where it is.
    """

    models: tuple[NDArray[np.float64], ...]
    lights: tuple[Light, ...]
    camera: GltfCamera

    @property
    def stands(self) -> tuple[bytes, ...]:
        """Where drawables are, to compare."""
        return tuple(model.tobytes() for model in self.models)

    @property
    def seen(self) -> tuple[bytes, ...]:
        """What the camera sees, to compare: wherever the lights are."""
        return (*self.stands, self.camera.world_to_view.tobytes())


def pose_at(scene: Scene, t_s: float) -> Pose:
    """Return where everything is at `t_s`.

    Raises:
        PhoslabError: something is scaled to nothing, or too far away.
    """
    if scene.motion is None:
        return Pose(tuple(d.model_to_world for d in scene.drawables), scene.lights, scene.camera)
    world = scene.motion.at(t_s)
    for name, node in (
        *((d.name, d.node) for d in scene.drawables),
        *((light.place.name, light.place.index) for light in scene.lights),
    ):
        check_placed(scene.file, name, world[node], f" at {t_s:g} s")
    return Pose(
        tuple(world[d.node] for d in scene.drawables),
        tuple(replace(light, place=light.place.placed(world[light.place.index])) for light in scene.lights),
        scene.camera.placed(world[scene.camera.index]),
    )


def moving_s(scene: Scene) -> tuple[float, float]:
    """Return from when to when anything moves; (0, 0): nothing does."""
    return (0.0, 0.0) if scene.motion is None else scene.motion.span_s


def moves_lit(scene: Scene) -> bool:
    """Whether anything moves that decides which light falls where: a drawable or a light, not the camera alone."""
    motion = scene.motion
    nodes = [d.node for d in scene.drawables] + [light.place.index for light in scene.lights]
    return motion is not None and any(motion.moved(node) for node in nodes)


def check_motion(scene: Scene, until_s: float, step_s: float) -> None:
    """Refuse more moves until a time than anybody would wait for.

    Raises:
        PhoslabError: there are more than `MOST_MOVES`.
    """
    begin, end = moving_s(scene)
    moved_s = min(end, until_s) - begin
    if moves_lit(scene) and moved_s / step_s > MOST_MOVES:
        raise PhoslabError(
            f"of {step_s:g} s makes {moved_s / step_s:.2g} moves until {until_s:g} s",
            field="the step (--step)",
            remedy=f"Use at least {moved_s / MOST_MOVES:.2g} s, or an earlier time.",
        )
