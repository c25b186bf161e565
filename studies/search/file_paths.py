"""Paths in a scene's data when its file moves: they are relative to the file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from magmpm.bodies.surface_mesh import PREFIX

PATHS = frozenset({"mesh", "table", "centreline", "path"})  # keys whose text names a file


def mended(value: Any, old: Path, new: Path, key: str | int = "") -> Any:
    """The same data, with paths that were relative to the folder `old` relative to `new`."""
    if isinstance(value, Mapping):
        return {name: mended(item, old, new, name) for name, item in value.items()}
    if isinstance(value, list):
        return [mended(item, old, new) for item in value]
    if key in PATHS and isinstance(value, str) and not value.startswith(PREFIX):
        return value if Path(value).is_absolute() else from_folder(old / value, new)
    return value


def from_folder(path: Path, folder: Path) -> str:
    """A path as a file in `folder` names it."""
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
