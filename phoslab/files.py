"""Files that are whole or absent, and names that stay inside their folder."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from phoslab.errors import PhoslabError


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` on success, delete it on failure.

    The rename is atomic, and the content is on disk before it: a reader, or a crash at any
    moment, sees the old file or the whole new one.
    """
    target = Path(path)
    if target.is_dir():
        raise PhoslabError("is a folder", file=target, remedy="Name a file to write.")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        # The suffix is kept: writers of images choose their format by it.
        handle, name = tempfile.mkstemp(prefix=f".{target.stem}-", suffix=target.suffix, dir=target.parent)
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
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(target)
    except OSError as error:
        raise PhoslabError(
            f"could not be written ({error.strerror})",
            file=target,
            remedy="Check the disk and its free space.",
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


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
        if path.is_symlink():
            raise PhoslabError(
                f"names {name!r}, which is a symbolic link", file=file, field=field, remedy=remedy
            )
    return path


def sha256(path: Path) -> str:
    """SHA-256 of a file's content, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _umask() -> int:
    """The process's file mode mask, which can be read only by setting it."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask
