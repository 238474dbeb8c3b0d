"""The probe of the path tracer's noise, held against pictures of the size that is planned for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from phoslab.render import load_scene
from phoslab.render.path_tracer import usual_variant
from phoslab.render.planning.drawn import render_choices
from phoslab.render.planning.pilot import look
from phoslab.render.planning.probe import PATHS, SIGMAS, STRATIFIED, PathNoise, measure_noise
from phoslab.render.planning.reduced import whole

SIZE = (64, 64)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory, planned_scenes):
    scene = planned_scenes.draw(tmp_path_factory.mktemp("drawn"), 6113)
    return load_scene(scene.folder), scene.time


@pytest.mark.parametrize("samples", [4, 64])
def test_a_picture_is_as_noisy_as_the_probe_says(drawn, device, samples):
    """No more: what the mean over 576 pixels leaves open is in it. Less, by as much again and by 0.6: the probe's
    pixels are larger and see more edges. And many paths are taken to gain by their number alone, with the power 1/2,
    while those that are stratified may gain with 3/4, as few of them do."""
    pytest.importorskip("mitsuba")
    scene, time = drawn
    pilot = look(scene, [scene.schedule.parse_time(time)], SIZE)
    everything = whole(scene)
    noise = measure_noise(pilot, everything, usual_variant(), device=device)
    assert noise is not None

    def picture(**gi: object) -> np.ndarray:
        return render_choices(scene, replace(everything, gi=gi), [time], SIZE, device=device)[0].xyz

    bare = picture(method="none")
    one, other = (picture(method="reference", samples=samples, full=True, seed=s) for s in (1, 2))
    reflected = float(((one + other) / 2 - bare).mean())
    seen = float(np.abs(one - other).mean() / np.sqrt(2)) / reflected
    least = 0.6 / (1 + 2 * SIGMAS * noise.spread) * (PATHS / max(samples, PATHS)) ** (STRATIFIED - 0.5)
    assert least * noise.of(samples) < seen < noise.of(samples)


def test_noise_falls_with_the_root_of_many_paths_and_faster_with_few():
    noise = PathNoise(0.1)
    assert noise.of(PATHS) == pytest.approx(0.1)
    assert noise.of(4 * PATHS) == pytest.approx(0.05)
    assert noise.of(PATHS // 4) > 0.2
