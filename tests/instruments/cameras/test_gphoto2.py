"""The libgphoto2 driver: on the virtual PTP camera of the gphoto2 wheel, and on a body that misbehaves at will.

The virtual camera answers over a real PTP stack, is a Nikon of sorts, hands out `next.jpg` whatever it holds, and has a
full card after 26 captures, until it is connected anew. It has no ISO and is never busy: the second one is for that.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from camera_contract import CameraContract
from fake_gphoto2 import FakeLibrary

from phoslab.instruments.bench.camera import CANON
from phoslab.instruments.bench.dng import write_dng
from phoslab.instruments.cameras.gphoto2 import GphotoCamera
from phoslab.instruments.devices import DeviceError, DeviceGoneError, DeviceTimeoutError, Exposure
from phoslab.instruments.recorder import Recorder
from phoslab.instruments.system_clock import SystemClock
from phoslab.session import Session

gphoto2 = pytest.importorskip("gphoto2", reason="the extra phoslab[camera] is not installed")


@pytest.fixture
def clock() -> SystemClock:
    return SystemClock()


@pytest.fixture
def virtual(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file that the virtual camera delivers, a RAW frame; its size may not change once it is connected."""
    folder = tmp_path / "virtual-camera"
    folder.mkdir()
    values = np.full(CANON.size, 2000, np.uint16)
    said: dict[str, Any] = {"taken": "2026:01:15 18:00:00", "description": "SIMULATED"}
    # One of the exposure times that the virtual camera offers.
    write_dng(folder / "next.jpg", values, CANON.sensor, exposure_s=0.005, iso=100, f_number=2.8, **said)
    monkeypatch.setenv("VCAMERADIR", str(folder))
    monkeypatch.setenv("IOLIBS", str(Path(gphoto2.__file__).parent / "libgphoto2" / "vusb"))
    return folder / "next.jpg"


class TestVirtualPtpCamera(CameraContract):
    """See CameraContract."""

    @pytest.fixture
    def camera(self, virtual: Path, clock: SystemClock) -> Iterator[GphotoCamera]:
        camera = GphotoCamera(clock)
        yield camera
        camera.unstage()

    @pytest.fixture
    def exposure(self) -> Exposure:
        return Exposure(0.005, 100.0, 2.8)


def test_its_choices_and_names_come_from_the_body(virtual: Path, clock: SystemClock) -> None:
    camera = GphotoCamera(clock, sensitivities="Nikon 5100 (NPL)")
    camera.stage()
    assert camera.choices["exposure_s"][-3:] == (0.05, 0.1, 1.0)
    assert camera.choices["f_number"][0] == 2.8
    assert camera.choices["iso"] == ()
    assert camera.suffix == "dng"
    assert camera.facts["sensitivities"] == "Nikon 5100 (NPL)"
    assert camera.facts["make"] == "GP"
    with pytest.raises(DeviceError, match="nearest that it offers is 1"):
        camera.set(Exposure(7.0, 100, None)).wait(10)
    camera.set(Exposure(1.0, 100, 5.6)).wait(10)
    assert camera._value("f-number") == "f/5.6"
    camera.unstage()


def test_a_camera_that_delivers_jpeg_is_refused_when_it_is_staged_whatever_the_files_are_called(
    virtual: Path, clock: SystemClock
) -> None:
    virtual.write_bytes(b"\xff\xd8\xff\xe1" + bytes(5000))
    with pytest.raises(DeviceError, match="JPEG"):
        GphotoCamera(clock).stage()
    virtual.write_bytes(bytes(5000))
    with pytest.raises(DeviceError, match="no whole RAW frame"):
        GphotoCamera(clock).stage()


def test_a_frame_that_was_made_with_another_exposure_time_is_refused(
    virtual: Path, clock: SystemClock, tmp_path: Path
) -> None:
    camera = GphotoCamera(clock)
    camera.stage()
    camera.set(Exposure(1.0, 100, 2.8)).wait(10)
    camera.trigger().wait(10)
    with pytest.raises(DeviceError, match=r"exposure_s 0.005 where 1 was set"):
        camera.save(tmp_path / "a")
    camera.unstage()


def test_a_camera_that_is_not_there_is_named_with_what_to_do(
    clock: SystemClock, monkeypatch: pytest.MonkeyPatch, virtual: Path
) -> None:
    monkeypatch.setenv("IOLIBS", str(Path(gphoto2.__file__).parent / "libgphoto2" / "iolibs"))
    with pytest.raises(DeviceError, match=r"camera .*(Switch it on|plug it in)"):
        GphotoCamera(clock).stage()


def test_37_frames_of_a_decay_survive_a_card_that_fills_up(
    virtual: Path, clock: SystemClock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None is lost and none double: each frame's content is stamped with its number before it is released."""
    content = bytearray(virtual.read_bytes())
    place = content.index(b"SIMULATED")
    camera = GphotoCamera(clock)
    connections: list[float] = []
    opening = camera._open
    monkeypatch.setattr(camera, "_open", lambda: (connections.append(clock.mono_s()), opening()))
    camera.stage()
    header = {
        "plan": {"name": "decay", "parameters": {"interval_s": 0.1, "n_frames": 37}},
        "sample": {"name": "virtual"},
        "camera": {"make": "GP", "model": "VC"},
        "software": {"phoslab": "test"},
    }
    sent = []
    with Recorder(tmp_path / "s", header, clock) as recorder:
        for k in range(37):
            content[place : place + 9] = b"FRAME %03d" % k
            virtual.write_bytes(content)
            sent.append(hashlib.sha256(content).hexdigest())
            camera.trigger().wait(20)
            recorder.frame(
                camera.save,
                role="decay",
                at_mono_s=camera.read()["start"]["value"] - 1.0,  # its doubt reaches past the line
                exposure_s=0.005,
                iso=100,
                f_number=2.8,
                suffix=camera.suffix,
            )
    camera.unstage()
    session = Session.open(tmp_path / "s")
    assert session.complete
    assert [hashlib.sha256(f.path.read_bytes()).hexdigest() for f in session.frames] == sent
    assert len(sent) == len(set(sent)) == 37
    assert len(connections) - 1 >= 1


class TestABodyThatMisbehaves:
    """What the virtual camera lacks, over a stand-in for the library."""

    @pytest.fixture
    def library(self, frame: Path) -> FakeLibrary:
        return FakeLibrary(frame.read_bytes())

    @pytest.fixture
    def camera(self, library: FakeLibrary, clock: SystemClock) -> GphotoCamera:
        return GphotoCamera(clock, library=library)

    def test_time_iso_and_aperture_are_set_and_read_back(
        self, camera: GphotoCamera, library: FakeLibrary, tmp_path: Path
    ) -> None:
        camera.stage()
        assert camera.choices["iso"] == (100.0, 200.0, 400.0)
        camera.set(Exposure(0.125, 400, 5.6)).wait(10)
        assert (library.values["shutterspeed"], library.values["iso"], library.values["aperture"]) == (
            "1/8",
            "400",
            "5.6",
        )
        camera.trigger().wait(10)
        with pytest.raises(DeviceError, match=r"iso 100 where 400 was set.*automatic ISO off"):
            camera.save(tmp_path / "a")

    def test_the_card_is_where_frames_go(self, camera: GphotoCamera, library: FakeLibrary) -> None:
        camera.stage()
        assert library.values["capturetarget"] == "Memory card"
        assert library.values["imageformat"] == "RAW"

    def test_ptp_device_busy_is_tried_again(
        self, camera: GphotoCamera, library: FakeLibrary, tmp_path: Path
    ) -> None:
        camera.stage()
        library.busy = 3
        camera.set(Exposure(0.125, 100, 2.8)).wait(10)
        library.busy = 3
        n = library.captures
        camera.trigger().wait(10)
        assert library.captures == n + 1
        camera.save(tmp_path / "a")

    def test_busy_for_ever_is_an_error_that_says_so(
        self, camera: GphotoCamera, library: FakeLibrary, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("phoslab.instruments.cameras.gphoto2._BUSY_S", 0.3)
        camera.stage()
        library.busy = 10_000
        with pytest.raises(DeviceError, match="camera is busy"):
            camera.trigger().wait(10)

    @pytest.mark.parametrize(
        ("name", "value", "words"),
        [
            ("focusmode", "One Shot", "focuses by itself.*manual focus"),
            ("autoexposuremode", "AV", "exposes by itself.*dial to M"),
            ("imageformat", "RAW + Large Fine JPEG", "does not make RAW files alone"),
        ],
    )
    def test_what_a_hand_must_set_is_refused_before_a_frame_is_taken(
        self, camera: GphotoCamera, library: FakeLibrary, name: str, value: str, words: str
    ) -> None:
        library.values[name] = value
        library.fixed.add(name)
        with pytest.raises(DeviceError, match=words):
            camera.stage()
        assert library.captures == 0

    def test_automatic_iso_is_switched_to_a_number_by_the_first_setting(
        self, camera: GphotoCamera, library: FakeLibrary
    ) -> None:
        library.values["iso"] = "Auto"
        camera.stage()
        camera.set(Exposure(0.125, 200, 2.8)).wait(10)
        assert library.values["iso"] == "200"

    def test_a_body_that_keeps_its_iso_is_an_error(self, camera: GphotoCamera, library: FakeLibrary) -> None:
        camera.stage()
        library.stubborn.add("iso")
        with pytest.raises(DeviceError, match="keeps iso at 100 where 400 was set"):
            camera.set(Exposure(0.125, 400, 2.8)).wait(10)

    def test_a_second_file_of_an_exposure_is_refused(
        self, camera: GphotoCamera, library: FakeLibrary
    ) -> None:
        library.files_a_capture = 2
        with pytest.raises(DeviceError, match="makes 2 files for an exposure"):
            camera.stage()
        assert library.card == {}

    def test_a_card_that_stays_full_is_an_error_after_one_new_connection(
        self, camera: GphotoCamera, library: FakeLibrary
    ) -> None:
        camera.stage()
        library.full = True
        n = library.connections
        with pytest.raises(DeviceError, match=r"full card.*format it"):
            camera.trigger().wait(10)
        assert library.connections == n + 1

    def test_a_camera_that_is_unplugged_is_gone_and_can_be_staged_again(
        self, camera: GphotoCamera, library: FakeLibrary, tmp_path: Path
    ) -> None:
        camera.stage()
        library.unplugged = True
        with pytest.raises(DeviceGoneError, match="camera is not there"):
            camera.trigger().wait(10)
        camera.unstage()
        library.unplugged = False
        camera.stage()
        camera.trigger().wait(10)
        camera.save(tmp_path / "a")

    def test_a_camera_that_another_program_holds_says_how_to_get_it(
        self, camera: GphotoCamera, library: FakeLibrary
    ) -> None:
        library.claimed = True
        with pytest.raises(DeviceGoneError, match=r"held by another program.*gio mount"):
            camera.stage()

    def test_a_truncated_download_is_told_and_the_frame_can_be_fetched_again(
        self, camera: GphotoCamera, library: FakeLibrary, tmp_path: Path
    ) -> None:
        camera.stage()
        camera.trigger().wait(10)
        library.cut = 1
        with pytest.raises(DeviceError, match=r"sent \d+ of \d+ bytes"):
            camera.save(tmp_path / "a")
        assert library.card
        camera.save(tmp_path / "a")
        assert library.card == {}

    def test_a_frame_that_never_comes_is_a_time_out_with_device_command_and_time(
        self, camera: GphotoCamera, library: FakeLibrary, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("phoslab.instruments.cameras.gphoto2._READ_OUT_S", 0.3)
        camera.stage()
        library.files_a_capture = 0
        with pytest.raises(DeviceTimeoutError, match=r"camera did not do 'expose' within 0\.\d s"):
            camera.trigger().wait(10)

    def test_the_file_of_an_exposure_that_was_stopped_is_not_taken_for_the_next(
        self, camera: GphotoCamera, library: FakeLibrary, tmp_path: Path
    ) -> None:
        camera.stage()
        library.delay_s = 0.5
        status = camera.trigger()
        import threading

        threading.Timer(0.1, camera.stop).start()
        with pytest.raises(DeviceError, match="was stopped"):
            status.wait(10)
        camera.trigger().wait(10)
        assert camera._file == ("/card", f"IMG_{library.captures:04d}.CR2")
        assert len(library.card) == 1
