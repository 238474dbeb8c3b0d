"""What the model takes for granted, judged by a session of the plan `check` that could contradict it.

* Decays from several levels are one curve but for a factor (Nalbach 2017, Fig. 8.11), and share their rates.
* The spectrum is constant in time (Fig. 8.9), and the same whatever lamp has excited (8.3).
* The sample glows alike in all directions (8.3).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError, printable
from phoslab.fitting.decay import fit_decay
from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.find_strip import follow_strip
from phoslab.fitting.lvf import Calibration, positions
from phoslab.fitting.measured_camera import UNMEASURED_REPEATABILITY
from phoslab.fitting.parts import SessionPart, finished_parts
from phoslab.fitting.region import find_sample
from phoslab.fitting.selection import select
from phoslab.fitting.settings import Settings
from phoslab.fitting.strip_light import read_light
from phoslab.fitting.verdict import Misfit, Verdict, judge, untested
from phoslab.raw import RegionMeans, frame_means, preview
from phoslab.session import Frame, Session

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

_UNCALIBRATED = 0.02
"""Standard deviation of what a dial's setting means, where no calibration says it."""

_LONELY = 5.0
"""Standard deviations: of some hundred values none is so far off by chance."""


def check_assumptions(
    session: Session, calibration: Calibration | None = None, progress: Progress | None = None
) -> tuple[Verdict, ...]:
    """Judge every claim that the session has frames for.

    Args:
        session: of the plan "check".
        calibration: of the LVF, without which spectra are not compared and the camera's settings not known so well.
        progress: called with (frames done, frames in all).

    Raises:
        PhoslabError: the session is of another plan, or no part of it was finished.
    """
    if session.header.plan != "check":
        raise PhoslabError(
            f"is of the plan {session.header.plan!r}",
            file=session.path,
            remedy="Name a session of the plan 'check': phoslab measure check.",
        )
    parts = finished_parts(session)
    if not parts:
        raise PhoslabError(
            "has no finished part with frames", file=session.path, remedy="Go on with it: phoslab resume."
        )
    settings = calibration.settings if calibration is not None else Settings()
    decays = [p for p in parts if p.frames[0].role == "decay" and len(p.frames) > 1]
    views = [p for p in parts if p.frames[0].role == "decay" and len(p.frames) == 1]
    spectra = [p for p in parts if p.frames[0].role == "emission"]
    lights = _Lights(session, settings, progress)
    series = {p.name: lights.decay(p) for p in decays}
    # At one setting, what it means does not matter.
    alike = len({(f.exposure_s, f.iso, f.f_number) for p in views for f in p.frames}) == 1
    return (
        *_one_shape(series),
        *_one_spectrum(session, spectra, calibration),
        _one_brightness({p.name: (p, lights.decay(p, alike=alike)) for p in views}, series),
    )


class _Lights:
    """Reads the sample's light in frames without the LVF: all channels together, dark frames taken off."""

    def __init__(self, session: Session, settings: Settings, progress: Progress | None) -> None:
        self._session, self._settings, self._progress = session, settings, progress
        self._darks: dict[tuple[float, float], tuple[Array, Array]] = {}

    def decay(self, part: SessionPart, *, alike: bool = False) -> DecayData:
        """Read a part as a decay of one channel, the sum of red, green and blue.

        Args:
            alike: what it is compared with was taken at the same setting.

        Raises:
            PhoslabError: a frame has no dark frame, or shows no sample.
        """
        region = find_sample(preview(part.frames[0].path))
        means = frame_means(part.frames, region, progress=self._progress)
        rows = [self._light(f, m, region, alike) for f, m in zip(part.frames, means, strict=True)]
        off_s = part.lamp_off_s if part.lamp_off_s is not None else part.frames[0].start_s
        signal, sigma = np.array(rows).T
        return DecayData(
            t_s=np.array([f.start_s - off_s for f in part.frames]),
            exposure_s=np.array([f.exposure_s for f in part.frames]),
            signal=signal[:, None],
            sigma=sigma[:, None],
            channels=(part.name,),
        )

    def _light(
        self, frame: Frame, seen: RegionMeans, region: NDArray[np.bool_], alike: bool
    ) -> tuple[float, float]:
        dark, dark_variance = self._dark(frame, region)
        gain = self._settings.gain(frame.exposure_s, frame.iso, frame.f_number)
        total = float((seen.mean - dark).sum()) / gain
        noise = float(np.sqrt((seen.variance + dark_variance).sum())) / gain
        if not np.isfinite(total) or (seen.n_saturated > 1e-3 * (seen.n_saturated + seen.n_pixels)).any():
            return 0.0, np.inf
        # ISO is the setting that dials miss by most.
        known = alike or ("iso", frame.iso) in self._settings.corrections
        return total, float(np.hypot(noise, (UNMEASURED_REPEATABILITY if known else _UNCALIBRATED) * total))

    def _dark(self, frame: Frame, region: NDArray[np.bool_]) -> tuple[Array, Array]:
        setting = frame.exposure_s, frame.iso
        if setting not in self._darks:
            frames = [f for f in self._session.frames_of("dark") if (f.exposure_s, f.iso) == setting]
            if not frames:
                raise PhoslabError(
                    f"has no dark frame for {setting[0]:g} s at ISO {setting[1]:g}",
                    file=self._session.path,
                    remedy="Black level and dark current cannot be told from light without: go on with the session, "
                    "phoslab resume.",
                )
            means = frame_means(frames, region)
            self._darks[setting] = (
                np.mean([m.mean for m in means], axis=0),
                np.sum([m.variance for m in means], axis=0) / len(means) ** 2,
            )
        return self._darks[setting]


def _one_shape(series: Mapping[str, DecayData]) -> list[Verdict]:
    """Whether decays from several levels are one curve, and whether they share their rates."""
    shape = "Decays from several levels are one curve but for a factor."
    rates = "Decays from several levels share their rates."
    if len(series) < 2:
        return [untested(c, "the session has fewer than two decays") for c in (shape, rates)]
    joint = _side_by_side(list(series.values()))
    # One curve: the factor of each series is its "colour". Shared rates: each series has amplitudes of its own.
    # As many states as one series alone asks for: with more, shared rates would be the rates of one and of the other.
    n = max(select(d, offsets=[False]).chosen.n_states for d in series.values())
    shared = fit_decay(joint, n, rank_one=False)
    one = fit_decay(joint, n, near=[shared.theta[:n]])
    own = [fit_decay(d, n, rank_one=False, near=[shared.theta[:n]]) for d in series.values()]
    misfits = [Misfit(f.chi2, f.dof) for f in (one, shared)]
    misfits.append(Misfit(sum(f.chi2 for f in own), sum(f.dof for f in own)))
    ends = (
        "States fill at speeds of their own, which the model knows; only the decay after one charge does not stand for "
        "the decay after another.",
        "The rates fitted to one level serve for the others.",
    )
    noise = (joint.sigma / np.abs(joint.signal))[joint.used]
    found = []
    for k, (claim, fit) in enumerate(((shape, one), (rates, shared))):
        off = (joint.signal / fit.predict(joint.t_s, joint.exposure_s) - 1)[joint.used]
        found.append(judge(claim, off, noise, misfits[k], misfits[k + 1], ends[k]))
    return found


def _side_by_side(series: Sequence[DecayData]) -> DecayData:
    """Return decays as channels of one: all times, each channel used at its own."""
    n = [d.t_s.size for d in series]
    signal, sigma = np.zeros((sum(n), len(n))), np.full((sum(n), len(n)), np.inf)
    for k, (d, start) in enumerate(zip(series, np.cumsum([0, *n]), strict=False)):
        rows = slice(int(start), int(start) + d.t_s.size)
        signal[rows, k], sigma[rows, k] = d.signal[:, 0], d.sigma[:, 0]
    return DecayData(
        t_s=np.concatenate([d.t_s for d in series]),
        exposure_s=np.concatenate([d.exposure_s for d in series]),
        signal=signal,
        sigma=sigma,
        channels=tuple(d.channels[0] for d in series),
    )


def _one_spectrum(
    session: Session, parts: Sequence[SessionPart], calibration: Calibration | None
) -> list[Verdict]:
    """Whether the spectrum is constant in time, and the same behind every filter before the lamp."""
    in_time, lamp = "The spectrum is constant in time.", "The spectrum does not depend on the lamp."
    if calibration is None:
        why = "spectra need the filter's calibration: name it with --lvf"
        return [untested(c, why) for c in (in_time, lamp)]
    if not parts:
        return [untested(c, "the session has no frames through the LVF") for c in (in_time, lamp)]
    strip, _ = follow_strip(preview(parts[0].frames[0].path), calibration.strip)
    by_part: list[list[tuple[Array, Array]]] = []
    weights = np.nan_to_num(calibration.reading(0.0))
    for part in parts:
        seen = []
        for frame in part.frames:
            lights, _ = read_light(session, [frame], strip, calibration.settings)
            if lights:
                signal, sigma = positions([lights[0].signal], [lights[0].sigma], weights)
                seen.append((signal[:, 0], sigma[:, 0]))
        by_part.append(seen)
    first = [s[0] for s in by_part if s]
    names = ", ".join(str(p.placed.get("filter", "none")) for p, s in zip(parts, by_part, strict=True) if s)
    return [
        _proportional(
            in_time,
            [s for s in by_part if len(s) > 1],
            "one part with two frames at least",
            "The spectrum of one moment stands for all.",
        ),
        _proportional(
            lamp,
            [first] if len(first) > 1 else [],
            "a filter before the lamp: phoslab measure check --lamp-filters NAME,...",
            f"Compared: {printable(names)}.",
        ),
    ]


def _proportional(claim: str, groups: Sequence[list[tuple[Array, Array]]], need: str, end: str) -> Verdict:
    """Whether the lights of each group, (n_k, 3) with σ, are one light but for a factor."""
    if not groups:
        return untested(claim, f"that needs {need}")
    chi2, dof, n_lonely = 0.0, 0, 0
    off, noise = [], []
    for lights in groups:
        y, sigma = (np.stack(parts) for parts in zip(*lights, strict=True))  # (n, n_k, 3)
        used = np.isfinite(sigma).all(axis=0)
        for _ in range(2):
            scale, profile = _rank_one(y[:, used], sigma[:, used])
            z = np.zeros(y.shape)
            z[:, used] = (y[:, used] - scale[:, None] * profile) / sigma[:, used]
            lonely = used & _lonely(z)
            n_lonely += int(lonely.sum())
            used &= ~lonely
        z = z[:, used]
        chi2 += float((z**2).sum())
        dof += (len(lights) - 1) * (int(used.sum()) - 1)
        # As a share of each light's own root mean square: faint ends do not count for more than they are.
        typical = scale[:, None] * np.sqrt(np.mean(profile**2))
        off.append((z * sigma[:, used] / typical).ravel())
        noise.append((sigma[:, used] / typical).ravel())
    if n_lonely:
        end += f" {n_lonely} values that stand alone (hot pixels) are left out."
    return judge(claim, np.concatenate(off), np.concatenate(noise), Misfit(chi2, dof), Misfit(0.0, 0), end)


def _lonely(z: Array) -> NDArray[np.bool_]:
    """Return (n_k, 3) values off by more than chance, z (n, n_k, 3), while their neighbours along the strip are not.

    A spectrum's change is as wide as the filter's bands, which several positions share; a hot pixel is in one.
    """
    neighbours = np.zeros(z.shape)
    neighbours[:, 1:-1] = (z[:, :-2] + z[:, 2:]) / 2
    return np.asarray((np.abs(z - neighbours) > _LONELY).any(axis=0))


def _rank_one(y: Array, sigma: Array) -> tuple[Array, Array]:
    """Return scale (n,) and profile (m,) that minimise Σ ((y - scale profile) / σ)², by turns."""
    w = 1 / sigma**2
    scale = np.maximum(y.sum(axis=1), 1e-12 * np.abs(y).max())
    profile = np.zeros(y.shape[1])
    for _ in range(200):
        profile = (w * y * scale[:, None]).sum(axis=0) / (w * scale[:, None] ** 2).sum(axis=0)
        new = (w * y * profile).sum(axis=1) / (w * profile**2).sum(axis=1)
        still = np.abs(new / scale - 1).max() < 1e-12
        scale = new
        if still:
            break
    return scale, profile


def _one_brightness(
    views: Mapping[str, tuple[SessionPart, DecayData]], series: Mapping[str, DecayData]
) -> Verdict:
    """Whether the sample is as bright from all sides."""
    claim = "The sample glows alike in all directions."
    seen = [(part, light) for part, light in views.values() if light.used.all()]
    if len(seen) < 2:
        return untested(claim, "the session has fewer than two directions")
    factor = np.ones(len(seen))
    if series:
        # Frames were not taken at quite the same moment: the decay after the longest charge says what that makes.
        longest = list(series.values())[-1]
        n = select(longest, offsets=[False]).chosen.n_states
        course = fit_decay(longest, n, rank_one=False)
        factor = np.array([course.predict(v.t_s, v.exposure_s)[0, 0] for _, v in seen])
        factor /= factor.mean()
    value = np.array([v.signal[0, 0] for _, v in seen]) / factor
    sigma = np.array([v.sigma[0, 0] for _, v in seen]) / factor
    w = 1 / sigma**2
    mean = float((w * value).sum() / w.sum())
    off = value / mean - 1
    k = int(np.argmax(np.abs(off)))
    left = Misfit(float(((off * mean / sigma) ** 2).sum()), len(seen) - 1)
    end = (
        f"Farthest from the mean at {seen[k][0].placed.get('angle_deg', '?')} degrees: {100 * off[k]:+.1f} %."
    )
    return judge(claim, off, sigma / mean, left, Misfit(0.0, 0), end)
