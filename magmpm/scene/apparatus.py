"""Columns that say how the apparatus stood when a row was read: a magnet's place and direction, coil currents, the inserted length."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from magmpm.bodies.segments import StraightBody
from magmpm.errors import InputError, in_mm
from magmpm.fields.magnets import taken
from magmpm.inputs.csv_tables import CsvLine
from magmpm.inputs.vectors import Vector, from_angles
from magmpm.scene.addresses import Place, Placed, changed
from magmpm.scene.scene import Scene
from magmpm.scene.variables import variables

AXES = "xyz"
_PLACE = tuple(f"magnet_{a}" for a in AXES)
_AXIS = tuple(f"magnet_axis_{a}" for a in AXES)
_ANGLES = ("magnet_azimuth", "magnet_elevation")
_CURRENTS = tuple(f"current_{k + 1}" for k in range(16))
APPARATUS = {
    **dict.fromkeys(_PLACE, "length"), **dict.fromkeys(_AXIS, "number"), **dict.fromkeys(_ANGLES, "angle"),
    "current": "current", **dict.fromkeys(_CURRENTS, "current"), "inserted": "length",
}  # fmt: skip  # quantity of each column
MAGNET: Place = ("field", "magnet", 0)
POSITION: Place = (*MAGNET, "position")
AXIS: Place = (*MAGNET, "axis")
WORDS: dict[Place, str] = {
    **{("field", "uniform", i): f"field_{a}" for i, a in enumerate(AXES)},
    **{(*POSITION, i): name for i, name in enumerate(_PLACE)},
    **{(*AXIS, i): name for i, name in enumerate(_AXIS)},
    **{("field", "coils", k, "current"): name for k, name in enumerate(_CURRENTS)},
}  # columns that are numbers of the scene by other names


@dataclass(frozen=True)
class Apparatus:
    """Settings of a row in SI. settings: numbers and vectors by their places (an axis of its scene's length or of a unit); inserted: length
    of the body that is free, of which a segmented one loses or gains the first segment, None: the scene's own.
    """

    settings: tuple[tuple[Place, float | Vector], ...] = ()
    inserted: float | None = None

    def applied(self, scene: Scene) -> Scene:
        """The scene with these settings. Raises InputError where it then breaks a rule."""
        if self == OWN:
            return scene
        if self.inserted is not None:
            scene = variables(scene, ["length"])[0].changed(scene, self.inserted - scene.length)
        values: Placed = {
            place: list(value) if isinstance(value, tuple) else value
            for place, value in self.settings
        }
        if AXIS in values:
            values[*MAGNET, "magnetization"] = None
        return changed(scene, values)


OWN = Apparatus()  # that of the scene


def check_apparatus(header: CsvLine, named: set[str], scene: Scene) -> None:
    """Raises TableError where the scene lacks what the columns set."""
    if not (given := {name for name in named if name in APPARATUS or "." in name}):
        return
    if scene.in_time:
        raise header.error(
            "in runs along time the scene sets the apparatus",
            "write its schedule in the scene, field.over_time",
        )
    magnets = scene.field.magnet or ()
    coils = scene.field.coils or ()
    if any(name.startswith("magnet") for name in given) and len(magnets) != 1:
        raise header.error(
            "columns of the magnet move the scene's one magnet, and it has"
            f" {len(magnets) or 'none'}",
            "give the scene one `field: {magnet: ...}`; what does not move can be a dipole or"
            " a map",
        )
    if any(name in given for name in _ANGLES) and any(name in given for name in _AXIS):
        raise header.error(
            "the magnet's direction is given by angles or by components", "remove one of the two"
        )
    highest = max(
        [_CURRENTS.index(name) + 1 for name in given if name in _CURRENTS],
        default=int("current" in given),
    )
    if highest > len(coils) or ("current" in given and len(coils) != 1):
        raise header.error(
            "columns of currents need as many coils in the scene, and it has"
            f" {len(coils) or 'none'}",
            "name them in the scene, field.coils, in the columns' order; current_A is for a single"
            " coil",
        )
    if "inserted" in given and not isinstance(scene.body.shape, StraightBody):
        raise header.error(
            f"a body of {scene.body.kind} has no length to insert", "remove the column"
        )


def apparatus_of(
    line: CsvLine, values: Mapping[str, float], placed: Mapping[str, Place], scene: Scene
) -> Apparatus:
    """The settings of a row; components without a column are the scene's. placed: of columns that are addresses. Raises TableError where
    the scene can't be set so."""
    own = (scene.field.magnet or (None,))[0]
    settings: dict[Place, float | Vector] = {
        place: values[name] for name, place in placed.items() if name in values
    }
    axis = None
    if own is not None and any(name in values for name in _PLACE):
        settings[POSITION] = _vector(
            values.get(name, part) for name, part in zip(_PLACE, own.position, strict=True)
        )
    if any(name in values for name in _AXIS):
        axis = _vector(values.get(name, 0.0) for name in _AXIS)
        if not any(axis):
            raise line.error(
                "the magnet's axis must have a direction",
                "give it, say, magnet_axis_x = 1",
                "an axis of zeros",
            )
    elif any(name in values for name in _ANGLES):
        a, e = (values.get(name, 0.0) for name in _ANGLES)
        axis = from_angles(a, e)
    if axis is not None:
        settings[AXIS] = axis
    for k, name in enumerate(("current",) if "current" in values else _CURRENTS):
        if name in values:
            settings["field", "coils", k, "current"] = values[name]
    found = Apparatus(tuple(settings.items()), values.get("inserted"))
    if (broken := _broken(found, scene)) is not None:
        raise line.error(broken[0], broken[1], broken[2])
    return found


@lru_cache(maxsize=256)
def _broken(apparatus: Apparatus, scene: Scene) -> tuple[str, str, str] | None:
    """The rule that the scene with these settings breaks, the remedy, what breaks it; None where it breaks none."""
    try:
        there = apparatus.applied(scene)
    except InputError as error:
        lines = [text.strip().partition(": ")[2] for text in str(error).splitlines()]
        return lines[1], lines[2], lines[0]
    points = np.outer(np.linspace(0.0, there.length, 101), [1.0, 0.0, 0.0])
    for solid in taken(there.field) if there.body.shape.line is not None else ():
        if solid.depth(points).max() > 0:
            rule = "the undeformed body must be outside of the magnet"
            remedy = "check its place and unit; the origin is the clamp"
            return rule, remedy, f"{solid.name} centered at {in_mm(solid.position, '.4g')}"
    return None


def _vector(parts: Iterable[float]) -> Vector:
    found = [float(part) for part in parts]
    return found[0], found[1], found[2]
