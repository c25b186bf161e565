"""Centreline tables: CSV files with columns s_mm, x_mm, y_mm, z_mm (targets, references, measured shapes)."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from magmpm.errors import InputError

COLUMNS = ("s_mm", "x_mm", "y_mm", "z_mm")
MAX_ROWS = 100_000
MAX_MM = 10_000.0  # 10 m: a larger coordinate is a unit mistaken


def read_centreline(path: Path | str) -> NDArray[np.float64]:
    """Rows [s, x, y, z] in m, (m, 4), m >= 2, s increasing: arc length along the undeformed body, and the point there.

    The file: a header with the four column names in any order, then numbers in mm; blank lines and lines that begin
    with # are passed over. Raises InputError naming file, line, value and rule.
    """
    path = Path(path)
    order: list[int] | None = None
    rows: list[list[float]] = []
    for number, line in enumerate(_lines(path), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = [cell.strip() for cell in next(csv.reader([line]))]
        place = f"{path}:{number}: received {line.strip()[:60]!r}"
        if order is None:
            if sorted(cells) != sorted(COLUMNS):
                raise InputError(
                    f"{place}\n  rule: the header must name the columns {','.join(COLUMNS)}\n  {_REMEDY}"
                )
            order = [cells.index(column) for column in COLUMNS]
            continue
        row = _row(cells, place, order)
        if rows and row[0] <= rows[-1][0]:
            raise InputError(
                f"{place}\n  rule: s_mm must increase from row to row\n  remedy: sort the rows, base first"
            )
        rows.append(row)
    if len(rows) < 2:
        raise InputError(
            f"{path}: received {len(rows)} rows\n  rule: a centreline has at least 2 rows\n  {_REMEDY}"
        )
    if len(rows) > MAX_ROWS:
        raise InputError(
            f"{path}: received {len(rows)} rows\n  rule: a centreline has at most {MAX_ROWS} rows\n  remedy: thin it out"
        )
    return np.asarray(rows) / 1000.0


_REMEDY = f"remedy: begin the file with the line {','.join(COLUMNS)}, then numbers in mm, such as 0,0,0,0"


def _row(cells: list[str], place: str, order: list[int]) -> list[float]:
    if len(cells) != len(COLUMNS):
        raise InputError(
            f"{place}\n  rule: a row has {len(COLUMNS)} numbers, as many as the header\n  {_REMEDY}"
        )
    try:
        row = [float(cells[column]) for column in order]
    except ValueError:
        raise InputError(f"{place}\n  rule: a row holds numbers only, in mm\n  {_REMEDY}") from None
    if not all(math.isfinite(value) and abs(value) <= MAX_MM for value in row):
        rule = f"numbers must be finite and at most {MAX_MM:g} mm"
        raise InputError(f"{place}\n  rule: {rule}\n  remedy: check this row")
    if row[0] < 0:
        raise InputError(
            f"{place}\n  rule: s_mm must not be negative\n  remedy: measure s from the clamped base"
        )
    return row


def _lines(path: Path) -> list[str]:
    try:
        return path.read_bytes().decode("utf-8-sig").splitlines()
    except FileNotFoundError:
        raise InputError(
            f"{path}: no such file\n  remedy: check the path (relative to the file naming it)"
        ) from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file\n  {_REMEDY}") from None
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: cannot be read ({error})\n  remedy: check the path and its permissions"
        ) from None


def write_centreline(path: Path | str, rows: NDArray[np.float64], *, comment: str = "") -> None:
    """Writes rows [s, x, y, z] in m, (m, 4), as a table that `read_centreline` reads; comment lines come first."""
    lines = [f"# {line}" for line in comment.splitlines()]
    lines.append(",".join(COLUMNS))
    lines += [",".join(f"{1000.0 * value:.6f}" for value in row) for row in np.asarray(rows, dtype=float)]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")
