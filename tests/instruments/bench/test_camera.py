"""The bench's camera: photons, noise and black level as a sensor has them, in a file that LibRaw reads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from phoslab import raw
from phoslab.instruments.bench.camera import Camera

FLAT = Camera(falloff=0.0, blur_px=0.001, glare=0.0)


def expose(
    path: Path, camera: Camera, electrons: float, *, iso: int = 100, exposure_s: float = 1.0
) -> NDArray[np.uint16]:
    return camera.expose(
        path,
        np.full(camera.shape, electrons / camera.exposure_e * 4),
        np.array([0.5, 1.0, 0.25]),
        exposure_s=exposure_s,
        iso=iso,
        f_number=2.0,
        taken="2026:01:01 00:00:00",
        description="SIMULATED",
        rng=np.random.default_rng(1),
    )


@pytest.mark.parametrize("iso", [100, 800])
def test_noise_is_shot_noise_plus_read_noise(tmp_path: Path, iso: int) -> None:
    path = tmp_path / "a.dng"
    expose(path, FLAT, 5000.0, iso=iso)
    means = raw.region_means(path, (0, 148, 0, 200))
    e_per_dn = FLAT.full_scale_e / FLAT.full_scale_dn * 100 / iso
    electrons = np.array([0.5, 1.0, 0.25]) * 5000 + FLAT.dark_e_per_s
    variance = (electrons + FLAT.read_noise_e**2) / e_per_dn**2 + FLAT.converter_noise_dn**2 + 1 / 12
    # Four standard errors of a mean, and of a variance by second differences (see tests/test_raw.py).
    n = means.n_pixels
    assert (np.abs(means.mean - electrons / e_per_dn) < 4 * np.sqrt(variance / n)).all()
    assert (np.abs(means.variance * n / variance - 1) < 4 * 1.25 * np.sqrt(3.9 / n)).all()


def test_what_is_written_is_what_libraw_reads(tmp_path: Path) -> None:
    values = expose(tmp_path / "a.dng", Camera(), 20_000.0)
    frame = raw.read_raw(tmp_path / "a.dng")
    np.testing.assert_array_equal(frame.values, values)
    assert (frame.exposure_s, frame.iso, frame.f_number) == (1.0, 100, 2.0)


def test_the_pattern_is_not_plain_rggb_and_borders_are_masked(tmp_path: Path) -> None:
    expose(tmp_path / "a.dng", Camera(), 20_000.0)
    frame = raw.read_raw(tmp_path / "a.dng")
    assert frame.cfa[:2, :2].tolist() == [[3, 2], [0, 1]]
    with tifffile.TiffFile(tmp_path / "a.dng") as file:
        whole = file.pages[0].asarray()
    assert whole.shape == Camera().size != frame.values.shape
    assert abs(whole[:, :14].mean() - np.mean(Camera().sensor.black)) < 1


def test_too_much_light_stops_at_white(tmp_path: Path) -> None:
    values = expose(tmp_path / "a.dng", Camera(), 1e6)
    assert values.max() == Camera().sensor.white
    assert raw.read_raw(tmp_path / "a.dng").saturated.all()


def test_the_file_says_that_it_is_simulated(tmp_path: Path) -> None:
    expose(tmp_path / "a.dng", Camera(), 100.0)
    with tifffile.TiffFile(tmp_path / "a.dng") as file:
        tags = file.pages[0].tags  # type: ignore[union-attr] # a page, not a frame: there is one
        assert tags["ImageDescription"].value.startswith("SIMULATED")
        assert "Simulated" in tags["Model"].value
        assert tags["ExifTag"].value["ISOSpeedRatings"] == 100


def test_green_light_is_green_and_corners_are_darker(tmp_path: Path) -> None:
    red, green, blue = Camera().response(lambda nm: np.exp(-(((nm - 525) / 40) ** 2)))
    assert green > 2 * max(red, blue)
    optics = Camera(glare=0.0)._optics(np.ones(Camera().shape))
    assert optics[0, 0] == pytest.approx(0.85)
    assert optics[74, 100] == pytest.approx(1.0, abs=1e-3)
