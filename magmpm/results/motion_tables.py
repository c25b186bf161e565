"""Tables that grow with a motion, a row at a time: `energies.csv` and `contacts.csv`; of parts `positions.csv`; of a path `steps.csv` and
`jumps.csv`.
"""

import csv
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array, Named, NamedNumbers, Plain
from magmpm.errors import InputError, length, quantity
from magmpm.results.whole_file import whole_file

MEANING = {
    "limit point": "the branch turns back there (limit point)",
    "bifurcation": "the branch is unstable from there on (bifurcation)",
}


def path_row(known: Named) -> Plain:
    """A row of steps.csv or jumps.csv: the time first, as `t` (s), and vectors in three columns; positions of parts have a table of their
    own."""
    row: Plain = {"t": known["time"]}
    for name, value in known.items():
        if isinstance(value, list):
            row |= {f"{name}_{axis}": part for axis, part in zip("xyz", value, strict=True)}
        elif name not in ("time", "positions"):
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
    return _columns(read_rows(path))


def _columns(rows: list[dict[str, str]]) -> dict[str, Array]:
    """Column -> (rows,), but for names of effects; NaN where a value is not given. Raises ValueError."""
    return {
        name: np.array([float(row[name] or "nan") for row in rows])
        for name in (rows[0] if rows else {})
        if name != "effect"
    }


def read_jumps(path: Path) -> list[Plain]:
    """The rows of jumps.csv: `time` and the others as in the `jumps` of a Result. Raises ValueError where it holds something else."""
    found = []
    for row in read_rows(path):
        numbers = {name: float(value) for name, value in row.items() if name not in ("t", "kind")}
        found.append({"time": float(row["t"]), "kind": row["kind"], **numbers})
    return found


def jump_in_words(jump: Named) -> str:
    """Describe a jump in one line: time, load, kind and distance."""
    load = f"in a field of {quantity(jump['field'], 'T', 4)}"
    if jump.get("inserted") is not None:
        load += f", with {length(jump['inserted'], 4)} out of the guide"
    what = MEANING[jump["kind"]]
    return (
        f"t = {quantity(jump['time'], 's', 4)}, {load}: {what}; the body moved by"
        f" {length(jump['moved'])} and lost {quantity(jump['released'], 'J')}"
    )


class GrowingTable:
    """A CSV file that grows; its first row names the columns. Numbers keep all digits."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._header: list[str] | None = None

    def add(self, row: Named) -> None:
        """Append a row; the first one writes the header too. Raises ValueError where its columns differ from those of the rows before."""
        new = not self.path.exists()
        if self._header is None and not new:
            with self.path.open(encoding="utf-8", newline="") as stream:
                self._header = next(csv.reader(stream))
        if not new and self._header != list(row):
            raise ValueError(
                f"{self.path.name} has the columns {', '.join(self._header or ())}; this frame"
                f" gives {', '.join(row)}"
            )
        self._header = list(row)
        with self.path.open("a", encoding="utf-8", newline="") as stream:
            write = csv.writer(stream, lineterminator="\n").writerow  # names may hold commas
            if new:
                write(row)
            write(map(_plain, row.values()))

    def cut(self, last: float) -> None:
        """Keep the rows up to a time (s, the first column). If none is left the file is removed, as before its first row."""
        self._header = None
        if not self.path.exists():
            return
        with _as_written(self.path):
            header, *rows = self.path.read_text(encoding="utf-8").splitlines(keepends=True) or [""]
            kept = [
                row for row in rows if row.endswith("\n") and float(row.split(",", 1)[0]) <= last
            ]
        if not kept:
            self.path.unlink()
            return
        with whole_file(self.path) as unfinished:
            unfinished.write_text("".join([header, *kept]), encoding="utf-8")


def energy_row(time: float, energies: Mapping[str, float]) -> NamedNumbers:
    """Row of energies.csv: t (s), then J: each energy, and their total."""
    return {"t": time, **energies, "total": sum(energies.values())}


def contact_row(time: float, effect: str, contact: Named) -> Plain:
    """Row of contacts.csv: t (s), effect, force on the body (N), points touching, deepest penetration (m); where given, slip (m/s),
    mean point p (m) and normal n. contact: effects.base.Contact.
    """
    vectors = [
        ("F", np.asarray(contact["force"], dtype=float)),
        *((of[0], contact.get(of, ("", "", ""))) for of in ("point", "normal")),
    ]
    force, point, normal = (
        {f"{of}{axis}": part[i] for i, axis in enumerate("xyz")} for of, part in vectors
    )
    plain = {name: contact.get(name, "") for name in ("count", "depth", "slip")}
    return {"t": time, "effect": effect, **force, **plain, **point, **normal}


def position_rows(time: float, positions: Mapping[str, Array]) -> Iterator[Plain]:
    """Rows of positions.csv: t (s), the part's name, and its center x, y, z (m)."""
    for name, place in positions.items():
        yield {"t": time, "part": name, **dict(zip("xyz", place.tolist(), strict=True))}


def read_positions(path: Path) -> dict[str, dict[str, Array]]:
    """Name of a part -> column (t, x, y, z) -> (rows,), SI. Raises InputError where the file holds something else."""
    found: dict[str, list[list[float]]] = {}
    with _as_written(path):
        for row in read_rows(path):
            found.setdefault(row["part"], []).append([float(row[column]) for column in "txyz"])
    return {name: dict(zip("txyz", np.array(rows).T, strict=True)) for name, rows in found.items()}


def read_energies(path: Path) -> dict[str, Array]:
    """Column -> (rows,). Raises InputError where the file holds something else."""
    with _as_written(path):
        rows = read_rows(path)
        return {
            name: np.array([float(row[name]) for row in rows]) for name in (rows[0] if rows else {})
        }


def read_contacts(path: Path) -> dict[str, dict[str, Array]]:
    """Effect -> column -> (rows,). Raises InputError where the file holds something else."""
    found: dict[str, dict[str, Array]] = {}
    with _as_written(path):
        rows = read_rows(path)
        for effect in dict.fromkeys(row["effect"] for row in rows):
            found[effect] = _columns([row for row in rows if row["effect"] == effect])
    return found


def must_have(path: Path, found: Mapping[str, Array], times: Array, *, lacking: int = 0) -> None:
    """Raises InputError unless a table, column -> (rows,), has a row for each of the frames at times (s).

    lacking: rows that may be missing at the end: a frame's row follows the frame.
    """
    rows = found.get("t", np.zeros(0))[: len(times)]
    if len(rows) < len(times) - lacking or not np.array_equal(rows, times[: len(rows)]):
        received = (
            f"{len(rows)} rows that do not match the {len(times)} frames beside it: each frame has"
            " its own row, at its time"
        )
        raise _damaged(path, received)


def _damaged(path: Path, received: str) -> InputError:
    rule = "must be the table that the run wrote, whole"
    return InputError(
        str(path),
        received=received,
        rule=rule,
        remedy="put it back, or run the scene again, without --resume",
    )


@contextmanager
def _as_written(path: Path) -> Iterator[None]:
    """Turns the errors of a table that can't be read into an InputError."""
    try:
        yield
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise _damaged(path, f"what can't be read as one ({error})") from None


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
