"""A film of pictures as a display shows them: H.264 in an .mp4 that is whole or absent."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from fractions import Fraction
from os import PathLike
from pathlib import Path
from types import TracebackType

import numpy as np

from phoslab.colorimetry import display_bytes
from phoslab.errors import PhoslabError
from phoslab.files import replacing
from phoslab.render.frame import Frame
from phoslab.render.frames import auto_exposure, darkness
from phoslab.render.scene import Exposure

# An hour at 60 a second, and five times that.
MOST_FRAMES = 1_000_000
MOST_FPS = 1000.0
# Of x264: below 18 a person sees no difference; glow has soft gradients in the dark, where too few bits make bands.
QUALITY = "14"


def film_times(from_s: float, to_s: float, fps: float) -> list[float]:
    """Return the times of a film's pictures: from `from_s` on, before `to_s`.

    Raises:
        PhoslabError: there is none, or too many.

    >>> film_times(1.0, 1.5, 4.0)
    [1.0, 1.25]
    """
    if not 0 < fps <= MOST_FPS:
        raise PhoslabError(f"is {fps:g} a second", field="--fps", remedy=f"Use up to {MOST_FPS:g}.")
    # A remainder below a millionth of a picture is rounding.
    n = int(np.ceil((to_s - from_s) * fps - 1e-6))
    if n < 1:
        raise PhoslabError(
            f"from {from_s:g} s to {to_s:g} s holds no picture", field="the film", remedy="End it later."
        )
    if n > MOST_FRAMES:
        raise PhoslabError(
            f"has {n} pictures", field="the film", remedy=f"Use fewer than {MOST_FRAMES}: --fps, --to."
        )
    return [from_s + k / fps for k in range(n)]


class Film:
    """Takes frames in ascending order of time; the file appears when all went well.

    An automatic exposure is chosen on the first picture to which it applies, as in pictures one by one.

    Args:
        size: (width, height) in pixels; an odd side is one longer, its last pixels twice there.
    """

    def __init__(
        self, out: str | PathLike[str], size: tuple[int, int], fps: float, exposures: Sequence[Exposure]
    ) -> None:
        self._out, self._size, self._exposures = Path(out), size, exposures
        self._rate = Fraction(fps).limit_denominator(1001)
        self._auto: dict[int, float] = {}
        self._warnings: dict[str, None] = {}
        self._black = self._shown = 0

    def __enter__(self) -> Film:
        import av

        self._stack = ExitStack()
        temporary = self._stack.enter_context(replacing(self._out))
        self._container = self._stack.enter_context(av.open(str(temporary), "w", format="mp4"))
        self._stream = self._container.add_stream("libx264", rate=self._rate)
        w, h = self._size
        self._stream.width, self._stream.height = w + w % 2, h + h % 2
        self._stream.pix_fmt = "yuv420p"
        self._stream.options = {"crf": QUALITY, "preset": "veryfast", "movflags": "+faststart"}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            try:
                self._container.mux(self._stream.encode())
            except BaseException as late:
                self._stack.__exit__(type(late), late, late.__traceback__)
                raise
        self._stack.__exit__(kind, error, trace)

    def show(self, frame: Frame) -> None:
        """Append a picture."""
        import av

        exposure = self._exposure(frame)
        self._shown += 1
        self._black += darkness(frame, exposure) is not None
        self._warnings |= dict.fromkeys(frame.warnings)
        rgb = display_bytes(frame.xyz, exposure)
        rgb = np.pad(rgb, ((0, rgb.shape[0] % 2), (0, rgb.shape[1] % 2), (0, 0)), mode="edge")
        picture = av.VideoFrame.from_ndarray(rgb, format="rgb24")
        self._container.mux(self._stream.encode(picture))

    def _exposure(self, frame: Frame) -> float:
        at = max(k for k, e in enumerate(self._exposures) if e.from_s <= frame.time_s)
        factor = self._exposures[at].factor
        if factor is not None:
            return factor
        if at not in self._auto:
            # What is black has no exposure of its own: the next picture is asked.
            if not frame.radiance.any():
                return 1.0
            self._auto[at] = auto_exposure(frame.xyz)
        return self._auto[at]

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the frames warn of, and how many are black."""
        black = (
            (
                f"{self._black} of {self._shown} pictures are shown black: see [display] exposures in the scene",
            )
            if self._black
            else ()
        )
        return (*self._warnings, *black)
