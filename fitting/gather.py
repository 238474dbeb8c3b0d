"""Sessions by their plan, from any mixture of session folders and folders of sessions (`phoslab measure all`)."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from phoslab.errors import PhoslabError
from phoslab.session import Session

PLANS = ("flats", "lamp", "lvf", "emission", "decay", "excitation", "check")


@dataclass(frozen=True)
class Gathered:
    """One session of each plan, as far as there are any.

    Args:
        by_plan: the sessions.
        warnings: one sentence each: what was left out and why, what does not belong together.
    """

    by_plan: Mapping[str, Session]
    warnings: tuple[str, ...]

    def get(self, plan: str) -> Session | None:
        """The session of a plan, if there is one."""
        return self.by_plan.get(plan)

    @property
    def sessions(self) -> tuple[Session, ...]:
        """All, in the order of their plans."""
        return tuple(self.by_plan[plan] for plan in PLANS if plan in self.by_plan)


def gather(paths: Sequence[str | os.PathLike[str]]) -> Gathered:
    """Open every session named, or lying in a folder that is named, and keep one of each plan: the last one.

    A session that is damaged is left out with a warning if there are others.

    Raises:
        PhoslabError: nothing is left; or a path holds no session.
    """
    folders = list(dict.fromkeys(folder for path in paths for folder in _folders(Path(path))))
    by_plan: dict[str, Session] = {}
    warnings: list[str] = []
    errors: list[PhoslabError] = []
    for folder in folders:
        try:
            session = Session.open(folder)
        except PhoslabError as error:
            errors.append(error)
            continue
        plan = session.header.plan
        if plan not in PLANS:
            warnings.append(
                f"{folder}: is of the plan {plan!r}, of which a fit makes nothing, and is left out."
            )
            continue
        if plan in by_plan:
            warnings.append(
                f"{by_plan[plan].path}: is left out, since {folder} is of the plan {plan!r} as well and the last one "
                "named of each plan counts. Name only the one that is meant."
            )
        by_plan[plan] = session
    if not by_plan:
        if errors:
            raise errors[0]
        raise PhoslabError(
            "names no session that a material can be fitted to",
            field="the fit",
            remedy="Name folders of sessions, or the folder that `phoslab measure all` wrote.",
        )
    warnings += [f"{error} The session is left out." for error in errors]
    sessions = [by_plan[plan] for plan in PLANS if plan in by_plan]
    warnings += [warning for session in sessions for warning in session.warnings]
    return Gathered(by_plan, (*warnings, *_strangers(sessions)))


def _folders(path: Path) -> list[Path]:
    """The session at a path, or those in the folder at it, by name."""
    if (path / "session.toml").exists() or not path.is_dir():
        return [path]
    inside = sorted(p for p in path.iterdir() if p.is_dir() and (p / "session.toml").exists())
    if not inside and not (path / "journal.jsonl").exists():
        deeper = next((p.parent.parent for p in path.glob("*/*/session.toml")), None)
        raise PhoslabError(
            "is no session (it has no session.toml), nor does a folder in it have one",
            file=path,
            remedy="Name folders of sessions, or the folder that `phoslab measure all` wrote"
            + (f"; {deeper} is one that holds sessions." if deeper else "."),
        )
    return inside or [path]


def _strangers(sessions: Sequence[Session]) -> list[str]:
    """Say where sessions are of another sample or camera than the decay (or the first)."""
    main = next((s for s in sessions if s.header.plan == "decay"), sessions[0])
    said = []
    for session in sessions:
        header = session.header
        # Calibrations belong to the camera; whatever lay there meanwhile is no sample.
        if header.plan not in ("flats", "lamp", "lvf") and header.sample_name != main.header.sample_name:
            said.append(
                f"{session.path}: is of the sample {header.sample_name!r}, and {main.path.name} of "
                f"{main.header.sample_name!r}: the material mixes them."
            )
        body, own = (
            tuple(h.camera.get(k) for k in ("make", "model", "serial")) for h in (main.header, header)
        )
        if body != own:
            said.append(
                f"{session.path}: is of another camera than {main.path.name}: signals do not compare."
            )
    return said
