"""One process at a time writes a folder of results. The lock ends with its process, however that ends."""

import errno
import json
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

from filelock import lock_descriptor

from magmpm.errors import InputError, report
from magmpm.results.file_names import CHECKPOINT, SUBFOLDERS

LOCK = ".lock"
SECONDS_FOR_THE_KILLED = 2.0  # s: a process that has just been killed may need a moment to go
_held: dict[tuple[Path, int], int] = {}  # (folder, thread) -> how many times over


class FolderInUse(InputError):
    """Another process is writing the folder."""


@contextmanager
def folder_lock(folder: Path | str) -> Iterator[None]:
    """Hold a folder of results, made if missing, as its only writer. A thread that holds it already goes on.

    Raises FolderInUse, with who holds it since when; InputError where it can't be written, or what is written would land elsewhere.
    """
    folder = Path(folder)
    key = (folder.resolve(), threading.get_ident())
    if key in _held:
        _held[key] += 1
        try:
            yield
        finally:
            _held[key] -= 1
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            number = errno.EROFS if _read_only(folder) else errno.EACCES
            raise OSError(number, os.strerror(number), str(folder))
        refuse_links(folder)
        while True:
            stream = (folder / LOCK).open("a+", encoding="utf-8")
            _take(stream, folder)
            if _still_there(stream, folder / LOCK):
                break
            # the holder has ended and removed the file: this lock is on a file without a name
            stream.close()
    except OSError as error:
        raise unwritable(folder, error) from None
    with stream:
        _held[key] = 1
        try:
            yield
        finally:
            del _held[key]
            with suppress(OSError):
                (folder / LOCK).unlink()


def refuse_links(folder: Path) -> None:
    """Raises InputError where a link leads out of a folder of results, perhaps someone else's: writing would follow it to any file."""
    for path in (
        *folder.iterdir(),
        *(inner for name in SUBFOLDERS for inner in _below(folder / name)),
    ):
        if (
            path.is_symlink()
            and (path.name in SUBFOLDERS or not path.is_dir())
            and not path.resolve().is_relative_to(folder.resolve())
        ):
            raise InputError(
                str(path),
                received=f"a link to {os.readlink(path)}",
                rule="results must not be written outside their folder",
                remedy="remove the link, or use another folder",
            )


def _below(folder: Path) -> Iterator[Path]:
    """All that a folder holds, links not followed."""
    for at, folders, files in os.walk(folder):
        yield from (Path(at) / name for name in (*folders, *files))


@contextmanager
def written_folder(
    folder: Path | str | None, resume: bool, on_begin: Callable[[], None] | None
) -> Iterator[None]:
    """Lock the folder of a run along time; on_begin is called unless the run continues from a checkpoint. None: no folder."""
    with nullcontext() if folder is None else folder_lock(folder):
        if on_begin is not None and not (
            folder and resume and (Path(folder) / CHECKPOINT).exists()
        ):
            on_begin()
        yield


def refuse_unwritable(folder: Path) -> None:
    """Raises InputError where a folder of results can't be made or written to; leaves none behind."""
    there = folder.is_dir()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise unwritable(folder, error) from None
    if not there:
        folder.rmdir()


def unwritable(folder: Path, error: OSError) -> InputError:
    """The error of a folder that results can't be written to."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        rule = f"results need free disk space ({error.strerror})"
        remedy = "free some, or use another --out"
    else:
        rule = f"the folder must be writable ({error.strerror})"
        remedy = "results can't be written there; use another --out"
    return InputError(str(folder), rule=rule, remedy=remedy)


def _take(stream: IO[str], folder: Path) -> None:
    """Lock the file and write into it which process this is. Raises FolderInUse, InputError."""
    if not _try_lock(stream):
        raise FolderInUse(
            report(
                f"{folder}: in use by {_described(holder(stream))}",
                rule="only one process at a time may write a folder of results",
                remedy="wait for it, end it, or use another --out",
            )
        )
    command = " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])[:200]
    since = time.strftime("%Y-%m-%d %H:%M:%S")
    about = {"pid": os.getpid(), "host": socket.gethostname(), "since": since, "command": command}
    try:
        sign(stream, json.dumps(about))
    except OSError as error:
        raise unwritable(folder, error) from None


def sign(stream: IO[str], text: str) -> None:
    """Write who holds a lock into its file, past the first byte: Windows lets nobody else read that while it is locked."""
    stream.truncate(0)
    stream.write(f" {text}\n")
    stream.flush()


def holder(stream: IO[str]) -> str:
    """Text that the holder of a lock has written into its file."""
    stream.seek(1)
    return stream.read(1000).strip()


def _still_there(stream: IO[str], path: Path) -> bool:
    try:
        return os.fstat(stream.fileno()).st_ino == path.stat().st_ino
    except FileNotFoundError:
        return False


def _described(text: str) -> str:
    """The holder in words, from what it has written into the lock's file."""
    try:
        about = json.loads(text)
        return (
            f"process {about['pid']} on {about['host']} since {about['since']} ({about['command']})"
        )
    except (ValueError, TypeError, KeyError):  # it has not written that yet
        return "another process"


def _try_lock(stream: IO[str]) -> bool:
    """Try to lock within SECONDS_FOR_THE_KILLED; True if the lock was obtained. File systems without locks count as free."""
    until = time.monotonic() + SECONDS_FOR_THE_KILLED
    try:
        while not lock_descriptor(stream.fileno(), blocking=False):
            if time.monotonic() > until:
                return False
            time.sleep(0.05)
    except OSError:
        pass
    return True


def _read_only(folder: Path) -> bool:
    """True for a folder on a file system that is mounted to be read alone, as far as the system tells."""
    return hasattr(os, "statvfs") and bool(os.statvfs(folder).f_flag & os.ST_RDONLY)
