"""From frames to signals: what is refused and what is left out."""

import shutil

import numpy as np
import pytest

from phoslab.errors import PhoslabError
from phoslab.fitting.reduction import reduce_decay
from phoslab.instruments.bench.bench import Bench, record_decay, star
from phoslab.session import Session


def recorded(folder, **options):
    """A short decay of the bench."""
    record_decay(folder, Bench(3), **({"charge_s": 60.0, "n_frames": 6, "n_darks": 1} | options))
    return Session.open(folder)


def test_the_region_lies_on_the_sample_and_covers_most_of_it(green_decay):
    region = reduce_decay(Session.open(green_decay)).region
    sample = star(region.shape) > 0.5
    assert not (region & ~sample).any()
    assert region.sum() > 0.4 * sample.sum()


def test_noise_estimates_are_the_scatter_of_frames_of_different_seeds(tmp_path):
    decays = []
    for seed in range(12):
        record_decay(tmp_path / str(seed), Bench(seed), charge_s=60.0, n_frames=2, n_darks=1)
        decays.append(reduce_decay(Session.open(tmp_path / str(seed))).data)
    scatter = np.std([d.signal for d in decays], axis=0, ddof=1)
    said = np.mean([d.sigma for d in decays], axis=0)
    # A standard deviation of 12 draws is known to 1/sqrt(22) = 21 %; six such ratios stay within 4 of those.
    assert (np.abs(np.log(scatter / said)) < 0.85).all()
    assert np.log(scatter / said).mean() == pytest.approx(0, abs=3 * 0.21 / np.sqrt(6))


def test_a_session_without_dark_frames_says_which_are_missing(tmp_path):
    with pytest.raises(PhoslabError, match=r"has no dark frame for .* s at ISO 100.*record dark frames"):
        reduce_decay(recorded(tmp_path / "s", n_darks=0))


def test_an_over_exposed_series_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("phoslab.instruments.bench.bench.LADDER", ((8.0, 1600),))
    with pytest.raises(PhoslabError, match=r"over-exposed: 1\d of 1\d values.*shorter"):
        reduce_decay(recorded(tmp_path / "s", interval_s=10.0))


def test_a_few_saturated_values_are_left_out_and_said(tmp_path, monkeypatch):
    # Twice the usual exposure: the strongest channel of the first frames clips.
    monkeypatch.setattr("phoslab.instruments.bench.bench.LADDER", ((0.3, 100),))
    reduced = reduce_decay(recorded(tmp_path / "s", charge_s=5400.0))
    lost = int((~reduced.data.used).sum())
    assert 0 < lost < reduced.data.sigma.size / 2
    assert any(f"{lost} of" in w and "saturated" in w for w in reduced.warnings)


def test_a_session_of_another_plan_is_refused(tmp_path):
    session = recorded(tmp_path / "s")
    header = (session.path / "session.toml").read_text().replace('name = "decay"', 'name = "flats"')
    (session.path / "session.toml").write_text(header)
    with pytest.raises(PhoslabError, match=r"plan 'flats'.*plan 'decay'"):
        reduce_decay(Session.open(session.path))


def test_an_altered_frame_is_found_before_anything_is_fitted(green_decay, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(green_decay, copy)
    frame = sorted((copy / "frames").iterdir())[5]
    content = bytearray(frame.read_bytes())
    content[-100] ^= 1
    frame.write_bytes(content)
    with pytest.raises(PhoslabError, match=frame.name):
        Session.open(copy)


def test_darkness_is_not_taken_for_a_sample(tmp_path, monkeypatch):
    monkeypatch.setattr(Bench, "move_door", lambda bench, to_open: bench.clock.now_s)
    with pytest.raises(PhoslabError, match="no sample that stands out"):
        reduce_decay(recorded(tmp_path / "s"))


def test_a_sample_that_is_as_bright_in_its_darks_is_refused(tmp_path, monkeypatch):
    """The lens was not covered: whatever glows, the frames less their darks are noise."""

    def wait_without_fading(bench, duration_s):
        bench.clock.now_s += duration_s
        return 0.0076 * duration_s  # about what it gives just after the lamp

    monkeypatch.setattr(Bench, "wait", wait_without_fading)

    def leave_open(bench, to_open):
        bench.door_open = True
        return bench.clock.now_s

    monkeypatch.setattr(Bench, "move_door", leave_open)
    with pytest.raises(PhoslabError, match="does not glow: its brightest value stands"):
        reduce_decay(recorded(tmp_path / "s"))
