"""`phoslab doctor` names what is missing and the command that brings it, whatever a driver does."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from phoslab.app import cli, doctor
from phoslab.render import device

NO_LIBRARY = "import ctypes; ctypes.CDLL('libEGL-that-is-not-here.so.1')"


def test_where_gl_works_it_names_the_renderer_and_exits_with_0(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["doctor", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["ready"] is True
    gl = next(part for part in told["parts"] if part["name"] == "OpenGL")
    assert gl["state"] == "ok"
    assert gl["details"]["renderer"] in gl["found"]
    assert gl["details"]["software"] is ("llvmpipe" in gl["details"]["renderer"])
    assert gl["details"]["max_texture_size"] >= 4096


def test_it_opens_gl_as_the_renderer_does() -> None:
    """A doctor that looks for other libraries, or another version, would send people the wrong way."""
    for word in (f'libgl="{device.LIBGL}"', f'libegl="{device.LIBEGL}"', f"require={device.GL_VERSION}"):
        assert word in doctor._GL_PROBE


@pytest.mark.parametrize(
    ("probe", "said"),
    [
        (NO_LIBRARY, "libEGL-that-is-not-here.so.1"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "its driver crashed (SIGSEGV)"),
        ("import time; time.sleep(60)", "did not answer"),
        ("import sys; sys.exit(3)", "its driver said nothing"),
    ],
)
def test_a_driver_that_is_missing_crashes_or_hangs_is_said_and_exits_with_1(
    probe: str, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(doctor, "_GL_PROBE", probe)
    monkeypatch.setattr(doctor, "_PROBE_TIMEOUT_S", 1.0)
    assert cli.main(["doctor"]) == 1
    told = capsys.readouterr().out
    assert said in told
    assert "OpenGL         missing" in told


@pytest.mark.parametrize(("user", "command"), [(0, "apt-get install"), (1000, "sudo apt-get install")])
def test_without_gl_it_gives_the_exact_command_on_debian(
    user: int, command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(doctor, "_GL_PROBE", NO_LIBRARY)
    monkeypatch.setattr("os.geteuid", lambda: user)
    monkeypatch.setattr("shutil.which", lambda name: f"/usr/bin/{name}")
    cli.main(["doctor"])
    assert f"-> {command} libgl1 libegl1 libgl1-mesa-dri\n" in capsys.readouterr().out


def test_without_gl_elsewhere_it_names_the_libraries(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(doctor, "_GL_PROBE", NO_LIBRARY)
    monkeypatch.setattr("shutil.which", lambda name: None)
    cli.main(["doctor"])
    assert "-> install libGL.so.1, libEGL.so.1 and Mesa's DRI driver" in capsys.readouterr().out


def test_a_file_in_the_current_folder_does_not_pass_for_a_library(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "moderngl.py").write_text("raise SystemExit('not the real one')")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["doctor"]) == 0


def test_a_usb_device_cannot_write_to_the_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    port = SimpleNamespace(
        device="/dev/ttyUSB0", vid=0x0403, pid=0x6001, serial_number="A1", description="lamp\x1b[2J"
    )
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [port])
    cli.main(["doctor"])
    told = capsys.readouterr().out
    assert "/dev/ttyUSB0 [0403:6001] lamp?[2J" in told
    assert "\x1b" not in told


def test_a_port_that_the_user_may_not_open_gets_the_remedy(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    port = SimpleNamespace(device="/dev/no-such", vid=1, pid=2, serial_number=None, description="door")
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [port])
    assert cli.main(["doctor"]) == 0
    assert "usermod -aG dialout" in capsys.readouterr().out


def test_a_connected_camera_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    monkeypatch.setattr("importlib.metadata.version", lambda name: "3.6")
    monkeypatch.setattr(doctor, "_CAMERA_PROBE", 'print(\'{"cameras": [["Nikon D750", "usb:001,004"]]}\')')
    cli.main(["doctor"])
    assert "camera         ok        Nikon D750 at usb:001,004" in capsys.readouterr().out


@pytest.mark.parametrize("name", doctor._RIVALS)
def test_a_program_that_grabs_camera_or_port_is_named_with_the_command_that_stops_it(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(doctor, "_running", lambda: {"init", name})
    cli.main(["doctor"])
    told = capsys.readouterr().out
    assert all(text in told for text in doctor._RIVALS[name])


def test_running_programs_are_found_by_the_names_that_the_system_cuts() -> None:
    """A kernel keeps 15 characters: a longer name would never match."""
    assert Path("/proc/self/comm").read_text().strip() in doctor._running()
    assert all(len(name) <= 15 for name in doctor._RIVALS)


def test_a_camera_that_the_user_may_not_open_gets_the_remedy(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    monkeypatch.setattr("importlib.metadata.version", lambda name: "3.6")
    monkeypatch.setattr(doctor, "_may_open", lambda port: False)
    monkeypatch.setattr(doctor, "_CAMERA_PROBE", 'print(\'{"cameras": [["Nikon D750", "usb:001,004"]]}\')')
    cli.main(["doctor"])
    assert "udev rules" in capsys.readouterr().out
