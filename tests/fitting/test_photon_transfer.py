"""Noise and settings of a camera from a `flats` session of the bench, against what the bench's camera is made of."""

import numpy as np
import pytest

from phoslab.app.cli import main
from phoslab.errors import PhoslabError
from phoslab.fitting.photon_transfer import photon_transfer
from phoslab.fitting.settings import KINDS, Settings, fit_settings, meant
from phoslab.instruments.bench import body
from phoslab.instruments.bench.camera import CANON
from phoslab.session import Session


@pytest.fixture(scope="module")
def flats(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flats") / "flats"
    assert main(["measure", "flats", "--simulate", "green", "-o", str(folder), "--json"]) == 0
    return Session.open(folder)


@pytest.fixture(scope="module")
def true():
    """What the bench's dials really mean."""
    return body.true_settings(CANON.serial)


def test_gain_and_read_noise_are_the_cameras_within_their_errors(flats, true):
    noise = photon_transfer(flats)
    assert len(noise) >= 5
    for iso, n in noise.items():
        gain = CANON.full_scale_dn / CANON.full_scale_e * true["iso"][int(iso)] / 100
        # Two numbers at each of some seven ISO: the worst of fourteen stays within 4 standard errors 999 times in 1000.
        assert abs(n.gain[0] - gain) < 4 * n.gain[1]
        # Rows and rounding add to what the pixel and the converter have.
        read = np.sqrt(
            (CANON.read_noise_e * gain) ** 2 + CANON.converter_noise_dn**2 + CANON.row_dn**2 + 1 / 12
        )
        assert abs(n.read_dn[0] - read) < 4 * n.read_dn[1]
        assert n.gain[1] < 0.02 * gain


def test_settings_are_found_to_a_fraction_of_a_percent(flats, true):
    fit = fit_settings(flats)
    power = {"exposure_s": 1.0, "iso": 1.0, "f_number": -2.0}
    wrong = []
    for kind in KINDS:
        values = [v for k, v in fit.settings.corrections if k == kind]
        truth = {v: power[kind] * np.log(_true(true[kind], v) / meant(kind, v)) for v in values}
        (exact,) = [v for v in values if fit.settings.corrections[kind, v][1] == 0.0]
        for v in values:
            found, error = fit.settings.corrections[kind, v]
            assert abs(found - (truth[v] - truth[exact])) <= 4 * error
            wrong.append(abs(truth[v] - truth[exact]))
    # The bench's dials are off by so much that trusting them would show.
    assert max(wrong) > 0.02
    assert max(error for _, error in fit.settings.corrections.values()) < 0.01


def _true(table, value):
    return table[min(table, key=lambda known: abs(np.log(known / value)))]


def test_numbers_on_a_dial_stand_for_powers_of_two():
    assert Settings().gain(1 / 15, 100, None) == pytest.approx(1 / 16, rel=1e-12)
    assert Settings().gain(1.0, 200, 5.6) == pytest.approx(2 / 32, rel=1e-12)


def test_a_session_without_pairs_is_refused(flats):
    class Empty:
        path = flats.path

        def frames_of(self, role):
            return ()

    with pytest.raises(PhoslabError, match="no two flat frames at the same setting"):
        photon_transfer(Empty())
    with pytest.raises(PhoslabError, match="0 flat frames"):
        fit_settings(Empty())
