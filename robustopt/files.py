"""Reading of files that a user names, and writing of files in one step.

Only regular files of bounded size are read: a device or a pipe would never end. A file is written beside its place and
moved there, so that it is never half-written, and no link is followed to the file of somebody else.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

MOST_TEXT = 10_000_000
"""Largest size of a text file [bytes], unless its reader knows better (our choice)."""

MOST_BYTES = 200_000_000
"""Largest size of a mesh, an image or a table of numbers [bytes] (our choice)."""


def require_regular(path: Path, most: int = MOST_BYTES) -> None:
    """Check that a path leads to a regular file of bounded size, without opening it.

    Args:
        path: the file.
        most: largest size [bytes].

    Raises:
        OSError: it does not; `strerror` says why.
    """
    try:
        found = path.stat()
    except ValueError:  # a null character, or one that the file system cannot encode
        raise OSError(errno.EINVAL, "no file can have this name", str(path)) from None
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, "is a folder; expected a file", str(path))
    if not stat.S_ISREG(found.st_mode) or (not found.st_size and _is_virtual(path)):
        message = "is not a regular file, but a pipe, a device or the like; expected a regular file"
        raise OSError(errno.EINVAL, message, str(path))
    if found.st_size > most:
        message = f"has {found.st_size:,} bytes; expected at most {most:,}"
        raise OSError(errno.EFBIG, message, str(path))


def _is_virtual(path: Path) -> bool:
    """Return whether a file system has no blocks, as /proc, whose files have no size and may have no end."""
    return hasattr(os, "statvfs") and os.statvfs(path).f_blocks == 0


def read_bytes(path: Path, most: int = MOST_BYTES) -> bytes:
    """Return the content of a regular file.

    Args:
        path: the file.
        most: largest size [bytes].

    Raises:
        OSError: it is not a regular file, is too large, or cannot be read; `strerror` says why.
    """
    require_regular(path, most)
    with path.open("rb") as file:
        return file.read(most)


def read_text(path: Path, most: int = MOST_TEXT) -> str:
    """Return the text of a regular file in UTF-8, without a byte order mark.

    Args:
        path: the file.
        most: largest size [bytes].

    Raises:
        OSError: it is not a regular file, is too large, cannot be read, or is not UTF-8; `strerror` says why.
    """
    try:
        return read_bytes(path, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise OSError(errno.EILSEQ, f"byte {error.start} is not UTF-8 text", str(path)) from None


def reason(error: OSError) -> str:
    """Return the reason of an error of the system, with the name of its file.

    Args:
        error: the error.
    """
    about = f" ({error.filename})" if error.filename else ""
    return f"{error.strerror or error}{about}"


@contextmanager
def written(path: Path) -> Iterator[Path]:
    """Yield a path beside a file, to write to; at the end of the block it replaces the file, if the block succeeds.

    Args:
        path: the file; must not be a link.

    Yields:
        The path to write to, with the same suffix.

    Raises:
        OSError: the file is a link, or cannot be written.
    """
    if path.is_symlink():
        raise OSError(errno.ELOOP, "is a link; expected a file of its own", str(path))
    beside = path.with_name(f".partial-{path.name}")
    beside.unlink(missing_ok=True)  # left by a process that was killed; a link is not followed
    try:
        yield beside
        beside.replace(path)
    except BaseException:
        with suppress(OSError):
            beside.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str) -> None:
    """Write a text file in one step.

    Args:
        path: the file; must not be a link.
        text: its content.

    Raises:
        OSError: the file is a link, or cannot be written.
    """
    with written(path) as beside:
        beside.write_text(text, encoding="utf-8", newline="\n")


def links_in(folder: Path) -> list[Path]:
    """Return the symbolic links in a folder and in the folders below it.

    Args:
        folder: the folder.
    """
    places = [Path(place, name) for place, folders, files in os.walk(folder) for name in (*folders, *files)]
    return [place for place in places if place.is_symlink()]
