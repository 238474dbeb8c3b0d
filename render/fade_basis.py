"""Fading in the dark as a sum: one picture for each rate, and any later time is these, weighted.

Without light, every state fades as exp(-kr t), everywhere at once (Nalbach 2017, eq. 8.4), and what reaches the camera
is linear in the states, whatever way the light took. So with geometry and camera at rest, the picture at any t >= t0 is

    L(t) = sum over the distinct rates k of exp(-k (t - t0)) B_k

where B_k is the picture at t0 of those states alone that fade at rate k. A film of any length, forwards or backwards,
costs as many pictures as there are rates.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phoslab.bands import Bands
from phoslab.errors import PhoslabError
from phoslab.exr import read_image, write_channels
from phoslab.programmes import Switched
from phoslab.render.frame import Frame
from phoslab.render.frames import Frames
from phoslab.render.images import band_channels
from phoslab.render.light_course import Course
from phoslab.render.pose import moving_s
from phoslab.render.scene import Exposure, Scene
from phoslab.render.schedule import Schedule

SUFFIX = ".basis.exr"
SCHEMA = "phoslab-fade-basis/1"
AUTOMATIC = (Exposure(0.0, None),)
_REMEDY = f"Name a {SUFFIX} file that phoslab render wrote."


@dataclass(frozen=True, eq=False)
class FadeBasis:
    """Pictures that fade, each at a rate of its own.

    Args:
        t0_s: from when on, in s of the scene's schedule.
        rates_per_s: (n,) ascending.
        pictures: (n, h, w, K) radiance at `t0_s`, top row first.
        bands: the K bands.
    """

    t0_s: float
    rates_per_s: NDArray[np.float64]
    pictures: NDArray[np.float32]
    bands: Bands

    def at(self, t_s: float) -> NDArray[np.float32]:
        """Return (h, w, K) the radiance at `t_s`.

        Raises:
            PhoslabError: `t_s` is before `t0_s`: how bright it was then depends on the light that went before.
        """
        if t_s < self.t0_s:
            raise PhoslabError(
                f"{t_s:g} s is before {self.t0_s:g} s, where the fading begins",
                field="the time",
                remedy="Ask for a later time, or make the basis at an earlier one.",
            )
        n, h, w, k = self.pictures.shape
        weights = np.exp(-self.rates_per_s * (t_s - self.t0_s)).astype(np.float32)
        return (weights @ self.pictures.reshape(n, -1)).reshape(h, w, k)

    def write(
        self,
        path: Path,
        *,
        scene: str,
        off_s: float | None,
        exposures: Sequence[Exposure] = AUTOMATIC,
    ) -> None:
        """Write the pictures as layers of one OpenEXR file, with their rates.

        Args:
            scene: where they come from.
            off_s: the moment that `off` names in times; None: there is none.
            exposures: how it is shown, by when.
        """
        names = band_channels(self.bands)
        channels = {
            f"rate{i}.{name}": picture[..., j]
            for i, picture in enumerate(self.pictures)
            for j, name in enumerate(names)
        }
        about = {
            "schema": SCHEMA,
            "t0_s": self.t0_s,
            "rates_per_s": self.rates_per_s.tolist(),
            "band_edges_nm": self.bands.edges_nm.tolist(),
            "scene": scene,
            "off_s": off_s,
            "exposures": [[e.from_s, e.factor] for e in exposures],
        }
        write_channels(path, channels, {"phoslab:fade_basis": json.dumps(about)})


def read_fade_basis(path: Path) -> tuple[FadeBasis, str, float | None, tuple[Exposure, ...]]:
    """Read a basis back; return it, the scene that it is of, the moment that `off` names, and how it is shown.

    Raises:
        PhoslabError: the file is missing, or none that `FadeBasis.write` wrote.
    """
    channels, attributes = read_image(path, remedy=_REMEDY)
    try:
        about = json.loads(str(attributes["phoslab:fade_basis"]))
        if about["schema"] != SCHEMA:
            raise PhoslabError(f"is {about['schema']!r}", file=path, field="schema", remedy=_REMEDY)
        bands = Bands(np.array(about["band_edges_nm"], dtype=np.float64))
        rates = np.array(about["rates_per_s"], dtype=np.float64)
        t0_s, off_s = float(about["t0_s"]), about["off_s"]
        pictures = np.stack(
            [
                np.stack([channels[f"rate{i}.{name}"] for name in band_channels(bands)], axis=-1)
                for i in range(rates.size)
            ]
        )
        if not (np.isfinite(pictures).all() and (rates >= 0).all() and np.isfinite([t0_s, *rates]).all()):
            raise ValueError("not finite")
        return (
            FadeBasis(t0_s, rates, pictures.astype(np.float32), bands),
            str(about["scene"]),
            None if off_s is None else float(off_s),
            tuple(Exposure(float(t), None if f is None else float(f)) for t, f in about.get("exposures", ()))
            or AUTOMATIC,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise PhoslabError("is not a fade basis", file=path, remedy=_REMEDY) from error


def fading_rates(scene: Scene, t_s: float) -> NDArray[np.float64]:
    """Return the distinct rates at which a scene fades from `t_s` on, ascending.

    Raises:
        PhoslabError: it does not fade so: a light is on at `t_s`, things still move, or a rate varies over a
            surface.
    """
    if t_s < moving_s(scene)[1]:
        raise PhoslabError(
            f"cannot begin at {t_s:g} s: things move until {moving_s(scene)[1]:g} s",
            field="the fade basis",
            remedy="Ask for a later time.",
        )
    if scene.schedule.dark_for_s(t_s) is None:
        raise PhoslabError(
            f"cannot begin at {t_s:g} s: a light is on",
            field="the fade basis",
            remedy="Ask for a time in the dark, such as --at off.",
        )
    rates = set()
    for drawable in scene.phosphors:
        assert drawable.phosphor is not None
        uniform = drawable.phosphor.optics.uniform_kr
        if uniform is None:
            raise PhoslabError(
                "has rates that vary over its surface, so no few pictures hold how it fades",
                field=f"the material of {drawable.name!r}",
                remedy="Render frame by frame.",
            )
        rates |= set(uniform.tolist())
    return np.array(sorted(rates), dtype=np.float64)


def faded_stretches(scene: Scene, moments: list[float]) -> list[list[int]]:
    """Return the indices of those moments that a fade basis serves with fewer pictures, by stretch of darkness."""
    stretches: dict[float, list[int]] = {}
    for k, t in enumerate(moments):
        since = scene.schedule.dark_since_s(t)
        if since is not None and t >= moving_s(scene)[1]:
            stretches.setdefault(since, []).append(k)
    if not scene.phosphors or any(
        d.phosphor is not None and d.phosphor.optics.uniform_kr is None for d in scene.phosphors
    ):
        return []
    return [
        indices
        for indices in stretches.values()
        if len({moments[k] for k in indices}) > len(fading_rates(scene, moments[indices[0]]))
    ]


def frames_of(path: Path, times: Sequence[str] | None) -> Frames:
    """Return the pictures at some times (None: where the fading begins), from a file that holds a fade basis.

    Raises:
        PhoslabError: the file is no fade basis, or a time is before it.
    """
    basis, scene, off_s, exposures = read_fade_basis(path)
    frames = []
    for text in times or [f"{basis.t0_s:.12g}"]:
        # The lights are over: of their schedule only the end still names times.
        courses = {} if off_s is None else {"light": Course(Switched(((0.0, off_s),)))}
        t_s = Schedule(courses).parse_time(text)
        frames.append(Frame(t_s, text, basis.bands, basis.at(t_s)))
    return Frames(tuple(frames), scene=scene, solver="exact", exposures=exposures)
