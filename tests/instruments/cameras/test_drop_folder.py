"""A camera that is known by the files of its own software: only whole new RAW frames count."""

from __future__ import annotations

import shutil
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from camera_contract import CameraContract

from phoslab.instruments.cameras.drop_folder import DropFolder
from phoslab.instruments.devices import DeviceError, DeviceGoneError, DeviceTimeoutError, Exposure
from phoslab.instruments.system_clock import SystemClock

SOFTWARE = Path(__file__).with_name("vendor_software.py")
EXPOSURE = Exposure(0.125, 100.0, 2.8)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "captures"
    path.mkdir()
    return path


@pytest.fixture
def clock() -> SystemClock:
    return SystemClock()


def remote(frame: Path, folder: Path, clock: SystemClock, *habits: str, **more: Any) -> DropFolder:
    """A camera that is released by a command."""
    command = [sys.executable, str(SOFTWARE), str(frame), str(folder), "{exposure_s}", *habits]
    choices = {"exposure_s": (0.125, 0.5), "iso": (100.0,), "f_number": (2.8,)}
    return DropFolder(folder, clock, command=command, choices=choices, settle_s=0.15, **more)


class TestByCommand(CameraContract):
    """See CameraContract."""

    @pytest.fixture
    def camera(self, frame: Path, folder: Path, clock: SystemClock) -> DropFolder:
        return remote(frame, folder, clock, facts={"make": "Canon"})

    @pytest.fixture
    def exposure(self) -> Exposure:
        return EXPOSURE


class TestByHand(CameraContract):
    """See CameraContract."""

    @pytest.fixture
    def camera(self, folder: Path, clock: SystemClock) -> DropFolder:
        return DropFolder(folder, clock, settle_s=0.15, patience_s=5)

    @pytest.fixture
    def exposure(self) -> Exposure:
        return EXPOSURE

    @pytest.fixture
    def release(self, frame: Path, folder: Path) -> Any:
        numbers = iter(range(100))

        def press() -> None:
            def write() -> None:
                time.sleep(0.2)  # nobody is faster than the program
                shutil.copyfile(frame, folder / f"{next(numbers)}.CR2")

            threading.Thread(target=write, daemon=True).start()

        return press


def test_files_that_were_there_before_are_ignored_and_left_alone(
    frame: Path, folder: Path, clock: SystemClock, tmp_path: Path
) -> None:
    old = folder / "sub" / "old.CR2"
    old.parent.mkdir()
    shutil.copyfile(frame, old)
    camera = DropFolder(folder, clock, settle_s=0.1, patience_s=0.6)
    camera.stage()
    camera.set(Exposure(0.125, 100, 2.8)).wait(5)
    with pytest.raises(DeviceTimeoutError, match=f"camera did not do 'write a frame into {folder}' within"):
        camera.trigger().wait(10)
    assert old.exists()


def test_a_file_is_not_taken_before_it_is_whole(
    frame: Path, folder: Path, clock: SystemClock, tmp_path: Path
) -> None:
    """Its writer rests in the middle for longer than a file must be quiet."""
    camera = DropFolder(folder, clock, settle_s=0.1, patience_s=10)
    camera.stage()
    content = frame.read_bytes()

    def write() -> None:
        time.sleep(0.2)
        with (folder / "a.CR2").open("wb") as stream:
            stream.write(content[: len(content) // 2])
            stream.flush()
            time.sleep(0.8)
            stream.write(content[len(content) // 2 :])

    threading.Thread(target=write, daemon=True).start()
    camera.trigger().wait(10)
    camera.save(tmp_path / "a")
    assert (tmp_path / "a").read_bytes() == content


def test_a_jpeg_beside_the_frame_does_not_matter_but_a_jpeg_alone_is_refused(
    frame: Path, folder: Path, clock: SystemClock, tmp_path: Path
) -> None:
    camera = remote(frame, folder, clock, "jpeg-beside", patience_s=1.0)
    camera.stage()
    camera.set(EXPOSURE).wait(10)
    camera.trigger().wait(10)
    camera.save(tmp_path / "a")
    assert (tmp_path / "a").read_bytes() == frame.read_bytes()
    jpeg = tmp_path / "picture"
    jpeg.write_bytes(b"\xff\xd8\xff\xe1" + bytes(50_000))
    with pytest.raises(DeviceError, match=r"wrote a JPEG picture \(IMG_\d+.CR2\) and no RAW file"):
        remote(jpeg, folder, clock, patience_s=0.6).stage()


def test_half_a_frame_is_an_error_and_never_saved(
    frame: Path, folder: Path, clock: SystemClock, tmp_path: Path
) -> None:
    with pytest.raises(DeviceError, match="no whole RAW frame"):
        remote(frame, folder, clock, "cut", patience_s=0.8).stage()


def test_its_suffix_is_by_content(frame: Path, folder: Path, clock: SystemClock) -> None:
    camera = remote(frame, folder, clock)
    camera.stage()
    assert camera.suffix == "dng"
    assert next(folder.iterdir()).suffix == ".CR2"


def test_a_command_that_fails_is_told_in_its_own_words(frame: Path, folder: Path, clock: SystemClock) -> None:
    with pytest.raises(DeviceError, match="said 'no camera found'"):
        remote(frame, folder, clock, "fail").stage()
    with pytest.raises(DeviceError, match="which is not there"):
        DropFolder(folder, clock, command=["no-such-program"]).stage()


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path, clock: SystemClock) -> None:
    with pytest.raises(DeviceGoneError, match="no folder that can be read"):
        DropFolder(tmp_path / "nowhere", clock).stage()


def test_a_frame_with_another_iso_is_refused(frame: Path, folder: Path, clock: SystemClock) -> None:
    command = [sys.executable, str(SOFTWARE), str(frame), str(folder), "{exposure_s}"]
    choices = {"exposure_s": (0.125,), "iso": (400.0,)}
    camera = DropFolder(folder, clock, command=command, choices=choices, settle_s=0.1, patience_s=0.8)
    with pytest.raises(DeviceError, match="iso 100 where 400 was set"):
        camera.stage()
