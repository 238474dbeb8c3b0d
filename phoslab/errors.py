"""The one exception that is meant for a person to read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from os import PathLike
from typing import TypeVar

T = TypeVar("T")


class PhoslabError(Exception):
    """Something went wrong that the user can mend.

    Args:
        problem: what is wrong, as the rest of a sentence ("is negative (-0.1)").
        remedy: what to do about it, as a sentence of its own.
        file: the file or folder in which it was found.
        field: the field, frame or parameter inside it.

    >>> print(PhoslabError("is negative", remedy="Give a rate of 0 or more.", file="a.json", field="kr_per_s[0]"))
    a.json: kr_per_s[0] is negative. Give a rate of 0 or more.
    """

    def __init__(
        self,
        problem: str,
        *,
        remedy: str,
        file: str | PathLike[str] | None = None,
        field: str | None = None,
    ) -> None:
        self.problem = problem
        self.remedy = remedy
        self.file = None if file is None else str(file)
        self.field = field
        where = "" if file is None else f"{file}: "
        subject = "" if field is None else f"{field} "
        super().__init__(printable(f"{where}{subject}{problem}. {remedy}"))


@contextmanager
def found_in(file: str | PathLike[str]) -> Iterator[None]:
    """Name `file` in whatever is raised inside that names no file."""
    try:
        yield
    except PhoslabError as error:
        if error.file is not None:
            raise
        raise PhoslabError(error.problem, remedy=error.remedy, file=file, field=error.field) from error


def look_up(registry: Mapping[str, T], name: str, field: str) -> T:
    """Return what `registry` has under `name`.

    Raises:
        PhoslabError: nothing; the error names `field` and lists what there is.
    """
    if name not in registry:
        raise PhoslabError(f"{name!r} is unknown", field=field, remedy=f"Use one of: {', '.join(registry)}.")
    return registry[name]


def printable(text: str) -> str:
    """Return `text` with control characters written out: a name from a file must not steer the terminal.

    >>> printable(chr(27) + "[2J")  # which would clear the screen
    '\\\\x1b[2J'
    """
    return "".join(c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in text)
