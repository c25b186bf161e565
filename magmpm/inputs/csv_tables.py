"""Centreline tables: CSV files with columns s_mm, x_mm, y_mm, z_mm (targets, references, measured shapes)."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from magmpm.errors import InputError, report, show
from magmpm.inputs.regular_file import UnfitFile, read_regular

COLUMNS = ("s_mm", "x_mm", "y_mm", "z_mm")
MAX_ROWS = 100_000
MAX_BYTES = 200_000_000  # of the largest table there is, a map of half a million points with all digits
MAX_MM = 10_000.0  # 10 m: a larger coordinate is a unit mistaken


class TableError(InputError):
    """A table that cannot be used: where and what in it, the rule, the remedy, for messages to quote."""

    def __init__(self, place: str, *, rule: str, remedy: str, received: str | None = None) -> None:
        super().__init__(report(place, received=received, rule=rule, remedy=remedy))
        self.place = place if received is None else f"{place} has {received}"
        self.rule = rule
        self.remedy = remedy


def read_centreline(path: Path | str) -> NDArray[np.float64]:
    """Rows [s, x, y, z] in m, (m, 4), m >= 2, s increasing: arc length of the undeformed body, its point.

    The file: a header with the four column names in any order, then numbers in mm; blank lines and lines that
    begin with # are passed over. Raises TableError naming file, line, value received, rule and remedy.
    """
    path = Path(path)
    order: list[int] | None = None
    rows: list[list[float]] = []
    for number, line in enumerate(read_lines(path, _START), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = [cell.strip() for cell in line.split(",")]
        place, received = f"{path}:{number}", show(line.strip())
        if order is None:
            if sorted(cells) != sorted(COLUMNS):
                rule = f"the header must name the columns {','.join(COLUMNS)}"
                raise TableError(place, received=received, rule=rule, remedy=_START)
            order = [cells.index(column) for column in COLUMNS]
            continue
        row = _row(cells, order, place, received)
        if rows and row[0] <= rows[-1][0]:
            rule, remedy = "s_mm must increase from row to row", "sort the rows, base first, each s_mm once"
            raise TableError(place, received=received, rule=rule, remedy=remedy)
        rows.append(row)
    if not 2 <= len(rows) <= MAX_ROWS:
        rule = f"a centreline has 2 to {MAX_ROWS} rows"
        raise TableError(
            str(path), received=f"{len(rows)} row{'s' * (len(rows) != 1)}", rule=rule, remedy=_START
        )
    return np.asarray(rows) / 1000.0


_START = f"begin the file with the line {','.join(COLUMNS)}, then numbers in mm, such as 0,0,0,0"


def _row(cells: list[str], order: list[int], place: str, received: str) -> list[float]:
    """The numbers of one row in the order of COLUMNS, mm. Raises TableError."""
    remedy = "check this row"
    try:
        row = [float(cells[column]) for column in order] if len(cells) == len(COLUMNS) else []
    except ValueError:
        row = []
    if not row:
        rule = f"a row must have {len(COLUMNS)} numbers, in mm"
    elif not all(math.isfinite(value) and abs(value) <= MAX_MM for value in row):
        rule = f"numbers must be finite and at most {MAX_MM:g} mm"
    elif row[0] < 0:
        rule, remedy = "s_mm must not be negative", "measure s from the clamped base"
    else:
        return row
    raise TableError(place, received=received, rule=rule, remedy=remedy)


def read_lines(path: Path, start: str) -> list[str]:
    """Lines of a text file; `start` says how one begins, for messages. Raises TableError."""
    rule, remedy = "the table must be a readable text file", "check the path and its permissions"
    try:
        return read_regular(path, MAX_BYTES).decode("utf-8-sig").splitlines()
    except FileNotFoundError:
        reason, remedy = "no such file", "check the path; it is relative to the file that names it"
    except UnicodeDecodeError:
        reason, remedy = "not a text file", start
    except UnfitFile as error:
        reason, rule, remedy = str(error.strerror), f"the table must be a regular file of at most {MAX_BYTES // 1_000_000} MB", start
    except (OSError, ValueError) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
    raise TableError(f"{path}: {reason}", rule=rule, remedy=remedy)


def write_centreline(path: Path | str, rows: NDArray[np.float64], *, comment: str = "") -> None:
    """Writes rows [s, x, y, z] in m, (m, 4), as a table that `read_centreline` reads; comment lines first."""
    lines = [f"# {line}" for line in comment.splitlines()]
    lines.append(",".join(COLUMNS))
    lines += [",".join(f"{1000.0 * value:.6f}" for value in row) for row in np.asarray(rows, dtype=float)]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")
