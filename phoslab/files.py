"""Files that are whole or absent, and names that stay inside their folder."""

from __future__ import annotations

import errno
import hashlib
import os
import stat
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from phoslab.errors import PhoslabError


def check_writable(path: str | os.PathLike[str]) -> None:
    """Refuse, before any work is done, an output that could not be written afterwards.

    Raises:
        PhoslabError: it is a folder, a device, a link or anything but a regular file; or its folder, or the
            nearest one above that exists, cannot be written to.
    """
    target = Path(path)
    try:
        mode = target.lstat().st_mode if os.path.lexists(target) else None
        folder = target.parent
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
        usable = folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)
        longest = max(len(os.fsencode(part)) for part in target.absolute().parts)
        if longest > os.pathconf(folder, "PC_NAME_MAX"):
            raise OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG))
    except (OSError, ValueError) as error:
        raise PhoslabError(
            f"cannot be written ({getattr(error, 'strerror', None) or error})",
            file=target,
            remedy="Choose another name or folder.",
        ) from error
    if mode is not None and not stat.S_ISREG(mode):
        # A rename would put a plain file in the place of a device or a link, and nobody asks for that.
        kind = "a folder" if stat.S_ISDIR(mode) else "not a regular file"
        raise PhoslabError(f"is {kind}", file=target, remedy="Name a file to write.")
    if not usable:
        raise PhoslabError(
            f"cannot be written: {folder} is not a folder that you may write to",
            file=target,
            remedy="Choose another folder.",
        )


def check_outside(outputs: Sequence[Path], sessions: Sequence[Path]) -> None:
    """Refuse, before any work, what cannot be written, is named twice, or lies in a session, which never changes.

    Raises:
        PhoslabError: the error names the output.
    """
    for k, output in enumerate(outputs):
        check_writable(output)
        where = output.resolve()
        if where in [other.resolve() for other in outputs[:k]]:
            raise PhoslabError("is named twice", file=output, remedy="Name different files.")
        if any(where.is_relative_to(session.resolve()) for session in sessions):
            raise PhoslabError(
                "lies in the session, which is never written to", file=output, remedy="Name a file elsewhere."
            )


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` on success, delete it on failure.

    The rename is atomic, and the content is on disk before it: a reader, or a crash at any
    moment, sees the old file or the whole new one.

    Raises:
        PhoslabError: the file cannot be written; see also `check_writable`.
    """
    target = Path(path)
    check_writable(target)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        # The suffix is kept: writers of images choose their format by it.
        handle, name = tempfile.mkstemp(prefix=".phoslab-", suffix=target.suffix, dir=target.parent)
    except OSError as error:
        raise PhoslabError(
            f"cannot be written ({error.strerror})",
            file=target,
            remedy="Choose a folder that you may write to.",
        ) from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.chmod(0o666 & ~umask())
        temporary.replace(target)
    except OSError as error:
        raise PhoslabError(
            f"could not be written ({error.strerror or error})",
            file=target,
            remedy="Check the name, the disk and its free space.",
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def read_regular(path: Path, largest_bytes: int, *, remedy: str) -> bytes:
    """Return a file's content if it is a regular file of at most `largest_bytes`.

    A pipe would block, a device never end, and an absurd size fill the memory.

    Raises:
        PhoslabError: it is missing, unreadable, of another kind or too large.
    """
    try:
        # O_NONBLOCK: opening a pipe that nobody writes to would wait for ever.
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as stream:
            status = os.fstat(stream.fileno())
            if not stat.S_ISREG(status.st_mode):
                kind = "a folder" if stat.S_ISDIR(status.st_mode) else "not a regular file"
                raise PhoslabError(f"is {kind}", file=path, remedy=remedy)
            if status.st_size > largest_bytes:
                raise PhoslabError(
                    f"has {status.st_size} bytes, more than the {largest_bytes} that phoslab reads",
                    file=path,
                    remedy=remedy,
                )
            return stream.read()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise PhoslabError(f"cannot be read ({reason})", file=path, remedy=remedy) from error


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write `text` as UTF-8, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def inside(folder: Path, name: str, *, file: Path, field: str) -> Path:
    """Return `folder / name` if that is a plain path inside `folder`, following no symbolic link.

    Names come from files that anyone may have written, so `..`, absolute paths, back-slashes
    and links are refused. `file` and `field` say in the error where the name stood.

    Raises:
        PhoslabError: the name would leave the folder.
    """
    parts = PurePosixPath(name).parts
    remedy = f"Use a plain relative name inside {folder}."
    if not parts or "\\" in name or "\0" in name or PurePosixPath(name).is_absolute() or ".." in parts:
        raise PhoslabError(
            f"names {name!r}, which is not a file inside the folder", file=file, field=field, remedy=remedy
        )
    path = folder
    for part in parts:
        path = path / part
        try:
            linked = path.is_symlink()
        except OSError as error:
            raise PhoslabError(
                f"cannot be looked at ({error.strerror})",
                file=path,
                remedy="Make its folder readable, or copy it to one that is.",
            ) from error
        if linked:
            raise PhoslabError(
                f"names {name!r}, which is a symbolic link", file=file, field=field, remedy=remedy
            )
    return path


def sha256(path: Path) -> str:
    """SHA-256 of a file's content, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def umask() -> int:
    """The process's file mode mask, which can be read only by setting it."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask
