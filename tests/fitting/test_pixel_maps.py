"""Maps of a sample that is not the same everywhere."""

from types import SimpleNamespace

import numpy as np
import pytest

from phoslab import maps
from phoslab.errors import PhoslabError
from phoslab.exr import read_channels
from phoslab.fitting import fit_session, pixel_frames
from phoslab.fitting.decay import fit_decay
from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.pixel_decay import Flag
from phoslab.fitting.pixel_frames import PixelFrames, stored
from phoslab.fitting.pixel_maps import fit_maps, write_maps
from phoslab.instruments.bench.bench import record_decay
from phoslab.instruments.bench.camera import Camera
from phoslab.instruments.bench.inlay import InlaidBench
from phoslab.material import Material
from phoslab.session import Session

STATES = 3


@pytest.fixture(scope="module")
def inlaid(tmp_path_factory):
    """A session of two paints, one left and one right, its whole fit, its maps, and the bench that knows the truth."""
    folder = tmp_path_factory.mktemp("inlaid")
    bench = InlaidBench(5, camera=Camera().resized((144, 200)))
    record_decay(folder / "session", bench)
    session = Session.open(folder / "session")
    whole = fit_session([folder / "session"], preset="green", states=STATES)
    (folder / "maps").mkdir()
    found = fit_maps(session, whole, folder)
    material = write_maps(found, folder / "maps")
    y, x, y1, x1 = material.provenance["maps"]["sensor_box_px"]
    share = bench._share[y:y1:2, x:x1:2]
    return SimpleNamespace(bench=bench, session=session, whole=whole, maps=found, folder=folder, share=share)


def test_the_rates_of_both_paints_are_those_of_each_alone(inlaid):
    data, fits = inlaid.whole.reduced.data, inlaid.maps.fits
    # The truth of each, averaged over the exposures by 8 midpoints: off by (kr h)²/24 < 1e-4 for 2 s and 0.15 1/s.
    inside = (np.arange(8) + 0.5) / 8
    times = (data.t_s[:, None] + data.exposure_s[:, None] * inside).ravel()
    order = np.argsort(times)
    for light, here in zip(inlaid.bench.true_lights(times[order]), (0.0, 1.0), strict=True):
        mean = np.empty(times.size)
        mean[order] = light
        mean = mean.reshape(-1, 8).mean(axis=1)[:, None]
        sigma = mean * np.hypot(data.repeatability, 0.005)  # as a pixel's: photons and the frame's own
        alone = fit_decay(DecayData(data.t_s, data.exposure_s, mean, sigma, channels=("G",)), STATES)
        some = inlaid.maps.fitted & (inlaid.share == here).ravel()
        assert some.sum() > 300
        # The lens scatters 2 % of the mean light, of both paints, over the frame: 0.5 % of what glows there is
        # foreign, with rates a fifth away. The weights above are a pixel's only about, and a decay that is no sum of
        # exponentials has other rates for other weights: that is most of the 3 %.
        assert np.median(fits.kr_per_s[some], axis=0) == pytest.approx(alone.kr_per_s, rel=0.03)


def test_the_paints_differ_by_more_than_that(inlaid):
    slow = inlaid.maps.fits.kr_per_s[:, -1]
    left, right = (
        np.median(slow[inlaid.maps.fitted & (inlaid.share == here).ravel()]) for here in (0.0, 1.0)
    )
    assert left / right > 1.15


def test_what_the_maps_say_is_what_the_camera_saw_pixel_by_pixel(inlaid):
    """Amplitudes and rates, read back as the renderer reads them, against the green of one photograph."""
    material = Material.load(inlaid.folder / "maps" / "material.json")
    known = maps.load_maps(material)
    whole = inlaid.whole
    per_amplitude = whole.material.emission[:, 3] * whole.fit.kr_per_s / whole.fit.strength
    k = 12
    t, tau = whole.reduced.data.t_s[k], whole.reduced.data.exposure_s[k]
    kr, glow = known["kr_per_s"], known["emission"][:, :, :, 3] * known["kr_per_s"]
    said = (glow / per_amplitude * np.exp(-kr * (t + tau / 2))).sum(axis=2)
    frames = inlaid.session.frames_of("decay")
    with stored(inlaid.session, frames, inlaid.folder) as store:
        seen = np.concatenate([signal for _, signal in store.strips()])[:, :, k, 1]
    y, x = (n // 2 for n in inlaid.maps.corner_px)
    seen = seen[y : y + said.shape[0], x : x + said.shape[1]]
    inside = inlaid.maps.fitted.reshape(said.shape) & (said > 0.5 * np.median(said[said > 0]))
    ratio = seen[inside] / said[inside]
    # A frame's green has 0.5 % of photon noise a pixel of the map; the fit averages 37 of them.
    assert np.median(ratio) == pytest.approx(1, abs=0.01)
    assert ratio.std() < 0.015


def test_what_does_not_glow_is_masked_dark_and_has_rates_of_the_sample(inlaid):
    material = Material.load(inlaid.folder / "maps" / "material.json")
    known = maps.load_maps(material)
    quality = read_channels(inlaid.folder / "maps" / "quality.exr", remedy="")
    masked = quality["flags"].astype(int) & Flag.MASKED > 0
    assert 0.2 < masked.mean() < 0.7
    assert (known["emission"][masked] == 0).all()
    assert (known["kr_per_s"][masked] == material.kr_per_s.astype(np.float32)).all()
    assert (quality["states"][masked] == 0).all()
    assert "do not glow" in inlaid.maps.report()


def test_noise_is_that_of_the_camera(inlaid):
    camera = inlaid.bench.camera
    assert inlaid.maps.gain == pytest.approx(camera.full_scale_dn / camera.full_scale_e, rel=0.05)
    # Reading, converter and rounding, at ISO 100.
    read = np.sqrt(
        (camera.read_noise_e * camera.full_scale_dn / camera.full_scale_e) ** 2
        + camera.converter_noise_dn**2
        + 1 / 12
    )
    assert inlaid.maps.read_dn[0] == pytest.approx(read, rel=0.1)


def test_pixels_of_twice_the_side_scatter_half_as_much(inlaid):
    binned = fit_maps(inlaid.session, inlaid.whole, inlaid.folder, side=2)
    assert binned.shape[0] == pytest.approx(inlaid.maps.shape[0] / 2, abs=2)
    scatter = []
    for m, side in ((inlaid.maps, 2), (binned, 4)):
        y, x = m.corner_px
        share = inlaid.bench._share[y : y + m.shape[0] * side : side, x : x + m.shape[1] * side : side]
        slow = m.fits.kr_per_s[m.fitted & (share == 0).ravel(), -1]
        # By quartiles: pixels of the rim have less light.
        scatter.append(float(np.subtract(*np.percentile(slow, [75, 25]))))
    # The spread of some 140 pixels is known to 8 %.
    assert scatter[1] / scatter[0] == pytest.approx(0.5, abs=0.15)


def test_the_temporary_file_is_gone_also_after_an_error(inlaid):
    with pytest.raises(PhoslabError, match="--bin"):
        fit_maps(inlaid.session, inlaid.whole, inlaid.folder, side=60)
    assert not list(inlaid.folder.glob(".phoslab-*"))


def test_frames_of_a_camera_that_moved_are_laid_on_the_first(inlaid, monkeypatch, tmp_path):
    """From the tenth frame on 4 pixels further down and 6 to the left; half a cell of 2 pixels is 1."""
    values_of = pixel_frames._whole_cells
    seen = 0

    def moved(frame, answer, cell, like):
        nonlocal seen
        values = values_of(frame, answer, cell, like)
        seen += frame.role == "decay"
        return np.roll(values, (4, -6), (0, 1)) if seen >= 10 else values

    frames = inlaid.session.frames_of("decay")
    with stored(inlaid.session, frames, tmp_path) as store:
        still = np.concatenate([signal for _, signal in store.strips()])
        assert np.abs(store.moved_px).max() < 1
    monkeypatch.setattr(pixel_frames, "_whole_cells", moved)
    with stored(inlaid.session, frames, tmp_path) as store:
        again = np.concatenate([signal for _, signal in store.strips()])
        assert np.abs(store.moved_px[:9]).max() < 1
        assert np.abs(store.moved_px[9:] - [4.0, -6.0]).max() < 1
    inner = np.isfinite(again[8:-8, 8:-8]) & np.isfinite(still[8:-8, 8:-8])
    assert inner.mean() > 0.9
    assert np.array_equal(again[8:-8, 8:-8][inner], still[8:-8, 8:-8][inner])
    seen = 0
    told = fit_maps(inlaid.session, inlaid.whole, tmp_path).warnings()
    assert any("The picture moved by up to" in w for w in told)


def test_a_disk_that_is_too_small_is_said_before_anything_is_written(inlaid, monkeypatch):
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=1000))
    with pytest.raises(PhoslabError, match="GB free"):
        fit_maps(inlaid.session, inlaid.whole, inlaid.folder)


def test_saturated_and_hot_pixels_are_left_out_and_others_averaged(tmp_path):
    """Three rows of cells in two strips, by hand: red 110, greens 120 and 140, blue 90 above a dark of 10."""
    block = np.tile(np.array([[110, 120], [140, 90]], np.uint16), (2, 3, 2))  # 2 frames, 6 x 4 pixels
    block[0, 0, 0] = 1000  # red of the first cell saturates in the first frame
    hot = np.zeros((6, 4), bool)
    hot[2, 3] = True  # a green of the second row
    padded = np.concatenate([block, np.zeros((2, 2, 4), np.uint16)], axis=1)
    padded.reshape(2, 2, 4, 4).swapaxes(0, 1).tofile(tmp_path / "frames")
    store = PixelFrames(
        file=tmp_path / "frames",
        shape=(6, 4),
        strip_rows=4,
        cell=2,
        colours=np.array([[0, 1], [1, 2]]),
        dark_dn=np.full((2, 2, 2), 10.0),
        read_dn2=np.ones(2),
        limit_dn=np.full((2, 2), 999.0),
        scale=np.array([1.0, 0.5]),
        hot=hot,
        total=np.zeros((3, 2), np.float32),
        moved_px=np.zeros((2, 2)),
    )
    (first, top), (second, bottom) = store.strips()
    assert (first, second, len(top), len(bottom)) == (0, 2, 2, 1)
    assert np.isnan(top[0, 0, 0, 0])
    assert top[0, 0, 1].tolist() == [50, 60, 40]
    assert top[0, 1, 0].tolist() == [100, 120, 80]
    assert np.isnan(top[1, 1, :, 1]).all()
    assert top[1, 1, 1, [0, 2]].tolist() == [50, 40]
    assert bottom[0, 1, 0].tolist() == [100, 120, 80]
