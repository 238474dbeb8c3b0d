"""`phoslab measure decay --rig` with every kind of lamp and camera driver, in real time; each session goes through
`phoslab fit` without a special case.

The boards run on pseudo-terminals, the cameras are the virtual PTP camera of the gphoto2 wheel and a vendor's software
that writes files. What they see is a disc that fades exponentially after the board's lamp went off.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from boards import HERE, SIMULATED, BoardProcess, same_phoslab
from scipy.optimize import curve_fit

from phoslab.files import sha256
from phoslab.instruments.bench.camera import CANON
from phoslab.instruments.bench.dng import write_dng
from phoslab.session import Frame, Session

RATE_PER_S = 0.4
EXPOSURE_S = 0.005
"""One that the virtual camera offers; far shorter than the light takes to change."""
PROMPT = b"press Enter"
FULL_DN = CANON.sensor.white - float(np.mean(CANON.sensor.black))


@dataclass(frozen=True)
class Shown:
    """What a frame shows, and when a camera could see it.

    Args:
        level: of the disc, as a share of full scale.
        after_s, there_s: monotonic times at which it was not there yet, and at which it was.
    """

    level: float
    after_s: float
    there_s: float


class World(threading.Thread):
    """Writes anew, many times a second, the frame that a camera would take now, and keeps a list of what it showed.

    On a busy machine a frame may be taken that shows what was a while ago; by its checksum the list tells what.

    Args:
        board: whose lamp it is.
        file: the frame.
        session: whose journal tells what the door was told.
    """

    def __init__(self, board: BoardProcess, file: Path, session: Path) -> None:
        super().__init__(daemon=True)
        self._board, self._file, self._journal = board, file, session / "journal.jsonl"
        self._rng = np.random.default_rng(1)
        self.ends = False
        self.shown: dict[str, Shown] = {}
        """By checksum, one after the other."""
        y, x = np.mgrid[: CANON.size[0], : CANON.size[1]]
        h, w = CANON.size
        self._disc = (y - h / 2) ** 2 + (x - w / 2) ** 2 < (h / 4) ** 2
        self.write(0.0)

    def run(self) -> None:
        while not self.ends:
            self.write(self._level() if self._door_is_open() else 0.0)
            time.sleep(0.03)

    def write(self, level: float) -> None:
        """Write a frame whose disc has this share of full scale."""
        sensor = CANON.sensor
        signal = self._disc * level * FULL_DN
        values = np.mean(sensor.black) + signal + self._rng.normal(0, 1, CANON.size) * noise_dn(signal)
        beside = self._file.with_suffix(".next")
        write_dng(
            beside,
            np.clip(values, 0, sensor.white).astype(np.uint16),
            sensor,
            exposure_s=EXPOSURE_S,
            iso=100,
            f_number=2.8,
            taken="2026:01:15 18:00:00",
            description="SIMULATED",
        )
        checksum, after_s = sha256(beside), time.monotonic()
        beside.replace(self._file)
        self.shown[checksum] = Shown(level, after_s, time.monotonic())

    def seen(self, frame: Frame) -> tuple[Shown, float]:
        """What a frame shows, and the monotonic time at which it was there no more."""
        all_shown = list(self.shown)
        k = all_shown.index(frame.sha256)
        following = self.shown[all_shown[k + 1]].there_s if k + 1 < len(all_shown) else math.inf
        return self.shown[frame.sha256], following

    def catch_up(self) -> None:
        """Wait until the frame shows what is so now."""
        n = len(self.shown)
        while len(self.shown) < n + 2 and self.is_alive():
            time.sleep(0.005)

    def _level(self) -> float:
        lamp = [pin for pin in list(self._board.pins) if pin.name == "lamp"]
        if not lamp:
            return 0.0
        last = lamp[-1]
        return 0.5 if last.value else 0.6 * math.exp(-RATE_PER_S * (time.monotonic() - last.mono_s))

    def _door_is_open(self) -> bool:
        if not self._journal.exists():
            return False
        told = [
            line
            for line in self._journal.read_text().splitlines()
            if '"device": "door", "name": "set"' in line
        ]
        return bool(told) and json.loads(told[-1])["arguments"]["to"] == "open"


@pytest.mark.parametrize("lamp", ["lcus-1"], indirect=True)
def test_a_camera_that_a_hand_releases_is_tried_before_the_lamp_is_on(
    lamp: tuple[BoardProcess, str], tmp_path: Path
) -> None:
    """It delivers JPEG, which only its frames can tell."""
    board, tables = lamp
    folder, rig = tmp_path / "frames-come-here", tmp_path / "rig.toml"
    folder.mkdir()
    rig.write_text(
        f'schema = "phoslab-rig/1"\nname = "by hand"\n{tables}[camera]\ndriver = "drop-folder"\n'
        f'folder = "{folder}"\nexposures_s = [0.5]\nisos = [100]\npatience_s = 2\n'
    )
    with subprocess.Popen(
        [sys.executable, "-m", "phoslab", "measure", "decay", "--rig", rig, "-o", tmp_path / "s"],
        env=same_phoslab(),
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stderr is not None
        asked = process.stderr.readline()
        time.sleep(0.3)  # no hand is faster
        (folder / "IMG_0001.CR2").write_bytes(b"\xff\xd8\xff\xe1" + bytes(1000))
        told = process.stderr.read()
    assert "Release the shutter" in asked, asked + told
    assert process.returncode == 1
    assert "no RAW file" in told
    assert all(pin.value == 0 for pin in board.pins)
    assert not (tmp_path / "s").exists()


def answered(process: subprocess.Popen[bytes], world: World) -> str:
    """Do what the program asks a hand for, until it ends; return what it said.

    The answer comes when the camera can see what was done: a door is closed before it is said to be.
    """
    assert process.stdin is not None
    assert process.stderr is not None
    said = b""
    while chunk := os.read(process.stderr.fileno(), 4096):
        before, said = said.count(PROMPT), said + chunk
        for _ in range(said.count(PROMPT) - before):
            world.catch_up()
            process.stdin.write(b"\n")
            process.stdin.flush()
    return said.decode()


def noise_dn(signal_dn: Any) -> Any:
    """Four electrons a DN, and 2 DN of read noise."""
    return np.sqrt(signal_dn / 4 + 4)


def rates_of_what_was_seen(world: World, session: Session) -> tuple[float, float]:
    """The rate that frames without noise would have, if each were as precise as its noise says, and if all were alike.

    What a frame showed, at the moment that the journal has for it, less what the dark frames showed.
    """
    darks = np.mean([world.seen(frame)[0].level for frame in session.frames_of("dark")])
    decay = session.frames_of("decay")
    level = np.array([world.seen(frame)[0].level for frame in decay]) - darks
    at_s = np.array([frame.start_s for frame in decay])
    at_s -= at_s[0]

    def fading(t: Any, amplitude: float, rate: float) -> Any:
        return amplitude * np.exp(-rate * t)

    rates = []
    for sigma in (noise_dn(np.abs(level) * FULL_DN), np.abs(level) + 1e-3):
        (_, rate), _ = curve_fit(fading, at_s, level, (level[0], RATE_PER_S), sigma=sigma)
        rates.append(float(rate))
    return min(rates), max(rates)


@pytest.fixture
def lamp(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[BoardProcess, str]]:
    """A running board, and the tables of the rig file for lamp and door on it."""
    kind = request.param
    port = f'port = "{tmp_path / "port"}"'
    if kind in ("lcus-1", "kmtronic"):
        command = [sys.executable, str(HERE / "relay_board.py"), kind]
        tables = f'[lamp]\ndriver = "{kind}"\n{port}\naccept_no_failsafe = true\n@[door]\ndriver = "hand"\n'
    else:
        command = SIMULATED if kind == "simulated" else request.getfixturevalue("firmware")
        tables = f'[lamp]\ndriver = "controller"\n{port}\n@[door]\ndriver = "controller"\n{port}\n'
    board = BoardProcess(command, tmp_path / "port")
    # The board's lamp fades within a fraction of a second; the boards' clocks are real ones.
    yield board, tables.replace("@", "warm_up_s = 0\n")
    board.close()


@pytest.mark.parametrize(
    ("lamp", "camera"),
    # Lamps and cameras do not know one another: each kind once or twice, not all with all.
    [
        ("lcus-1", "drop-folder"),
        ("kmtronic", "gphoto2"),
        ("simulated", "gphoto2"),
        ("firmware", "drop-folder"),
    ],
    indirect=["lamp"],
)
def test_a_decay_of_every_lamp_and_camera_goes_through_fit(
    lamp: tuple[BoardProcess, str], camera: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    board, tables = lamp
    session, folder = tmp_path / "s", tmp_path / "frames-come-here"
    folder.mkdir()
    world = World(board, folder.parent / "next.jpg", session)
    if camera == "gphoto2":
        gphoto2 = pytest.importorskip("gphoto2", reason="the extra phoslab[camera] is not installed")
        monkeypatch.setenv("VCAMERADIR", str(folder.parent))
        monkeypatch.setenv("IOLIBS", str(Path(gphoto2.__file__).parent / "libgphoto2" / "vusb"))
        table = '[camera]\ndriver = "gphoto2"\n'
    else:
        software = HERE / "cameras" / "vendor_software.py"
        command = [sys.executable, str(software), str(world._file), str(folder), "{exposure_s}"]
        table = f'[camera]\ndriver = "drop-folder"\nfolder = "{folder}"\ncommand = {json.dumps(command)}\n'
    rig = tmp_path / "rig.toml"
    rig.write_text(
        f'schema = "phoslab-rig/1"\nname = "every driver"\n{tables}{table}'
        f'sensitivities = "Nikon 5100 (NPL)"\nexposures_s = [{EXPOSURE_S}]\nisos = [100]\nf_numbers = [2.8]\n'
        "frame_MB = 0.2\n"
    )
    world.start()
    plan = ("--charge", "1", "--until", "7", "--interval", "1", "--darks", "1")
    try:
        with subprocess.Popen(
            [sys.executable, "-m", "phoslab", "measure", "decay", "--rig", rig, "-o", session, *plan],
            env=same_phoslab(),
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        ) as process:
            killer = threading.Timer(120, process.kill)
            killer.start()
            told = answered(process, world)
            killer.cancel()
    finally:
        world.ends = True
        world.join()
    assert process.returncode == 0, told
    assert board.level("lamp") == 0
    recorded = Session.open(session)
    assert recorded.complete
    decay = recorded.frames_of("decay")
    # On a busy machine some are left out, and the journal says so.
    left_out = [e for e in recorded.events if str(e.fields.get("reply")).startswith("left out")]
    assert len(decay) + len(left_out) >= 8
    assert len(decay) >= 3
    exposures = {e.fields["frame"]: e for e in recorded.events if e.event == "exposure"}
    for frame in decay:
        shown, following_s = world.seen(frame)
        # The shutter was open at a moment at which this could be seen: the journal's start is right to what it says.
        doubt_s = exposures[frame.name].fields["start_uncertainty_s"]
        closed_s = frame.start_s + doubt_s + EXPOSURE_S
        # But the virtual PTP camera has no shutter: it shows what is there when its frame is fetched.
        last_s = exposures[frame.name].mono_s if camera == "gphoto2" else closed_s
        assert frame.start_s - doubt_s <= following_s
        assert shown.after_s <= last_s
    fitted = subprocess.run(
        [
            *(sys.executable, "-m", "phoslab", "fit", session, "--preset", "green", "--states", "1"),
            *("-o", tmp_path / "m.json", "--json"),
        ],
        env=same_phoslab(),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert fitted.returncode == 0, fitted.stderr
    (rate,) = json.loads(fitted.stdout)["kr_per_s"]
    # Some 1000 pixels a colour: the worst frame's mean is good to 0.1 %, the slope of three or more in 7 s to 0.3 %.
    # Between the two ways to weight frames (which differ where the world lagged) lies what a fit may make of them.
    least, most = rates_of_what_was_seen(world, recorded)
    assert 0.99 * least <= rate <= 1.01 * most
