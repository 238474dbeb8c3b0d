"""The animations of a glTF file, as channels that move its nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab import times
from phoslab.render.gltf_accessors import Buffers
from phoslab.render.motion import CUBIC, LINEAR, PATHS, STEP, Channel, Motion, Place


def node_place(node: Any) -> Place:
    """Return a node's translation, rotation and scale."""
    return Place(
        np.array(node.translation if node.translation is not None else [0, 0, 0], dtype=np.float64),
        np.array(node.rotation or [0, 0, 0, 1], dtype=np.float64),
        np.array(node.scale if node.scale is not None else [1, 1, 1], dtype=np.float64),
    )


def node_matrix(node: Any) -> NDArray[np.float64]:
    """Return (4, 4) a node's place within its parent, as the file has it at rest."""
    if node.matrix is not None:
        return np.array(node.matrix, dtype=np.float64).reshape(4, 4).T
    return node_place(node).matrix()


def read_motion(buffers: Buffers, parents: dict[int, int | None]) -> Motion | None:
    """Return what moves the nodes of a scene; None where nothing does.

    Args:
        parents: of every node in the scene, a parent before its children.

    Raises:
        PhoslabError: a channel is malformed, its keys do not ascend, or two move the same.
    """
    nodes = buffers.document.nodes
    channels: dict[int, list[Channel]] = {}
    for a, animation in enumerate(buffers.document.animations or []):
        for k, entry in enumerate(animation.channels or []):
            where = f"animations[{a}].channels[{k}]"
            target = entry.target
            if target is None or target.node not in parents or target.path not in PATHS:
                continue
            if nodes[target.node].matrix is not None:
                raise buffers.error(where, "moves a node that has a matrix", "Export it with TRS.")
            channel = _channel(buffers, animation, entry, where)
            if any(other.path == channel.path for other in channels.get(target.node, [])):
                raise buffers.error(
                    where,
                    f"moves the {channel.path} of a node that another channel moves already",
                    "Keep one animation: all of a file's are played together.",
                )
            channels.setdefault(target.node, []).append(channel)
    if not channels:
        return None
    return Motion(
        parents=parents,
        fixed={k: node_matrix(nodes[k]) for k in parents if k not in channels},
        places={k: node_place(nodes[k]) for k in channels},
        channels={k: tuple(each) for k, each in channels.items()},
    )


def _channel(buffers: Buffers, animation: Any, entry: Any, where: str) -> Channel:
    sampler = buffers.pick(f"{where}: samplers", entry.sampler, animation.samplers or [])
    t = buffers.read_accessor(sampler.input).astype(np.float64)[:, 0]
    v = buffers.read_accessor(sampler.output).astype(np.float64)
    kind = sampler.interpolation or LINEAR
    if kind not in (LINEAR, STEP, CUBIC):
        raise buffers.error(where, f"has an unknown interpolation {kind!r}")
    path = entry.target.path
    each = 3 if kind == CUBIC else 1
    if not len(t) or v.shape != (each * len(t), PATHS[path]):
        raise buffers.error(where, f"has not one {path} a key")
    if not (np.isfinite(t).all() and np.isfinite(v).all()):
        raise buffers.error(where, "has a key that is not finite")
    if (np.diff(t) <= 0).any() or not 0 <= t[0] <= t[-1] <= times.LATEST_S:
        raise buffers.error(where, "has keys that do not ascend from 0 s")
    v = v.reshape(len(t), 3, -1) if kind == CUBIC else v
    keys = v[:, 1] if kind == CUBIC else v
    if path == "rotation" and not (np.linalg.norm(keys, axis=1) > 1e-6).all():
        raise buffers.error(where, "has a rotation of no length")
    return Channel(path, t, v, kind)
