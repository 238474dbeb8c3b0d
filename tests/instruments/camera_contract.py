"""What every camera must do, whoever made it: a test class to inherit."""

from __future__ import annotations

import itertools
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from phoslab import raw
from phoslab.instruments.devices import Camera, Clock, DeviceError, Exposure

PATIENCE_S = 30.0


class CameraContract:
    """A subclass gives the fixtures `camera` (made, not staged), `clock` (its own), and `exposure` (one it can make).

    `release` is what a hand does after `trigger`, for cameras that cannot do it themselves.
    """

    @pytest.fixture
    def release(self) -> Any:
        return lambda: None

    @pytest.fixture
    def staged(self, camera: Camera) -> Any:
        camera.stage()
        yield camera
        camera.unstage()

    @staticmethod
    def shoot(camera: Camera, exposure: Exposure, release: Any) -> None:
        camera.set(exposure).wait(PATIENCE_S)
        status = camera.trigger()
        release()
        status.wait(PATIENCE_S)

    def test_it_is_a_camera_and_follows_the_protocol_of_bluesky(self, staged: Camera) -> None:
        from bluesky.protocols import Movable, Readable, Stageable, Stoppable, Triggerable, check_supports

        assert isinstance(staged, Camera)
        for protocol in (Readable, Stageable, Stoppable, Triggerable, Movable):
            check_supports(staged, protocol)

    def test_its_choices_ascend_and_its_facts_are_texts(self, staged: Camera) -> None:
        assert set(staged.choices) <= {"exposure_s", "iso", "f_number"}
        for values in staged.choices.values():
            assert all(a < b for a, b in itertools.pairwise(values))
        assert all(isinstance(fact, str) for fact in staged.facts.values())

    def test_what_is_not_staged_says_so(self, camera: Camera, exposure: Exposure) -> None:
        with pytest.raises(DeviceError, match="not staged"):
            camera.read()
        with pytest.raises(DeviceError, match="not staged"):
            camera.set(exposure).wait(PATIENCE_S)
        with pytest.raises(DeviceError, match="not staged"):
            camera.trigger().wait(PATIENCE_S)

    def test_unstaging_is_harmless_and_staging_may_be_repeated(self, camera: Camera) -> None:
        camera.unstage()
        for _ in range(2):
            camera.stage()
            assert camera.read()
        camera.unstage()
        camera.unstage()

    def test_readings_are_described_and_have_unit_and_time(
        self, staged: Camera, clock: Clock, exposure: Exposure, release: Any
    ) -> None:
        self.shoot(staged, exposure, release)
        readings, described = staged.read(), staged.describe()
        assert next(iter(readings)) == staged.name
        assert readings.keys() == described.keys()
        for name, reading in readings.items():
            assert reading["unit"] == described[name]["units"]
            # Both clocks name the same moment, as far as time passes between two looks at them.
            assert clock.wall().timestamp() - reading["timestamp"] == pytest.approx(
                clock.mono_s() - reading["mono_s"], abs=0.5
            )
        for name in ("exposure_s", "iso", "f_number"):
            if name in readings:
                assert readings[name]["value"] == pytest.approx(getattr(exposure, name))

    def test_the_shutter_opened_when_its_reading_says(
        self, staged: Camera, clock: Clock, exposure: Exposure, release: Any
    ) -> None:
        staged.set(exposure).wait(PATIENCE_S)
        before_s = clock.mono_s()
        status = staged.trigger()
        release()
        status.wait(PATIENCE_S)
        after_s = clock.mono_s()
        readings = staged.read()
        start_s, doubt_s = readings["start"]["value"], readings["start_uncertainty"]["value"]
        assert doubt_s >= 0
        assert before_s - doubt_s <= start_s <= after_s - exposure.exposure_s + doubt_s

    def test_every_exposure_is_one_whole_raw_frame(
        self, staged: Camera, exposure: Exposure, release: Any, tmp_path: Path
    ) -> None:
        folder = tmp_path / "frames"
        folder.mkdir()
        for k in range(3):
            self.shoot(staged, exposure, release)
            path = folder / f"{k}.{staged.suffix}"
            staged.save(path)
            frame = raw.read_raw(path)
            assert frame.exposure_s == pytest.approx(exposure.exposure_s, rel=0.08)
        assert len(list(folder.iterdir())) == 3

    def test_a_frame_that_could_not_be_written_is_kept_until_it_was(
        self, staged: Camera, exposure: Exposure, release: Any, tmp_path: Path
    ) -> None:
        self.shoot(staged, exposure, release)
        with pytest.raises(OSError, match="No such file"):
            staged.save(tmp_path / "nowhere" / "a")
        staged.save(tmp_path / "a")
        assert raw.read_raw(tmp_path / "a").values.size
        with pytest.raises(DeviceError, match="no frame"):
            staged.save(tmp_path / "b")
        assert not (tmp_path / "b").exists()

    def test_nothing_is_saved_before_an_exposure(self, staged: Camera, tmp_path: Path) -> None:
        with pytest.raises(DeviceError, match="no frame"):
            staged.save(tmp_path / "a")
        assert not (tmp_path / "a").exists()

    def test_what_it_does_not_offer_is_refused_with_the_nearest(self, staged: Camera) -> None:
        values = staged.choices.get("exposure_s")
        if not values:  # a hand sets it, to whatever there is; its frames tell what that was
            staged.set(Exposure(1234.5, 100, None)).wait(PATIENCE_S)
            return
        with pytest.raises(DeviceError, match=f"nearest .* {values[-1]:g}"):
            staged.set(Exposure(values[-1] * 7, 100, None)).wait(PATIENCE_S)

    def test_stop_is_harmless_at_any_moment_and_the_camera_goes_on_after_it(
        self, camera: Camera, exposure: Exposure, release: Any, tmp_path: Path
    ) -> None:
        camera.stop()
        camera.stage()
        camera.stop()
        camera.set(exposure).wait(PATIENCE_S)
        status = camera.trigger()
        threading.Timer(0.02, camera.stop).start()
        end = time.monotonic() + PATIENCE_S
        while not status.done and time.monotonic() < end:
            time.sleep(0.01)
        assert status.done
        camera.stop(success=True)
        self.shoot(camera, exposure, release)
        camera.save(tmp_path / "a")
        assert raw.read_raw(tmp_path / "a").values.size
        camera.unstage()
        camera.stop()
