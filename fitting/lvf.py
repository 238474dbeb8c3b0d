"""Calibrate a linear variable filter from recorded sessions: which wavelengths pass where, and how much of them.

    calibrate([sessions]) -> Calibration, which is what lvf.json holds (docs/formats-lvf.md).

It delivers what the sessions carry: without a mercury lamp the wavelengths rest on the LED's colours, without an LED
there are wavelengths but no curves, without flats the camera's settings count as what their numbers stand for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.fitting.card import Shading
from phoslab.fitting.find_strip import find_strip
from phoslab.fitting.lvf_curves import GRID_NM, X_NM, Curves, fit_curves
from phoslab.fitting.measured_camera import MeasuredCamera, measure_camera
from phoslab.fitting.photon_transfer import Noise
from phoslab.fitting.sensitivities import Sensitivities
from phoslab.fitting.settings import Settings
from phoslab.fitting.strip_light import StripLight, read_light
from phoslab.fitting.wavelength_map import NM, KnownLight, WavelengthMap, fit_map
from phoslab.raw import preview
from phoslab.session import Frame, Session
from phoslab.spectra import spectrum
from phoslab.strip import INSIDE, Strip

Array = NDArray[np.float64]

POSITIONS_NM = np.arange(400.0, 701.0, 10.0)
"""Where the strip is read: 31 positions (Nalbach 2017, 8.4.2)."""

HALF_NM = 4.0
"""A position is read over so much to either side."""

FEW_FILTERS = 8
"""With fewer, curves rest on their smoothness more than on data."""

REPEATABILITY = 0.003
"""How well a camera repeats a setting and a lamp its light, as a share of the signal."""

_MARGIN = 0.08
"""Share of the lit length that is read beyond its ends."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated strip before a camera.

    Args:
        strip: where it lies in a frame.
        map: the wavelength at each place.
        places_px: (n_k,) s of the positions; NaN for one that does not lie on the strip.
        curves: transmission at `GRID_NM` of each position; None without an LED.
        absolute: curves are shares of light; else in an unknown unit, the same for all.
        sensitivities: the camera's, gains included.
        settings: what the camera's settings are.
        light: name of the LED's spectrum, or None.
        filters: names of the filters that took part.
        sessions: (name, plan, SHA-256) of each.
        simulated: the statement of simulated sessions, or None.
        warnings: one sentence each.
        settings_misfit: of the overlaps, None without flats.
        noise: of the camera by ISO; empty without flats.
        shading: how unevenly an even card shows under the lamp; None without flats.
    """

    strip: Strip
    map: WavelengthMap
    places_px: Array
    curves: Curves | None
    absolute: bool
    sensitivities: Sensitivities
    settings: Settings
    light: str | None
    filters: tuple[str, ...]
    sessions: tuple[tuple[str, str, str], ...]
    simulated: str | None = None
    warnings: tuple[str, ...] = field(default=())
    settings_misfit: float | None = None
    noise: Mapping[float, Noise] = field(default_factory=dict)
    shading: Shading | None = None

    @property
    def body(self) -> MeasuredCamera:
        """The camera as the flats of this calibration showed it."""
        return MeasuredCamera(self.settings, self.settings_misfit, self.noise, self.shading)

    def reading(self, shift_px: float = 0.0) -> Array:
        """(n_k, n) weights that turn values at the strip's nodes into means over each position; NaN off the strip.

        Args:
            shift_px: by how much the strip has moved along itself since the calibration.
        """
        return reading(self.strip, self.map, shift_px)


def reading(strip: Strip, at: WavelengthMap, shift_px: float = 0.0) -> Array:
    """See `Calibration.reading`."""
    nodes = strip.nodes_px
    step = nodes[1] - nodes[0]
    fine = np.linspace(nodes[0], nodes[-1], 20 * nodes.size)
    nm = at.nm(fine)
    weights = np.full((POSITIONS_NM.size, nodes.size), np.nan)
    for k, position in enumerate(POSITIONS_NM):
        inside = np.abs(nm - position) <= HALF_NM
        s = fine[inside] + shift_px
        # All of a position must lie on the strip, and what is beyond the nodes is not seen.
        if not inside.any() or inside[0] or inside[-1] or s.min() < nodes[0] or s.max() > nodes[-1]:
            continue
        weights[k] = np.maximum(0.0, 1 - np.abs(s[:, None] - nodes) / step).mean(axis=0)
    return weights


def calibrate(
    paths: Sequence[Path],
    *,
    led: str | None = None,
    camera: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Calibration:
    """Calibrate from sessions: one of the plan `lvf`, and, if there is one, of `flats`; others are named and left out.

    Args:
        led: the white LED's spectrum, as `phoslab.spectra` names it; None: what the rig file says.
        camera: sensitivities, as colour-science names them or a rawtoaces JSON file; None: what the session says.
        progress: called with (frames done, frames in all) of each step.

    Raises:
        PhoslabError: there is no `lvf` session or more than one; it has neither mercury nor LED frames
        that can be used;
            no sensitivities; or the strip cannot be found.
    """
    sessions = [Session.open(path) for path in paths]
    warnings = [w for s in sessions for w in s.warnings]
    main = _only(sessions, "lvf")
    flats = [s for s in sessions if s.header.plan == "flats"]
    for s in sessions:
        if s.header.plan not in ("lvf", "flats"):
            warnings.append(
                f"{s.path}: is of the plan {s.header.plan!r}, which calibrates nothing, and is left out."
            )
    body = MeasuredCamera()
    if flats:
        body = measure_camera(flats[-1], progress)
        warnings += body.warnings
    else:
        warnings.append(
            "There is no session of the plan 'flats': exposure times, ISO and apertures count as the "
            "powers of two that their "
            "numbers stand for, which a camera meets to a few per cent."
        )
    sensitivities = Sensitivities.of(camera or main.header.sensitivities, file=main.path)
    known = _known_filters(main, warnings)
    light = led or _rig_led(main)
    strip, lights = _read(main, known, body.settings, warnings, progress)
    mercury = lights.get("mercury")
    roles = [r for r in ("led", *(f"filter:{n}" for n in known)) if r in lights]
    if light is None and roles:
        warnings.append(
            f"{main.path}: nothing says what the LED's spectrum is, so its frames serve for nothing and "
            f"there are no curves. "
            "Name it with --led, or in the rig file as led.spectrum."
        )
        roles = []
    if mercury is None and not roles:
        raise PhoslabError(
            "has neither usable frames of a mercury lamp nor of an LED whose spectrum is known",
            file=main.path,
            remedy="Record a session of the plan 'lvf'; name the LED's spectrum with --led.",
        )
    evenness = shading(lights.get("flat"))
    known_lights = [
        _known(lights[role], evenness, _spectrum(light, known.get(role.removeprefix("filter:")), NM))
        for role in roles
    ]
    at_nm = sensitivities.at(NM)
    seen_mercury = None if mercury is None else _known(mercury, evenness, np.zeros(NM.size))
    if mercury is None:
        warnings.append(
            f"{main.path}: has no usable frame of a mercury lamp: wavelengths rest on the colours and "
            f"the edges of the filters, "
            "and are as good as the camera's sensitivities."
        )
    at = fit_map(strip.nodes_px, seen_mercury, known_lights, at_nm)
    curves = None
    filters = tuple(r.removeprefix("filter:") for r in roles if r != "led")
    if known_lights:
        if len(filters) < FEW_FILTERS:
            warnings.append(
                f"Only {len(filters)} filters: the curves' shapes rest on their being smooth more than on data. "
                f"Take {FEW_FILTERS} or more, of different colours."
            )
        # The bands' true shape locates them better than the first one did.
        first = _curves(strip, at, known_lights, at_nm)
        if first is not None:
            before = at
            at = fit_map(strip.nodes_px, seen_mercury, known_lights, at_nm, (X_NM, first.shape(POSITIONS_NM)))
            # What the bands' shape does to the map is not in its covariance.
            moved = at.coefficients_nm - before.coefficients_nm
            at = replace(at, covariance_nm2=at.covariance_nm2 + np.outer(moved, moved))
            curves = _curves(strip, at, known_lights, sensitivities.times(at.gains).at(NM))
    if seen_mercury is not None:
        for feature in at.features:
            if not feature.seen:
                warnings.append(f"Mercury's line at {feature.name} nm is not seen; the others stand in.")
    if curves is not None and curves.at_end:
        warnings.append("The data do not say how smooth the curves are; the smoothest is taken.")
    gains = at.gains
    for c, name in ((0, "red"), (2, "blue")):
        if abs(np.log(gains[c])) > 0.05:
            warnings.append(
                f"The camera's {name} is {gains[c]:.2f} of what its sensitivities say, against green: "
                f"it is another body, "
                "or the LED has another spectrum."
            )
    absolute = curves is not None and evenness is not None
    if curves is not None and not absolute:
        warnings.append(
            f"{main.path}: has no usable 'flat' frame of the card under the LED without the strip: how "
            f"unevenly the LED lights it "
            "is taken for the strip's own, and transmissions are relative."
        )
    if absolute and curves is not None:
        # What the card sends without the strip, in the same unit.
        flat = lights["flat"]
        whole = np.nansum(_spectrum(light, None, NM)[:, None] * sensitivities.times(gains).at(NM), axis=0) * (
            NM[1] - NM[0]
        )
        middle = np.average(flat.signal, axis=0, weights=np.isfinite(flat.sigma).all(axis=1).astype(float))
        share = float(whole.sum() / middle.sum())
        curves = curves.times(share)
    return Calibration(
        strip=strip,
        map=at,
        places_px=at.place(POSITIONS_NM),
        curves=curves,
        absolute=absolute,
        sensitivities=sensitivities.times(gains),
        settings=body.settings,
        light=light if roles else None,
        filters=filters,
        sessions=tuple((s.path.resolve().name, s.header.plan, s.digest) for s in (main, *flats[-1:])),
        simulated=(main.header.simulated or {}).get("statement"),
        warnings=tuple(dict.fromkeys(warnings)),
        settings_misfit=body.settings_misfit,
        noise=body.noise,
        shading=body.shading,
    )


def _only(sessions: Sequence[Session], plan: str) -> Session:
    found = [s for s in sessions if s.header.plan == plan]
    if len(found) != 1:
        plans = ", ".join(sorted({s.header.plan for s in sessions}))
        how_many = "no session" if not found else f"{len(found)} sessions"
        raise PhoslabError(
            f"has {how_many} of the plan {plan!r} among those named (plans: {plans or 'none'})",
            field="the calibration",
            remedy=f"Name one session of the plan {plan!r}, and beside it one of 'flats' if there is one.",
        )
    return found[0]


def _rig_led(session: Session) -> str | None:
    led = session.header.rig.get("led", {})
    return str(led["spectrum"]) if "spectrum" in led else None


def _known_filters(session: Session, warnings: list[str]) -> dict[str, tuple[Array, Array]]:
    """Wavelengths and transmission of the session's filters, of those whose curves are known."""
    from phoslab.fitting.filters import transmission

    known = {}
    unknown = []
    for name in dict.fromkeys(f.role.removeprefix("filter:") for f in session.frames_of("filter:")):
        curve = transmission(name)
        if curve is None:
            unknown.append(name)
        else:
            known[name] = curve
    if unknown:
        warnings.append(
            f"{session.path}: lighting-filters holds no curve of {', '.join(unknown)}; their frames are left out."
        )
    return known


def _read(
    session: Session,
    known: Mapping[str, tuple[Array, Array]],
    settings: Settings,
    warnings: list[str],
    progress: Callable[[int, int], None] | None,
) -> tuple[Strip, dict[str, StripLight]]:
    """Find the strip and read every light along it."""
    frames: list[Frame] = [
        *session.frames_of("mercury"),
        *session.frames_of("led"),
        *(f for f in session.frames_of("filter:") if f.role.removeprefix("filter:") in known),
    ]
    if not frames:
        raise PhoslabError(
            "has no frames of a mercury lamp, an LED or a known filter",
            file=session.path,
            remedy="Record a session of the plan 'lvf'.",
        )
    whole = (session.frames_of("led") or session.frames_of("mercury") or frames)[0]
    found = find_strip(preview(whole.path))
    low, high = found.ends_px
    room = _MARGIN * (high - low)
    limit = found.shape[1] if abs(np.cos(np.deg2rad(found.angle_deg))) > 0.7 else found.shape[0]
    strip = replace(found, ends_px=(max(low - room, -limit / 2 + 2), min(high + room, limit / 2 - 2)))
    if session.frames_of("mercury"):
        strip = replace(strip, slant=_slant(session, strip, settings))
    lights, said = read_light(session, frames, strip, settings, progress=progress)
    warnings += said
    flat, said = read_light(session, session.frames_of("flat"), strip, settings, scattered=False)
    warnings += said
    return strip, {x.role: x for x in (*lights, *flat)}


def _slant(session: Session, strip: Strip, settings: Settings) -> float:
    """dx/dy of the lines of one wavelength: by how much mercury's lines are shifted from the upper to
    the lower half."""
    mercury = session.frames_of("mercury")[:1]
    middle = sum(INSIDE) / 2
    halves = []
    for part in ((INSIDE[0], middle), (middle, INSIDE[1])):
        lights, _ = read_light(session, mercury, strip, settings, part=part)
        if not lights:
            return 0.0
        halves.append(lights[0])
    upper, lower = halves
    used = np.isfinite(upper.sigma) & np.isfinite(lower.sigma)
    if not used.any():
        return 0.0
    slope = np.gradient((upper.signal + lower.signal) / 2, strip.nodes_px, axis=0)
    # lower(s) = gain * upper(s - shift), to first order.
    A = np.stack([upper.signal[used], -slope[used]], axis=1)
    noise = np.hypot(upper.sigma, lower.sigma)[used]
    (_, shift), *_ = np.linalg.lstsq(A / noise[:, None], lower.signal[used] / noise, rcond=None)
    apart = (INSIDE[1] - INSIDE[0]) / 2 * strip.width_px
    return float(shift / apart)


def shading(flat: StripLight | None, degree: int = 4) -> Array | None:
    """(n,) how evenly a surface is lit and the lens lets pass, mean 1; None if nothing says.

    Args:
        flat: the surface without the strip.
        degree: of the polynomial that smooths it: a light and a lens need less than a painted sample.
    """
    if flat is None or not np.isfinite(flat.sigma).all(axis=1).any():
        return None
    good = np.isfinite(flat.sigma).all(axis=1)
    total = flat.signal.sum(axis=1)
    n = np.arange(total.size)
    # A light's and a lens's shading are smooth: noise is not to be carried over.
    curve = np.polynomial.Chebyshev.fit(n[good], total[good], degree)(n)
    return np.asarray(curve / curve[good].mean())


def _known(light: StripLight, evenness: Array | None, known: Array) -> KnownLight:
    even = 1.0 if evenness is None else evenness[:, None]
    sigma = np.hypot(light.sigma, REPEATABILITY * light.signal)
    return KnownLight(light.role, light.signal / even, sigma / even, known)


def _spectrum(light: str | None, filtered: tuple[Array, Array] | None, nm: Array) -> Array:
    base = spectrum(light, file=Path("--led"), field="the LED's spectrum")(nm) if light else np.ones(nm.size)
    if filtered is None:
        return base
    return np.asarray(base * np.interp(nm, *filtered))


def _curves(
    strip: Strip, at: WavelengthMap, lights: Sequence[KnownLight], sensitivities: Array
) -> Curves | None:
    weights = reading(strip, at)
    there = np.isfinite(weights).all(axis=1)
    if there.sum() < 3:
        return None
    signal, sigma = positions([x.signal for x in lights], [x.sigma for x in lights], weights[there])
    fitted = fit_curves(
        POSITIONS_NM[there], signal, sigma, np.stack([x.spectrum for x in lights]), sensitivities, NM
    )
    curve = np.full((there.size, GRID_NM.size), np.nan)
    error = curve.copy()
    curve[there], error[there] = fitted.curve, fitted.standard_error
    assert fitted.covariance is not None
    covariance = np.full((there.size, *fitted.covariance.shape[1:]), np.nan)
    covariance[there] = fitted.covariance
    return replace(fitted, curve=curve, standard_error=error, covariance=covariance)


def positions(signals: Sequence[Array], sigmas: Sequence[Array], weights: Array) -> tuple[Array, Array]:
    """(n_k, n_f, 3) signals of nodes (n, 3) read at positions by `weights` (n_k, n), and their standard deviations."""
    signal = np.stack([weights @ x for x in signals], axis=1)
    sigma = np.stack([np.sqrt(weights**2 @ np.where(np.isfinite(s), s, 0.0) ** 2) for s in sigmas], axis=1)
    lost = np.stack([weights @ (~np.isfinite(s)).astype(float) > 0 for s in sigmas], axis=1)
    return signal, np.where(lost, np.inf, sigma)
