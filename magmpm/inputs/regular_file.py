"""Reading files that a user names: regular ones only, and none that is far too large, so that no name can hang a command or fill memory."""

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


MOST = 64_000_000  # bytes of a file of ours that says what a result is


class UnfitFile(OSError):
    """A name that stands for something else than a regular file of a usable size; strerror says for what."""


def read_regular(path: Path, most: int) -> bytes:
    """Content of a regular file of at most `most` bytes.

    Raises UnfitFile where it is no regular file or larger, and what else the system says as OSError.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # opening a FIFO would otherwise wait for somebody who writes
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
    if len(content) > most:  # files of /proc say that they are empty
        raise UnfitFile(errno.EFBIG, f"received more than {most} bytes", str(path))
    return content
