"""Which files a scene or study may name: those near it, those where the command runs, and those that the user has allowed.

A file that someone sent is data, and must not make a command read, and quote in its messages, whatever this user can read. A path in a
file, with all links followed, must lie in one of these folders:

* the folder above the file's (`../targets/shape.csv` is the usual way), where that is not a folder of everything, such as / or /home;
* the current folder, and the checkout or installation of magmpm, for what it ships;
* folders of the variable MAGMPM_ALLOW_OUTSIDE (with the system's separator between them), which `--allow-outside` sets to everything;
* folders that `magmpm import` has been given by name: they are kept in the user's settings, `magmpm/allowed-folders`.

What begins with a dot below such a folder (.ssh, .config) is refused unless it is allowed by name.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

VARIABLE = "MAGMPM_ALLOW_OUTSIDE"
KEPT = "allowed-folders"
LEAST_PARTS = 3  # of a folder that counts as someone's own: / and /home hold what belongs to others
RULE = "a path in a file must stay below the folder above it, or the current folder"
REMEDY = "copy that file beside this one, or allow it: --allow-outside, or the variable MAGMPM_ALLOW_OUTSIDE=FOLDER"


def is_allowed(named: Path, file: Path) -> bool:
    """True if `file` may name the path `named`, which is relative to the current folder or absolute."""
    try:
        found = named.resolve()
    except (OSError, RuntimeError, ValueError):  # a circle of links, or no name at all: reading it will say so
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
        if len(folder.parts) >= LEAST_PARTS and folder != Path.home().parent:
            near.append(folder)
    return near


def _allowed_by_name() -> list[Path]:
    """Folders that the user, or who set magmpm up, has named."""
    checkout = Path(__file__).resolve().parents[2]
    found = [checkout / "data"]
    found += [Path(name).resolve() for name in os.environ.get(VARIABLE, "").split(os.pathsep) if name]
    with suppress(OSError, RuntimeError, UnicodeDecodeError):  # none are kept
        found += [Path(line) for line in _settings().read_text(encoding="utf-8").splitlines() if line.startswith(os.sep)]
    return found


def _settings() -> Path:
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "magmpm" / KEPT


def allow(folder: Path) -> None:
    """Keep a folder that the user has named on a command line as one whose files scenes may name; where nothing can be kept, do nothing."""
    kept, wanted = _settings(), str(folder.resolve())
    try:
        known = kept.read_text(encoding="utf-8").splitlines() if kept.exists() else []
        if wanted not in known and "\n" not in wanted:
            kept.parent.mkdir(parents=True, exist_ok=True)
            kept.write_text("\n".join([*known, wanted]) + "\n", encoding="utf-8")
    except (OSError, RuntimeError, UnicodeDecodeError):
        return
