"""Tables of measurements as people have them: tips against the field, marked points, markers over time, curves digitized from photos.

A header names what is measured and its unit, `tip_x_mm`; a row is one reading; an empty cell was not measured. What the columns are decides
what the table is: see docs/fitting.md. Everything is read into SI.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from magmpm.compiled.arrays import Array, Index, NamedNumbers
from magmpm.errors import InputError
from magmpm.inputs.csv_tables import MAX_ROWS, CsvLine, TableError, table_lines
from magmpm.inputs.quantities import KINDS, divided, kind_of
from magmpm.inputs.vectors import Vector
from magmpm.scene import Scene
from magmpm.scene.addresses import Place, places, value_at, written
from magmpm.scene.apparatus import (
    APPARATUS,
    OWN,
    WORDS,
    Apparatus,
    apparatus_of,
    check_apparatus,
)

AXES = "xyz"
_UNITS = {
    "length": ("mm", "m", "cm", "um", "in"),
    "flux density": ("mT", "T", "uT", "G"),
    "time": ("ms", "s"),
    "angle": ("deg", "rad"),
    "current": ("A", "mA"),
    "number": ("",),
}
ANGLES = {
    "tip_angle": None,
    "tip_angle_xy": 1,
    "tip_angle_xz": 2,
}  # columns of the tip's angle; signed, in the plane of x and this axis
_QUANTITIES = {
    **{f"field_{a}": "flux density" for a in AXES},
    "field": "flux density",
    "t": "time",
    "s": "length",
    **{f"tip_{a}": "length" for a in AXES},
    **dict.fromkeys(ANGLES, "angle"),
    **dict.fromkeys(AXES, "length"),
    **APPARATUS,
}
LABELS = (
    "marker",
    "note",
    "series",
    "repeat",
)  # columns for the reader and for what is held out, of any text
MOST = {
    "length": 10.0,
    "flux density": 20.0,
    "time": 1e4,
    "angle": math.pi,
    "current": 1e6,
    "number": 1e6,
}  # SI: else a unit is mistaken
_START = (
    "begin the file with the names of its columns, say field_z_mT,tip_x_mm,tip_z_mm, then rows of"
    " numbers"
)


# field (3,) T (None: the scene's own), time s (None: an equilibrium), and the apparatus
_State = tuple[Vector | None, float | None, Apparatus]


@dataclass(frozen=True)
class Readings:
    """The rows of one state of the body: one field, or one moment.

    Attributes
    ----------
    field : tuple of float (3,), T, or None
        The uniform field; None: the scene's own.
    time : float, s, or None
        The moment; None of an equilibrium.
    lines : array (m,) of int
        Of the file.
    s : array (m,), m
        Arc lengths; NaN at the tip and along a curve.
    points : array (m, 3), m
        What was measured; NaN where it was not.
    angles : array (m,), rad
        Of the tip's tangent to the base's axis, +x; NaN where not measured.
    kind : {'tips', 'places', 'curve'}
        Of the table.
    axes : tuple of int
        Coordinates that its points have.
    table : int
        Which of several it is of.
    apparatus : Apparatus
        Magnet, currents and inserted length.
    plane : int or None
        The axis that has the plane with x in which the angles have a sign.
    """

    field: Vector | None
    time: float | None
    lines: Index
    s: Array
    points: Array
    angles: Array
    kind: str = "tips"
    axes: tuple[int, ...] = (0, 1, 2)
    table: int = 0
    apparatus: Apparatus = OWN
    plane: int | None = None

    @property
    def numbers(self) -> int:
        """Count of the numbers measured: of a curve those across it, one in a plane and two in space."""
        if self.kind == "curve":
            return (len(self.axes) - 1) * len(self.lines)
        return int(np.isfinite(self.points).sum() + np.isfinite(self.angles).sum())


@dataclass(frozen=True)
class Measurements:
    """A table, or several of the same body.

    Attributes
    ----------
    path : Path
        Of the file.
    kind : {'tips', 'places', 'curve', 'several'}
        Whether its points are tips, places (marked by s) or a curve without them.
    states : tuple of Readings
        Its rows, by state.
    columns : tuple of str
        Names of its columns.
    axes : tuple of int
        Coordinates that the points have.
    tables : tuple of Measurements
        Where there are several, each of them.
    """

    path: Path
    kind: str  # tips | places | curve | several
    states: tuple[Readings, ...]
    columns: tuple[str, ...]
    axes: tuple[int, ...] = field(default=())  # coordinates that the points have
    tables: tuple[Measurements, ...] = ()  # where there are several

    @property
    def each(self) -> tuple[Measurements, ...]:
        """The tables one by one."""
        return self.tables or (self,)

    @property
    def named(self) -> str:
        """Its file, or its files."""
        return ", ".join(str(one.path) for one in self.each)

    @property
    def numbers(self) -> int:
        """Count of the numbers measured."""
        return sum(state.numbers for state in self.states)

    @property
    def in_time(self) -> bool:
        return self.states[0].time is not None

    @property
    def has_angles(self) -> bool:
        return any(bool(np.isfinite(state.angles).any()) for state in self.states)

    @property
    def angles_alone(self) -> bool:
        return not any(bool(np.isfinite(state.points).any()) for state in self.states)


@dataclass(frozen=True)
class _Column:
    """A column: its title, what it holds, its unit in SI, and the kind of that; a label has no quantity."""

    title: str
    quantity: str
    factor: float
    kind: str = ""
    place: Place = ()  # of a number by its address


def read_tables(paths: Sequence[Path | str], scene: Scene) -> Measurements:
    """Read the measurements in files, for a scene, to be explained together.

    Parameters
    ----------
    paths : sequence of Path or str
        The files.
    scene : Scene
        The scene.

    Returns
    -------
    Measurements
        The measurements.

    Raises
    ------
    TableError
        As read_measured.
    """
    known: dict[Path, Path | str] = {}
    for path in paths:
        if known.setdefault(Path(path).resolve(), path) is not path:
            raise TableError(
                str(path),
                received="the same file twice",
                rule="each reading counts once",
                remedy="name each table once",
            )
    return together([read_measured(path, scene) for path in paths])


def together(tables: Sequence[Measurements]) -> Measurements:
    """Join several tables of the same body.

    Parameters
    ----------
    tables : sequence of Measurements
        The tables.

    Returns
    -------
    Measurements
        All of them; of one table itself.
    """
    if len(tables) == 1:
        return tables[0]
    own = tuple(
        replace(one, states=tuple(replace(state, table=k) for state in one.states))
        for k, one in enumerate(tables)
    )
    return Measurements(
        own[0].path, "several", tuple(state for one in own for state in one.states), (), (), own
    )


def read_split(
    paths: Sequence[Path | str], scene: Scene, hold_out: str | None
) -> tuple[Measurements, Measurements | None]:
    """The measurements in files, and those that are held out of them.

    Parameters
    ----------
    paths : sequence of paths
        Tables of the same body.
    scene : Scene
        What the tables are of.
    hold_out : str or None
        "COLUMN=VALUE,VALUE,COLUMN=VALUE": rows whose cell in one of the columns is one of its values are held out.
        None: no row is.

    Returns
    -------
    known, left : Measurements, Measurements or None
        The rows to fit, and those held out.

    Raises
    ------
    TableError
        A column is not in the tables, a value stands in none of its rows, or no row is left to fit.
    """
    whole = read_tables(paths, scene)
    if hold_out is None:
        return whole, None
    titles = list(dict.fromkeys(title for table in whole.each for title in table.columns))
    chosen = _held_out(hold_out, titles)
    met: set[tuple[str, str]] = set()
    cells: dict[str, set[str]] = {column: set() for column, _ in chosen}

    def held(row: dict[str, str]) -> bool:
        for column in cells.keys() & row.keys():
            cells[column].add(row[column])
        matches = {pair for pair in chosen if pair[0] in row and _same_cell(row[pair[0]], pair[1])}
        met.update(matches)
        return bool(matches)

    left = [table for table in (read_measured(path, scene, held) for path in paths) if table.states]
    for column, value in chosen:
        if (column, value) not in met:
            raise TableError(
                "--hold-out",
                received=repr(hold_out),
                rule=f"each value must appear in its column: no row has {column} = {value!r}",
                remedy=f"{column} is one of {', '.join(sorted(cells[column])[:12])}",
            )
    known = [
        table
        for table in (read_measured(path, scene, lambda row: not held(row)) for path in paths)
        if table.states
    ]
    if not known:
        raise TableError(
            "--hold-out",
            received=repr(hold_out),
            rule="some rows must remain for the fit, and these are all",
            remedy="hold out fewer values",
        )
    return together(known), together(left)


def _held_out(text: str, titles: Sequence[str]) -> list[tuple[str, str]]:
    """Pairs of a column and a value in "COLUMN=VALUE,VALUE,COLUMN=VALUE". Raises TableError.

    A part that begins with the name of a column begins that column; every other one, such as "phi=90", is a value of the column before it.
    """
    chosen: list[tuple[str, str]] = []
    column = ""
    for part in text.split(","):
        before, sign, after = (word.strip() for word in part.partition("="))
        begins = bool(sign) and before in titles
        if begins:
            column = before
        value = after if begins else part.strip()
        if not column or not value:
            rule = (
                "rows are held out by what their cells hold: COLUMN=VALUE, more values or columns"
                " after commas"
            )
            raise TableError(
                "--hold-out",
                received=repr(text),
                rule=rule,
                remedy=f"the columns are {', '.join(titles)}",
            )
        chosen.append((column, value))
    return chosen


def _same_cell(cell: str, value: str) -> bool:
    """Tell whether a cell holds a value: the same text, or the same number however written."""
    return cell == value or bool(_as_number(cell) & _as_number(value))


def _as_number(cell: str) -> set[float]:
    """The number in a cell, if it holds one."""
    try:
        return {float(cell)}
    except ValueError:
        return set()


def read_measured(
    path: Path | str, scene: Scene, keep: Callable[[dict[str, str]], bool] | None = None
) -> Measurements:
    """Read the measurements in a file, for a scene.

    Parameters
    ----------
    path : Path or str
        The file.
    scene : Scene
        The scene.
    keep : callable, optional
        Tells of a row, by its cells, whether it is read. Where none is, the answer has no
        states.

    Returns
    -------
    Measurements
        The measurements.

    Raises
    ------
    TableError
        Names file, row, column, value, rule and remedy.
    """
    path = Path(path)
    lines = table_lines(path, _START)
    header = next(lines, None)
    if header is None:
        raise TableError(
            str(path), received="no rows", rule="a table has a header and rows", remedy=_START
        )
    columns = _columns(header, scene)
    placed = {column.quantity: column.place for column in columns if column.place}
    kind = _kind(header, columns)
    named = {column.quantity for column in columns if column.quantity}
    _fit_together(header, named, scene, kind)
    grouped: dict[_State, list[tuple[int, NamedNumbers]]] = {}
    for count, line in enumerate(lines):
        if count >= MAX_ROWS:
            raise TableError(
                str(path),
                rule=f"a table has at most {MAX_ROWS} rows",
                remedy="leave out rows: a fit needs a few hundred",
            )
        values = _row(line, columns, named, kind, scene)
        if keep is not None and not keep(dict(zip(header.cells, line.cells, strict=True))):
            continue
        state = _field_of(values, scene), values.get("t"), apparatus_of(line, values, placed, scene)
        grouped.setdefault(state, []).append((int(line.place.rsplit(":", 1)[1]), values))
    if not grouped and keep is None:
        raise TableError(
            str(path),
            received="a header alone",
            rule="a table has a header and rows",
            remedy=_START,
        )
    prefix = "tip_" if kind == "tips" else ""
    axes = tuple(i for i, a in enumerate(AXES) if f"{prefix}{a}" in named)
    states = tuple(
        replace(_readings(state, rows, prefix), kind=kind, axes=axes)
        for state, rows in grouped.items()
    )
    return Measurements(path, kind, states, tuple(column.title for column in columns), axes)


def _readings(state: _State, rows: list[tuple[int, NamedNumbers]], prefix: str) -> Readings:
    """The rows of one state."""

    def column(name: str) -> Array:
        return np.array([values.get(name, math.nan) for _, values in rows])

    lines = np.array([line for line, _ in rows])
    points = np.stack([column(f"{prefix}{a}") for a in AXES], axis=1)
    angle = next(
        (name for name in ANGLES if any(name in values for _, values in rows)), "tip_angle"
    )
    s = column("s")
    field, time, apparatus = state
    plane = ANGLES[angle]
    return Readings(field, time, lines, s, points, column(angle), apparatus=apparatus, plane=plane)


def _columns(header: CsvLine, scene: Scene) -> list[_Column]:
    """Columns named by the header. Raises TableError."""
    found: list[_Column] = []
    for title in header.cells:
        column = _addressed(header, title, scene) if "." in title else _named(header, title)
        if column.quantity and column.quantity in (other.quantity for other in found):
            raise header.error(
                f"each column may appear once, and {column.quantity} appears twice",
                "remove one of the two",
                title,
            )
        found.append(column)
    return found


def _named(header: CsvLine, title: str) -> _Column:
    """The column of a word. Raises TableError."""
    if title in LABELS:
        return _Column(title, "", 1.0)
    quantity, _, unit = (
        (title, "", "") if _QUANTITIES.get(title) == "number" else title.rpartition("_")
    )
    kind = _QUANTITIES.get(quantity)
    if kind is None or unit not in _UNITS[kind]:
        raise _unknown(header, title)
    return _Column(title, quantity, float(KINDS[kind].plain[unit]) if unit else 1.0, kind)


def _addressed(header: CsvLine, title: str, scene: Scene) -> _Column:
    """The column of a number by its address, "field.uniform[2] (mT)": that of its word, or one of its own. Raises TableError."""
    address, _, unit = title.removesuffix(")").partition(" (")
    try:
        place, *more = places(scene, address)
    except InputError as error:
        rule, remedy = (line.partition(": ")[2] for line in str(error).splitlines()[1:])
        raise header.error(rule, remedy, f'the column "{title}"') from None
    said = divided(value_at(scene, place, units=True))
    if more or said is None:
        raise header.error(
            "a column is the address of one number",
            'write, say, "field.uniform[2] (mT)"',
            f'the column "{title}"',
        )
    own = said[1]
    kind = kind_of(own) or "number"
    known = KINDS[kind].plain if kind in KINDS else {"": 1}
    if unit not in known:
        raise header.error(
            f"the number's unit stands behind it, one of {', '.join(known)}",
            f'write, say, "{address} ({own})"' if own else f'write "{address}"',
            f'the column "{title}"',
        )
    word = WORDS.get(place)
    factor = float(known[unit])
    if word is not None:
        return _Column(title, word, factor, kind)
    return _Column(title, written(place), factor, kind, place)


def _unknown(header: CsvLine, title: str) -> TableError:
    """The error for a column that is not known: the nearest name, or all of them."""
    known = [f"{name}_{unit}" for name, kind in _QUANTITIES.items() for unit in _UNITS[kind]]
    rule = (
        "a column is a quantity with its unit: "
        + ", ".join(f"{name}_{_UNITS[kind][0]}" for name, kind in _QUANTITIES.items())
        + f" (also in {', '.join(sorted({u for kind in _UNITS.values() for u in kind[1:]}))}), or"
        f" {' or '.join(LABELS)}"
    )
    if title in _QUANTITIES:
        return header.error(
            rule,
            f'add the unit: "{title}_{_UNITS[_QUANTITIES[title]][0]}"',
            f'the column "{title}"',
        )
    usual = [f"{name}_{_UNITS[kind][0]}" for name, kind in _QUANTITIES.items()]
    near = difflib.get_close_matches(title, usual, n=1, cutoff=0.7) or difflib.get_close_matches(
        title, known, n=1, cutoff=0.7
    )
    return header.error(
        rule,
        f'did you mean "{near[0]}"?' if near else "rename or remove the column",
        f'the column "{title}"',
    )


def _kind(header: CsvLine, columns: list[_Column]) -> str:
    """Tips, places or a curve. Raises TableError where the columns are none of them, or of two."""
    named = {column.quantity for column in columns}
    tips = {name for name in named if name.startswith("tip_")}
    points = named & set(AXES)
    if tips and (points or "s" in named):
        raise header.error(
            "a table holds tips (tip_x_mm ...) or points (x_mm ...), not both",
            "make two tables of it, or give each tip its s_mm",
        )
    if tips:
        return "tips"
    if "s" in named and points:
        return "places"
    if len(points) >= 2 and "t" not in named:
        return "curve"
    rule = (
        "something must be measured: tip_x_mm ..., points x_mm ... at s_mm, or a curve in a plane,"
        " two of x_mm, y_mm, z_mm"
    )
    if points and "t" in named:
        raise header.error(
            "points over time need the arc length s_mm of each marker",
            "add the column s_mm: from the clamped base",
        )
    raise header.error(rule, _START)


def _fit_together(header: CsvLine, named: set[str], scene: Scene, kind: str) -> None:
    """Raises TableError where the columns do not suit each other, or the scene."""
    fields = named & {"field", *(f"field_{a}" for a in AXES)}
    angles = named & set(ANGLES)
    parts = scene.body.parts
    axis = scene.body.shape.line is not None
    apart = (
        (
            "field" in fields and len(fields) > 1,
            "the field is given by its strength (field_mT) or by components",
            "remove field_mT, or the components",
        ),
        (
            fields and not scene.effects.in_a_field,
            "the scene names no effect of the field",
            "name one in the scene, `magnetic_torque: {}`, or remove the columns",
        ),
        (
            "field" in fields and not any(scene.field.uniform),
            "field_mT is along the scene's uniform field, and it has none",
            "write field_x_mT, field_y_mT, field_z_mT instead",
        ),
        (
            "t" in named and not scene.in_time,
            "the scene is an equilibrium, which has no time",
            "write `solver: {dynamic: {duration: ...}}` in the scene, or remove t",
        ),
        (
            scene.in_time and "t" not in named,
            "the scene runs along time, so the table must say when",
            "add the column t_ms, or make the scene an equilibrium: `solver: {static: {}}`",
        ),
        (
            fields and scene.in_time,
            "in runs along time the scene sets the field",
            "write the field's schedule in the scene, and remove the columns",
        ),
        (
            len(angles) > 1,
            "a row has one angle of the tip",
            "remove the others, or make two tables of it",
        ),
        (
            kind == "tips" and parts is not None and parts.tip is None,
            "parts have no tip unless the scene names one",
            "name a part or a point, say `tip: arm` in body.parts",
        ),
        (
            kind != "tips" and not axis,
            f"a body of {scene.body.kind} has no axis to mark points on",
            "measure its tip: tip_x_mm ...",
        ),
        (
            angles and not axis,
            f"a body of {scene.body.kind} has no axis, so its tip has no angle",
            "measure the tip's place: tip_x_mm ...",
        ),
    )
    for broken, rule, remedy in apart:
        if broken:
            raise header.error(rule, remedy)
    check_apparatus(header, named, scene)


def _row(
    line: CsvLine, columns: list[_Column], named: set[str], kind: str, scene: Scene
) -> NamedNumbers:
    """The numbers of a row in SI; cells that are empty are left out. Raises TableError."""
    cells = line.cells
    if len(cells) != len(columns):
        raise line.error(
            f"a row must have {len(columns)} cells, as the header has",
            "check this row; leave a cell empty where nothing was measured",
            f"{len(cells)} cells",
        )
    values: NamedNumbers = {}
    for column, text in zip(columns, cells, strict=True):
        if not column.quantity or not text:
            continue
        values[column.quantity] = _number(line, column, text)
    for quantity in (
        "s",
        "t",
        *(name for name in named if name.startswith("field") or name in APPARATUS or "." in name),
    ):
        if quantity in named and quantity not in values:
            title = next(column.title for column in columns if column.quantity == quantity)
            raise line.error(
                f"{title} identifies a reading; it can't be empty",
                "fill it in, or remove the row",
                f"{title} empty",
            )
    measured = [name for name in values if name in AXES or name.startswith("tip_")]
    if not measured or (kind == "curve" and len(measured) < len(named & set(AXES))):
        raise line.error(
            (
                "a row must hold a measured number"
                if kind != "curve"
                else "a point needs all its coordinates"
            ),
            "remove the row",
        )
    _within(line, values, scene)
    return values


def _number(line: CsvLine, column: _Column, text: str) -> float:
    """A cell's number in SI. Raises TableError."""
    try:
        value = line.number(text) * column.factor if "_" not in text else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise line.error(
            f"{column.title} must be a finite number",
            "correct it, or leave the cell empty",
            f'"{text[:40]}" in {column.title}',
        )
    most = MOST.get(column.kind, math.inf)
    if abs(value) > most * (1 + 1e-12):
        most /= column.factor
        raise line.error(
            f"{column.title} must be at most {most:g}",
            "check the number, and the unit in the header",
            f"{text[:40]} in {column.title}",
        )
    return value


def _within(line: CsvLine, values: NamedNumbers, scene: Scene) -> None:
    """Raises TableError for places off the body, and moments that the scene does not reach."""
    s = values.get("s")
    t = values.get("t")
    if s is not None and not 0 <= s <= scene.length * (1 + 1e-6):
        rule = (
            f"s must lie on the body: 0 to {1e3 * scene.length:g} mm, from the clamped base along"
            " the undeformed axis"
        )
        raise line.error(
            rule, "check the number, its unit, and the length in the scene", f"s = {1e3 * s:g} mm"
        )
    if t is not None and not 0 <= t <= scene.duration * (1 + 1e-9):
        raise line.error(
            f"t must lie within the scene's time: 0 to {1e3 * scene.duration:g} ms",
            "make the scene longer, or remove the row",
            f"t = {1e3 * t:g} ms",
        )
    if values.get("tip_angle", 0.0) < 0:
        rule = (
            "tip_angle is the angle between the tip's axis and the clamped base's, 0 to 180 degrees"
        )
        raise line.error(
            rule,
            "give its size without a sign, and the side by tip_x_mm ...",
            f"{math.degrees(values['tip_angle']):g} deg",
        )


def _field_of(values: NamedNumbers, scene: Scene) -> Vector | None:
    """The uniform field (T) of a row; components without a column are the scene's."""
    if "field" in values:
        uniform = np.array(scene.field.uniform)
        found = values["field"] * uniform / np.linalg.norm(uniform)
    elif any(f"field_{a}" in values for a in AXES):
        found = np.array(
            [
                values.get(f"field_{a}", own)
                for a, own in zip(AXES, scene.field.uniform, strict=True)
            ]
        )
    else:
        return None
    return float(found[0]), float(found[1]), float(found[2])
