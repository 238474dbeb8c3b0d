"""The excitation fit, on series that a general integrator made under a lamp that is never constant."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phoslab.app.report import _excitation_figure
from phoslab.bands import Bands
from phoslab.errors import PhoslabError
from phoslab.fitting.charging import LampCourse, Steps, Table
from phoslab.fitting.decay import fit_decay
from phoslab.fitting.decay_data import DecayData
from phoslab.fitting.excitation import fit_excitation
from phoslab.fitting.excitation_model import Charge, ExcitationData, Problem
from phoslab.fitting.excitation_report import report
from phoslab.fitting.light import Shapes, outside
from phoslab.instruments.bench import lights
from phoslab.instruments.bench.film import Film
from phoslab.instruments.bench.lvf import Lvf
from phoslab.instruments.bench.paints import paint

NM = np.arange(360.0, 740.1, 0.5)
POSITIONS_NM = np.linspace(400, 700, 31)
# The truth is summed up over cells of 0.1 nm, by their middles: no band's edge lies inside one.
CELL_NM = 0.1
CELLS_NM = np.arange(360 + CELL_NM / 2, 740, CELL_NM)


def lamp(nm: np.ndarray) -> np.ndarray:
    return 0.02 * (0.3 + (nm - 360) / 300)


def through(nm: np.ndarray) -> np.ndarray:
    return 5e-4 + 0.5 / (1 + ((nm - POSITIONS_NM[:, None]) / 12.5) ** 4)


LAMP_NM, THROUGH = lamp(NM), through(NM)
LIT_S = np.array([1.0, 2, 4, 8, 16, 32, 64, 128, 256, 512, 11.3, 45.3])
DELAY_S = np.full(12, 0.6) + 0.02 * np.sin(np.arange(12))
EXPOSURE_S = np.where(LIT_S > 10, 1.0, 4.0)
CHARGE_S, FADE_S, RISE_S = 5400.0, 0.32, 0.08
COURSE = LampCourse(
    Table.of(lambda t: 1 - np.exp(-t / RISE_S), 1.0), Table.of(lambda t: (1 - t / FADE_S) ** 2, FADE_S)
)
KR = np.array([0.2, 0.02])
GAIN = np.array([3000.0, 20000.0])
NOISE = 0.003
"""Of a value, and this part of a hundredth of the brightest besides."""


def lamp_level(t: float, off_s: float) -> float:
    """The lamp's light as a formula of time, not in steps."""
    if t < off_s:
        return 1 - np.exp(-t / RISE_S)
    return (1 - np.exp(-off_s / RISE_S)) * max(0.0, 1 - (t - off_s) / FADE_S) ** 2


def watched(a: np.ndarray, kr: np.ndarray, times: tuple[float, float, float], law=None) -> np.ndarray:
    """(n_places, n_c) mean kr r over an exposure, by LSODA under the formula. `law`: another dr/dt in the dark."""
    lit, delay, exposure = times
    fall = law or (lambda r: -kr * r)

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        r = y[: a.size].reshape(a.shape)
        change = (1 - r) * a * lamp_level(t, lit) + fall(r)
        seen = -fall(r) if t > lit + delay else 0 * r
        return np.concatenate([change.ravel(), seen.ravel()])

    y = np.zeros(2 * a.size)
    # Cut where the light has a kink, or the solver would step over it.
    stops = [0.0, min(1.0, lit), lit, lit + FADE_S, lit + delay, lit + delay + exposure]
    for begin, end in pairwise(stops):
        if end > begin:
            open_from = begin + (end - begin) * 1e-12
            y = solve_ivp(slope, (open_from, end), y, method="LSODA", rtol=1e-9, atol=1e-13).y[:, -1]
    return y[a.size :].reshape(a.shape) / exposure


@dataclass(frozen=True)
class Truth:
    """A series and its decay with noise, and what they are made of."""

    data: ExcitationData
    charge: Charge
    ke: np.ndarray
    a: np.ndarray
    initial: np.ndarray


def made(ke_nm, saturation: float, *, seed: int = 1, shapes: Shapes | None = None, law=None) -> Truth:
    """A sample with excitation spectra `ke_nm` (n_c, n_cells), which the lamp takes to a / kr = `saturation`."""
    shapes = shapes or Shapes(Bands.uniform())
    rng = np.random.default_rng(seed)
    n_c = len(ke_nm)
    kr, gain = KR[:n_c], GAIN[:n_c]
    fine = np.asarray(ke_nm, dtype=float)
    fine = fine * (saturation * kr / (fine @ lamp(CELLS_NM) * CELL_NM))[:, None]
    a_places = (through(CELLS_NM) * lamp(CELLS_NM)) @ fine.T * CELL_NM
    a = fine @ lamp(CELLS_NM) * CELL_NM
    shots = zip(LIT_S, DELAY_S, EXPOSURE_S, strict=True)
    signal = np.array([(watched(a_places, kr, shot, law) * gain).sum(axis=1) for shot in shots])
    # The decay: where all of the lamp takes each state, seen well after the fade, and back to lamp-off.
    later = watched(a[None, :], kr, (CHARGE_S, 0.5, 1e-3))[0]
    at_off = later / (np.exp(-kr * 0.5) * -np.expm1(-kr * 1e-3) / (kr * 1e-3))
    error = 0.01
    charge = Charge(
        kr * np.exp(error * rng.standard_normal(n_c)),
        gain * at_off * np.exp(error * rng.standard_normal(n_c)),
        np.eye(2 * n_c) * error**2,
        Steps.of(np.array([CHARGE_S]), np.array([0.5]), np.array([0.1]), COURSE),
        shapes.light(NM, LAMP_NM),
    )
    sigma = NOISE * np.hypot(signal, 0.05 * signal.max())
    data = ExcitationData(
        Steps.of(LIT_S, DELAY_S, EXPOSURE_S, COURSE),
        signal + sigma * rng.standard_normal(signal.shape),
        sigma,
        shapes.light(NM, LAMP_NM, THROUGH),
        shapes.bands,
        shapes.band_means(NM, LAMP_NM),
        np.ones(POSITIONS_NM.size),
    )
    edges = Bands.uniform().edges_nm
    cells = [(low < CELLS_NM) & (high > CELLS_NM) for low, high in pairwise(edges)]
    by_band = np.stack([fine[:, c] @ lamp(CELLS_NM[c]) / lamp(CELLS_NM[c]).sum() for c in cells], axis=1)
    return Truth(data, charge, by_band, a, at_off / kr)


def steps_of_bands(*levels: tuple[float, ...]) -> np.ndarray:
    """(n_c, n_cells) spectra that are constant in the eight bands, and 0 outside."""
    at = np.searchsorted(Bands.uniform().edges_nm, CELLS_NM) - 1
    inside = (at >= 0) & (at < 8)
    return np.array([np.where(inside, np.array(row)[np.clip(at, 0, 7)], 0.0) for row in levels])


BLUE = (0.5, 1.0, 0.3, 0.02, 0.0, 0.0, 0.0, 0.0)
VIOLET = (1.0, 0.4, 0.06, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def two_states():
    truth = made(steps_of_bands(VIOLET, BLUE), 1.5)
    return truth, fit_excitation(truth.data, truth.charge)


def test_every_rate_comes_back_within_its_error(two_states):
    truth, fit = two_states
    found = fit.ke_m2_per_J > 0
    pulls = (fit.ke_m2_per_J - truth.ke)[found] / fit.ke_standard_error[found]
    # 6 to 8 rates, one of them 4 errors off once in 2,000 draws.
    assert found.sum() >= 6
    assert np.abs(pulls).max() < 4
    assert fit.discrepancy == 0


def test_bright_rates_are_as_sharp_as_the_data_allow(two_states):
    truth, fit = two_states
    # The decay's amplitude and rate are known to 1 %: nothing can be better, and saturation at a = 1.5 kr costs a few.
    assert (fit.ke_standard_error[:, :2] / truth.ke[:, :2] < 0.06).all()
    assert fit.ke_m2_per_J[:, :2] == pytest.approx(truth.ke[:, :2], rel=0.2)


def test_the_decay_is_known_not_to_have_begun_full(two_states):
    truth, fit = two_states
    assert truth.initial == pytest.approx([0.6, 0.6], abs=0.02)  # a / (a + kr) at a = 1.5 kr
    error = fit.scale_error * (1 - fit.initial) * fit.initial
    assert (np.abs(fit.initial - truth.initial) < 4 * error).all()
    assert (error < 0.03).all()


def test_saturation_and_emission_are_bound_to_each_other(two_states):
    _, fit = two_states
    # What makes ke larger makes Λ smaller and the decay's start fuller.
    assert (fit.correlation[:, 0] < -0.5).all()
    assert (fit.correlation[:, 1] > 0.5).all()


def test_dark_bands_come_back_as_nothing_with_a_limit(two_states):
    truth, fit = two_states
    assert (fit.ke_m2_per_J[:, 4:] == 0).all()
    limit = fit.ke_upper_limit[:, 4:]
    assert np.isfinite(limit).all()
    assert (limit > 0).all()
    # A thousandth of the best band and less: what the noise floor, 0.015 % of the brightest, and 12 frames let through.
    assert (limit < 3e-3 * truth.ke.max(axis=1, keepdims=True)).all()
    assert np.isnan(fit.ke_upper_limit[fit.ke_m2_per_J > 0]).all()
    # An estimate within 1.645 standard errors of 0, and 1.645 more: what bounds on other rates add only narrows it.
    gain = fit.product[:, :1] / fit.ke_m2_per_J[:, :1]
    assert (limit * gain <= 1.01 * 2 * 1.645 * fit.product_standard_error[:, 4:]).all()


def test_a_decay_fit_becomes_what_the_joint_fit_takes():
    t_s, exposure_s = np.arange(0.6, 180, 5.0), np.full(36, 0.5)
    light = np.stack([a * decayed(k, t_s, exposure_s) for a, k in ((40.0, 0.2), (8.0, 0.02))]).sum(axis=0)
    signal = light[:, None] * np.array([0.2, 1.0, 0.4])
    sigma = np.full(signal.shape, 0.02)
    rng = np.random.default_rng(0)
    fit = fit_decay(DecayData(t_s, exposure_s, signal + sigma * rng.standard_normal(signal.shape), sigma), 2)
    charge = Charge.from_decay(fit, Steps.of(np.ones(1), np.ones(1), np.ones(1), COURSE), np.ones(8))
    assert charge.kr_per_s == pytest.approx([0.2, 0.02], rel=0.02)
    assert charge.amplitude == pytest.approx([40.0, 8.0], rel=0.02)
    error = np.sqrt(np.diag(charge.covariance))
    assert error[:2] == pytest.approx(fit.kr_standard_error / fit.kr_per_s, rel=1e-12)
    assert error[2:] == pytest.approx(fit.strength_standard_error / fit.strength, rel=1e-12)


def decayed(kr: float, t_s: np.ndarray, exposure_s: np.ndarray) -> np.ndarray:
    return np.exp(-kr * t_s) * -np.expm1(-kr * exposure_s) / (kr * exposure_s)


def test_far_from_saturation_only_the_product_is_claimed():
    truth = made(steps_of_bands(VIOLET), 0.003)
    fit = fit_excitation(truth.data, truth.charge)
    assert fit.product_only.tolist() == [True]
    assert "only their product" in report(fit)
    # Λ ke is right to the decay's 1 % and the noise, whatever became of the factors.
    product = GAIN[0] * truth.ke[0, :3]
    assert (np.abs(fit.product[0, :3] / product - 1) < 4 * fit.product_standard_error[0, :3] / product).all()
    assert (fit.product_standard_error[0, :2] / product[:2] < 0.02).all()


def test_near_saturation_the_factors_are_claimed():
    truth = made(steps_of_bands(VIOLET), 3.0)
    fit = fit_excitation(truth.data, truth.charge)
    assert fit.product_only.tolist() == [False]
    assert "not determined" not in report(fit)
    # Known as far as saturation is: the truth lies within 4 errors.
    assert abs(np.log(fit.initial[0] / truth.initial[0])) < 4 * fit.initial_error[0]


def test_where_the_model_misses_more_than_noise_only_the_product_is_claimed(two_states):
    _, fit = two_states
    assert not fit.product_only.any()
    loose = replace(fit, discrepancy=0.03)
    assert loose.product_only.all()
    told = [line for line in report(loose).splitlines() if "r when the lamp went off" in line]
    assert len(told) == 2
    assert all("not determined" in line for line in told)


def test_a_series_that_begins_past_the_rise_says_that_it_was_not_recorded():
    truth = made(steps_of_bands(VIOLET, VIOLET), 1.5)
    # The slower state rises at 0.05 1/s behind the whole lamp, and glows a little: past half after 128 s everywhere.
    late = LIT_S >= 128
    steps = Steps.of(LIT_S[late], DELAY_S[late], EXPOSURE_S[late], COURSE)
    data = replace(truth.data, steps=steps, signal=truth.data.signal[late], sigma=truth.data.sigma[late])
    fit = fit_excitation(data, truth.charge, common_shape=True, limits=False)
    assert fit.rise_unseen
    assert "(128 s and longer) were past half of the final glow" in report(fit)
    assert "--first 1" in report(fit)
    assert not fit_excitation(truth.data, truth.charge, common_shape=True, limits=False).rise_unseen


def test_a_state_that_stays_empty_is_said_to_render_too_bright(two_states):
    _, fit = two_states
    empty = replace(fit, discrepancy=0.03, initial=np.array([0.9, 0.001]))
    (said,) = [line for line in report(empty).splitlines() if "next to empty" in line]
    assert f"the state of {fit.kr_per_s[1]:.3g} 1/s" in said


def test_one_spectrum_for_both_states_is_preferred_where_it_is_true():
    same, other = made(steps_of_bands(VIOLET, VIOLET), 1.5), made(steps_of_bands(VIOLET, BLUE), 1.5)
    assert fit_excitation(same.data, same.charge, limits=False).common_shape
    assert not fit_excitation(other.data, other.charge, limits=False).common_shape


def test_one_spectrum_for_all_states_is_told_once_and_sharper_than_the_rates():
    truth = made(steps_of_bands(VIOLET, VIOLET), 0.05)
    fit = fit_excitation(truth.data, truth.charge, common_shape=True, limits=False)
    found = fit.ke_m2_per_J[0] > 0
    ke = truth.ke[:, found]
    pulls = fit.ke_m2_per_J[:, found] / fit.a_per_s[:, None] / (ke / truth.a[:, None]) - 1
    # A handful of bands, the same in both states: one of them 4 errors off once in 3,000 draws.
    assert (np.abs(pulls) < 4 * fit.shape_error[:, found]).all()
    assert np.allclose(fit.shape_error[0], fit.shape_error[1])
    # Far from saturation the rates themselves are hardly known; how they compare is.
    assert (fit.shape_error[:, found] < 0.5 * fit.ke_standard_error[:, found] / ke).all()
    told = report(fit)
    assert all(told.count(fit.bands.label(j)) == 1 for j in range(fit.bands.n))


def test_a_rate_that_changes_within_a_band_is_met_by_straight_lines():
    slope = np.exp(-0.5 * ((CELLS_NM - 420) / 25) ** 2)[None, :]
    truth = made(slope, 1.5, shapes=Shapes.lines(Bands.uniform()))
    fit = fit_excitation(truth.data, truth.charge, limits=False)
    # The lamp's mean over a band. A line over h = 18.75 nm through a spectrum of width w = 25 nm is off by up to
    # h² / (8 w²) = 7 % of its peak, 5 % on average, of both signs; saturation is known to 1 to 2 %.
    assert fit.ke_m2_per_J[0, :2] == pytest.approx(truth.ke[0, :2], rel=0.05)
    # With a constant in each band the model misses the places by more than noise, and the rates with them.
    steps = made(slope, 1.5)
    rough = fit_excitation(steps.data, steps.charge, limits=False)
    assert rough.discrepancy > fit.discrepancy
    assert np.abs(rough.ke_m2_per_J / truth.ke - 1)[0, :2].max() > 0.05


def test_more_bands_than_places_are_refused(two_states):
    truth, _ = two_states
    few = replace(
        truth.data,
        light=truth.data.light[:5],
        signal=truth.data.signal[:, :5],
        sigma=truth.data.sigma[:, :5],
        response=truth.data.response[:5],
    )
    with pytest.raises(PhoslabError, match="5 places under the filter, too few to tell 8 rates apart"):
        fit_excitation(few, truth.charge)


def test_a_sample_that_follows_the_model_rises_in_the_time_that_is_modelled(two_states):
    _, fit = two_states
    # 5 %: half an interpolation between two exposures whose glow is known to 0.3 %.
    assert fit.rise_ratio == pytest.approx(1.0, abs=0.05)
    assert np.nanmax(np.abs(fit.level_error)) < 0.02
    assert "[[warnings]]" not in report(fit)


def test_a_sample_that_does_not_follow_the_model_is_met_at_its_level_and_its_rise_reported():
    # Recombination of pairs, dr/dt = -kr r² in place of -kr r: what the decay's exponential says is wrong for the rise.
    truth = made(steps_of_bands(BLUE), 1.5, law=lambda r: -KR[:1] * 3 * r**2)
    truth = replace(truth, charge=replace(truth.charge, amplitude=1.8 * truth.charge.amplitude))
    fit = fit_excitation(truth.data, truth.charge)
    assert fit.discrepancy > 0.01
    # What the series misses widens no error of the decay's.
    assert np.sqrt(fit.covariance[0, 0]) <= np.sqrt(truth.charge.covariance[0, 0]) * (1 + 1e-6)
    assert np.nanmedian(np.abs(fit.level_error)) < 0.02
    assert abs(fit.rise_ratio - 1) > 0.05
    said = report(fit)
    assert "does not follow the model" in said
    assert "rises" in said
    assert "Another recording does not mend this" in said
    assert "No other recording of this kind tells more" in said
    near = fit.near_from(0.1)
    assert f"From {near:.3g} s of light on it is within 10%" in said
    # Medians of all places, these being bright and clear of noise from there on: near from there, off just before.
    lit = fit.data.steps.lit_s
    off = np.array(
        [abs(np.median((m / s)[fit.bright]) - 1) for m, s in zip(fit.model, fit.data.signal, strict=True)]
    )
    assert (off[lit >= near] <= 0.1).all()
    assert off[lit == lit[lit < near].max()] > 0.1
    # And the decay is left alone.
    assert fit.kr_per_s == pytest.approx(truth.charge.kr_per_s, rel=1e-12)


def test_light_after_which_the_model_is_near_is_told_only_where_there_is_some(two_states):
    _, fit = two_states
    assert fit.near_from(0.5) == fit.data.steps.lit_s.min()
    assert np.isnan(replace(fit, model=2 * fit.model).near_from(0.1))


def test_photographs_of_one_length_of_light_are_not_joined(two_states):
    truth, fit = two_states
    # The second length of light as long as the first: as where a badly exposed photograph is followed by a better one.
    lit = truth.data.steps.lit_s.copy()
    lit[1] = lit[0]
    data = replace(truth.data, steps=replace(truth.data.steps, lit_s=lit))
    series = SimpleNamespace(data=data, charge=truth.charge, positions_nm=np.arange(data.signal.shape[1]))
    left = _excitation_figure(SimpleNamespace(fit=fit, series=series)).axes[0]
    lines = [line for line in left.lines if line.get_linestyle() == "-"]
    assert lines
    for line in lines:
        assert (np.diff(line.get_xdata()) > 0).all()
    points = left.containers[0].lines[0].get_xdata()
    assert np.unique(points).size == points.size


def test_a_saturated_value_is_left_out(two_states):
    truth, _ = two_states
    signal, sigma = truth.data.signal.copy(), truth.data.sigma.copy()
    signal[9, :4], sigma[9, :4] = 1e9, np.inf
    fit = fit_excitation(replace(truth.data, signal=signal, sigma=sigma), truth.charge, limits=False)
    assert fit.chi2 / fit.dof < 1.5
    assert (fit.residual[9, :4] == 0).all()


def test_a_frame_s_own_scale_is_no_misfit(two_states):
    truth, fit = two_states
    scale = 1 + 0.01 * np.random.default_rng(2).standard_normal(LIT_S.size)
    data = replace(truth.data, signal=truth.data.signal * scale[:, None])
    assert fit_excitation(data, truth.charge, limits=False).discrepancy > 0
    repeated = fit_excitation(replace(data, repeatability=0.01), truth.charge, limits=False)
    assert repeated.discrepancy == 0
    found = fit.ke_m2_per_J > 0
    assert repeated.ke_m2_per_J[found] == pytest.approx(fit.ke_m2_per_J[found], rel=0.15)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: (replace(t.data, sigma=np.full_like(t.data.sigma, np.inf)), t.charge), "too few"),
        (lambda t: (replace(t.data, signal=0 * t.data.signal), t.charge), "does not glow"),
        (lambda t: (t.data, replace(t.charge, light=0 * t.charge.light)), "no light"),
        (lambda t: (t.data, replace(t.charge, amplitude=np.array([1.0, 0.0]))), "without amplitude"),
        (lambda t: (t.data, replace(t.charge, covariance=np.full((4, 4), np.inf))), "does not determine"),
    ],
)
def test_what_cannot_be_fitted_is_said(two_states, change, words):
    with pytest.raises(PhoslabError, match=words):
        fit_excitation(*change(two_states[0]))


def test_light_of_bands_sums_to_the_whole():
    total = np.trapezoid(LAMP_NM, NM)
    odd = Bands(np.array([360.0, 401.3, 555.5, 740.0]))
    # A straight line is integrated exactly by the middles of cells.
    assert Shapes(odd).light(NM, LAMP_NM).sum() == pytest.approx(total, rel=1e-12)
    # Shapes of straight lines sum to 1 everywhere, from 362.5 to 737.5 nm.
    lines = Shapes.lines(Bands.uniform())
    inside = (NM >= 362.5) & (NM <= 737.5)
    assert lines.light(NM, LAMP_NM).sum() == pytest.approx(
        np.trapezoid(LAMP_NM[inside], NM[inside]), rel=1e-12
    )
    assert lines.band_means(NM, LAMP_NM).sum(axis=1) == pytest.approx(np.ones(8), rel=1e-12)


def test_a_band_s_mean_rate_is_the_lamp_s():
    # Light at 400 to 410 nm alone: the mean of a band is the rate at 405 nm, 5 / 18.75 of the way between its nodes.
    nm = np.array([399.999, 400.0, 410.0, 410.001, 437.5, 475.0])
    lines = Shapes.lines(Bands(np.array([400.0, 437.5, 475.0])))
    light = np.array([0.0, 1.0, 1.0, 0.0, 1e-9, 1e-9])
    rates = np.where(lines.nodes_nm == 418.75, 1.0, 0.0)
    # Cells of 0.25 nm: the last one of the ten may lie half outside.
    assert (lines.band_means(nm, light) @ rates)[0] == pytest.approx(5 / 18.75, rel=0.03)


def test_light_outside_the_bands_is_noticed():
    share = outside(NM, LAMP_NM, Bands.uniform(), THROUGH)
    assert share[0] > 0.3  # half of the band at 400 nm
    assert share[15] < 0.02


def test_a_band_without_light_is_refused():
    with pytest.raises(PhoslabError, match="no light at 400-437"):
        Shapes(Bands.uniform()).band_means(np.array([450.0, 700.0]), np.array([1.0, 1.0]))


@pytest.fixture(scope="module")
def paint_of_traps():
    """The bench's green paint under its filter: traps that fill one another, computed by the bench, with noise."""
    sample, lvf, nm = paint("green"), Lvf(), np.arange(380.0, 740.0)
    lamp_nm = lights.halogen(3000.0)(nm)
    u = np.linspace(0.02, 0.98, 31)
    through_nm = lvf.transmission(u, nm)
    # As the bench: means over the 400 nm from 360 to 760.
    power = sample.excitation(nm) * lamp_nm * sample.excitation_per_s / 400
    places, whole = through_nm @ power, np.array([power.sum()])

    def glow_of(drive, lit_s, moments, exposure_s):
        film = Film(sample, np.zeros((drive.size, sample.n_depths)))
        film, _ = film.advance(lit_s, lambda t: drive * lamp_level(t, lit_s))
        film, _ = film.advance(FADE_S, lambda t: drive * lamp_level(lit_s + t, lit_s))
        now, seen = FADE_S, []
        for moment in moments:
            film, _ = film.advance(moment - now)
            film, light = film.advance(exposure_s)
            seen.append(light / exposure_s)
            now = moment + exposure_s
        return np.array(seen)

    rng = np.random.default_rng(3)
    t_s = np.arange(0.6, 181, 5.0)
    fading = 1e4 * glow_of(whole, 1800.0, t_s, 0.5)
    sigma = 0.003 * fading + 1e-3
    decay = DecayData(t_s, np.full(t_s.size, 0.5), fading + sigma * rng.standard_normal(fading.shape), sigma)
    lit_s = np.array([1.0, 2, 4, 8, 16, 32, 64, 128, 5.7, 11.3])
    signal = 1e4 * np.concatenate([glow_of(places, t, [0.7], 1.0) for t in lit_s])
    shapes = Shapes.lines(Bands.uniform())
    charge = Charge.from_decay(
        fit_decay(decay, 3),
        Steps.of(np.array([1800.0]), np.array([0.5]), np.array([0.1]), COURSE),
        shapes.light(nm, lamp_nm),
    )
    sigma = NOISE * np.hypot(signal, 0.01 * signal.max())
    data = ExcitationData(
        Steps.of(lit_s, np.full(10, 0.7), np.full(10, 1.0), COURSE),
        signal + sigma * rng.standard_normal(signal.shape),
        sigma,
        shapes.light(nm, lamp_nm, through_nm),
        shapes.bands,
        shapes.band_means(nm, lamp_nm),
        np.ones(31),
    )
    share = Shapes(shapes.bands).light(nm, power)
    return (
        fit_excitation(data, charge, limits=False),
        Shapes(shapes.bands).light(nm, lamp_nm),
        share / share.sum(),
    )


def test_paint_of_traps_is_met_at_its_level_within_2_percent(paint_of_traps):
    fit, _, _ = paint_of_traps
    assert np.nanmedian(np.abs(fit.level_error)) < 0.02


def test_paint_of_traps_rises_slower_than_any_model_and_that_is_reported(paint_of_traps):
    fit, _, _ = paint_of_traps
    # Retrapping: the first electrons fill traps and give little light. The paper found the same of its model.
    assert fit.rise_ratio < 0.95
    told = report(fit)
    assert "rises faster than the measured one" in told
    measured = np.nanmedian(fit.rise_s[:, 0])
    assert f"after {measured * fit.rise_ratio:.2g} s of light, the sample after {measured:.2g} s" in told
    lit_s, factor = fit.farthest_off()
    frame = int(np.argmin(np.abs(fit.data.steps.lit_s - lit_s)))
    ratio = fit.model[frame, fit.bright] / fit.data.signal[frame, fit.bright]
    assert ratio.min() < factor < ratio.max()
    # It is early that a sample of traps lags behind.
    assert factor > 1.2
    assert lit_s < measured
    assert f"after {lit_s:.2g} s of light, where it is {factor:.2g} times as bright" in told


def test_the_excitation_spectrum_of_paint_of_traps_comes_out(paint_of_traps):
    fit, light, truth = paint_of_traps
    share = fit.product.sum(axis=0) * light
    # What the glow at rest says of the drive is not linear in it where traps are caught again: 5 points of 100.
    assert share / share.sum() == pytest.approx(truth, abs=0.05)


def test_a_step_beyond_all_rates_has_no_model_and_no_overflow(two_states):
    truth, _ = two_states
    problem = Problem(truth.data, truth.charge, common=True)
    near = problem.start(1.0)
    residual, slope = problem.residual(near)
    far = near.copy()
    far[2 * problem.n_c] = 800.0  # log of the ratio of two states' rates: exp of it is no float
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lost, lost_slope = problem.residual(far)
    assert (lost.shape, lost_slope.shape) == (residual.shape, slope.shape)
    assert np.isinf(lost).all()
