"""The pictures of one scene: how bright each is shown, and writing them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phoslab.colorimetry import xyz_to_linear_srgb
from phoslab.errors import PhoslabError
from phoslab.render import images
from phoslab.render.frame import Frame
from phoslab.render.scene import Exposure

# An automatic exposure brings this share of the pixels that are not dark below display white.
AUTO_PERCENTILE, AUTO_LEVEL = 99.5, 0.95
AUTO_DARK = 1e-4

# Linear, of display white: half of the first step of 8-bit sRGB.
BLACK = 0.5 / 255 / 12.92


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames of one scene, in the order asked for, and how to show them.

    Args:
        scene: where they come from, for the files' metadata: the scene's folder and file.
        about: more for the files' metadata, by name.
    """

    frames: tuple[Frame, ...]
    scene: str
    solver: str
    exposures: tuple[Exposure, ...]
    about: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> Frame:
        return self.frames[index]

    @property
    def warnings(self) -> tuple[str, ...]:
        """The warnings of all frames, each once, and which of them are shown black."""
        black = (darkness(frame, self.exposure_of(frame)) for frame in self.frames)
        each = [w for frame in self.frames for w in frame.warnings] + [w for w in black if w is not None]
        return tuple(dict.fromkeys(each))

    def exposure_of(self, frame: Frame) -> float:
        """Return the factor from luminance to display white that is in force at the frame's time.

        An automatic one is chosen on the earliest of these frames to which it applies, and kept: what fades is
        then seen to fade.
        """
        at = max(k for k, e in enumerate(self.exposures) if e.from_s <= frame.time_s)
        factor = self.exposures[at].factor
        if factor is not None:
            return factor
        end = self.exposures[at + 1].from_s if at + 1 < len(self.exposures) else np.inf
        shown = [f for f in self.frames if self.exposures[at].from_s <= f.time_s < end]
        return auto_exposure(min(shown, key=lambda f: f.time_s).xyz)

    def write(self, out: str | PathLike[str]) -> list[Path]:
        """Write every frame as PNG (display colours) or EXR (bands and XYZ), by the suffix of `out`.

        Several frames have their time in the name: `glow.png` becomes `glow-off+80s.png`. Debug views lie beside.

        Returns:
            The files written. Each is whole or absent.

        Raises:
            PhoslabError: the suffix is another, or the folder cannot be written to.
        """
        out = Path(out)
        check_suffix(out)
        written = []
        # A time that was asked for twice is one file.
        each = {frame.label: frame for frame in self.frames}.values()
        for frame in each:
            path = out if len(each) == 1 else out.with_name(f"{out.stem}-{frame.label}{out.suffix}")
            if out.suffix.lower() == ".exr":
                images.write_exr(path, frame, scene=self.scene, solver=self.solver, about=self.about)
            else:
                images.write_png(
                    path,
                    frame,
                    scene=self.scene,
                    solver=self.solver,
                    exposure=self.exposure_of(frame),
                    about=self.about,
                )
            written.append(path)
            for name, view in frame.debug.items():
                beside = path.with_name(f"{path.stem}.{name}.png")
                images.write_view(beside, view)
                written.append(beside)
        return written


def check_suffix(out: Path) -> None:
    """Refuse a file name whose kind cannot be written: better before rendering than after."""
    if out.suffix.lower() not in (".png", ".exr"):
        raise PhoslabError(
            f"has the suffix {out.suffix!r}", file=out, remedy="Name a .png or .exr file to write."
        )


def darkness(frame: Frame, exposure: float) -> str | None:
    """Return what to say of a picture that is shown black; None where something is to be seen."""
    largest = float(frame.xyz[..., 1].max(initial=0.0))
    if largest * exposure >= BLACK:
        return None
    if largest == 0.0:
        return (
            f"the picture at {frame.time_s:g} s is black: no light falls on what is seen, and nothing glows"
        )
    return (
        f"the picture at {frame.time_s:g} s is shown black: the exposure in force would have to be "
        f"{1 / (largest * exposure):.2g} times as long; give [display] exposures of the scene a later `from`"
    )


def auto_exposure(xyz: NDArray[np.float32]) -> float:
    """Return the factor that shows (h, w, 3) XYZ well: bright, with next to nothing clipped."""
    wide = xyz.astype(np.float64)
    rgb, grey = wide @ xyz_to_linear_srgb(), wide[..., 1]
    # What the display makes of a colour outside its gamut is paler and less bright: that is what must fit.
    low, high = np.minimum(rgb.min(axis=-1), 0.0), rgb.max(axis=-1)
    keep = np.divide(grey, grey - low, out=np.ones_like(grey), where=low < 0)
    brightest = np.maximum(grey + keep * (high - grey), 0.0)
    seen = brightest[brightest > AUTO_DARK * brightest.max(initial=0.0)]
    return AUTO_LEVEL / float(np.percentile(seen, AUTO_PERCENTILE)) if seen.size else 1.0
