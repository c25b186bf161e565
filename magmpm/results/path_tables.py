"""Tables of equilibria along time, `steps.csv` and `jumps.csv`, and a jump in words."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.results.readable import length, quantity

MEANING = {"limit point": "the branch turns back there (limit point)", "bifurcation": "the branch is unstable from there on (bifurcation)"}


def path_row(known: Mapping[str, Any]) -> dict[str, Any]:
    """A row of steps.csv or jumps.csv: the time first, as `t` (s), and vectors in three columns."""
    row: dict[str, Any] = {"t": known["time"]}
    for name, value in known.items():
        if isinstance(value, list):
            row |= {f"{name}_{axis}": part for axis, part in zip("xyz", value, strict=True)}
        elif name != "time":
            row[name] = "" if value is None else value
    return row


def read_rows(path: Path) -> list[dict[str, str]]:
    """The rows of such a table, as text; the last may be cut off by a kill, and is then left out. None where there is no file."""
    if not path.exists():
        return []
    text = path.read_text(encoding="utf-8")
    return list(csv.DictReader(text[: text.rfind("\n") + 1].splitlines()))


def read_steps(path: Path) -> dict[str, Array]:
    """Column of steps.csv -> (rows,), SI; NaN where a value is not known. Raises ValueError where it holds something else."""
    rows = read_rows(path)
    return {name: np.array([float(row[name] or "nan") for row in rows]) for name in (rows[0] if rows else {})}


def read_jumps(path: Path) -> list[dict[str, Any]]:
    """The rows of jumps.csv: `time` and the others as in the `jumps` of a Result. Raises ValueError where it holds something else."""
    found = []
    for row in read_rows(path):
        numbers = {name: float(value) for name, value in row.items() if name not in ("t", "kind")}
        found.append({"time": float(row["t"]), "kind": row["kind"], **numbers})
    return found


def jump_in_words(jump: Mapping[str, Any]) -> str:
    """Describe a jump in one line: time, load, kind and distance."""
    load = f"in a field of {quantity(jump['field'], 'T', 4)}"
    if jump.get("inserted") is not None:
        load += f", with {length(jump['inserted'], 4)} out of the guide"
    what = MEANING[jump["kind"]]
    return (
        f"t = {quantity(jump['time'], 's', 4)}, {load}: {what}; the body moved by {length(jump['moved'])} and lost "
        f"{quantity(jump['released'], 'J')}"
    )
