"""From the frames of an excitation session to what `fitting.excitation` takes: the glow at places under the filter.

The filter lies on the sample where it lay before the camera, so that its calibration says which light came to which
place: lamp times transmission. What is read there is brought to one channel by the decay's colour, and compared with
the same places of the decay session, where the whole lamp had charged them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phoslab.bands import Bands
from phoslab.errors import PhoslabError
from phoslab.fitting.charging import LampCourse, Steps, Table
from phoslab.fitting.decay import DecayFit
from phoslab.fitting.excitation_model import Charge, ExcitationData
from phoslab.fitting.find_strip import follow_strip
from phoslab.fitting.lamp_light import NM, LampLight
from phoslab.fitting.light import Shapes
from phoslab.fitting.lvf import POSITIONS_NM, Calibration
from phoslab.fitting.lvf_curves import GRID_NM
from phoslab.fitting.measured_camera import MeasuredCamera
from phoslab.fitting.reduction import ReducedDecay, decay_frames
from phoslab.raw import preview
from phoslab.session import Frame, Session
from phoslab.strip import Strip, StripSignal, mean_signal, read_strip

Array = NDArray[np.float64]

FADE_S = 0.32
"""Of a lamp whose rig says nothing (Nalbach 2017, 8.4.6)."""

_NODES_NM = 19.0
"""Bands are cut into parts of at most this width: half of what the strip passes. See `fitting.light`."""

_FADE_STEPS = 8
"""Of a fade of 0.3 s: the error (see `fitting.charging`) is 1e-4 of the light of an exposure of 1 s, at k = 1/s."""

_COMPARED = 12
"""Decay frames that say how bright the paint is at each place."""

_LEAST_LEFT = 0.5
"""Of the places and frames of a series, this share must have some colour that is not saturated."""

_RESTED = 3.0
"""A rest shorter than so many lifetimes of the slowest state leaves more than a twentieth of it behind."""


@dataclass(frozen=True, eq=False)
class ExcitationSeries:
    """An excitation series, ready to fit.

    Args:
        data, charge: see `fitting.excitation_model`.
        positions_nm: (n_places,) which wavelength passes there.
        outlined: whether the filter's outline was found in a frame; if not, it is taken to lie where it was calibrated.
        warnings: one sentence each.
    """

    data: ExcitationData
    charge: Charge
    positions_nm: Array
    outlined: bool
    warnings: tuple[str, ...]


def reduce_excitation(
    session: Session,
    decay_session: Session,
    decay: ReducedDecay,
    fit: DecayFit,
    calibration: Calibration,
    lamp: LampLight,
    camera: MeasuredCamera,
    bands: Bands,
    progress: Callable[[int, int], None] | None = None,
) -> ExcitationSeries:
    """Read an excitation session along the filter, and the decay session at the same places.

    Args:
        decay: what `decay_session` was reduced to; `fit` is the decay's fit, of one colour.
        lamp: the whole lamp's light.
        bands: in which rates are wanted.

    Raises:
        PhoslabError: the calibration has no curves, the session has no usable frames, or frames without dark ones.
    """
    if calibration.curves is None:
        raise PhoslabError(
            "holds no transmission curves: which light comes to which place is not known",
            file="the calibration",
            remedy="Calibrate from a session that has LED frames, and name the LED's spectrum.",
        )
    frames = _lit_frames(session)
    warnings = list(_doubts(session, fit, calibration))
    strip, outlined = follow_strip(preview(max(frames, key=_light_then(session)).path), calibration.strip)
    there = np.isfinite(calibration.reading()).all(axis=1) & np.isfinite(calibration.curves.curve).all(axis=1)
    weights = calibration.reading()[there]
    glow = _Places.read(session, frames, strip, weights, camera, scattered=True, progress=progress)
    response = _response(decay_session, decay, fit, strip, weights, camera)

    # All three channels through the decay's colour: as one, of the strongest channel.
    information = np.where(np.isfinite(glow.sigma), 1 / glow.sigma**2, 0.0)
    total = (information * fit.colour**2).sum(axis=2)
    signal = (information * fit.colour * glow.signal).sum(axis=2) / np.maximum(total, 1e-300)
    sigma = np.where(total > 0, 1 / np.sqrt(np.maximum(total, 1e-300)), np.inf)
    sigma = np.where(response > 0, sigma, np.inf)
    lost = ~np.isfinite(glow.sigma)
    told = f"{lost.sum()} of {lost.size} values along the filter are saturated"
    if not np.isfinite(sigma[:, response > 0]).sum() > _LEAST_LEFT * (response > 0).sum() * len(frames):
        raise PhoslabError(
            f"is over-exposed: {told}",
            file=session.path,
            remedy="Record it anew with shorter exposures, a lower ISO or a smaller aperture.",
        )
    if lost.any():
        warnings.append(f"{session.path.name}: {told} and left out.")

    course = LampCourse(fade=_fade(fade_s(session)))
    on_s, off_s = np.array([_last_light(session, f) for f in frames]).T
    exposure_s = np.array([camera.settings.exposure_s(f.exposure_s) for f in frames])
    start_s = np.array([f.start_s for f in frames])
    shapes = Shapes.lines(bands, int(np.ceil(bands.widths_nm.max() / _NODES_NM)))
    curves = np.stack([np.interp(NM, GRID_NM, row) for row in calibration.curves.curve[there]])
    data = ExcitationData(
        steps=Steps.of(off_s - on_s, start_s - off_s, exposure_s, course),
        signal=np.where(np.isfinite(sigma), signal, 0.0),
        sigma=sigma,
        light=shapes.light(NM, lamp.irradiance, curves),
        bands=bands,
        band_means=shapes.band_means(NM, lamp.irradiance),
        response=np.where(response > 0, response, 1.0),
        repeatability=camera.repeatability,
    )
    charged = Steps.of(
        np.array([charged_s(decay_session)]),
        np.array([fade_s(decay_session) + 0.1]),
        np.array([0.01]),
        course,
    )
    charge = Charge.from_decay(fit, charged, shapes.light(NM, lamp.irradiance))
    return ExcitationSeries(data, charge, POSITIONS_NM[there], outlined, tuple(warnings))


def fade_s(session: Session) -> float:
    """How long the session's lamp takes to fade, as its rig file says."""
    lamp = session.header.rig.get("lamp", {})
    told = lamp.get("fade_s") if hasattr(lamp, "get") else None
    return float(told if told is not None else session.header.rig.get("lamp_fade_s", FADE_S))


def _fade(duration_s: float) -> Table:
    """Light that falls in a straight line, in `_FADE_STEPS` steps."""
    return Table.of(lambda t: 1 - t / duration_s, duration_s, _FADE_STEPS)


def charged_s(session: Session) -> float:
    """How long the lamp had shone on the sample of a decay session, all trials together.

    Raises:
        PhoslabError: the journal does not say when the lamp was on.
    """
    total, on_s = 0.0, None
    for edge in session.edges_of("lamp"):
        if edge.to == "on":
            on_s = edge.at_s
        elif on_s is not None:
            total, on_s = total + edge.at_s - on_s, None
    if total <= 0:
        raise PhoslabError(
            "never says when the lamp was on",
            file=session.path / "journal.jsonl",
            remedy="How full the sample was cannot be told: record the session anew.",
        )
    return total


@dataclass(frozen=True, eq=False)
class _Places:
    """What frames show at each place: (n_frames, n_places, 3) signal of 1 s at ISO 100 and f/1, and its σ."""

    signal: Array
    sigma: Array

    @classmethod
    def read(
        cls,
        session: Session,
        frames: Sequence[Frame],
        strip: Strip,
        weights: Array,
        camera: MeasuredCamera,
        *,
        scattered: bool,
        progress: Callable[[int, int], None] | None = None,
    ) -> _Places:
        settings = {(f.exposure_s, f.iso) for f in frames}
        darks = [f for f in session.frames_of("dark") if (f.exposure_s, f.iso) in settings]
        missing = sorted(settings - {(f.exposure_s, f.iso) for f in darks})
        if missing:
            text = ", ".join(f"{t:g} s at ISO {iso:g}" for t, iso in missing)
            raise PhoslabError(
                f"has no dark frame for {text}", file=session.path, remedy="Record dark frames with it."
            )
        read = read_strip([*frames, *darks], strip, progress=progress)
        by_setting: dict[tuple[float, float], list[StripSignal]] = {}
        for frame, seen in zip(darks, read[len(frames) :], strict=True):
            by_setting.setdefault((frame.exposure_s, frame.iso), []).append(seen)
        dark_of = {setting: mean_signal(seen) for setting, seen in by_setting.items()}
        signal, sigma = [], []
        for frame, seen in zip(frames, read, strict=False):
            dark = dark_of[frame.exposure_s, frame.iso]
            beside = seen.beside - dark.beside if scattered else np.zeros(3)
            factor = camera.factor(frame)
            signal.append(weights @ np.nan_to_num(seen.signal - dark.signal - beside) * factor)
            variance = seen.variance + dark.variance
            lost = seen.saturated | ~np.isfinite(variance) | ~np.isfinite(seen.signal - dark.signal)
            noise = np.sqrt(weights**2 @ np.where(lost, 0.0, variance)) * factor
            sigma.append(np.where(weights @ lost.astype(float) > 0, np.inf, noise))
        return cls(np.array(signal), np.array(sigma))


def _response(
    session: Session,
    decay: ReducedDecay,
    fit: DecayFit,
    strip: Strip,
    weights: Array,
    camera: MeasuredCamera,
) -> Array:
    """(n_places,) how bright places under the filter are in the decay, relative to its signal; 0 where unknown."""
    frames = decay_frames(session)
    strongest = int(np.argmax(fit.colour))
    usable = np.flatnonzero(decay.data.used.all(axis=1))[:_COMPARED]
    places = _Places.read(session, [frames[k] for k in usable], strip, weights, camera, scattered=False)
    whole = decay.data.signal[usable, strongest]
    # The light that is scattered lies over the places as well as over the sample.
    share = decay.scattered[strongest]
    over = share / (1 - share) * decay.shading * whole
    ratio = (places.signal[:, :, strongest] - over[:, None]) / whole[:, None]
    seen = np.isfinite(places.sigma[:, :, strongest])
    n = seen.sum(axis=0)
    mean = np.divide(np.where(seen, ratio, 0.0).sum(axis=0), n, out=np.zeros(len(n)), where=n > 0)
    return np.asarray(np.maximum(mean, 0.0))


def _lit_frames(session: Session) -> list[Frame]:
    frames = [f for f in session.frames_of("excitation") if _last_light(session, f) is not None]
    if session.header.plan != "excitation" or not frames:
        raise PhoslabError(
            f"is of the plan {session.header.plan!r} with {len(frames)} frames of a sample that was lit",
            file=session.path,
            remedy="Name a session of the plan 'excitation'.",
        )
    return frames


def _last_light(session: Session, frame: Frame) -> tuple[float, float] | None:
    """When the lamp went on and off for the last time before a frame."""
    edges = [e for e in session.edges_of("lamp") if e.at_s <= frame.start_s]
    for on, off in zip(edges[-2::-1], edges[::-1], strict=False):
        if (on.to, off.to) == ("on", "off"):
            return on.at_s, off.at_s
    return None


def _light_then(session: Session) -> Callable[[Frame], float]:
    def lit(frame: Frame) -> float:
        on_off = _last_light(session, frame)
        return 0.0 if on_off is None else on_off[1] - on_off[0]

    return lit


def _doubts(session: Session, fit: DecayFit, calibration: Calibration) -> list[str]:
    said = []
    rest = session.header.parameters.get("dark_s")
    slowest = float(fit.kr_per_s.min())
    if rest is not None and float(rest) * slowest < _RESTED:
        said.append(
            f"{session.path.name}: the sample rested {float(rest):g} s between exposures, and its slowest state lives "
            f"{1 / slowest:.3g} s: what was left of earlier light counts as glow of the next."
        )
    if not calibration.absolute:
        said.append(
            "The filter's transmission is known but for a factor: how far it darkens the lamp, and with it how full "
            "the states were, is off by that."
        )
    return said
