"""Functions shared by several commands: where results go, and how answers are printed."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from magmpm.errors import InputError
from magmpm.results.folder_lock import folder_lock

SURFACE, PARTICLES = STYLES = ("surface", "particles")  # what a body at rest is drawn by


def results_folder(name: str) -> Path:
    """runs/NAME for a scene or study of that name."""
    return Path("runs") / name.replace(" ", "-")


@contextmanager
def folder_of_results(options: argparse.Namespace, name: str) -> Iterator[Path]:
    """Hold the folder that a command's results go to: --out, or runs/NAME. Raises InputError where it belongs to a study, or is in use."""
    folder = options.out or results_folder(name)
    with folder_lock(folder):
        if is_study(folder):
            rule = "a study has a folder of its own: a run's result would mix with its designs"
            raise InputError(f"{folder}: holds a study", rule=rule, remedy="use another --out")
        yield folder


def is_study(folder: Path) -> bool:
    """True if a folder holds a study, or the files of one that ended before its first report."""
    from magmpm.studies.problem import DATABASE, OWNER, REPORT

    return any((folder / name).exists() for name in (REPORT, OWNER, DATABASE))


def print_summary(options: argparse.Namespace, summary: dict[str, Any], text: str) -> None:
    """The one JSON object, or the text for people."""
    print(json.dumps(summary) if options.json else text)
