"""Whose a session's folder is: free, begun by a writer that died, or in use by another process."""

from __future__ import annotations

import contextlib
import fcntl
import glob
import os
import time
from pathlib import Path

from phoslab.errors import PhoslabError

BEGUN_S = 60.0
"""A session that has not got its journal in this time will not get one."""


def check_free(path: Path) -> None:
    """Refuse a place where a session lies already, or anything else.

    Raises:
        PhoslabError: it exists and is no empty folder, or cannot be looked at.
    """
    try:
        taken = path.is_symlink() or (path.exists() and (not path.is_dir() or any(path.iterdir())))
    except OSError as error:
        raise PhoslabError(
            f"cannot be looked at ({error.strerror})",
            file=path,
            remedy="Choose a folder that you may write to.",
        ) from error
    if taken:
        raise PhoslabError(
            "already exists",
            file=path,
            remedy="Name a new folder: a session is never overwritten. phoslab resume goes on with an interrupted one.",
        )


def sweep(target: Path) -> None:
    """Remove what a writer left that was killed while it began the session `target`; nothing was recorded there yet.

    What is in use, was begun a moment ago or holds anything else than a beginning stays.
    """
    for building in target.parent.glob(f".{glob.escape(target.name)}-????????"):
        with contextlib.suppress(OSError, PhoslabError):
            lines = building / "journal.jsonl"
            if lines.exists():
                handle = os.open(lines, os.O_RDONLY | os.O_NOFOLLOW)
                try:
                    lock(handle, building)
                finally:
                    os.close(handle)
            elif time.time() - building.stat().st_mtime < BEGUN_S:
                continue
            with contextlib.suppress(FileNotFoundError):
                (building / "frames").rmdir()  # first: it refuses if there is a frame
            for file in (*building.glob("*session.toml*"), lines):
                file.unlink(missing_ok=True)
            building.rmdir()


def lock(handle: int, path: Path) -> None:
    """Lock an open file for this process, until it is closed or the process ends, however it ends.

    Raises:
        PhoslabError: another process has it; the error names that.
    """
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise PhoslabError(
            f"is in use by {_holder(handle)}",
            file=path,
            remedy="Wait until it is done, or stop it (Ctrl-C leaves the session whole).",
        ) from None


def _holder(handle: int) -> str:
    """Name the process that has locked a file, where the system tells."""
    status = os.fstat(handle)
    this = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
    with contextlib.suppress(OSError):
        for line in Path("/proc/locks").read_text().splitlines():
            words = line.split()  # "1: FLOCK  ADVISORY  WRITE 4242 fe:00:131 0 EOF"
            if len(words) > 5 and words[1] == "FLOCK" and words[5] == this:
                return f"process {words[4]}"
    return "another process"
