"""Open what a plan runs on, the rig or the simulated bench, and close it however the plan ends."""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from phoslab import raw
from phoslab.app.live import Lines, Live, Silent, Terminal
from phoslab.errors import PhoslabError
from phoslab.instruments.devices import Clock, DeviceError, Exposure
from phoslab.instruments.interrupts import Interrupts
from phoslab.instruments.laboratory import Laboratory, check_space
from phoslab.instruments.operator import Operator
from phoslab.instruments.plans.ladder import Ladder
from phoslab.instruments.plans.steps import Setup
from phoslab.instruments.rehearsal import TimeLine
from phoslab.instruments.rig import Devices, Rig, connect
from phoslab.instruments.shooting import CAMERA_S
from phoslab.instruments.system_clock import SystemClock


@dataclass(frozen=True)
class Source:
    """Where a measurement takes place.

    Args:
        rig: the rig file; None: on the simulated bench.
        sample: name of the simulated sample: a preset.
        seed: of the simulated noise.
        faults: that are injected, as the bench names them.
    """

    rig: Rig | None = None
    sample: str = ""
    seed: int = 0
    faults: tuple[str, ...] = ()

    def table(self) -> dict[str, Any]:
        """As campaign.toml has it."""
        if self.rig is not None:
            return {"rig": dict(self.rig.data), **({"rig_file": str(self.rig.file)} if self.rig.file else {})}
        return {"simulate": {"sample": self.sample, "seed": self.seed, "faults": list(self.faults)}}


@dataclass
class Opened:
    """A laboratory that is ready.

    Args:
        lab: the devices.
        setup: what plans know of it.
        header: the tables of session.toml that describe it.
        max_on_s: how long its lamp may shine without a break.
        word: for the journal, if there is something to say.
    """

    lab: Laboratory
    setup: Setup
    header: dict[str, Any]
    max_on_s: float
    word: str = ""


@contextmanager
def opened(
    source: Source,
    session: Path,
    interrupts: Interrupts,
    *,
    view: str,
    title: str,
    total_s: float,
    not_before: str | None = None,
) -> Iterator[Opened]:
    """Open the devices, check the camera with a trial frame, and show what goes on; leave everything safe.

    Args:
        session: folder of the session, or of several.
        view: "live", "lines" or "silent".
        title, total_s: for the view.
        not_before: wall time, RFC 3339, of the last line of a session that goes on.

    Raises:
        PhoslabError: something is not there or not as it should be. The lamp has not been on then.
    """
    with ExitStack() as stack:
        operator: Operator
        clock: Clock
        word = ""
        if source.rig is None:
            from phoslab.app.simulation import started

            bench = stack.enter_context(
                started(session, source.sample, source.seed, source.faults, not_before)
            )
            rig, clock, operator, extra, word = (
                bench.rig,
                bench.clock,
                bench.operator,
                bench.header,
                bench.word,
            )
        else:
            rig, clock, operator, extra = source.rig, SystemClock(), Terminal(), {}
        devices: Devices = connect(rig, clock, operator, interrupts.check)
        clock = devices.clock  # which now knows the controller's
        stack.callback(devices.unstage)
        devices.stage()
        setup = rig.setup(devices.camera.choices)
        lab = Laboratory(
            devices.lamp,
            devices.door,
            devices.camera,
            clock,
            operator,
            Silent(),
            interrupts,
            frame_bytes=rig.frame_bytes,
        )
        stack.callback(lab.safe)
        check_camera(lab, setup.ladder)
        if view == "live":
            from rich.console import Console

            live = Live(Console(file=sys.stderr), clock, title, total_s)
            lab.watcher = live
            if isinstance(operator, Terminal):
                operator.live = live
            stack.enter_context(live.shown())
        elif view == "lines":
            lab.watcher = Lines(clock)
        if word:
            lab.watcher.trouble(word)
        yield Opened(lab, setup, {**rig.header(devices.camera.facts), **extra}, rig.max_on_s, word)


def check_camera(lab: Laboratory, ladder: Ladder) -> None:
    """Take a frame, lamp off, and look at it: it must be RAW by its content and have the settings that were set.

    So JPEG and automatic ISO are found before the lamp is on, whatever the camera says of itself.

    Raises:
        DeviceError: it is not so.
    """
    exposure = Exposure(
        ladder.exposures_s[len(ladder.exposures_s) // 2], ladder.isos[-1], ladder.f_numbers[0]
    )
    lab.camera.set(exposure).wait(CAMERA_S)
    exposed = lab.camera.trigger()
    if getattr(lab.camera, "by_hand", False):
        text = f"Release the shutter of the {lab.camera.name} once, for a trial with the lamp off"
        print(f"  -> {text} ({exposure.exposure_s:g} s, ISO {exposure.iso:g}).", file=sys.stderr, flush=True)
    exposed.wait(exposure.exposure_s + CAMERA_S)
    with tempfile.TemporaryDirectory(prefix="phoslab-") as folder:
        path = Path(folder) / f"trial.{lab.camera.suffix}"
        lab.camera.save(path)
        lab.frame_bytes = path.stat().st_size
        try:
            frame = raw.read_raw(path)
        except PhoslabError as error:
            raise DeviceError(
                f"delivered a trial frame that {error.problem}",
                field=lab.camera.name,
                remedy="Set it to RAW alone: not JPEG, not RAW + JPEG.",
            ) from error
    for name, wanted, found in (
        ("exposure time", exposure.exposure_s, frame.exposure_s),
        ("ISO", exposure.iso, frame.iso),
        ("f-number", exposure.f_number, frame.f_number),
    ):
        if wanted and found and abs(math.log(found / wanted)) > math.log1p(raw.SETTING_TOLERANCE):
            raise DeviceError(
                f"took a trial frame with the {name} {found:g} where {wanted:g} was set",
                field=lab.camera.name,
                remedy="Turn its dial to M and switch automatic ISO off.",
            )


def check_plan(line: TimeLine, max_on_s: float, out: Path, frame_bytes: int) -> None:
    """Refuse what a plan asks too much of: the lamp's longest time, the disk's room.

    Raises:
        PhoslabError: it does.
    """
    if line.longest_on_s > max_on_s:
        raise PhoslabError(
            f"would be on for {line.longest_on_s:.0f} s without a break, and the rig allows {max_on_s:.0f} s",
            field="the lamp",
            remedy="Shorten --charge, or raise lamp.max_on_s in the rig file (and the controller's limit).",
        )
    check_space(out.resolve(), line.n_frames, frame_bytes)


def header_of(
    plan: str, parameters: Mapping[str, Any], sample: str, described: Mapping[str, Any]
) -> dict[str, Any]:
    """session.toml without its first two lines."""
    from phoslab import __version__

    return {
        **described,
        "plan": {"name": plan, "parameters": dict(parameters)},
        "sample": {"name": sample, **described.get("sample", {})},
        "software": {"phoslab": __version__, "python": sys.version.split()[0]},
    }
