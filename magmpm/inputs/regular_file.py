"""Reading files that a user names: only regular files of a bounded size, so that no name can hang a command or fill the memory."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe (FIFO)"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


MOST = 64_000_000  # bytes of a JSON file of results


class UnfitFile(OSError):
    """A name that is not a regular file of a usable size; strerror says what it is."""


def read_regular(path: Path, most: int) -> bytes:
    """Content of a regular file of at most `most` bytes.

    Raises UnfitFile where it is not a regular file or is larger, and OSError for what else the system reports.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # otherwise opening a FIFO would wait for a writer
    try:
        about = os.fstat(handle)
        for is_kind, name in _KINDS:
            if is_kind(about.st_mode):
                raise UnfitFile(errno.EINVAL, f"this is {name}", str(path))
        if about.st_size > most:
            raise UnfitFile(errno.EFBIG, f"received {about.st_size} bytes", str(path))
        with os.fdopen(handle, "rb", closefd=False) as stream:
            content = stream.read(most + 1)
    finally:
        os.close(handle)
    if len(content) > most:  # files of /proc have size 0
        raise UnfitFile(errno.EFBIG, f"received more than {most} bytes", str(path))
    return content
