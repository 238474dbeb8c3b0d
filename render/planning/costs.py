"""What a picture costs, and what its ways to transport glow err by: as `phoslab trade model` measured it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from os import PathLike
from typing import Any

import numpy as np

from phoslab import trades
from phoslab.errors import PhoslabError
from phoslab.model_plan import Choices
from phoslab.render.fade_basis import faded_stretches, fading_rates
from phoslab.render.glow_methods import METHODS
from phoslab.render.glow_transport import NONE, TransportParameters
from phoslab.render.optics import layer_count
from phoslab.render.path_tracer import usual_variant
from phoslab.render.scene import Scene

# Of a trade from before it was measured: rooms of some boxes, in pictures of 64 pixels along a side.
USUAL_UNEVENNESS = 0.05


@dataclass(frozen=True)
class MeasuredWay:
    """A way to reflect glow: mean relative error of the reflected light, s once, and s a pixel."""

    method: str
    parameters: dict[str, Any]
    error: float
    s_per_pixel: float
    once_s: float = 0.0

    @property
    def reflects_once(self) -> bool:
        """Whether it was measured with light that is reflected once: that says nothing of cells that send light on."""
        return bool(self.parameters.get("bounces", 1) == 1)


@dataclass(frozen=True)
class Costs:
    """What was measured on a machine.

    Args:
        texel_error, texel_power: glow is off by texel_error x^texel_power with texels of x pixels.
        gi: ways that reflect glow.
        unevenness: of the scenes in which `gi` was measured, that of the worst (`Pilot.reflected_unevenness`).
        path_noise: mean relative error of reflected glow with one path a pixel; it falls with the root of their number.
        costs_s: s for each of `features`; those of paths are of the variant of Mitsuba that this machine takes.
    """

    texel_error: float
    texel_power: float
    gi: tuple[MeasuredWay, ...]
    path_noise: float
    costs_s: dict[str, float]
    unevenness: float = USUAL_UNEVENNESS

    def predict_s(self, choices: Choices, work: Work) -> float:
        """Return the predicted time of all pictures in s."""
        return sum(self.shares_s(choices, work).values())

    def shares_s(self, choices: Choices, work: Work) -> dict[str, float]:
        """Return the predicted time in s by the decision that it follows from; "start" is that of none."""
        shares = dict.fromkeys(_DECIDES.values(), 0.0)
        for name, count in features(choices, work).items():
            shares[_DECIDES[name]] += self.costs_s.get(name, 0.0) * count
        nearest = self.nearest(choices.gi)
        if nearest is not None:
            shares["gi"] += nearest.once_s + nearest.s_per_pixel * work.size[0] * work.size[1]
        return shares

    def nearest(self, gi: Mapping[str, Any]) -> MeasuredWay | None:
        """Return what was measured with the parameters of `--gi` that are most like these; None: no such method was."""
        alike = [m for m in self.gi if m.method == gi["method"]]
        return min(alike, key=lambda m: unlike(m.parameters, gi), default=None)

    def finest_error(self, like: MeasuredWay) -> float:
        """Return the least error of a method, for light that is reflected once, or more often, as in `like`."""
        return min(
            m.error for m in self.gi if (m.method, m.reflects_once) == (like.method, like.reflects_once)
        )


def unlike(a: Mapping[str, Any], b: Mapping[str, Any]) -> float:
    """Return how far apart two settings of a way are: in doublings."""
    names = [f.name for f in fields(TransportParameters) if f.name not in ("method", "seed", "full")]
    x, y = (
        np.array([float(some.get(n, getattr(TransportParameters, n)) or 0.0) for n in names])
        for some in (a, b)
    )
    return float(np.abs(np.log2((1 + x) / (1 + y))).sum())


def load_costs(path: str | PathLike[str] | None = None) -> Costs:
    """Read what was measured: from a trade.json of kind "model", or from that which ships.

    Raises:
        PhoslabError: it cannot be read, or is of another kind.
    """
    data = trades.load("model", path)
    return Costs(
        texel_error=data["texels"]["error"],
        texel_power=data["texels"]["power"],
        gi=tuple(_way(way, k, path) for k, way in enumerate(data["gi"])),
        path_noise=data["path_noise"],
        costs_s={**data["costs_s"], **_of_paths(data)},
        unevenness=data.get("unevenness", USUAL_UNEVENNESS),
    )


def _way(way: dict[str, Any], k: int, path: str | PathLike[str] | None) -> MeasuredWay:
    known = {f.name for f in fields(TransportParameters)}
    for field, name in (("method", way["method"]), *(("parameters", p) for p in way["parameters"])):
        if name not in (METHODS if field == "method" else known):
            raise PhoslabError(
                f"has {name!r}, which this version of phoslab does not know",
                file=path,
                field=f"gi[{k}].{field}",
                remedy="Measure anew: phoslab trade model -o DIR; its trade.json lies in DIR.",
            )
    return MeasuredWay(**way)


def _of_paths(data: Mapping[str, Any]) -> dict[str, float]:
    """Return what paths cost with the variant of Mitsuba that this machine takes, or else any that was measured."""
    known: Mapping[str, dict[str, float]] = data.get("paths_s", {})
    usual = usual_variant()
    if usual in known or "path" not in data["costs_s"]:
        return dict(known.get(usual) or next(iter(known.values())))
    # A trade from before variants were told apart.
    return {}


# From which decision the time of a feature follows.
_DECIDES = {
    "start": "start",
    "texel_layer": "texels",
    "sample_layer": "bands",
    "texel_step": "solver",
    "path_start": "gi",
    "path_picture": "gi",
    "path": "gi",
}
FEATURES = ("start", "texel_layer", "sample_layer", "texel_step")
PATH_FEATURES = ("path_start", "path_picture", "path")


@dataclass(frozen=True)
class Work:
    """What is to be drawn.

    Args:
        size: (width, height) in pixels.
        supersampling: samples along the side of a pixel.
        times: how many are asked for.
        drawn: how many pictures are drawn where glow is transported.
        steps: of a state.
    """

    size: tuple[int, int]
    supersampling: int
    times: int
    drawn: int
    steps: int


def features(choices: Choices, work: Work) -> dict[str, float]:
    """Return how often each thing that takes time is done.

    start: once. texel_layer: a texel in four bands. sample_layer: a sample of a picture in four bands. texel_step: a
    texel and a step. path_start: once where paths are traced, for what is compiled. path_picture: three bands of a
    picture for the path tracer. path: one path of it.
    """
    layers = layer_count(len(choices.bands_nm) - 1)
    texels = sum(s.atlas_texels**2 for s in choices.surfaces.values() if s.glows)
    pixels = work.size[0] * work.size[1]
    traced = 0
    if choices.gi["method"] == "reference":
        traced = work.drawn * -(-(len(choices.bands_nm) - 1) // 3)
    drawn = work.times if choices.gi["method"] == NONE else work.drawn
    return {
        "start": 1.0,
        "texel_layer": float(texels * layers),
        "sample_layer": float(pixels * work.supersampling**2 * layers * drawn),
        "texel_step": float(texels * work.steps),
        "path_start": float(traced > 0),
        "path_picture": float(traced),
        "path": float(traced * pixels * choices.gi.get("samples", TransportParameters.samples)),
    }


def pictures(scene: Scene, moments: list[float]) -> int:
    """Return how many pictures are drawn where glow is transported: a fade basis serves a stretch of darkness."""
    stretches = faded_stretches(scene, moments)
    served = sum(len(s) for s in stretches)
    return len(moments) - served + sum(len(fading_rates(scene, moments[s[0]])) for s in stretches)
