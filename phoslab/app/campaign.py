"""One session or a folder of them, measured from the beginning or from where it was interrupted.

`measure all` writes campaign.toml into its folder first: the sessions in order, and what they are measured with. Each
session is a folder of its own beside it. What a single session was begun with stands in its own header.
"""

from __future__ import annotations

import contextlib
import os
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import tomli_w

from phoslab import schemas
from phoslab.app.laboratory import Opened, Source, check_plan, header_of, opened
from phoslab.errors import PhoslabError, printable
from phoslab.files import inside, read_regular, write_text
from phoslab.instruments.history import History
from phoslab.instruments.interrupts import Interrupts
from phoslab.instruments.plans import start
from phoslab.instruments.recorder import Recorder
from phoslab.instruments.rehearsal import Rehearsal, TimeLine
from phoslab.instruments.rig import Rig, plain
from phoslab.instruments.runner import Runner
from phoslab.instruments.session_folder import check_free, lock
from phoslab.journal import check_version
from phoslab.plan_parameters import Lamp, Parameters, parameters
from phoslab.session import Session

SCHEMA = "phoslab-campaign/1"
FILE = "campaign.toml"


@dataclass(frozen=True)
class Entry:
    """A session that is to be measured.

    Args:
        folder: where it lies.
        plan: its plan.
        parameters: of the plan.
    """

    folder: Path
    plan: str
    parameters: Parameters


@dataclass(frozen=True)
class Campaign:
    """What is measured, with what, where to.

    Args:
        folder: of the sessions; with one session, the session's own.
        entries: the sessions in order.
        source: the rig or the bench.
        sample: name of the sample.
        several: whether this is a folder of sessions.
    """

    folder: Path
    entries: tuple[Entry, ...]
    source: Source
    sample: str
    several: bool

    @classmethod
    def load(cls, folder: Path) -> Campaign:
        """What an interrupted measurement in `folder` was to become.

        Raises:
            PhoslabError: it is neither a session nor a folder of them.
        """
        if (folder / FILE).is_file():
            return _load_several(folder)
        session = Session.open(folder)
        header = session.header
        entry = Entry(
            folder, header.plan, parameters(header.plan, header.parameters, file=folder / "session.toml")
        )
        if header.simulated is not None:
            told = header.simulated
            source = Source(
                None, str(told.get("sample", "green")), int(told["seed"]), tuple(told.get("faults", ()))
            )
        else:
            source = Source(Rig.from_header(header.rig))
        return cls(folder, (entry,), source, header.sample_name, several=False)

    @property
    def rig(self) -> Rig:
        """The rig; that of the bench if there is no other."""
        if self.source.rig is not None:
            return self.source.rig
        from phoslab.app.simulation import bench_of

        return bench_of(Path("controller"), Path("socket"))

    def save(self) -> None:
        """Write campaign.toml."""
        data = {
            "schema": SCHEMA,
            "sample": self.sample,
            **self.source.table(),
            "sessions": [
                {"folder": e.folder.name, "plan": e.plan, "parameters": asdict(e.parameters)}
                for e in self.entries
            ],
        }
        write_text(self.folder / FILE, tomli_w.dumps(plain(data)))

    def rehearse(self, opened: Opened | None = None, done: frozenset[Path] = frozenset()) -> TimeLine:
        """Go through what is left to do.

        Args:
            opened: the laboratory, as far as it is known.
            done: sessions that are complete.
        """
        setup = opened.setup if opened else self.rig.setup()
        rehearsal = Rehearsal(setup)
        for entry in self.entries:
            if entry.folder not in done:
                if self.several:
                    rehearsal.title(f"{entry.plan} -> {entry.folder}")
                rehearsal.run(start(entry.parameters, setup))
        return rehearsal.line


class NothingLeftError(PhoslabError):
    """All was measured before."""


def begin(campaign: Campaign) -> None:
    """Refuse what is wrong before any device is touched; then make room for it."""
    check_free(campaign.folder)
    line = campaign.rehearse()
    check_plan(line, campaign.rig.max_on_s, campaign.folder, campaign.rig.frame_bytes)


def measured(campaign: Campaign, *, json: bool, resume: bool = False) -> int:
    """Measure, say what came of it, and return the exit code."""
    view = "silent" if json else "live" if sys.stderr.isatty() else "lines"
    outcomes: list[Outcome] = []
    problem, left = "", True
    try:
        for outcome in run(campaign, view=view, resume=resume):
            outcomes.append(outcome)
            if not json:
                print(outcome.line())
    except KeyboardInterrupt:
        problem = "stopped by a signal; the lamp is off"
    except PhoslabError as error:
        problem, left = str(error), not isinstance(error, NothingLeftError)
    again = f"phoslab resume {campaign.folder}"
    can_resume = bool(problem and left) and (
        (campaign.folder / FILE).exists() or (campaign.folder / "journal.jsonl").exists()
    )
    if json:
        import json as json_module

        told = [{"session": str(o.folder), "plan": o.plan, **o.summary} for o in outcomes]
        print(
            json_module.dumps(
                {
                    "complete": not problem,
                    "sessions": told,
                    "problem": problem or None,
                    "resume": again if can_resume else None,
                }
            )
        )
    elif problem:
        print(printable(f"phoslab: {problem}"), file=sys.stderr)
        if can_resume:
            print(printable(f"What was recorded is kept. To go on: {again}"), file=sys.stderr)
    return 1 if problem else 0


@dataclass(frozen=True)
class Outcome:
    """What came of a session."""

    folder: Path
    plan: str
    summary: dict[str, Any]

    def line(self) -> str:
        """It in one line."""
        s = self.summary
        timing = ""
        if s["planned"]:
            timing = (
                f"; {s['planned']} planned instants met to {s['deviation_median_s'] * 1e3:.1f} ms (median), "
                f"{s['deviation_worst_s'] * 1e3:.1f} ms at worst"
            )
        return f"{self.folder}: {self.plan}, {s['frames']} frames{timing}"


def run(campaign: Campaign, *, view: str, resume: bool = False) -> Iterator[Outcome]:
    """Measure what is not there yet, session by session.

    Raises:
        NothingLeftError: it is complete.
        PhoslabError: it cannot go on. KeyboardInterrupt: a signal asked for an end. Either way the lamp is off, and the
            session that was being recorded is closed as interrupted.
    """
    done, last_wall = _progress(campaign) if resume else (frozenset(), None)
    left = [e for e in campaign.entries if e.folder not in done]
    if not left:
        raise NothingLeftError(
            "is complete",
            file=campaign.folder,
            remedy="There is nothing to resume; measure into a new folder.",
        )
    title = f"{campaign.sample}: {', '.join(e.plan for e in left)}"
    with _locked(campaign, resume), Interrupts() as interrupts:
        total_s = campaign.rehearse(None, done).duration_s
        with opened(
            campaign.source,
            campaign.folder,
            interrupts,
            view=view,
            title=title,
            total_s=total_s,
            not_before=last_wall,
        ) as laboratory:
            line = campaign.rehearse(laboratory, done)
            check_plan(line, laboratory.max_on_s, campaign.folder, laboratory.lab.frame_bytes)
            for entry in left:
                yield _measure(campaign, entry, laboratory)


def _measure(campaign: Campaign, entry: Entry, laboratory: Opened) -> Outcome:
    lab = laboratory.lab
    told = entry.parameters
    if isinstance(told, Lamp) and not told.lux_lx:
        told = replace(told, lux_lx=laboratory.setup.lux_lx)
    header = header_of(entry.plan, asdict(told), campaign.sample, laboratory.header)
    if (entry.folder / "journal.jsonl").exists():
        history = History.read(Session.open(entry.folder).events)
        recorder = Recorder.resume(entry.folder, lab.clock)
    else:
        history = History()
        recorder = Recorder(entry.folder, header, lab.clock)
    with recorder:
        if "simulated" in header:
            recorder.note(header["simulated"]["statement"])
        if laboratory.word:
            recorder.note(laboratory.word)
        if not getattr(lab.lamp, "failsafe", True):
            recorder.note("the lamp does not go out by itself; a guardian process switches it off")
        Runner(lab, recorder, history).run(lambda: start(entry.parameters, laboratory.setup))
    return Outcome(entry.folder, entry.plan, recorder.summary)


@contextlib.contextmanager
def _locked(campaign: Campaign, resume: bool) -> Iterator[None]:
    """A folder of sessions is locked as a whole by its campaign.toml; a single session by its journal.

    That is the recorder's to do; here it is only looked whether it could, before the devices of another are touched.
    """
    if not campaign.several:
        if resume:
            handle = os.open(campaign.folder / "journal.jsonl", os.O_RDONLY | os.O_NOFOLLOW)
            try:
                lock(handle, campaign.folder)
            finally:
                os.close(handle)
        yield
        return
    if not resume:
        campaign.folder.mkdir(parents=True, exist_ok=True)
        campaign.save()
    handle = os.open(campaign.folder / FILE, os.O_RDONLY | os.O_NOFOLLOW)
    try:
        lock(handle, campaign.folder)
        yield
    finally:
        os.close(handle)


def _progress(campaign: Campaign) -> tuple[frozenset[Path], str | None]:
    """The sessions that are complete, and the wall time of the last line of any."""
    done, walls = set(), []
    for entry in campaign.entries:
        if not (entry.folder / "journal.jsonl").exists():
            continue
        session = Session.open(entry.folder)
        walls.append(session.events[-1].wall)
        if session.complete:
            done.add(entry.folder)
    return frozenset(done), max(walls, default=None)


def _load_several(folder: Path) -> Campaign:
    file = folder / FILE
    content = read_regular(file, 1 << 20, remedy="Name the folder that phoslab measure all wrote.")
    try:
        data = tomllib.loads(content.decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise PhoslabError(
            f"is not valid TOML: {error}",
            file=file,
            remedy="Copy the folder again from where it was measured.",
        ) from error
    check_version(data.get("schema"), SCHEMA, file, "schema")
    schemas.check(data, "campaign-1", file=file)
    entries = tuple(
        Entry(
            inside(folder, s["folder"], file=file, field="sessions.folder"),
            s["plan"],
            parameters(s["plan"], s["parameters"], file=file),
        )
        for s in data["sessions"]
    )
    if "simulate" in data:
        told = data["simulate"]
        source = Source(None, told["sample"], told["seed"], tuple(told["faults"]))
    else:
        source = Source(Rig.of(data["rig"], Path(data["rig_file"]) if "rig_file" in data else None))
    return Campaign(folder, entries, source, data["sample"], several=True)
