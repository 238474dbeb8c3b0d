"""What the plans ask for, played against a light that is known: only the steps and their answers."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from phoslab.instruments.devices import Exposure
from phoslab.instruments.plans import start
from phoslab.instruments.plans.ladder import NOMINAL, Ladder, gain
from phoslab.instruments.plans.steps import (
    Cold,
    Dark,
    Door,
    Lamp,
    Part,
    Plan,
    Setup,
    Shoot,
    Shot,
    Stage,
    Step,
    Wait,
)
from phoslab.instruments.rehearsal import Rehearsal
from phoslab.plan_parameters import PLANS, parameters

SETUP = Setup(Ladder.of(NOMINAL), cycle_s=0.5, filters=("R02", "R27", "R80"))


Light = Callable[[float | None, Stage, float], float]


@dataclass
class Player:
    """Answers steps as an ideal rig would.

    Args:
        light: brightness of what the camera sees, in levels at gain 1, from the s since lamp-off (None while it is on),
            how the bench stands, and the s for which the lamp was on before.
        cold: whether the lights are, whenever it is asked.
    """

    light: Light
    cold: bool = False
    now_s: float = 1000.0
    on: bool = False
    off_s: float = -1e9
    on_s: float = 0.0
    door: str = "?"
    stage: Stage | None = None
    steps: list[Step] = field(default_factory=list)
    shots: list[tuple[Shoot, Shot]] = field(default_factory=list)
    troubles: list[str] = field(default_factory=list)
    part: str = ""
    parts: list[str] = field(default_factory=list)
    lit: list[tuple[str, float]] = field(default_factory=list)

    def play(self, plan: Plan) -> Player:
        answer: Any = None
        while True:
            try:
                step = plan.send(answer)
            except StopIteration:
                return self
            self.steps.append(step)
            answer = self._answer(step)

    def _answer(self, step: Step) -> Any:
        self.now_s += 0.01
        match step:
            case Part(name):
                self.parts.append(name)
            case Stage():
                if step != self.stage and self.on:
                    self.troubles.append("a hand is asked for while the lamp is on")
                self.stage = step
            case Cold():
                return self.cold
            case Lamp(to):
                if self.on and to == "off":
                    self.off_s = self.now_s
                    self.lit.append((self.stage.target if self.stage else "?", self.now_s))
                elif to == "on" and not self.on:
                    self.on_s = self.now_s
                self.on = to == "on"
                return self.now_s
            case Door(to):
                self.now_s += 0.28
                self.door = to
                return self.now_s
            case Wait(duration_s, _, since_s):
                self.now_s = max(self.now_s, (self.now_s if since_s is None else since_s) + duration_s)
            case Dark(duration_s):
                self.now_s = max(self.now_s, self.off_s + duration_s)
            case Shoot():
                return self._shoot(step)
        return None

    def _shoot(self, step: Shoot) -> Shot:
        if step.at_s is not None:
            self.now_s = max(self.now_s, step.at_s)
        start_s = self.now_s
        assert self.stage is not None
        since_s = None if self.on else start_s - self.off_s
        bright = self.light(since_s, self.stage, self.off_s - self.on_s) if self.door == "open" else 0.0
        shot = Shot(
            f"{len(self.shots):04d}.dng", step.exposure, start_s, min(1.0, bright * gain(step.exposure)), 0.0
        )
        self.now_s += step.exposure.exposure_s + SETUP.cycle_s
        self.shots.append((step, shot))
        return shot

    def of(self, role: str) -> list[Shot]:
        return [shot for step, shot in self.shots if step.role == role]


def fading(brightness: float, rate_per_s: float) -> Light:
    return lambda since_s, _, lit_s: (
        brightness * (30.0 if since_s is None else math.exp(-rate_per_s * since_s))
    )


def filling(brightness: float, tau_s: float) -> Light:
    """A glow that fills with light as 1 - exp(-t/tau), and hardly fades."""
    return lambda since_s, _, lit_s: (
        1e5 if since_s is None else brightness * (1 - math.exp(-lit_s / tau_s)) * math.exp(-1e-3 * since_s)
    )


def run(plan: str, light: Light, **given: Any) -> Player:
    return Player(light).play(start(parameters(plan, given), SETUP))


BRIGHTEST = 0.3 / gain(SETUP.ladder.rungs[0])
"""A glow that the ladder's lowest rung still shows well."""


@given(st.floats(0.0, 0.22), st.floats(math.log(10.0), math.log(BRIGHTEST)), st.sampled_from(["even", "log"]))
def test_every_frame_of_a_decay_is_well_exposed_while_the_ladder_reaches(
    rate_per_s: float, log_brightness: float, spacing: str
) -> None:
    """Between 5 % and 80 % of saturation, for any light that falls to a third, at most, from frame to frame."""
    player = run(
        "decay", fading(math.exp(log_brightness), rate_per_s), spacing=spacing, until_s=180, charge_s=600
    )
    for shot in player.of("decay"):
        most = [e for e in SETUP.ladder.rungs if e.exposure_s <= 2.0][-1]
        reachable = shot.level / gain(shot.exposure) * gain(most) > 0.5
        if reachable:
            assert 0.05 <= shot.level <= 0.80, (shot, rate_per_s)


def test_a_decay_is_37_frames_on_the_papers_grid_and_overlaps_between_them() -> None:
    player = run("decay", fading(50.0, 0.03))
    planned = [step.at_s for step, _ in player.shots if step.role == "decay" and step.at_s is not None]
    assert len(planned) == 37
    assert [b - a for a, b in itertools.pairwise(planned)] == pytest.approx([5.0] * 36)
    assert player.of("decay")[0].start_s - player.off_s < 0.85
    assert planned[-1] - planned[0] == pytest.approx(180.0)


def test_where_a_decay_changes_its_setting_both_settings_saw_the_same_light() -> None:
    player = run("decay", fading(50.0, 0.03))
    shots = player.of("decay")
    changes = [(a, b) for a, b in itertools.pairwise(shots) if a.exposure != b.exposure]
    # Where both fit into 5 s, with half a second for each to be saved; longer ones are overlapped by the flats.
    changes = [(a, b) for a, b in changes if a.exposure.exposure_s + b.exposure.exposure_s + 1.0 < 5.0]
    assert len(changes) >= 5
    for a, b in changes:
        assert b.start_s - a.start_s < a.exposure.exposure_s + 0.6
        assert b.level / a.level == pytest.approx(gain(b.exposure) / gain(a.exposure), rel=0.1)


def test_log_spacing_reaches_an_hour_with_few_frames_and_the_last_is_at_its_end() -> None:
    player = run("decay", fading(50.0, 0.0005), spacing="log", until_s=3600, per_decade=15)
    planned = [step.at_s - player.off_s for step, _ in player.shots if step.role == "decay" and step.at_s]
    assert planned[-1] == pytest.approx(3600.0)
    assert len(planned) < 60
    assert all(b > a for a, b in itertools.pairwise(planned))


@pytest.mark.parametrize("plan", PLANS)
def test_every_setting_of_every_plan_has_dark_frames(plan: str) -> None:
    player = run(plan, fading(40.0, 0.01), **({"charge_s": 600} if plan in ("decay", "emission") else {}))
    dark = {(s.exposure.exposure_s, s.exposure.iso) for s in player.of("dark")}
    others = {
        (s.exposure.exposure_s, s.exposure.iso)
        for step, s in player.shots
        if step.role not in ("dark", "meter")
    }
    assert others <= dark


@pytest.mark.parametrize("plan", PLANS)
def test_no_plan_leaves_the_lamp_on_or_asks_for_a_hand_under_it(plan: str) -> None:
    player = run(plan, fading(40.0, 0.01))
    assert not player.on
    assert player.troubles == []


@pytest.mark.parametrize("plan", PLANS)
def test_parts_have_different_names_and_each_says_how_the_bench_must_stand(plan: str) -> None:
    """What is resumed by name must have one; a part may be the first of a session that is taken up again."""
    player = run(plan, fading(40.0, 0.01))
    assert max(Counter(player.parts).values()) == 1
    opening = ""
    for step in player.steps:
        if isinstance(step, Part):
            opening = step.name
        elif isinstance(step, Stage):
            opening = ""
        elif isinstance(step, Shoot):
            assert not opening or opening == "dark frames", opening


@pytest.mark.parametrize("plan", PLANS)
def test_a_rehearsal_is_no_shorter_than_the_plan_and_counts_its_frames(plan: str) -> None:
    """An ideal rig needs no more time, and no more frames save for trials, than the rehearsal says."""
    player = run(plan, fading(40.0, 0.001))
    line = Rehearsal(SETUP).run(start(parameters(plan, {}), SETUP))
    took_s = player.now_s - 1000.0
    n_frames = sum(step.role not in ("meter", "dark") for step, _ in player.shots)
    rehearsed = line.n_frames - line.frames["meter"] - line.frames["dark"]
    # Settings differ, so overlaps and exposure times do: a tenth.
    assert took_s <= 1.1 * line.duration_s + 60
    assert n_frames <= 1.5 * rehearsed + 10


def test_excitation_doubles_until_the_glow_no_longer_grows_then_goes_between() -> None:
    player = run("excitation", filling(30.0, 20.0), between=3, dark_s=100)
    times = [s.duration_s for s in player.steps if isinstance(s, Wait) and "exciting" in s.why]
    doubled = [t for t in times if math.log2(t) % 1 == 0]
    # 1 - exp(-t/20) grows by 4.1 % from 64 s to 128 s, and by less than 2 %, 0.2 %, from 128 s to 256 s.
    assert doubled == [1, 2, 4, 8, 16, 32, 64, 128, 256]
    # It grows most from 16 s to 32 s (0.25), from 8 s to 16 s (0.22) and from 32 s to 64 s (0.16).
    assert times[len(doubled) :] == pytest.approx([11.31, 22.63, 45.25], abs=0.01)


@pytest.mark.parametrize("samples", [1, 3])
def test_each_excitation_begins_with_a_sample_that_rested_in_the_dark(samples: int) -> None:
    player = run("excitation", filling(40.0, 100.0), dark_s=3600, samples=samples, last_s=64)
    lit = player.lit
    assert len(lit) == 7 + 4
    assert len({target for target, _ in lit}) == samples
    for k, (target, off_s) in enumerate(lit):
        before = [s for t, s in lit[:k] if t == target]
        if before:
            assert off_s - before[-1] > 3600


def test_an_excitation_whose_lamp_warms_up_on_the_card_lights_the_sample_only_for_its_exposure() -> None:
    glow = filling(40.0, 100.0)

    def light(since_s: float | None, stage: Stage, on_s: float) -> float:
        return 40.0 if stage.target == "card" and since_s is None else glow(since_s, stage, on_s)

    plan = start(
        parameters("excitation", {"dark_s": 3600, "last_s": 8, "between": 0, "warm_up": "card"}), SETUP
    )
    player = Player(light, cold=True).play(plan)
    assert player.troubles == []
    # Card and sample in turn, and the sample right after the card: the lamp is still warm.
    assert [target for target, _ in player.lit] == ["card", "sample"] * 4
    for (_, warm_s), (_, off_s), lit_s in zip(player.lit[::2], player.lit[1::2], (1, 2, 4, 8), strict=True):
        assert off_s - warm_s == pytest.approx(lit_s, abs=0.5)
    exposed = [off_s for target, off_s in player.lit if target == "sample"]
    assert all(b - a > 3600 for a, b in itertools.pairwise(exposed))


def test_flats_hold_an_overlap_for_every_neighbouring_exposure_time_iso_and_aperture() -> None:
    player = run("flats", lambda since_s, *_: 40.0 if since_s is None else 0.0)
    flats = [s.exposure for s in player.of("flat")]
    pairs = {frozenset((a, b)) for a, b in itertools.pairwise(flats) if a != b}
    changes: Counter[str] = Counter()
    for pair in pairs:
        a, b = sorted(pair, key=gain)
        differ = [n for n in ("exposure_s", "iso", "f_number") if getattr(a, n) != getattr(b, n)]
        if len(differ) == 1:
            changes[differ[0]] += 1
    ladder = SETUP.ladder
    assert changes["iso"] >= len(ladder.isos) - 1
    assert changes["f_number"] >= len(ladder.f_numbers) - 1
    # Light of one brightness cannot show the longest times: f/16 and ISO 100 overexpose them.
    assert changes["exposure_s"] >= 8
    for shot in player.of("flat"):
        assert shot.level <= 0.80


def test_the_noise_model_has_pairs_at_several_levels_for_every_iso() -> None:
    player = run("flats", lambda since_s, *_: 40.0 if since_s is None else 0.0, levels=4)
    pairs = Counter(s.exposure for s in player.of("flat"))
    for iso in SETUP.ladder.isos:
        assert sum(n >= 2 for e, n in pairs.items() if e.iso == iso) >= 4


def test_each_filter_is_a_part_of_its_own_and_says_how_many_there_are() -> None:
    player = run("lvf", lambda since_s, stage, _: 40.0 if stage.filter == "none" else 4.0)
    filters = ["filter R02", "filter R27", "filter R80"]
    assert player.parts == ["mercury", "LED", *filters, "LED without the LVF", "dark frames"]
    roles = [step.role for step, _ in player.shots if step.role not in ("meter", "dark")]
    assert roles == ["mercury", "led", "filter:R02", "filter:R27", "filter:R80", "flat"]
    stages = [s for s in player.steps if isinstance(s, Stage) and s.filter != "none"]
    assert [s.progress for s in stages] == ["filter 1 of 3", "filter 2 of 3", "filter 3 of 3"]


def test_a_lost_frame_of_a_decay_does_not_stop_it_nor_spoil_the_exposure() -> None:
    n_tried = 0

    class Losing(Player):
        def _shoot(self, step: Shoot) -> Shot:
            nonlocal n_tried
            shot = super()._shoot(step)
            n_tried += step.role == "decay"
            if step.role == "decay" and n_tried in (3, 4, 10):
                self.shots.pop()
                return Shot(None, step.exposure, shot.start_s, math.nan, 0.0)
            return shot

    player = Losing(fading(50.0, 0.03)).play(start(parameters("decay", {}), SETUP))
    assert len(player.of("decay")) >= 34
    assert all(0.05 <= s.level <= 0.80 for s in player.of("decay"))


def test_the_ladder_catches_light_before_it_amplifies() -> None:
    rungs = SETUP.ladder.rungs
    assert [gain(e) for e in rungs] == sorted(gain(e) for e in rungs)
    assert all(e.f_number == 2.8 for e in rungs if e.exposure_s > SETUP.ladder.exposures_s[0])
    assert all(e.exposure_s == SETUP.ladder.exposures_s[-1] for e in rungs if e.iso > 100)
    ratios = [gain(b) / gain(a) for a, b in itertools.pairwise(rungs)]
    assert all(1.7 < r < 2.4 for r in ratios)


def test_third_stops_as_cameras_name_them_become_whole_stops() -> None:
    thirds = (1 / 60, 1 / 50, 1 / 40, 1 / 30, 1 / 25, 1 / 20, 1 / 15, 1 / 13, 0.1, 1 / 8, 1 / 6, 0.2, 0.25)
    f_numbers = (2.8, 3.2, 3.5, 4, 4.5, 5, 5.6, 6.3, 7.1, 8, 9, 10, 11, 13, 14, 16)
    ladder = Ladder.of(
        {"exposure_s": thirds, "iso": (100, 125, 160, 200, 250, 320, 400), "f_number": f_numbers}
    )
    assert ladder.exposures_s == (1 / 60, 1 / 30, 1 / 15, 1 / 8, 0.25)
    assert ladder.isos == (100, 200, 400)
    assert ladder.f_numbers == (2.8, 4, 5.6, 8, 11, 16)


def test_a_camera_without_aperture_or_choice_still_has_a_ladder() -> None:
    ladder = Ladder.of({"exposure_s": (0.5,), "iso": (100,)})
    assert ladder.rungs == (Exposure(0.5, 100, None),)
    assert ladder.aim(ladder.rungs[0], 0.01) == ladder.rungs[0]
