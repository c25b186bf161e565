"""Files that a scene or study may name: those near it, those where the command runs, and those that the user has allowed.

A file that someone sent is data, and must not make a command read, and quote in its messages, whatever this user can read. A path in a
file, with all links followed, must lie in one of these folders:

* the folder above the file's (`../targets/shape.csv` is the usual way), where that is not a folder of everything, such as / or /home;
* the current folder, and the checkout or installation of magmpm, for what it ships;
* folders of the variable MAGMPM_ALLOW_OUTSIDE (with the system's separator between them), which `--allow-outside` sets to everything;
* folders that `magmpm import` has been given by name: they are kept in the user's settings, `magmpm/allowed-folders`.

What begins with a dot below such a folder (.ssh, .config) is refused unless it is allowed by name.

Of files that a user names only regular ones of a bounded size are read, so that no name can hang a command or fill the memory. Results go
to runs/NAME, so the names of scenes and studies must be usable for folders, on any system.
"""

import errno
import os
import stat
from contextlib import suppress
from pathlib import Path

VARIABLE = "MAGMPM_ALLOW_OUTSIDE"
RULE = "a path in a file must stay below the folder above it, or the current folder"
REMEDY = (
    "copy that file beside this one, or allow it: --allow-outside, or the variable"
    " MAGMPM_ALLOW_OUTSIDE=FOLDER"
)


def is_allowed(named: Path, file: Path) -> bool:
    """True if `file` may name the path `named`, which is relative to the current folder or absolute."""
    try:
        found = named.resolve()
    except (
        OSError,
        RuntimeError,
        ValueError,
    ):  # a circle of links, or no name at all: reading it will say so
        return True
    if any(found.is_relative_to(folder) for folder in _allowed_by_name()):
        return True
    for folder in _near(file):
        if found.is_relative_to(folder):
            return not any(part.startswith(".") for part in found.relative_to(folder).parts)
    return False


def _near(file: Path) -> list[Path]:
    """Folders whose files need no permission."""
    own = file.resolve().parent
    near = [own]
    for folder in (own.parent, Path.cwd()):
        if (
            len(folder.parts) >= 3 and folder != Path.home().parent
        ):  # / and /home hold what belongs to others
            near.append(folder)
    return near


def _allowed_by_name() -> list[Path]:
    """Folders that the user, or who set magmpm up, has named."""
    found = [Path(__file__).resolve().parents[2] / "data"]
    found += [
        Path(name).resolve() for name in os.environ.get(VARIABLE, "").split(os.pathsep) if name
    ]
    with suppress(OSError, RuntimeError, UnicodeDecodeError):  # none are kept
        found += [
            Path(line)
            for line in _settings().read_text(encoding="utf-8").splitlines()
            if line.startswith(os.sep)
        ]
    return found


def _settings() -> Path:
    return (
        Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config")
        / "magmpm"
        / "allowed-folders"
    )


def allow(folder: Path) -> None:
    """Keep a folder that the user has named on a command line as one whose files scenes may name; where nothing can be kept, do nothing."""
    kept = _settings()
    wanted = str(folder.resolve())
    try:
        known = kept.read_text(encoding="utf-8").splitlines() if kept.exists() else []
        if wanted not in known and "\n" not in wanted:
            kept.parent.mkdir(parents=True, exist_ok=True)
            kept.write_text("\n".join([*known, wanted]) + "\n", encoding="utf-8")
    except (OSError, RuntimeError, UnicodeDecodeError):
        return


_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe (FIFO)"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


MOST_JSON_BYTES = 64_000_000  # bytes of a JSON file of results


class UnfitFile(OSError):
    """A name that is not a regular file of a usable size; strerror says what it is."""


def read_regular(path: Path, most: int) -> bytes:
    """Content of a regular file of at most `most` bytes. Raises UnfitFile where it is another or larger, OSError for all else."""
    # A FIFO, which Windows has not, would otherwise wait for a writer.
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
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


FORBIDDEN = frozenset('/\\<>:"|?*')
RESERVED = frozenset(  # names of devices on Windows, with any ending
    {"con", "prn", "aux", "nul", *(f"{port}{k}" for port in ("com", "lpt") for k in range(1, 10))}
)


def folder_fault(name: str) -> tuple[str, str] | None:
    """Rule and remedy where a name can't be a folder's; else None."""
    longest_name = 100  # characters
    rule = "must be usable as the name of a folder"
    bad = sorted({c for c in name if c in FORBIDDEN})
    odd = sorted({c for c in name if not c.isprintable()})
    if bad or odd:
        found = ", ".join([*bad, *(f"U+{ord(c):04X}" for c in odd)])
        return (
            rule,
            (
                f"leave out {found}: letters of any script, digits, spaces and all signs but"
                f" {' '.join(sorted(FORBIDDEN))} can be used, and no line breaks, tabs or other"
                " characters that can't be printed"
            ),
        )
    if not name.strip() or name != name.strip():
        return rule, "remove spaces at its start and end"
    if name.startswith(".") or name.endswith("."):
        return (
            rule,
            (
                "begin and end it with something other than a dot: such a folder is hidden, another"
                " one, or lost on some systems"
            ),
        )
    if name.split(".")[0].strip().lower() in RESERVED:
        return rule, f"choose another name: {name.split('.')[0]} is a device on Windows"
    if len(name) > longest_name:
        return f"{rule}, of at most {longest_name} characters", "shorten it"
    return None
