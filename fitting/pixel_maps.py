"""From a decay session to maps of a material whose rates and brightness vary over its surface.

The sample as a whole is fitted first: it gives the number of states, excitation rates, spectrum and calibration. Then
each pixel is fitted by itself with that number of states, and its rates and emission replace the sample's.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phoslab.errors import PhoslabError
from phoslab.exr import write_channels
from phoslab.fitting.decay_starts import rate_limits
from phoslab.fitting.engine import Fits, here
from phoslab.fitting.pixel_decay import Flag, PixelFits, PixelNoise, PixelProblem
from phoslab.fitting.pixel_frames import PixelFrames, stored
from phoslab.fitting.result import FitResult
from phoslab.maps import channel_names, write_map
from phoslab.material import Material
from phoslab.session import Frame, Session

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]

# What stands below this share of the sample's median brightness is not the sample: a lens scatters a few percent.
_STRAY = 0.05
# Spread beyond this many standard errors is said to be of the material.
_VARIES = 1.5


@dataclass(frozen=True, eq=False)
class PixelMaps:
    """What was fitted at each pixel of a map: (h, w) cells of `cell` sensor pixels a side.

    Args:
        whole: the fit of the sample as a whole.
        fits: of all (h w) pixels, row by row from the top; of those that were not fitted 0.
        shape: (h, w).
        cell: side of a pixel of the map in pixels of the sensor.
        corner_px: (y, x) of the map's first pixel on the sensor.
        gain: DN per electron at ISO 100.
        read_dn: noise of a sensor's pixel without light, in the frames with the least and the most of it.
        moved_px: (n_frames, 2) see `PixelFrames`.
    """

    whole: FitResult
    fits: PixelFits
    shape: tuple[int, int]
    cell: int
    corner_px: tuple[int, int]
    gain: float
    read_dn: tuple[float, float]
    moved_px: Array

    @property
    def fitted(self) -> NDArray[np.bool_]:
        """(h w) the pixels that have numbers."""
        fitted: NDArray[np.bool_] = (self.fits.flags & (Flag.MASKED | Flag.DARK)) == 0
        return fitted

    def counts(self) -> dict[str, int]:
        """Return how many pixels there are, are fitted, and have each flag."""
        flags = {flag.name.lower(): int((self.fits.flags & flag > 0).sum()) for flag in Flag if flag.name}
        return {"pixels": self.fits.flags.size, "fitted": int(self.fitted.sum()), **flags}

    def spread(self) -> list[dict[str, float]]:
        """Return, for each state, median and quantiles of its rates, their median error, and spread over error."""
        rows = []
        for i in range(self.whole.fit.n_states):
            has = self.fitted & (self.fits.amplitude[:, i] > 0) & (self.fits.flags & Flag.UNDETERMINED == 0)
            kr, error = (v[has, i].astype(float) for v in (self.fits.kr_per_s, self.fits.kr_error))
            if not kr.size:
                rows.append(dict.fromkeys(("median", "low16", "high84", "error", "excess"), float("nan")))
                continue
            low, middle, high = np.percentile(kr, [16, 50, 84])
            rows.append(
                {
                    "median": float(middle),
                    "low16": float(low),
                    "high84": float(high),
                    "error": float(np.median(error)),
                    "excess": float((high - low) / 2 / np.median(error)),
                }
            )
        return rows

    def warnings(self) -> list[str]:
        """Say what of the maps should not be believed, one sentence each."""
        n, fitted = self.counts(), max(1, int(self.fitted.sum()))
        said = []
        if self.whole.reduced.camera.shading is None:
            said.append(
                "Brightness is as the camera saw it: the lens's falloff towards the corners is in the emission map, "
                "since no session of the plan 'flats' is among those named."
            )
        lost = int(np.isnan(self.moved_px).any(axis=1).sum())
        far = float(np.nanmax(np.abs(self.moved_px), initial=0.0))
        if far > self.cell / 2:
            said.append(
                f"The picture moved by up to {far:.1f} pixels of the sensor; frames were laid on each other to half a "
                "pixel of the maps, so that edges are less sharp than they were. Fasten camera and sample."
            )
        if lost:
            said.append(f"In {lost} frames the sample is too faint to tell whether it moved.")
        for flag, share, text in (
            ("fewer", 0.02, "carry fewer states than the sample as a whole; the others are dark there"),
            ("undetermined", 0.02, "have a rate that their light does not determine: see the error maps"),
            ("misfit", 0.05, "are missed by the model by more than noise; their errors are widened"),
            ("unconverged", 0.0, "were given up before their search ended"),
            ("clipped", 0.02, "have saturated values, or hot ones, that are left out"),
        ):
            if n[flag] > share * fitted:
                said.append(f"{n[flag] / fitted:.1%} of the pixels {text}.")
        return said

    def report(self) -> str:
        """Return the maps as text."""
        n, (h, w) = self.counts(), self.shape
        lines = [
            self.whole.report(),
            f"[[pixels: {w} x {h}, each {self.cell} x {self.cell} of the sensor]]",
            f"  fitted                  {n['fitted']} of {n['pixels']}"
            f" ({n['masked']} do not glow, {n['dark']} are too dark)",
            f"  noise of a sensor pixel {self.read_dn[0]:.2g} to {self.read_dn[1]:.2g} DN without light,"
            f" {self.gain:.3g} DN an electron at ISO 100",
        ]
        for i, row in enumerate(self.spread()):
            varies = "varies over the sample" if row["excess"] > _VARIES else "as much as its errors explain"
            lines.append(
                f"  kr[{i + 1}] [1/s]           median {row['median']:.4g}, two thirds in {row['low16']:.4g} .. "
                f"{row['high84']:.4g}; error of a pixel {row['error']:.2g}: {varies}"
            )
        lines.append("[[warnings of the pixels]]")
        lines += [f"  {text}" for text in self.warnings()]
        return "\n".join(lines) + "\n"


def fit_maps(
    session: Session,
    whole: FitResult,
    scratch: Path,
    *,
    side: int = 1,
    engine: Fits = here,
    decoded: Callable[[int, int], None] | None = None,
    fitted: Callable[[int, int], None] | None = None,
) -> PixelMaps:
    """Fit every pixel of a decay session.

    Args:
        session: of the plan "decay".
        whole: the fit of the same session; its number of states, and its rates as one start, are taken over.
        scratch: folder for a temporary file of 2 bytes a pixel and frame.
        side: of a map's pixel, in units of the colour pattern (2 x 2 pixels).
        engine: what fits.
        decoded, fitted: called with (frames done, in all) and (rows done, in all).

    Raises:
        PhoslabError: see `pixel_frames.stored`; or no pixel stands out from the dark.
    """
    data, fit = whole.reduced.data, whole.fit
    off_s = session.lamp_off_s
    frames = [f for f in session.frames_of("decay") if off_s is not None and f.start_s >= off_s]
    camera = whole.reduced.camera
    with stored(session, frames, scratch, side=side, camera=camera, progress=decoded) as store:
        gain = electron_dn(session, frames, whole, store)
        iso = np.array([f.iso / 100 for f in frames])
        per_cell = store.pixels_a_colour
        problem = PixelProblem(
            t_s=data.t_s,
            exposure_s=data.exposure_s,
            noise=PixelNoise(
                floor=(store.read_dn2 * store.scale**2)[:, None] / per_cell,
                gain=(gain * iso * store.scale)[:, None] / per_cell,
                repeatability=data.repeatability,
            ),
            typical=fit.predict(data.t_s, data.exposure_s),
            n_states=fit.n_states,
            limits_per_s=rate_limits(data),
            near_per_s=fit.kr_per_s,
        )
        glows = glowing(store, whole.reduced.region, float(store.read_dn2.sum()))
        rows, columns = (np.flatnonzero(glows.any(axis=axis)) for axis in (1, 0))
        top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
        shape = (int(bottom - top), int(right - left))
        fits = PixelFits.empty(shape[0] * shape[1], fit.n_states, data.signal.shape[1])
        fits.flags[:] = Flag.MASKED
        places: deque[tuple[NDArray[np.intp], int]] = deque()

        def strips() -> Iterator[Pixels]:
            for first, signal in store.strips():
                y0, y1 = max(first, top), min(first + len(signal), bottom)
                if y0 < y1:
                    inside = np.flatnonzero(glows[y0:y1, left:right])
                    places.append((inside + (y0 - top) * shape[1], int(y1 - top)))
                    yield signal[y0 - first : y1 - first, left:right].reshape(-1, *signal.shape[2:])[inside]

        for found in engine(problem, strips()):
            place, n_rows = places.popleft()
            for name, array in vars(fits).items():
                array[place] = getattr(found, name)
            if fitted:
                fitted(n_rows, shape[0])
    if camera.shading is not None:
        middle = (np.arange(n) + 0.5 for n in shape)
        row, column = (k * store.cell for k in np.meshgrid(*middle, indexing="ij"))
        evenness = camera.shading.at(row + top * store.cell - 0.5, column + left * store.cell - 0.5)
        for values in (fits.amplitude, fits.amplitude_error):
            values /= evenness.reshape(-1, 1).astype(np.float32)
    _match_states(fits, fit.kr_per_s)
    corner = (int(top) * store.cell, int(left) * store.cell)
    read_dn = (float(store.read_dn2.min()) ** 0.5, float(store.read_dn2.max()) ** 0.5)
    return PixelMaps(whole, fits, shape, store.cell, corner, gain, read_dn, store.moved_px)


def electron_dn(session: Session, frames: list[Frame], whole: FitResult, store: PixelFrames) -> float:
    """Return DN per electron at ISO 100, from the frames themselves: σ² = read² + gain (ISO/100) S.

    σ² is what each frame's own second differences say of a pixel at the sample's mean signal (see
    `phoslab.raw.region_means`); read² what the dark frames say.
    """
    data, region = whole.reduced.data, whole.reduced.region
    h, w = store.shape
    n_pixels = np.zeros(3)
    for y in range(2):
        for x in range(2):
            n_pixels[store.colours[y, x]] += np.count_nonzero(region[y:h:2, x:w:2])
    settings = [(f.exposure_s, f.iso) for f in session.frames_of("dark")]
    n_darks = np.array([settings.count((f.exposure_s, f.iso)) for f in frames])
    used = np.isfinite(data.sigma)
    variance = np.where(used, data.sigma / store.scale[:, None], 1.0) ** 2 * n_pixels
    # The variance of the mean dark frame is in sigma, too.
    of_light = variance - (store.read_dn2 * (1 + 1 / n_darks))[:, None]
    iso = np.array([f.iso / 100 for f in frames])
    slope = np.maximum(data.signal, 0) / store.scale[:, None] * iso[:, None]
    a, b = (slope / variance)[used], (of_light / variance)[used]
    return max(0.0, float(a @ b / (a @ a))) if a.any() else 0.0


def glowing(store: PixelFrames, region: NDArray[np.bool_], read_dn2: float) -> NDArray[np.bool_]:
    """Return (h, w) the cells that glow, by all frames together.

    Args:
        region: pixels of the sensor that are the sample's for certain.
        read_dn2: variance of a sensor pixel's sum over all frames, without light.

    Raises:
        PhoslabError: none does.
    """
    h, w = store.shape
    cell = store.cell
    inside = region[:h, :w].reshape(h // cell, cell, w // cell, cell).all(axis=(1, 3))
    typical = float(np.median(store.total[inside])) if inside.any() else 0.0
    least = max(_STRAY * typical, 5 * cell * read_dn2**0.5)
    glows: NDArray[np.bool_] = store.total > least
    if not inside.any() or not glows.any():
        raise PhoslabError(
            "has no pixel that stands out from the dark, or a sample of less than one of the maps' pixels",
            field="--bin",
            remedy="Average fewer or more pixels, or fit the sample as a whole, without --per-pixel.",
        )
    return glows


def _match_states(fits: PixelFits, kr_per_s: Array) -> None:
    """Put the states of pixels that have fewer than the sample where their rates are nearest to the sample's."""
    n_states = kr_per_s.size
    fewer = (fits.flags & Flag.FEWER > 0) & (fits.flags & Flag.DARK == 0)
    for n in range(1, n_states):
        some = np.flatnonzero(fewer & ((fits.kr_per_s > 0).sum(axis=1) == n))
        if not some.size:
            continue
        places = np.array(list(combinations(range(n_states), n)))
        far = np.abs(np.log(fits.kr_per_s[some, None, :n]) - np.log(kr_per_s[places])).sum(axis=2)
        chosen = places[far.argmin(axis=1)]
        for values in (fits.kr_per_s, fits.amplitude, fits.kr_error, fits.amplitude_error):
            own = values[some, :n].copy()
            values[some] = 0.0
            values[some[:, None], chosen] = own


def write_maps(maps: PixelMaps, folder: Path) -> Material:
    """Write maps and material.json into a folder that exists; return the material.

    `kr.exr` and `emission.exr` are what a renderer takes: where nothing was fitted, the sample's rates and no light.
    `amplitude.exr`, `kr_error.exr`, `amplitude_error.exr` (0: not fitted; infinite: not determined) and `quality.exr`
    (channels `flags`, `chi2_per_dof`, `states`) are for people and programs.
    """
    fits, whole, (h, w) = maps.fits, maps.whole.fit, maps.shape
    material = maps.whole.material
    has = fits.amplitude > 0
    kr = np.where(has, fits.kr_per_s, whole.kr_per_s.astype(np.float32))
    write_map(folder / "kr.exr", kr.reshape(h, w, -1))
    # The sample's Λ_ij, by this pixel's A_i / kr_i over the sample's.
    factor = np.where(has, fits.amplitude / kr, 0.0) * (whole.kr_per_s / whole.strength).astype(np.float32)
    Lambda = material.emission.astype(np.float32)
    # Channel by channel, since this is by far the largest map.
    channels = {
        name: (factor[:, i] * value).reshape(h, w)
        for name, (i, value) in zip(
            channel_names(Lambda.shape), ((i, v) for i, row in enumerate(Lambda) for v in row), strict=True
        )
    }
    write_channels(folder / "emission.exr", channels, {})
    del channels
    for name, values in (
        ("amplitude", fits.amplitude),
        ("kr_error", fits.kr_error),
        ("amplitude_error", fits.amplitude_error),
    ):
        write_map(folder / f"{name}.exr", values.reshape(h, w, -1))
    quality = {
        "flags": fits.flags.astype(np.float32),
        "chi2_per_dof": fits.chi2_per_dof,
        "states": has.sum(axis=1).astype(np.float32),
    }
    write_channels(folder / "quality.exr", {k: v.reshape(h, w) for k, v in quality.items()}, {})
    y, x = maps.corner_px
    mapped = replace(
        material,
        maps={"kr_per_s": "kr.exr", "emission": "emission.exr"},
        provenance={
            **material.provenance,
            "maps": {
                "sensor_box_px": [y, x, y + h * maps.cell, x + w * maps.cell],
                "sensor_pixels_a_side": maps.cell,
                "counts": maps.counts(),
                "flag_bits": {flag.name.lower(): int(flag) for flag in Flag if flag.name},
            },
        },
        folder=folder,
    )
    mapped.save(folder / "material.json")
    return mapped
