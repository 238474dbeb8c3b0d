"""The bench's camera: light on the sensor to noisy 14-bit numbers in a DNG."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from phoslab.instruments.bench.dng import Sensor, write_dng
from phoslab.spectra import camera_sensitivities

Array = NDArray[np.float64]

SENSOR = Sensor(
    make="phoslab",
    model="Simulated Bayer 14",
    # The pattern and the masked borders that LibRaw reports of a 5D Mark II: [[3, 2], [0, 1]] behind a crop.
    active_area=(8, 14, 156, 214),
    cfa=((1, 2), (0, 1)),
    black=((1023, 1021), (1027, 1025)),
    white=15800,
)


@dataclass(frozen=True)
class Camera:
    """A camera with the spectral sensitivities of a Nikon D5100.

    Args:
        sensitivities: their name in colour-science.
        sensor: black and white levels, colour pattern, pixels that see light.
        size: (rows, columns) of the whole sensor, masked borders included.
        full_scale_e: electrons from black to white at ISO 100.
        read_noise_e: of the pixel, in electrons; it is amplified with the signal.
        converter_noise_dn: of the converter behind the amplifier, in DN.
        dark_e_per_s: dark current of a pixel, electrons per second.
        exposure_e: electrons that a mean spectral radiance of 1 makes in a second at f/1.
        falloff: share of light that the corners lack.
        blur_px: standard deviation of the lens's blur.
        glare: share of the frame's mean light that the lens scatters over all of it.
        gain_spread: standard deviation of the pixels' sensitivity, as a share.
        hot_share: share of the pixels that are hot.
        hot_e_per_s: mean dark current of those.
        column_dn, row_dn: standard deviations of what a column adds in every frame, and a row in each anew.
        doubling_C: by how much warmer a sensor makes twice the dark current.
        serial: of the body; gain, hot pixels and columns are its own.

    `CANON` is one with all the flaws of a real body; the plain one has none of the last six.
    """

    sensitivities: str = "Nikon 5100 (NPL)"
    sensor: Sensor = SENSOR
    size: tuple[int, int] = (164, 224)
    full_scale_e: float = 60_000.0
    read_noise_e: float = 3.0
    converter_noise_dn: float = 1.2
    dark_e_per_s: float = 0.3
    exposure_e: float = 3.6e8
    falloff: float = 0.15
    blur_px: float = 0.7
    glare: float = 0.02
    gain_spread: float = 0.0
    hot_share: float = 0.0
    hot_e_per_s: float = 60.0
    column_dn: float = 0.0
    row_dn: float = 0.0
    doubling_C: float = 6.0
    serial: int = 1

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w) of the pixels that see light."""
        top, left, bottom, right = self.sensor.active_area
        return bottom - top, right - left

    @property
    def full_scale_dn(self) -> int:
        """DN from the highest black level to white."""
        return self.sensor.white - max(b for row in self.sensor.black for b in row)

    def response(self, spectrum: Callable[[Array], Array]) -> Array:
        """(3,) signal of red, green and blue pixels for a spectrum, by 1 nm; 1 if it is 1 everywhere in the green."""
        nm, sensitivities = camera_sensitivities(self.sensitivities)
        fine_nm = np.arange(nm[0], nm[-1] + 0.5, 1.0)
        fine = np.stack([np.interp(fine_nm, nm, s) for s in sensitivities.T])
        return np.asarray((fine * spectrum(fine_nm)).sum(axis=1) / fine[1].sum())

    def expose(
        self,
        path: Path,
        picture: Array,
        colour: Array,
        *,
        exposure_s: float,
        iso: int,
        f_number: float,
        taken: str,
        description: str,
        rng: np.random.Generator,
    ) -> NDArray[np.uint16]:
        """Take a frame of a scene, write it to `path` and return the visible values (h, w).

        Args:
            picture: (h, w) light, integrated over the exposure.
            colour: (3,) from `response`.
            exposure_s, iso, f_number: the settings.
            taken, description: see `write_dng`.
            rng: the noise.
        """
        light = self._optics(picture) * self._mosaic(colour)[self.visible]
        values = self.numbers(light, exposure_s=exposure_s, iso=iso, f_number=f_number, rng=rng)
        write_dng(
            path,
            values,
            self.sensor,
            exposure_s=exposure_s,
            iso=iso,
            f_number=f_number,
            taken=taken,
            description=description,
        )
        return values[self.visible]

    @property
    def visible(self) -> tuple[slice, slice]:
        """Rows and columns of the whole sensor that see light."""
        top, left, bottom, right = self.sensor.active_area
        return slice(top, bottom), slice(left, right)

    def on_pixels(self, picture: Array) -> Array:
        """(h, w) light that each pixel's own colour gets of a picture (h, w, 3) in camera RGB, behind the lens."""
        through = np.stack([self._optics(picture[..., c]) for c in range(3)], axis=-1)
        colour = self._tiled(self.sensor.cfa).astype(int)[self.visible]
        return np.asarray(np.take_along_axis(through, colour[..., None], axis=-1)[..., 0])

    def numbers(
        self,
        light: Array,
        *,
        exposure_s: float,
        iso: float,
        f_number: float,
        rng: np.random.Generator,
        warmer_C: float = 0.0,
    ) -> NDArray[np.uint16]:
        """Return the whole sensor's values (rows, columns) in DN.

        Args:
            light: (h, w) radiance on the pixels that see light, integrated over the exposure.
            exposure_s, iso, f_number: as they truly are.
            rng: the noise.
            warmer_C: by how much the sensor is warmer than where `dark_e_per_s` holds.
        """
        gain, hot, columns = self._flaws
        electrons = np.zeros(self.size)
        electrons[self.visible] = light * self.exposure_e / f_number**2
        electrons *= gain
        electrons += (self.dark_e_per_s + hot) * 2 ** (warmer_C / self.doubling_C) * exposure_s
        electrons = rng.poisson(electrons) + rng.normal(0, self.read_noise_e, self.size)
        e_per_dn = self.full_scale_e / self.full_scale_dn * 100 / iso
        dn = (
            electrons / e_per_dn
            + self._tiled(self.sensor.black)
            + rng.normal(0, self.converter_noise_dn, self.size)
        )
        if self.row_dn:
            dn += rng.normal(0, self.row_dn, (self.size[0], 1))
        return np.clip(np.round(dn + columns), 0, self.sensor.white).astype(np.uint16)

    @cached_property
    def _flaws(self) -> tuple[Array, Array, Array]:
        """What is this body's own: gain, hot pixels' dark current in e/s (rows, columns), columns' offsets in DN."""
        rng = np.random.default_rng([0x5EED, self.serial])
        gain = np.exp(rng.normal(0, 1, self.size) * self.gain_spread)
        hot = rng.exponential(self.hot_e_per_s, self.size) * (rng.random(self.size) < self.hot_share)
        return gain, hot, rng.normal(0, 1, self.size[1]) * self.column_dn

    def resized(self, shape: tuple[int, int]) -> Camera:
        """The same camera with (h, w) pixels that see light, both even."""
        top, left, *_ = self.sensor.active_area
        h, w = shape
        sensor = replace(self.sensor, active_area=(top, left, top + h, left + w))
        return replace(self, sensor=sensor, size=(top + h + 8, left + w + 10))

    def _optics(self, picture: Array) -> Array:
        h, w = self.shape
        y, x = np.mgrid[-1 : 1 : h * 1j, -1 : 1 : w * 1j]
        sharp = gaussian_filter(picture, self.blur_px)
        # cos⁴ falls off as the square of the distance while that is small.
        return np.asarray((sharp + self.glare * picture.mean()) * (1 - self.falloff * (x**2 + y**2) / 2))

    def _tiled(self, cell: tuple[tuple[int, int], tuple[int, int]]) -> Array:
        """(rows, columns) of the whole sensor: a 2 x 2 cell repeated from the active area's corner."""
        rows, columns = self.size
        top, left, *_ = self.sensor.active_area
        return np.array(cell, float)[(np.arange(rows)[:, None] - top) % 2, (np.arange(columns) - left) % 2]

    def _mosaic(self, colour: Array) -> Array:
        return np.asarray(colour[self._tiled(self.sensor.cfa).astype(int)])


CANON = Camera(gain_spread=0.008, hot_share=1e-3, column_dn=0.5, row_dn=0.3)
"""With the flaws of a real body."""
