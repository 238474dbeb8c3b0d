"""Pictures as files: the numbers that went in, and nothing half-written."""

from __future__ import annotations

import json
import os
import resource
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from phoslab.bands import Bands
from phoslab.colorimetry import display_srgb, xyz_matrix
from phoslab.errors import PhoslabError
from phoslab.render import Frame, Frames
from phoslab.render.frames import auto_exposure
from phoslab.render.images import band_channels
from phoslab.render.scene import Exposure

AUTO = (Exposure(0.0, None),)


def frames_of(*radiances: np.ndarray, times=None, exposures=AUTO) -> Frames:
    bands = Bands.uniform(radiances[0].shape[-1])
    times = times or range(len(radiances))
    each = [
        Frame(float(t), f"{t:g}", bands, r.astype("f4"), ("mind the gap",))
        for t, r in zip(times, radiances, strict=True)
    ]
    return Frames(tuple(each), scene="test", solver="exact", exposures=exposures)


@contextmanager
def no_room():
    """A disk on which no file takes more than 100 bytes."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def read_exr(path) -> tuple[dict[str, np.ndarray], dict]:
    with OpenEXR.File(str(path), separate_channels=True) as exr:
        return {n: np.asarray(c.pixels) for n, c in exr.channels().items()}, dict(exr.header())


@pytest.mark.parametrize("n_bands", [1, 3, 8, 13])
def test_exr_keeps_every_band_bit_by_bit_over_nine_decades(tmp_path, n_bands):
    rng = np.random.default_rng(0)
    radiance = (10.0 ** rng.uniform(-9, 0, (6, 5, n_bands))).astype("f4")
    frames_of(radiance).write(tmp_path / "a.exr")
    channels, header = read_exr(tmp_path / "a.exr")
    bands = Bands.uniform(n_bands)
    for k, name in enumerate(band_channels(bands)):
        np.testing.assert_array_equal(channels[name], radiance[..., k])
    xyz = np.stack([channels[c] for c in "XYZ"], axis=-1)
    np.testing.assert_allclose(xyz, radiance @ xyz_matrix(bands), rtol=1e-6)
    assert json.loads(header["phoslab:band_edges_nm"]) == bands.edges_nm.tolist()
    assert float(header["phoslab:time_s"]) == 0.0
    assert header["phoslab:warnings"] == "mind the gap"
    assert header["spectralLayoutVersion"] == "1.0"


def test_png_is_what_a_display_shows_with_its_story(tmp_path):
    radiance = np.random.default_rng(1).uniform(0, 1, (4, 7, 8)).astype("f4")
    frames = frames_of(radiance, exposures=(Exposure(0.0, 0.002),))
    frames.write(tmp_path / "a.png")
    image = Image.open(tmp_path / "a.png")
    want = np.round(display_srgb(frames[0].xyz, 0.002) * 255)
    np.testing.assert_array_equal(np.asarray(image), want)
    assert image.text["phoslab:warnings"] == "mind the gap"
    assert image.text["phoslab:solver"] == "exact"
    assert image.text["phoslab:exposure"] == "0.002"


def test_several_frames_have_their_time_in_the_name(tmp_path):
    radiance = np.ones((2, 2, 3), "f4")
    written = frames_of(radiance, radiance).write(tmp_path / "glow.png")
    assert [p.name for p in written] == ["glow-0.png", "glow-1.png"]


def test_automatic_exposure_is_kept_so_that_fading_shows():
    """Before off: chosen on the first picture; after off: on the first dark one, and kept for the later."""
    bright, glow, faded = (np.full((2, 2, 8), level, "f4") for level in (1.0, 1e-3, 1e-4))
    frames = frames_of(
        faded, bright, glow, times=[90, 0, 61], exposures=(Exposure(0.0, None), Exposure(60.0, None))
    )
    late, lit, early = (frames.exposure_of(frame) for frame in frames.frames)
    assert early == pytest.approx(1000 * lit, rel=1e-5)
    assert late == early


def test_automatic_exposure_of_darkness_is_finite():
    assert auto_exposure(np.zeros((2, 2, 3), "f4")) == 1.0


def test_a_failed_write_leaves_neither_the_picture_nor_a_part_of_it(tmp_path, monkeypatch):
    monkeypatch.setattr(Image.Image, "save", lambda *a, **k: (_ for _ in ()).throw(OSError(28, "No space")))
    with pytest.raises(PhoslabError, match="No space"):
        frames_of(np.ones((2, 2, 3), "f4")).write(tmp_path / "a.png")
    assert list(tmp_path.iterdir()) == []


def test_another_kind_of_file_is_refused(tmp_path, refuses):
    message = refuses(frames_of(np.ones((2, 2, 3), "f4")).write, tmp_path / "a.jpg")
    assert "Name a .png or .exr" in message


@pytest.mark.parametrize("suffix", [".png", ".exr"])
def test_a_full_disk_is_an_error_that_leaves_nothing(tmp_path, suffix):
    frames = frames_of(np.random.default_rng(2).uniform(0, 1, (16, 16, 8)))
    with pytest.raises(PhoslabError, match="could not be written") as caught, no_room():
        frames.write(tmp_path / f"a{suffix}")
    assert f"a{suffix}" in str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", [".png", ".exr"])
def test_a_folder_whose_name_is_not_utf_8_takes_pictures(tmp_path, suffix):
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/l\xe4rm"))
    (path,) = frames_of(np.ones((4, 4, 8))).write(folder / f"a{suffix}")
    assert path.stat().st_size > 100
