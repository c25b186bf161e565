"""Files that appear whole or not at all, and messages for where the disk does not take them."""

import errno
import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from magmpm.errors import report

FULL = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
)  # no room on the disk, in the quota, or within the system's limit for a file
REFUSED = (
    errno.EACCES,
    errno.EPERM,
    errno.EROFS,
    errno.ENOTDIR,
    errno.EISDIR,
)  # trying again would not help


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A file beside `path` to write to, which replaces it at the end, or is removed on an error. An OSError names `path`."""
    part = path.with_name(f".{path.name}")
    with naming(path):
        try:
            yield part
            part.replace(path)
        except BaseException:
            with suppress(OSError):
                part.unlink(missing_ok=True)  # a partial file would take room on a full disk
            raise


def write_json(path: Path, data: Any, **options: Any) -> None:
    """Plain data as a JSON file that appears whole; options: of json.dumps."""
    with whole_file(path) as part:
        part.write_text(json.dumps(data, **options) + "\n", encoding="utf-8")


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """An OSError names the file: for a failed write the system does not."""
    try:
        yield
    except OSError as error:
        error.filename = str(path)
        raise


def explained(error: OSError, kept: str = "") -> str:
    """The message for a file that can't be read or written; kept: what is not lost."""
    place = f"{error.filename or 'the system'}: {error.strerror or error}"
    if error.errno in FULL:
        rule = "output needs free disk space, within the system's limits for this user"
        remedy = "free disk space, or write to another disk"
    elif error.errno in REFUSED:
        rule = "the location must be writable"
        remedy = "use another folder, or fix its permissions"
    else:
        rule = "files must stay accessible while a command runs"
        remedy = "check that the disk is connected and healthy, then run it again"
    return report(place, rule=rule, remedy=f"{remedy}{kept}")
