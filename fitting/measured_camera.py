"""What a session of `flats` tells of a camera: its settings, its noise, its shading. Nothing on its dial is trusted."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from phoslab.errors import PhoslabError
from phoslab.fitting.card import Shading, find_card, fit_shading
from phoslab.fitting.photon_transfer import Noise, photon_transfer
from phoslab.fitting.settings import Settings, fit_settings
from phoslab.raw import preview
from phoslab.session import Frame, Session

UNMEASURED_REPEATABILITY = 0.005
"""Shutters, lens apertures and gain steps of a camera repeat to about this, whatever the light."""

_LEAST_REPEATABILITY = 0.002
"""Overlaps cannot show less than their lamp flickers."""

_SHADED = 4
"""Flat frames that shading is told from."""


@dataclass(frozen=True, eq=False)
class MeasuredCamera:
    """A camera as its flats show it; by default one of which nothing is known.

    Args:
        settings: what exposure times, ISO and apertures are.
        settings_misfit: of the overlaps, as a share; None: nobody looked.
        noise: by ISO, of one pixel.
        shading: how unevenly an even card shows; None: unknown.
        warnings: one sentence each.
    """

    settings: Settings = field(default_factory=Settings)
    settings_misfit: float | None = None
    noise: Mapping[float, Noise] = field(default_factory=dict)
    shading: Shading | None = None
    warnings: tuple[str, ...] = ()

    @property
    def repeatability(self) -> float:
        """Relative standard deviation of a whole frame: of its shutter, and of what is not known of its settings."""
        if self.settings_misfit is None:
            return UNMEASURED_REPEATABILITY
        return max(self.settings_misfit, _LEAST_REPEATABILITY)

    def factor(self, frame: Frame) -> float:
        """What turns DN of a frame into DN of 1 s at ISO 100 and f/1."""
        return 1 / self.settings.gain(frame.exposure_s, frame.iso, frame.f_number)


def measure_camera(session: Session, progress: Callable[[int, int], None] | None = None) -> MeasuredCamera:
    """Measure settings, noise and shading from a session of the plan `flats`; what it does not carry is said.

    Raises:
        PhoslabError: the session is of another plan, or carries nothing at all.
    """
    if session.header.plan != "flats":
        raise PhoslabError(
            f"is of the plan {session.header.plan!r}",
            file=session.path,
            remedy="Name one of the plan 'flats'.",
        )
    fit = fit_settings(session, progress)
    warnings = list(fit.warnings)
    try:
        noise = photon_transfer(session)
    except PhoslabError as error:
        noise = {}
        warnings.append(f"{error} Noise is taken from the pixels of each frame.")
    shading = None
    try:
        shading = measure_shading(session)
    except PhoslabError as error:
        warnings.append(f"{error} How unevenly the lens and the lamp show an even surface is not known.")
    return MeasuredCamera(fit.settings, fit.misfit, noise, shading, tuple(warnings))


def measure_shading(session: Session) -> Shading:
    """Fit the shading to some flat frames of one setting, the one of which there are most, dark frames taken off.

    Raises:
        PhoslabError: there are none, or no card is seen in them.
    """
    darks: dict[tuple[float, float], list[Frame]] = {}
    for frame in session.frames_of("dark"):
        darks.setdefault((frame.exposure_s, frame.iso), []).append(frame)
    lit: dict[tuple[float, float, float | None], list[Frame]] = {}
    for frame in session.frames_of("flat"):
        if (frame.exposure_s, frame.iso) in darks:
            lit.setdefault((frame.exposure_s, frame.iso, frame.f_number), []).append(frame)
    if not lit:
        raise PhoslabError(
            "has no flat frame with dark frames of its setting",
            file=session.path,
            remedy="Record a session of the plan 'flats'.",
        )
    lowest = min(iso for _, iso, _ in lit)
    # At the lowest ISO the most light, hence the least noise; of those the widest lens, which the samples are seen by.
    setting = max(lit, key=lambda s: (s[1] == lowest, -(s[2] or 0.0), len(lit[s]), s[0]))
    frames = lit[setting][:_SHADED]
    pictures = [preview(f.path) for f in frames]
    dark = np.mean([preview(f.path).image for f in darks[setting[:2]][:_SHADED]], axis=0)
    card = find_card(pictures[0])
    image = np.mean([p.image for p in pictures], axis=0) - dark
    return fit_shading(image, pictures[0], card)
