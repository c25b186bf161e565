"""Measured fields: a map on a regular grid with its settings, and a schedule in time, from CSV tables.

Units stand in the header: x_mm, Bz_mT, time_ms.
"""

import base64
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, ValidationInfo, WithJsonSchema

from magmpm.compiled.arrays import Array, Plain
from magmpm.errors import in_mm, show
from magmpm.fields.spline import LEAST_NODES_OF_SPLINE
from magmpm.inputs.csv_tables import MAX_ROWS, CsvLine, TableError, table_faults, table_lines
from magmpm.inputs.quantities import KINDS, BadQuantity, Kind, format_si, parse_quantity
from magmpm.inputs.settings import Settings, fault, from_file, named_file
from magmpm.inputs.vectors import Point, Vector

_MAP = {
    name: KINDS[kind]
    for kind, names in (("length", "xyz"), ("flux density", ("Bx", "By", "Bz")))
    for name in names
}
_SCHEDULE = {"time": KINDS["time"], **_MAP}
_NUMBER = (
    -1e6,
    1e6,
    "-1e6",
    "1e6",
)  # least and largest in SI, and as messages write them: as over_time.Keyframe has them
_FLUX = (-20.0, 20.0, "-20 T", "20 T")
_PLACE = (-100.0, 100.0, "-100 m", "100 m")
_MEASURED = (
    -100.0,
    100.0,
    "-100 T",
    "100 T",
)  # no magnet or coil that a robot is near has more: a larger value is a mistaken unit
_BOUNDS = {
    "time": (0.0, 1e6, "0 s", "1e6 s"),
    "strength": _NUMBER,
    **dict.fromkeys(("Bx", "By", "Bz"), _FLUX),
    **dict.fromkeys("xyz", _PLACE),
}
_MAP_BOUNDS = {**dict.fromkeys(("Bx", "By", "Bz"), _MEASURED), **dict.fromkeys("xyz", _PLACE)}
_START_MAP = (
    "begin the file with a header such as x_mm,y_mm,z_mm,Bx_mT,By_mT,Bz_mT, then one row a grid"
    " point"
)
_START_SCHEDULE = (
    "begin the file with a header such as time_s,strength or time_s,Bx_mT,By_mT,Bz_mT, then numbers"
)


class Grid3(Settings):
    """A map after reading: a field on a regular grid, in SI, with the values as base64 of little-endian doubles."""

    lower: Vector
    spacing: Vector
    shape: tuple[int, int, int]
    values: str

    def array(self) -> Array:
        """Values (N, M, K, 3) T."""
        return np.frombuffer(base64.b64decode(self.values), "<f8").reshape(*self.shape, 3)


def _read_map(value: Any, info: ValidationInfo) -> Any:
    if isinstance(value, (Mapping, Grid3)) and not from_file(info):
        return value
    if not isinstance(value, (str, Path)):
        raise fault(
            "must be the path of a CSV table", "write, say, `table: ../measured/magnet.csv`"
        )
    with table_faults():
        lower, spacing, values = read_map(named_file(info, value))
    text = base64.b64encode(np.ascontiguousarray(values, "<f8").tobytes()).decode()
    return Grid3(
        lower=tuple(lower.tolist()),
        spacing=tuple(spacing.tolist()),
        shape=values.shape[:3],
        values=text,
    )


class Map(Settings):
    """A measured or computed field on a regular grid."""

    table: Annotated[Grid3, BeforeValidator(_read_map), WithJsonSchema({"type": "string"})] = Field(
        description=(
            "Path, relative to this file, of a CSV table with columns x, y, z, Bx, By, Bz, each"
            " with its unit in the header: x_mm,y_mm,z_mm,Bx_mT,By_mT,Bz_mT."
        ),
        examples=["../measured/magnet.csv"],
    )
    position: Point = Field(
        default=(0.0, 0.0, 0.0),
        description=(
            "Where the origin of the map lies in the scene; [0 mm, 0 mm, 0 mm] unless given."
        ),
        examples=[["0 mm", "0 mm", "0 mm"]],
    )


def read_map(path: Path | str) -> tuple[Array, Array, Array]:
    """A measured map: lower corner (3,) m, spacing (3,) m, values (N, M, K, 3) T.

    The file: a header that names x, y, z, Bx, By and Bz, each with its unit after an underscore, in any order; then one row for each
    point of a regular grid, in any order; # begins a comment. Raises TableError naming file, line, value received, rule and remedy.
    """
    path = Path(path)
    names, rows, lines = _read(path, _MAP, _START_MAP, 500_000, _MAP_BOUNDS)
    missing = [name for name in _MAP if name not in names]
    if missing:
        rule = f"a map has the columns x, y, z, Bx, By and Bz; {', '.join(missing)} is missing"
        raise TableError(str(path), rule=rule, remedy=_START_MAP)
    rows = rows[:, [names.index(name) for name in _MAP]]
    axes = [_axis(path, rows[:, k], "xyz"[k]) for k in range(3)]
    shape = tuple(len(axis) for axis in axes)
    spacing = np.array([(axis[-1] - axis[0]) / (len(axis) - 1) for axis in axes])
    lower = np.array([axis[0] for axis in axes])
    place = np.rint((rows[:, :3] - lower) / spacing).astype(int)
    flat = np.ravel_multi_index(tuple(place.T), shape)
    count = np.bincount(flat, minlength=math.prod(shape))
    if count.max() > 1:
        twice = int(np.flatnonzero(flat == int(np.argmax(count)))[1])
        raise lines[twice].error(
            "each grid point may appear once",
            "remove one of the rows",
            received=in_mm(rows[twice, :3], "g"),
        )
    if count.min() == 0:
        hole = np.array(np.unravel_index(int(np.argmin(count)), shape))
        rule = (
            f"a map has a row for each of its {shape[0]} x {shape[1]} x {shape[2]} grid points;"
            f" {int((count == 0).sum())} are missing, the first at"
            f" {in_mm(lower + hole * spacing, 'g')}"
        )
        raise TableError(str(path), rule=rule, remedy="measure or interpolate the missing points")
    values = np.empty((len(rows), 3))
    values[flat] = rows[:, 3:]
    return lower, spacing, values.reshape(*shape, 3)


def _axis(path: Path, coordinates: Array, name: str) -> Array:
    """The planes of the grid along an axis, evenly spaced. Raises TableError."""
    found = np.unique(coordinates)
    extent = found[-1] - found[0]
    step = np.diff(found)
    keep = np.concatenate(
        [[True], step > 1e-4 * (step.max() if len(step) else 1.0)]
    )  # nearer ones belong to one plane
    found = found[keep]
    if len(found) < LEAST_NODES_OF_SPLINE:
        rule = (
            f"a map has at least {LEAST_NODES_OF_SPLINE} grid points along each axis; along"
            f" {name} it has"
            f" {len(found)}"
        )
        raise TableError(str(path), rule=rule, remedy="measure more planes")
    even = np.linspace(found[0], found[-1], len(found))
    off = np.abs(found - even)
    worst = int(np.argmax(off))
    if off[worst] > 1e-3 * extent / (len(found) - 1):
        raise TableError(
            str(path),
            rule=f"the grid of a map must be evenly spaced: {len(found)} planes from "
            f"{1e3 * found[0]:g} to {1e3 * found[-1]:g} mm along {name} would have one at "
            f"{1e3 * even[worst]:g} mm, the file has {1e3 * found[worst]:g} mm",
            remedy="interpolate the map onto a regular grid",
        )
    return even


def read_schedule(path: Path | str) -> list[Plain]:
    """A schedule: one dict a row with `time` s and, where the table has them, `strength`, `uniform` (Bx, By, Bz) T, `move` (x, y, z) m.

    Raises TableError naming file, line, value received, rule and remedy.
    """
    path = Path(path)
    names, rows, lines = _read(
        path, _SCHEDULE, _START_SCHEDULE, MAX_ROWS, _BOUNDS, plain=("strength",)
    )
    groups = {"uniform": ("Bx", "By", "Bz"), "move": ("x", "y", "z")}
    for group in groups.values():
        if 0 < sum(name in names for name in group) < 3:
            raise TableError(
                str(path),
                rule=f"the columns {', '.join(group)} must all be given, or none of them",
                remedy="add the missing columns",
            )
    if "time" not in names or len(names) == 1:
        rule = "a schedule has a column of time and at least one of strength; Bx, By, Bz; x, y, z"
        raise TableError(str(path), rule=rule, remedy=_START_SCHEDULE)
    times = rows[:, names.index("time")]
    falls = np.flatnonzero(np.diff(times) <= 0)
    if len(falls):
        at = int(falls[0]) + 1
        raise lines[at].error(
            "times must rise from row to row",
            "sort the rows, each time once",
            f"{times[at]:g} s after {times[at - 1]:g} s",
        )
    out: list[Plain] = []
    for row in rows.tolist():
        frame: Plain = {"time": row[names.index("time")]}
        if "strength" in names:
            frame["strength"] = row[names.index("strength")]
        for key, group in groups.items():
            if group[0] in names:
                frame[key] = [row[names.index(name)] for name in group]
        out.append(frame)
    return out


def _read(
    path: Path,
    kinds: dict[str, Kind],
    start: str,
    most: int,
    bounds: dict[str, tuple[float, float, str, str]],
    plain: tuple[str, ...] = (),
) -> tuple[list[str], Array, list[CsvLine]]:
    """Names of the columns, rows in SI, and the line of each row. Raises TableError, also for what is out of bounds (SI; in words)."""
    names = list[str]()
    factors = list[float]()
    rows = list[list[float]]()
    used = list[CsvLine]()
    lines = table_lines(path, start)
    for header in lines:
        names, factors = _header(header, kinds, plain, start)
        for line in lines:
            row = line.numbers(len(names))
            if not row or not all(map(math.isfinite, row)):
                raise line.error(f"a row must have {len(names)} finite numbers", "check this row")
            for k, name in enumerate(names):
                if not bounds[name][0] <= row[k] * factors[k] <= bounds[name][1]:
                    reads = (
                        format_si(row[k] * factors[k], kinds[name])
                        if name in kinds
                        else f"{row[k]:g}"
                    )
                    raise line.error(
                        f"{name} must be at least {bounds[name][2]} and at most {bounds[name][3]}",
                        f"check the number, and the unit in the header: this reads as {reads}",
                        received=f"{line.cells[k]} in the column {header.cells[k]}",
                    )
            if len(rows) == most:
                raise line.error(f"a table has at most {most} rows", "thin it out", received="more")
            rows.append(row)
            used.append(line)
    if len(rows) < 2:
        raise TableError(
            str(path),
            received=f"{len(rows)} rows",
            rule="a table has 2 rows at least",
            remedy=start,
        )
    return names, np.asarray(rows) * factors, used


def _header(
    header: CsvLine, kinds: dict[str, Kind], plain: tuple[str, ...], start: str
) -> tuple[list[str], list[float]]:
    """Names of the columns and their factors to SI. Raises TableError."""
    names = []
    factors = []
    for cell in header.cells:
        name, _, unit = cell.partition("_")
        if cell in plain:
            name = cell
            factor = 1.0
        elif name in kinds:
            try:
                factor = parse_quantity(f"1 {unit}", kinds[name])
            except BadQuantity as error:
                raise header.error(error.rule, start, received=show(cell)) from None
        else:
            rule = (
                f"columns are {', '.join([*kinds, *plain])}, each with its unit after an underscore"
            )
            raise header.error(rule, start, received=show(cell))
        if name in names:
            raise header.error("each column may appear once", "remove one", received=show(cell))
        names.append(name)
        factors.append(factor)
    return names, factors
