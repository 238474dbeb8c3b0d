"""What the bench says that it did is what its frames show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from benches import laboratory

from phoslab import raw
from phoslab.instruments.bench import rig
from phoslab.instruments.controller import RigController
from phoslab.instruments.devices import Exposure


def test_a_decays_frames_follow_the_true_light_with_the_true_settings(tmp_path: Path) -> None:
    with rig.start("blue", seed=11) as bench:
        lab = laboratory(bench)
        controller = RigController(bench.port, clock=lab.clock)
        for device in (controller.lamp, controller.door, lab.camera):
            device.stage()
        controller.lamp.allow_until(lab.clock.mono_s() + 700)
        controller.lamp.set("on").wait(5)
        lab.clock.sleep_until(lab.clock.mono_s() + 600)
        controller.lamp.set("off").wait(5)
        off_s = controller.lamp.read()["lamp"]["mono_s"]
        lab.clock.sleep_until(off_s + 0.4)
        controller.door.set("open").wait(5)
        starts, doubts, means, variances = [], [], [], []
        shots = ((1.0, 0.25, 100), (10.0, 0.5, 100), (30.0, 0.5, 200), (60.0, 2.0, 400))
        for k, (at_s, exposure_s, iso) in enumerate(shots):
            lab.clock.sleep_until(off_s + at_s)
            lab.camera.set(Exposure(exposure_s, iso, 2.8)).wait(10)
            lab.camera.trigger().wait(10)
            lab.camera.save(tmp_path / f"{k}.dng")
            readings = lab.camera.read()
            starts.append(readings["start"]["value"])
            doubts.append(readings["start_uncertainty"]["value"])
            found = raw.region_means(tmp_path / f"{k}.dng", (50, 100, 60, 140))
            means.append(found.mean[1])
            variances.append(found.variance[1])
        times_s = [s + f * shots[k][1] for k, s in enumerate(starts) for f in (0.0, 0.5, 1.0)]
        true = rig.truth(bench, times_s)
        settings = {
            name: {round(said, 9): real for said, real in known} for name, known in true["settings"].items()
        }
        # Simpson's rule over each exposure.
        light = np.array(true["light"]).reshape(-1, 3) @ [1, 4, 1] / 6
        gains = [settings["exposure_s"][e] * settings["iso"][i] for _, e, i in shots]
        signal = np.array(means) / (light * gains)
        controller.lamp.unstage()
    # Noise; the doubt about the moment, times the decay's steepest rate (some kr = 0.032/s, three times that at first);
    # dark current and hot pixels, not taken off: (0.3 + 0.06) e/s of some 2.4 e/DN, against hundreds of DN.
    noise = 4 * np.sqrt(variances) / np.array(means) + 0.1 * np.array(doubts) + 2e-3
    assert (np.abs(signal / signal[0] - 1) < noise + noise[0]).all()
    assert np.ptp(light) > 5 * light.min()


def test_the_strip_lies_where_the_truth_says(tmp_path: Path) -> None:
    with rig.start("blue", seed=12) as bench:
        lab = laboratory(bench)
        controller = RigController(bench.port, clock=lab.clock)
        controller.door.stage()
        lab.camera.stage()
        lab.hands.place(target="card", lvf="camera", light="led")
        controller.door.set("open").wait(5)
        lab.camera.set(Exposure(1 / 15, 100, 2.8)).wait(10)
        lab.camera.trigger().wait(10)
        lab.camera.save(tmp_path / "a.dng")
        lvf = rig.truth(bench)["lvf"]
        controller.door.unstage()
    picture = raw.preview(tmp_path / "a.dng", largest=200)
    green = picture.image[..., 1]
    blue_top, red_top, red_bottom, blue_bottom = (np.array(c) / picture.bin for c in lvf["corners_px"])
    # A column a little to the red of the middle, where the LED is bright: the strip's edges there, and what is bright.
    x = np.interp(0.55, [0, 1], [blue_top[0], red_top[0]])
    top = np.interp(x, [blue_top[0], red_top[0]], [blue_top[1], red_top[1]])
    bottom = np.interp(x, [blue_bottom[0], red_bottom[0]], [blue_bottom[1], red_bottom[1]])
    column = green[:, int(x)]
    assert not picture.saturated.any()
    bright = np.flatnonzero(column > 0.5 * column.max())
    # Bins are two pixels; the lens blurs by less than one.
    assert bright[0] == pytest.approx(top, abs=1.5)
    assert bright[-1] + 1 == pytest.approx(bottom, abs=1.5)
