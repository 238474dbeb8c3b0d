"""The bench's camera, over its socket: a camera like the others, with faults that it gets over or names."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from benches import SHORT, Laboratory, laboratory
from camera_contract import CameraContract

from phoslab import raw
from phoslab.instruments.bench import rig
from phoslab.instruments.cameras.simulated import SimulatedCamera
from phoslab.instruments.devices import DeviceError, DeviceGoneError, Exposure
from phoslab.instruments.simulated import BenchClock


@pytest.fixture(scope="module")
def lab() -> Iterator[Laboratory]:
    with rig.start("green", seed=3) as bench:
        yield laboratory(bench)


@pytest.fixture
def camera(lab: Laboratory) -> SimulatedCamera:
    return laboratory(lab.bench).camera


@pytest.fixture
def clock(lab: Laboratory) -> BenchClock:
    return lab.clock


@pytest.fixture
def exposure() -> Exposure:
    return SHORT


class TestSimulatedCamera(CameraContract):
    """See CameraContract."""


def test_waiting_for_an_exposure_of_30_s_takes_its_lag_only(lab: Laboratory, camera: SimulatedCamera) -> None:
    import time

    camera.stage()
    camera.set(Exposure(30.0, 100.0, 2.8)).wait(10)
    before_s, begin = lab.clock.mono_s(), time.monotonic()
    camera.trigger().wait(10)
    assert lab.clock.mono_s() - before_s > 30
    assert time.monotonic() - begin < 10


def test_a_jump_neither_outruns_the_shutter_nor_hides_when_it_opened(
    lab: Laboratory, camera: SimulatedCamera
) -> None:
    """A plan that sleeps until the exposure must be over lets the clock jump right after the release."""
    camera.stage()
    camera.set(Exposure(10.0, 100.0, 2.8)).wait(10)
    for _ in range(10):
        before_s = lab.clock.mono_s()
        status = camera.trigger()
        lab.clock.sleep_until(before_s + 10)
        status.wait(10)
        readings = camera.read()
        # It lags by 65 ms, and was seen then: not at the end of a jump of 10 s.
        assert readings["start"]["value"] - before_s < 5
        assert readings["start_uncertainty"]["value"] < 2


def test_the_same_light_at_other_settings_is_the_same_but_for_what_the_dial_leaves_out(
    lab: Laboratory, camera: SimulatedCamera, tmp_path: Path
) -> None:
    """Third stops are rounded on the dial (1/60 s is 1/64 s, 6.3 %), and missed by 2 % in time, ISO and aperture."""
    lab.hands.place(target="card", light="led")
    camera.stage()
    signals = []
    # The door is closed until the controller opens it: let it be opened.
    from phoslab.instruments.controller import RigController

    controller = RigController(lab.bench.port, clock=lab.clock)
    controller.door.stage()
    controller.door.set("open").wait(10)
    lab.clock.sleep_until(lab.clock.mono_s() + 3600)
    for k, exposure in enumerate(
        (Exposure(1 / 125, 100, 4.0), Exposure(1 / 60, 100, 5.6), Exposure(1 / 125, 200, 5.6))
    ):
        camera.set(exposure).wait(10)
        camera.trigger().wait(10)
        path = tmp_path / f"{k}.dng"
        camera.save(path)
        h, w = raw.read_raw(path).values.shape
        mean, _ = raw.per_second(raw.region_means(path, (h // 3, 2 * h // 3, w // 3, 2 * w // 3)))
        signals.append(mean[1])
    controller.door.set("closed").wait(10)
    controller.door.unstage()
    ratios = np.array(signals) / signals[0]
    assert (np.abs(np.log(ratios)) < np.log(1.063) + 0.008 + 0.03 + 0.032).all()
    assert (np.abs(np.log(ratios[1:])) > 1e-3).all()


def test_a_card_fills_up_and_a_frame_that_was_saved_makes_room(tmp_path: Path) -> None:
    with rig.start("green", card_frames=2) as bench:
        camera = laboratory(bench).camera
        camera.stage()
        camera.set(SHORT).wait(10)
        for k in range(4):  # each is deleted once it is saved
            camera.trigger().wait(10)
            camera.save(tmp_path / f"{k}.dng")
        connection = camera._connection
        for _ in range(2):  # frames of somebody else's
            camera._link.ask("expose", connection=connection)
            camera._clock.sleep_until(camera._clock.mono_s() + 1)
        with pytest.raises(DeviceError, match="full card"):
            camera.trigger().wait(10)


class TestFaults:
    """Each by its name, at the driver."""

    @pytest.fixture(autouse=True)
    def staged(self, camera: SimulatedCamera) -> Iterator[None]:
        camera.stage()
        camera.set(SHORT).wait(10)
        yield
        camera.unstage()

    def test_a_busy_camera_is_asked_again(self, lab: Laboratory, camera: SimulatedCamera) -> None:
        n = lab.state()["exposures"]
        lab.hands.inject("camera-busy")
        camera.trigger().wait(10)
        assert lab.state()["exposures"] == n + 1

    def test_a_camera_that_is_gone_says_so_and_comes_back_when_it_is_staged(
        self, lab: Laboratory, camera: SimulatedCamera, tmp_path: Path
    ) -> None:
        import time

        lab.hands.inject("camera-gone")
        with pytest.raises(DeviceGoneError, match="camera is not connected"):
            camera.trigger().wait(10)
        with pytest.raises(DeviceGoneError):
            camera.stage()
        time.sleep(1.1)
        camera.stage()
        camera.set(SHORT).wait(10)
        camera.trigger().wait(10)
        camera.save(tmp_path / "a.dng")

    def test_a_card_that_only_seems_full_is_got_over_by_connecting_anew(
        self, lab: Laboratory, camera: SimulatedCamera, tmp_path: Path
    ) -> None:
        n = lab.state()["exposures"]
        lab.hands.inject("card-full")
        camera.trigger().wait(10)
        camera.save(tmp_path / "a.dng")
        assert lab.state()["exposures"] == n + 1

    def test_a_truncated_download_is_told_and_the_frame_can_be_fetched_again(
        self, lab: Laboratory, camera: SimulatedCamera, tmp_path: Path
    ) -> None:
        camera.trigger().wait(10)
        lab.hands.inject("truncated-download")
        with pytest.raises(DeviceError, match=r"sent \d+ of \d+ bytes"):
            camera.save(tmp_path / "a.dng")
        camera.save(tmp_path / "a.dng")
        assert raw.read_raw(tmp_path / "a.dng").values.size

    def test_a_late_shutter_is_seen(self, lab: Laboratory, camera: SimulatedCamera) -> None:
        lab.hands.inject("late-shutter")
        before_s = lab.clock.mono_s()
        camera.trigger().wait(10)
        assert camera.read()["start"]["value"] - before_s > 0.7

    def test_a_fault_waits_for_its_exposure(self, lab: Laboratory, camera: SimulatedCamera) -> None:
        lab.hands.inject(f"late-shutter@{lab.state()['exposures'] + 2}")
        lags = []
        for _ in range(3):
            before_s = lab.clock.mono_s()
            camera.trigger().wait(10)
            lags.append(camera.read()["start"]["value"] - before_s)
        assert lags[1] - max(lags[0], lags[2]) > 0.3
