"""RAW frames: the sensor's own numbers, honest means with honest noise, and files that cannot do harm."""

from __future__ import annotations

import io
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from phoslab import limited, raw, raw_worker
from phoslab.errors import PhoslabError
from phoslab.instruments.bench.camera import SENSOR
from phoslab.instruments.bench.dng import Sensor, write_dng
from phoslab.session import Frame

SIZE = (164, 224)
TOP, LEFT, BOTTOM, RIGHT = SENSOR.active_area
VISIBLE = (slice(TOP, BOTTOM), slice(LEFT, RIGHT))
SHAPE = (BOTTOM - TOP, RIGHT - LEFT)
PATTERNS = {
    "RGGB": ((0, 1), (1, 2)),
    "GRBG": ((1, 0), (2, 1)),
    "GBRG": ((1, 2), (0, 1)),
    "BGGR": ((2, 1), (1, 0)),
}


def frame_file(
    path: Path,
    values: NDArray[Any],
    sensor: Sensor = SENSOR,
    exposure_s: float = 0.25,
    iso: int = 200,
    f_number: float = 2.8,
) -> Path:
    whole = np.full(SIZE, 500.0)  # what the masked borders hold must not matter
    whole[VISIBLE] = values
    write_dng(
        path,
        np.clip(np.round(whole), 0, sensor.white).astype(np.uint16),
        sensor,
        exposure_s=exposure_s,
        iso=iso,
        f_number=f_number,
        taken="2026:01:01 00:00:00",
        description="SIMULATED",
    )
    return path


def black_of(sensor: Sensor = SENSOR) -> NDArray[np.float64]:
    return np.tile(np.array(sensor.black, float), (SHAPE[0] // 2, SHAPE[1] // 2))


def colours_of(sensor: Sensor = SENSOR) -> NDArray[np.int64]:
    return np.tile(np.array(sensor.cfa), (SHAPE[0] // 2, SHAPE[1] // 2))


@pytest.fixture
def good(tmp_path: Path) -> Path:
    return frame_file(tmp_path / "good.dng", black_of() + 1000)


# ---- what the sensor said


def test_values_come_back_bit_for_bit_without_the_masked_borders(tmp_path: Path) -> None:
    values = np.random.default_rng(1).integers(0, SENSOR.white + 1, SHAPE)
    frame = raw.read_raw(frame_file(tmp_path / "a.dng", values))
    np.testing.assert_array_equal(frame.values, values)
    assert frame.values.dtype == np.uint16


@pytest.mark.parametrize("pattern", PATTERNS)
def test_colours_and_black_levels_are_right_for_every_bayer_pattern(tmp_path: Path, pattern: str) -> None:
    sensor = replace(SENSOR, cfa=PATTERNS[pattern], black=((1000, 1010), (1020, 1030)))
    frame = raw.read_raw(frame_file(tmp_path / "a.dng", black_of(sensor) + 7, sensor))
    np.testing.assert_array_equal(frame.colours, colours_of(sensor))
    np.testing.assert_array_equal(frame.linear, 7)
    np.testing.assert_array_equal(frame.white, sensor.white)


def test_settings_come_from_exif(good: Path) -> None:
    frame = raw.read_raw(good)
    assert frame.exposure_s == pytest.approx(0.25)
    assert frame.iso == 200
    assert frame.f_number == pytest.approx(2.8)


# ---- means


def test_a_mean_is_that_of_each_colours_own_pixels(tmp_path: Path) -> None:
    path = frame_file(tmp_path / "a.dng", black_of() + np.array([100, 2000, 300])[colours_of()])
    means = raw.region_means(path, (10, 50, 20, 80))
    np.testing.assert_allclose(means.mean, [100, 2000, 300])
    np.testing.assert_array_equal(means.n_pixels, [600, 1200, 600])
    np.testing.assert_array_equal(means.variance, 0)
    assert means.shape == SHAPE


def test_a_pattern_of_six_pixels_is_averaged_by_colour_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """X-Trans, from a frame made here: the bench has no such sensor."""
    cell = ["GBGGRG", "RGRBGB", "GBGGRG", "GRGGBG", "BGBRGR", "GRGGBG"]
    cfa = np.tile(np.array([["RGB".index(c) for c in row] for row in cell], np.uint8), (20, 20))
    values = np.random.default_rng(8).normal(3000, 30, cfa.shape).round().astype(
        np.uint16
    ) + 500 * cfa.astype(np.uint16)
    frame = raw.RawFrame(
        Path("x"), values.astype(np.uint16), cfa, np.full(4, 1000.0), np.full(4, 9e3), 1.0, 100, 1.0
    )
    monkeypatch.setattr(raw_worker, "decode", lambda _: frame)
    mask = np.hypot(*(np.mgrid[:120, :120] - 60)) < 50
    answer = raw_worker.job_means("x", mask=np.packbits(mask), mask_shape=[120, 120])
    for k in range(3):
        chosen = values[mask & (cfa == k)]
        assert answer["n_pixels"][k] == chosen.size
        assert answer["mean"][k] == pytest.approx(chosen.mean() - 1000)
        # As in the repeated frames above: 1700 red pixels.
        assert answer["variance"][k] * chosen.size == pytest.approx(
            900, rel=4 * 1.25 * np.sqrt(3.9 / chosen.size)
        )
    preview = raw_worker.job_preview("x", 512)
    assert preview["image"].shape == (20, 20, 3)


def test_a_mask_selects_the_same_pixels_as_its_rectangle(tmp_path: Path) -> None:
    path = frame_file(tmp_path / "a.dng", np.random.default_rng(2).integers(2000, 9000, SHAPE))
    mask = np.zeros(SHAPE, dtype=bool)
    mask[11:51, 20:81] = True
    by_mask, by_box = raw.region_means(path, mask), raw.region_means(path, (11, 51, 20, 81))
    np.testing.assert_array_equal(by_mask.mean, by_box.mean)
    np.testing.assert_array_equal(by_mask.n_pixels, by_box.n_pixels)


def test_saturated_pixels_are_left_out_and_counted(tmp_path: Path) -> None:
    values = black_of() + 1000
    values[20:24, 30:34] = SENSOR.white
    means = raw.region_means(frame_file(tmp_path / "a.dng", values), (0, 100, 0, 100))
    np.testing.assert_allclose(means.mean, 1000)
    np.testing.assert_array_equal(means.n_saturated, [4, 8, 4])
    np.testing.assert_array_equal(means.n_pixels + means.n_saturated, [2500, 5000, 2500])


def test_a_region_without_a_usable_pixel_of_a_colour_says_so(tmp_path: Path) -> None:
    means = raw.region_means(frame_file(tmp_path / "a.dng", np.full(SHAPE, SENSOR.white)), (0, 10, 0, 10))
    assert np.isnan(means.mean).all()
    assert np.isnan(means.variance).all()


def test_the_variance_is_that_of_the_mean_over_repeated_frames(tmp_path: Path) -> None:
    """On a picture with gradient, edges and shot noise: the region takes in a disc and its dark surround."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    disc = np.hypot(y - 70, x - 90) < 45
    signal = np.where(disc, 4000 + 10.0 * x - 5.0 * y, 200.0)
    sigma = np.sqrt(4 + signal / 4)  # read noise of 2 DN, 4 electrons a DN
    region = np.hypot(y - 70, x - 90) < 47
    rng = np.random.default_rng(3)
    measured = [
        raw.region_means(frame_file(tmp_path / f"{k}.dng", black_of() + rng.normal(signal, sigma)), region)
        for k in range(8)
    ]
    estimated = np.mean([m.variance for m in measured], axis=0)
    colours = colours_of()
    true = [(sigma**2)[region & (colours == k)].mean() / (region & (colours == k)).sum() for k in range(3)]
    # Second differences of n pixels tell a variance to sqrt(3.9 / n); the median over 8 groups costs a factor
    # of 1.25; rounding to whole DN adds 1/12 to 1000. Red and blue have n = 1700, eight frames: 2 %, times 4.
    np.testing.assert_allclose(estimated, true, rtol=0.08)


def test_a_frame_with_ordinary_noise_has_its_mean_within_four_standard_errors(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    path = frame_file(tmp_path / "a.dng", black_of() + rng.normal(2000, 20, SHAPE))
    means = raw.region_means(path, (0, 148, 0, 200))
    assert (np.abs(means.mean - 2000) < 4 * np.sqrt(means.variance)).all()
    np.testing.assert_allclose(
        np.sqrt(means.variance * means.n_pixels), 20, rtol=4 * 1.25 * np.sqrt(3.9 / 7400) / 2
    )


def test_hot_pixels_are_no_noise_of_the_others(tmp_path: Path) -> None:
    """Few, at every brightness: a bright gradient with one pixel in 200 far off."""
    rng = np.random.default_rng(7)
    values = black_of() + rng.normal(np.linspace(1000, 9000, SHAPE[1]), 20, SHAPE)
    values += 300 * (rng.random(SHAPE) < 0.005)
    means = raw.region_means(frame_file(tmp_path / "a.dng", values), (0, 148, 0, 200))
    # 1.5 % of the triples are spoilt, by 15 or 30 standard deviations of a pixel; taken for noise they would
    # make it half as large again. Those within the clip of 4 add no more than 1.5 % of 4², with 8 % as above.
    np.testing.assert_allclose(means.variance * means.n_pixels, 20**2, rtol=0.24 + 0.08)


@pytest.mark.parametrize("region", [(0, 200, 0, 10), (-1, 5, 0, 5), (5, 5, 0, 5)])
def test_a_region_outside_the_frame_is_refused(good: Path, region: tuple[int, int, int, int]) -> None:
    with pytest.raises(PhoslabError, match="148 x 200 pixels"):
        raw.region_means(good, region)


def test_a_mask_of_another_size_or_an_empty_one_is_refused(good: Path) -> None:
    with pytest.raises(PhoslabError, match="mask"):
        raw.region_means(good, np.ones((10, 10), dtype=bool))
    with pytest.raises(PhoslabError, match="no pixel"):
        raw.region_means(good, np.zeros(SHAPE, dtype=bool))


def test_exposure_iso_and_aperture_divide_out(tmp_path: Path) -> None:
    one = frame_file(tmp_path / "1.dng", black_of() + 800, exposure_s=1.0, iso=100, f_number=4.0)
    two = frame_file(tmp_path / "2.dng", black_of() + 6400, exposure_s=0.5, iso=400, f_number=2.0)
    a, b = (raw.per_second(raw.region_means(p, (0, 10, 0, 10)))[0] for p in (one, two))
    np.testing.assert_allclose(a, 800 * 16)
    np.testing.assert_allclose(a, b)


# ---- frames of a session


def frame_of(path: Path, **settings: Any) -> Frame:
    known = {"exposure_s": 0.25, "iso": 200.0, "f_number": 2.8, **settings}
    return Frame(path=path, name=path.name, role="decay", start_s=0.0, sha256="", **known)


@pytest.mark.parametrize(("field", "said"), [("exposure_s", 0.5), ("iso", 100.0), ("f_number", 4.0)])
def test_a_frame_whose_exif_contradicts_the_journal_is_named(good: Path, field: str, said: float) -> None:
    with pytest.raises(PhoslabError, match="journal") as caught:
        raw.frame_means([frame_of(good), frame_of(good, **{field: said})], (0, 10, 0, 10))
    assert (caught.value.field, caught.value.file) == (field, str(good))


def test_nominal_and_true_shutter_speeds_agree(tmp_path: Path) -> None:
    path = frame_file(tmp_path / "a.dng", black_of(), exposure_s=1 / 64)
    (means,) = raw.frame_means([frame_of(path, exposure_s=1 / 60)], (0, 10, 0, 10))
    assert means.exposure_s == 1 / 60  # the journal's, like every other frame's


def test_frames_come_back_in_order_with_progress(tmp_path: Path) -> None:
    frames = [frame_of(frame_file(tmp_path / f"{k}.dng", black_of() + 100 * k)) for k in range(7)]
    told: list[tuple[int, int]] = []
    means = raw.frame_means(frames, (0, 10, 0, 10), progress=lambda done, of: told.append((done, of)))
    np.testing.assert_allclose([m.mean[1] for m in means], 100 * np.arange(7))
    assert told == [(k + 1, 7) for k in range(7)]


# ---- preview


def test_a_preview_shows_each_colour_and_its_mask_fits_the_frame(tmp_path: Path) -> None:
    values = black_of()
    values[40:60, 100:140] += np.array([1000, 4000, 2000])[colours_of()][40:60, 100:140]
    values[40:42, 100:102] = SENSOR.white
    preview = raw.preview(frame_file(tmp_path / "a.dng", values))
    assert (preview.bin, preview.image.shape) == (2, (74, 100, 3))
    np.testing.assert_allclose(preview.image[25, 60] * (SENSOR.white - 1024), [1000, 4000, 2000], rtol=1e-3)
    np.testing.assert_allclose(preview.image[5, 5], 0, atol=1e-6)
    assert np.argwhere(preview.saturated).tolist() == [[20, 50]]
    mask = preview.full_mask(preview.image[..., 1] > 0.1)
    expected = np.zeros(SHAPE, dtype=bool)
    expected[40:60, 100:140] = True
    np.testing.assert_array_equal(mask, expected)


def test_a_preview_keeps_to_its_size(good: Path) -> None:
    preview = raw.preview(good, largest=30)
    assert max(preview.image.shape) <= 30
    assert preview.full_mask(np.ones(preview.image.shape[:2], dtype=bool)).shape == SHAPE


# ---- files that nobody vouches for


def with_tags(content: bytes, tags: dict[int, int]) -> bytes:
    data = bytearray(content)
    (first,) = struct.unpack_from("<I", data, 4)
    (n,) = struct.unpack_from("<H", data, first)
    for entry in range(first + 2, first + 2 + 12 * n, 12):
        tag = struct.unpack_from("<H", data, entry)[0]
        if tag in tags:
            struct.pack_into("<I", data, entry + 8, tags[tag])
    return bytes(data)


def jpeg(_: bytes) -> bytes:
    stream = io.BytesIO()
    Image.new("RGB", (64, 64)).save(stream, "JPEG")
    return stream.getvalue()


def linear_dng(content: bytes) -> bytes:
    return with_tags(content, {262: 34892})


@pytest.mark.parametrize(
    "spoil",
    [
        pytest.param(lambda good: good[: len(good) // 2], id="truncated"),
        pytest.param(lambda good: good[:200], id="truncated in the header"),
        pytest.param(lambda _: b"", id="empty"),
        pytest.param(lambda _: np.random.default_rng(5).bytes(70_000), id="random bytes"),
        pytest.param(lambda good: with_tags(good, {256: 60_000, 257: 60_000}), id="60000 x 60000 pixels"),
        pytest.param(lambda good: with_tags(good, {256: 2**31 - 1, 257: 2**31 - 1}), id="2**62 pixels"),
        pytest.param(lambda good: with_tags(good, {257: 0}), id="no pixels"),
        pytest.param(lambda good: with_tags(good, {50717: 3}), id="white below black"),
        pytest.param(jpeg, id="a JPEG"),
    ],
)
def test_a_bad_file_is_one_sentence_that_names_it(good: Path, spoil: Any) -> None:
    content = spoil(good.read_bytes())
    bad = good.with_name("bad.dng")
    bad.write_bytes(content)
    for read in (raw.read_raw, raw.preview, lambda path: raw.region_means(path, (0, 10, 0, 10))):
        with pytest.raises(PhoslabError) as caught:
            read(bad)
        assert caught.value.file == str(bad)
    assert raw.read_raw(good).values.shape == SHAPE  # and the next file is read as ever


def test_no_byte_of_a_header_crashes_the_reader(good: Path) -> None:
    """Flip bytes all over the header and the EXIF data: an error or a frame, each within its limits."""
    content = good.read_bytes()
    rng = np.random.default_rng(6)
    header = [*range(590), *range(len(content) - 110, len(content))]
    jobs = []
    for k in range(60):
        data = bytearray(content)
        for place in rng.choice(header, 3):
            data[place] = rng.integers(256)
        path = good.with_name(f"flipped{k}.dng")
        path.write_bytes(bytes(data))
        jobs.append(path)
    for path in jobs:
        try:
            assert raw.read_raw(path).values.size > 0
        except PhoslabError as error:
            assert error.file == str(path)  # noqa: PT017 # either outcome is right


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(PhoslabError, match="does not exist"):
        raw.read_raw(tmp_path / "nothing.dng")


@pytest.mark.parametrize(
    ("function", "reason"),
    [("hang", "took longer than 1 s"), ("crash", "crashed the decoder"), ("devour", "GiB of memory")],
)
def test_a_decoder_that_goes_wrong_costs_one_frame_and_names_it(
    good: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, function: str, reason: str
) -> None:
    """Through the real path from read_raw to the worker: only what the worker calls is replaced."""
    (tmp_path / "wrong_decoder.py").write_text(
        "import os, time\n"
        "def hang(path): time.sleep(60)\n"
        "def crash(path): os.kill(os.getpid(), 11)\n"
        "def devour(path): return {'values': bytearray(1 << 40)}\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    with limited.Workers(1, limited.Limits(wall_s=1.0)) as workers:
        real = workers.run_as_done
        monkeypatch.setattr(workers, "run_as_done", lambda _, jobs: real(f"wrong_decoder:{function}", jobs))
        with pytest.raises(PhoslabError, match=reason) as caught:
            raw.read_raw(good, workers=workers)
        assert caught.value.file == str(good)
        monkeypatch.setattr(workers, "run_as_done", real)
        assert raw.read_raw(good, workers=workers).values.shape == SHAPE
