"""Start the simulated bench, or find one that is running.

>>> from phoslab.instruments.bench import rig
>>> from phoslab.instruments.simulated import BenchClock, Hands, Link
>>> with rig.start("green", seed=7) as bench:
...     clock, hands = BenchClock(bench.folder, Link(bench.socket)), Hands(Link(bench.socket))
...     hands.place(target="card", light="led")
...     before_s = clock.mono_s()
...     clock.sleep_until(before_s + 3600)
...     clock.mono_s() - before_s >= 3600
True
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Any

from phoslab.errors import PhoslabError
from phoslab.instruments.devices import DeviceGoneError
from phoslab.instruments.simulated import Link

ENDPOINTS = "endpoints.json"
_PATIENCE_S = 60.0
_PREFIX = "phoslab-bench-"


@dataclass(frozen=True)
class Bench:
    """A running bench; as a context manager it is stopped at the end.

    Args:
        folder: where it says how to reach it.
        socket: clock, camera and hands.
        pid: its process.
        sample, seed: what it was started with.
        session: the session that it serves, as a whole path; None if nobody said.
    """

    folder: Path
    socket: Path
    pid: int
    sample: str
    seed: int
    session: Path | None = None

    @property
    def port(self) -> str:
        """Path of the controller's serial port: a link that is not there while its cable is out."""
        return str(self.folder.absolute() / "port")

    def stop(self) -> None:
        """End its process; harmless if it has ended. Left alone, it ends soon after its last host has."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGTERM)
        deadline = time.monotonic() + 10.0
        while _alive(self.pid) and time.monotonic() < deadline:
            time.sleep(0.01)

    def __enter__(self) -> Bench:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()


def start(
    sample: str,
    *,
    seed: int = 0,
    faults: Sequence[str] = (),
    folder: Path | None = None,
    at: datetime | None = None,
    mono_s: float = 0.0,
    linger_s: float = 60.0,
    card_frames: int = 500,
    size: tuple[int, int] | None = None,
    session: Path | None = None,
) -> Bench:
    """Start a bench in a process that outlives this one by `linger_s`.

    Args:
        sample: a preset that is fully measured: the samples look like it and last as long.
        seed: of all that is random.
        faults: see `phoslab.instruments.bench.faults`.
        folder: an empty one; by default a temporary one that goes with the bench.
        at: what its wall clock shows at first, with a time zone. A bench that is started anew for a session goes
            on where the time has got to, with samples that have been in the dark meanwhile.
        mono_s: what its monotonic clock shows at first.
        linger_s: real time for which it waits for a host that has died to come back.
        card_frames: how many frames the camera's card holds.
        size: rows and columns of a frame, both even.
        session: that it serves, so that `serving` finds it again.

    Raises:
        PhoslabError: it cannot be started; its own words say why.
    """
    temporary = folder is None
    if folder is None:
        folder = Path(tempfile.mkdtemp(prefix=_PREFIX))
    folder.mkdir(parents=True, exist_ok=True)
    # As phoslab.limited starts its workers: with this process's import path, whatever folder it is in.
    code = (
        "import json, sys; sys.path[:] = json.loads(sys.argv.pop(1)); "
        "from phoslab.instruments.bench.__main__ import main; sys.exit(main())"
    )
    command = [sys.executable, "-P", "-c", code, json.dumps(sys.path), "--folder", str(folder.absolute())]
    command += ["--sample", sample, "--seed", str(seed), "--mono", repr(mono_s), "--linger", repr(linger_s)]
    command += ["--card-frames", str(card_frames), *(f"--fault={fault}" for fault in faults)]
    command += [] if at is None else ["--start", at.isoformat()]
    command += [] if size is None else ["--size", *map(str, size)]
    command += ["--temporary"] if temporary else []
    command += [] if session is None else ["--session", str(session.resolve())]
    log = folder / "bench.log"
    with log.open("wb") as words:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=words, stderr=words, start_new_session=True
        )
    deadline = time.monotonic() + _PATIENCE_S
    while (bench := find(folder)) is None:
        if process.poll() is not None or time.monotonic() > deadline:
            process.kill()
            said = log.read_text("utf-8", "replace").strip()
            if temporary:
                shutil.rmtree(folder, ignore_errors=True)
            problem = said.splitlines()[-1] if said else f"it was not there within {_PATIENCE_S:g} s"
            raise PhoslabError(
                f"could not be started: {problem.removesuffix('.')}",
                field="the simulated bench",
                remedy="Mend that and start it again.",
            )
        time.sleep(0.01)
    return bench


def find(folder: Path) -> Bench | None:
    """Return the bench that runs in `folder`, None if none does."""
    try:
        said = json.loads((folder / ENDPOINTS).read_text("utf-8"))
        session = None if said.get("session") is None else Path(said["session"])
        what = str(said["sample"]), int(said["seed"]), session
        bench = Bench(folder, Path(said["socket"]), int(said["pid"]), *what)
        Link(bench.socket).close()
    except (OSError, ValueError, KeyError, TypeError, DeviceGoneError):
        return None
    return bench


def serving(session: Path) -> Bench | None:
    """Return the bench that has outlived the host which measured `session` on it, None if none has.

    It stands in a temporary folder of this user, and says itself whom it serves.
    """
    for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        try:
            mine = folder.lstat().st_uid == os.getuid() and folder.is_dir() and not folder.is_symlink()
        except OSError:
            continue
        bench = find(folder) if mine else None
        if bench is not None and bench.session == session.resolve():
            return bench
    return None


def truth(bench: Bench, times_s: Sequence[float] = (), *, piece: int = 1) -> dict[str, Any]:
    """Return what the bench really did, for tests; see `phoslab.instruments.bench.truth`.

    Args:
        bench: a running one.
        times_s: ascending moments of its monotonic clock, past and dark, at which a sample's light is wanted.
        piece: of the samples.
    """
    link = Link(bench.socket)
    try:
        return dict(json.loads(link.ask("truth", times_s=list(times_s), piece=piece)["body"]))
    finally:
        link.close()


def _alive(pid: int) -> bool:
    try:
        # A child that has ended stays until its parent asks.
        if os.waitpid(pid, os.WNOHANG)[0] == pid:
            return False
    except ChildProcessError:
        pass
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
