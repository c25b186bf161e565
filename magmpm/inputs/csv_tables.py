"""CSV tables: their lines and errors; tables of centerlines, columns s_mm, x_mm, y_mm, z_mm (targets, references, measured shapes)."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, ValidationInfo

from magmpm.errors import InputError, report, show
from magmpm.inputs.settings import fault, from_file, named_file
from magmpm.inputs.user_files import UnfitFile, read_regular

COLUMNS = ("s_mm", "x_mm", "y_mm", "z_mm")
MAX_ROWS = 100_000


class TableError(InputError):
    """A table that cannot be used: where and what in it, the rule, the remedy, for messages to quote."""

    def __init__(self, place: str, *, rule: str, remedy: str, received: str | None = None) -> None:
        super().__init__(report(place, received=received, rule=rule, remedy=remedy))
        self.place = place if received is None else f"{place} has {received}"
        self.rule = rule
        self.remedy = remedy


@contextmanager
def table_faults() -> Iterator[None]:
    """Turns the TableError of a table that a setting names into that setting's PydanticCustomError (see `fault`)."""
    try:
        yield
    except TableError as error:
        raise fault(f"{error.rule} ({error.place})", error.remedy) from None


def named_table(read: Callable[[Path], Any], example: str | None) -> BeforeValidator:
    """Validator of a key that names a table: what `read` makes of it. Python's are taken as they are; in files too where no example."""

    def table_of(value: Any, info: ValidationInfo) -> Any:
        if not isinstance(value, (str, Path)):
            if example is not None and from_file(info):
                raise fault("must be the path of a CSV table", f"write, say, `{example}`")
            return value
        with table_faults():
            return read(named_file(info, value))

    return BeforeValidator(table_of)


@dataclass(frozen=True)
class CsvLine:
    """A line of a table that holds cells: its place for messages, and its text."""

    place: str
    text: str
    separator: str = ","

    @property
    def cells(self) -> list[str]:
        return [cell.strip() for cell in self.text.split(self.separator)]

    def numbers(self, count: int) -> list[float]:
        """The numbers of the cells, finite or not; none unless there are `count` of them."""
        try:
            row = [self.number(cell) for cell in self.cells]
        except ValueError:
            return []
        return row if len(row) == count else []

    def number(self, cell: str) -> float:
        """A cell's number; where commas do not separate cells, they are decimal points. Raises ValueError."""
        return float(cell if self.separator == "," else cell.replace(",", "."))

    def error(self, rule: str, remedy: str, received: str | None = None) -> TableError:
        """Error to raise where the line, or the value received in it, breaks a rule."""
        return TableError(
            self.place,
            received=show(self.text.strip()) if received is None else received,
            rule=rule,
            remedy=remedy,
        )


def table_lines(path: Path, start: str) -> Iterator[CsvLine]:
    """Lines of a table from its header on, without blank lines and those that begin with #; `start` says how a table begins, for messages.

    Cells are separated as the header separates its names: by commas, semicolons or tabs. Raises TableError where it can't be read.
    """
    # of the largest table there is, a map of half a million points with all digits
    most_table_bytes = 200_000_000
    rule = "the table must be a readable text file"
    remedy = "check the path and its permissions"
    try:
        lines = read_regular(path, most_table_bytes).decode("utf-8-sig").splitlines()
    except FileNotFoundError:
        reason = "no such file"
        remedy = "check the path; it is relative to the file that names it"
    except UnicodeDecodeError:
        reason = "not a text file"
        remedy = start
    except UnfitFile as error:
        reason = str(error.strerror)
        rule = f"the table must be a regular file of at most {most_table_bytes // 1_000_000} MB"
        remedy = start
    except (OSError, ValueError) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
    else:
        separator = ""
        for number, text in enumerate(lines, start=1):
            if text.strip() and not text.lstrip().startswith("#"):
                separator = separator or next((one for one in (",", ";", "\t") if one in text), ",")
                yield CsvLine(f"{path}:{number}", text, separator)
        return
    raise TableError(f"{path}: {reason}", rule=rule, remedy=remedy)


def read_centreline(path: Path | str) -> NDArray[np.float64]:
    """Rows [s, x, y, z] in m, (m, 4), m >= 2, s increasing: arc length of the undeformed body, its point.

    The file: a header with the four column names in any order, then numbers in mm; blank lines and lines that begin with # are skipped.
    Raises TableError, which names file, line, value received, rule and remedy.
    """
    lines = table_lines(Path(path), _START)
    rows = list[list[float]]()
    for header in lines:
        if sorted(header.cells) != sorted(COLUMNS):
            raise header.error(f"the header must name the columns {','.join(COLUMNS)}", _START)
        order = [header.cells.index(column) for column in COLUMNS]
        for line in lines:
            row = _row(line, order)
            if rows and row[0] <= rows[-1][0]:
                raise line.error(
                    "s_mm must increase from row to row",
                    "sort the rows, base first, each s_mm once",
                )
            rows.append(row)
    if not 2 <= len(rows) <= MAX_ROWS:
        raise TableError(
            str(path),
            received=f"{len(rows)} row{'s' * (len(rows) != 1)}",
            rule=f"a centreline has 2 to {MAX_ROWS} rows",
            remedy=_START,
        )
    return np.asarray(rows) / 1000.0


_START = f"begin the file with the line {','.join(COLUMNS)}, then numbers in mm, such as 0,0,0,0"


def _row(line: CsvLine, order: list[int]) -> list[float]:
    """The numbers of one row in the order of COLUMNS, mm. Raises TableError."""
    max_mm = 10_000.0  # 10 m: a larger coordinate is a unit mistaken
    numbers = line.numbers(len(COLUMNS))
    if not numbers:
        raise line.error(f"a row must have {len(COLUMNS)} numbers, in mm", "check this row")
    row = [numbers[column] for column in order]
    if not all(math.isfinite(value) and abs(value) <= max_mm for value in row):
        raise line.error(f"numbers must be finite and at most {max_mm:g} mm", "check this row")
    if row[0] < 0:
        raise line.error("s_mm must not be negative", "measure s from the clamped base")
    return row


def write_centreline(path: Path | str, rows: NDArray[np.float64], *, comment: str = "") -> None:
    """Writes rows [s, x, y, z] in m, (m, 4), as a table that `read_centreline` reads; comment lines first."""
    lines = [f"# {line}" for line in comment.splitlines()]
    lines.append(",".join(COLUMNS))
    lines += [
        ",".join(f"{1000.0 * value:.6f}" for value in row) for row in np.asarray(rows, dtype=float)
    ]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")
