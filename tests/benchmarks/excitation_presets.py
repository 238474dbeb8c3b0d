"""Fit the excitation of the bench's eight paints, and say what came out and how far it is off.

    python tests/benchmarks/excitation_presets.py DIR [PRESET ...]

DIR is to hold, for each preset, what `phoslab measure all --only decay,excitation --simulate PRESET -o DIR/PRESET`
leaves; what is not there is measured first (two minutes each). Where the filter lies, what it lets through and the
lamp's light are taken as known; the paint is not: it holds traps of many depths, and does not obey the model.

The truth of a band's excitation, up to a factor for each paint: the electrons that the lamp's light in it sets free
in a second. The factor is not comparable, since a trap distribution has no r; so the table compares shares of the
whole. Beside them: how well the glow's level after the longest exposure is met, how the modelled rise compares with
the measured one, and how saturation (the scale of ke) is correlated with Λ and r(0).
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phoslab.bands import Bands
from phoslab.fitting.charging import LampCourse, Steps, Table
from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.excitation import ExcitationFit, fit_excitation
from phoslab.fitting.excitation_model import Charge, ExcitationData
from phoslab.fitting.light import Shapes
from phoslab.fitting.selection import select
from phoslab.instruments.bench import lights, scene
from phoslab.instruments.bench.courses import Bulb
from phoslab.instruments.bench.lvf import Lvf
from phoslab.instruments.bench.paints import paint
from phoslab.raw import exposure_factor, read_raw
from phoslab.session import Frame, Session

Array = NDArray[np.float64]

PRESETS = ("blue", "green", "orange", "pink", "purple", "red", "white", "yellow")
NM = np.arange(360.0, 781.0)
POSITIONS_NM = np.linspace(400.0, 700.0, 31)
REPEATABILITY = 0.005
CUTS = 2
"""Parts into which nodes cut each of the eight bands."""


def lamp_course(bulb: Bulb) -> LampCourse:
    """The bench's lamp: most of its light within 0.1 s, the rest as it warms up over minutes; off as a square."""

    def rise(t: Array) -> Array:
        return np.asarray((1 - np.exp(-t / bulb.rise_s)) * (1 - bulb.cold * np.exp(-t / bulb.warm_s)))

    edges = np.concatenate([np.linspace(0, 1, 33), np.geomspace(1, 1800, 33)[1:]])
    level = np.concatenate([Table.of(rise, 1.0, 32).level, rise((edges[32:-1] + edges[33:]) / 2)])
    return LampCourse(Table(edges, level), Table.of(lambda t: (1 - t / bulb.fade_s) ** 2, bulb.fade_s))


@dataclass(frozen=True, eq=False)
class Places:
    """Masks (n_places, h, w) along the filter, and (h, w) beside it on the paint, and off the paint."""

    along: NDArray[np.bool_]
    u: list[Array]
    beside: NDArray[np.bool_]
    off: NDArray[np.bool_]


def places(shape: tuple[int, int], lvf: Lvf) -> Places:
    """31 stretches of 10 nm, from the middle two thirds of the filter's width."""
    view = scene.View.of(shape)
    right, down = scene.STRIP.across(view.x_mm, view.y_mm)
    u = view.mean(right + lvf.tilt * (down - 0.5))
    across = view.mean(down)
    inside = (np.abs(across - 0.5) < 0.33) & (u > 0.01) & (u < 0.99)
    nm = lvf.centre_nm(u.ravel()).reshape(u.shape)
    along = [inside & (np.abs(nm - centre) < 5) for centre in POSITIONS_NM]
    painted = view.mean(scene.SAMPLE.covers(view.x_mm, view.y_mm)) == 1
    beside = painted & (np.abs(across - 0.5) > 0.9) & (np.abs(across - 0.5) < 1.3) & (u > 0.05) & (u < 0.95)
    off = view.mean(scene.SAMPLE.covers(view.x_mm, view.y_mm)) == 0
    return Places(np.stack(along), [u[m] for m in along], beside, off)


def means(
    frames: tuple[Frame, ...], darks: tuple[Frame, ...], masks: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Signal and its σ, (n_frames, n_masks, 3), dark frames subtracted, exposure divided out; NaN where clipped."""
    colours = read_raw(frames[0].path).colours
    pixels = [[np.nonzero((mask & (colours == c)).ravel())[0] for c in range(3)] for mask in masks]

    def one(frame: Frame) -> tuple[Array, Array]:
        raw = read_raw(frame.path)
        linear, clipped = raw.linear.ravel().astype(float), raw.saturated.ravel()
        value, variance = np.empty((len(masks), 3)), np.empty((len(masks), 3))
        for m, c in np.ndindex(len(masks), 3):
            x = linear[pixels[m][c]]
            # Hot pixels are left out; the rest of the spread is noise and the glow's own slope over 10 nm.
            near = np.abs(x - np.median(x)) <= 5 * 1.48 * np.median(np.abs(x - np.median(x))) + 1e-9
            value[m, c] = np.nan if clipped[pixels[m][c]].mean() > 0.01 else x[near].mean()
            variance[m, c] = x[near].var() / near.sum()
        return value, variance

    known: dict[tuple[float, float], tuple[Array, Array]] = {}
    for setting in {(f.exposure_s, f.iso) for f in frames}:
        same = [one(f) for f in darks if (f.exposure_s, f.iso) == setting]
        known[setting] = (np.mean([v for v, _ in same], 0), np.sum([s for _, s in same], 0) / len(same) ** 2)
    signal, sigma = [], []
    for f in frames:
        value, variance = one(f)
        dark, dark_variance = known[f.exposure_s, f.iso]
        factor = exposure_factor(f.exposure_s, f.iso, f.f_number)
        signal.append((value - dark) * factor)
        sigma.append(np.sqrt(variance + dark_variance) * factor)
    return np.array(signal), np.array(sigma)


def lit(session: Session, frames: tuple[Frame, ...]) -> tuple[Array, Array]:
    """(n,) how long the lamp had shone before each frame, and how long it had been off."""
    edges = session.edges_of("lamp")
    times = []
    for f in frames:
        off = max(e.at_s for e in edges if e.to == "off" and e.at_s <= f.start_s)
        on = max(e.at_s for e in edges if e.to == "on" and e.at_s <= off)
        times.append((off - on, f.start_s - off))
    a, b = np.array(times).T
    return a, b


def fitted(folder: Path) -> tuple[ExcitationFit, ExcitationData, Charge]:
    """Fit one preset's two sessions; the fit, and what went in."""
    decay, excitation = Session.open(folder / "01-decay"), Session.open(folder / "02-excitation")
    lvf, lamp = Lvf(), lamp_course(Bulb())
    spectrum = lights.halogen(3000.0)(NM)
    frames = excitation.frames_of("excitation")
    shape = read_raw(frames[0].path).values.shape
    where = places(shape, lvf)
    shapes = Shapes.lines(Bands.uniform(), CUTS)
    transmission = np.stack([lvf.transmission(u, NM).mean(axis=0) for u in where.u])
    light, full = shapes.light(NM, spectrum, transmission), shapes.light(NM, spectrum)

    fading = decay.frames_of("decay")
    off_s = decay.lamp_off_s or 0.0
    masks = np.concatenate([where.along, [where.along.any(axis=0), where.off]])
    seen, noise = means(fading, decay.frames_of("dark"), masks)
    bright = seen[:, :-1] - seen[:, -1:]
    whole = np.where(np.isfinite(noise[:, -2]) & np.isfinite(seen[:, -2]), noise[:, -2], np.inf)
    data = DecayData(
        t_s=np.array([f.start_s - off_s for f in fading]),
        exposure_s=np.array([f.exposure_s for f in fading]),
        signal=np.nan_to_num(bright[:, -1]),
        sigma=whole,
        repeatability=REPEATABILITY,
    )
    fit = select(data, rank_one=True, offsets=(False,), states=(1, 2, 3)).chosen.fit
    charged = Steps.of(np.array([5400.0]), np.array([0.5]), np.array([0.01]), lamp)
    charge = Charge.from_decay(fit, charged, full)
    green = int(np.argmax(fit.colour))
    response = np.nanmean((bright[:, :-1] / bright[:, -1:])[:12, :, green], axis=0)

    masks = np.concatenate([where.along, [where.beside]])
    seen, noise = means(frames, excitation.frames_of("dark"), masks)
    glow = seen[:, :-1] - seen[:, -1:]
    # All three channels through the decay's colour: as one, of the strongest channel.
    weight = np.where(np.isfinite(glow), 1 / noise[:, :-1] ** 2, 0.0)
    information = (weight * fit.colour**2).sum(axis=2)
    signal = (weight * fit.colour * np.nan_to_num(glow)).sum(axis=2) / np.maximum(information, 1e-300)
    sigma = np.where(information > 0, 1 / np.sqrt(np.maximum(information, 1e-300)), np.inf)
    on, since = lit(excitation, frames)
    steps = Steps.of(on, since, np.array([f.exposure_s for f in frames]), lamp)
    means_of = shapes.band_means(NM, spectrum)
    measured = ExcitationData(steps, signal, sigma, light, shapes.bands, means_of, response, REPEATABILITY)
    return fit_excitation(measured, charge), measured, charge


def truth(name: str) -> Array:
    """(8,) share of each band in what the whole lamp excites."""
    light = lights.halogen(3000.0)(NM)
    part = Shapes(Bands.uniform()).light(NM, light * paint(name).excitation(NM))
    return np.asarray(part / part.sum())


def measure(name: str, folder: Path) -> None:
    command = [sys.executable, "-m", "phoslab", "measure", "all", "--only", "decay,excitation"]
    subprocess.run([*command, "--simulate", name, "-o", str(folder)], check=True, stdout=subprocess.DEVNULL)


def main() -> None:
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    where, chosen = Path(sys.argv[1]), sys.argv[2:] or PRESETS
    np.set_printoptions(precision=3, suppress=True, linewidth=150)
    for name in chosen:
        if not (where / name).exists():
            measure(name, where / name)
        fit, _, _ = fitted(where / name)
        stored = fit.product.sum(axis=0) * Shapes(fit.bands).light(NM, lights.halogen(3000.0)(NM))
        print(f"[[{name}]] kr {fit.kr_per_s} 1/s, {'one shape' if fit.common_shape else 'own shapes'}")
        print(f"  discrepancy {fit.discrepancy:.2f}, chi-square / dof {fit.chi2 / fit.dof:.2f}")
        print(
            f"  level, bright places      median {np.nanmedian(np.abs(fit.level_error)):.1%}, "
            f"worst {np.nanmax(np.abs(fit.level_error)):.1%}"
        )
        ratio = fit.rise_s[:, 1] / fit.rise_s[:, 0]
        print(
            f"  half rise, model/measured {np.nanmedian(ratio):.2f} ({np.nanmedian(fit.rise_s[:, 0]):.1f} s measured)"
        )
        for i in range(fit.n_states):
            known = "only Λ ke" if fit.product_only[i] else "ke"
            print(
                f"  state {i}: {known}; a {fit.a_per_s[i]:.3g} 1/s, r(0) {fit.initial[i]:.2f}, error of log a "
                f"{fit.scale_error[i]:.2f}, correlation of log a with log Λ {fit.correlation[i, 0]:.2f}, "
                f"with log r(0) {fit.correlation[i, 1]:.2f}"
            )
            print(f"    ke [1e-3]    {1e3 * fit.ke_m2_per_J[i]}")
            print(
                f"    relative se of Λ ke {fit.product_standard_error[i] / np.maximum(fit.product[i], 1e-300)}"
            )
            print(f"    upper limit  {1e3 * fit.ke_upper_limit[i]}")
        print(f"  share of excitation by band {stored / stored.sum()}")
        print(f"  truth                       {truth(name)}")


if __name__ == "__main__":
    main()
