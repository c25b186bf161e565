"""Sliders of a scene that can be changed while one looks: a number each, with its unit and its range."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from magmpm.errors import InputError, report
from magmpm.fields.schedule import places
from magmpm.inputs.vectors import Vector
from magmpm.scene import Scene

LEAST_FIELD = 20e-3  # T: fields up to this, or twice the scene's own, can be reached
WAY = 50e-3  # m, or the body's length: how far a magnet can be moved to either side
SOURCES = ("dipole", "magnet", "coils")
AXES = "xyz"
Values = Mapping[str, float]


@dataclass(frozen=True)
class Control:
    """One number. value, low, high: in `unit`; group: what it stands under; id: its name in `Values`."""

    id: str
    group: str
    label: str
    unit: str
    low: float
    high: float
    step: float
    value: float

    def said(self, value: float) -> str:
        """Slider, number and unit, as in "field Bz: 99 999 mT"."""
        number = f"{value:.6g}" if abs(value) >= 1e9 else f"{value:,.9g}".replace(",", " ")
        return f"{self.group.lower()} {self.label}: {number} {'°' if self.unit == 'deg' else self.unit}"

    def plain(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


def controls(scene: Scene) -> tuple[Control, ...]:
    """All that can be turned in a scene, in the order in which they are shown."""
    return (*_field(scene), *_inserted(scene), *_sources(scene), *_directions(scene))


def checked(known: Mapping[str, Control], values: Any) -> dict[str, float]:
    """Values that came from outside: names of controls with finite numbers. Their ranges are the sliders', not the scene's, but a number
    can be typed, so that anything the scene itself allows is. Raises InputError."""
    if not isinstance(values, Mapping):
        raise InputError(report("values", received=type(values).__name__, rule="must be numbers by name", remedy="move a slider"))
    out = {}
    for name, value in values.items():
        if name not in known:
            rule, remedy = "this scene has no such slider", f"use one of {', '.join(list(known)[:8])}"
            raise InputError(report("values", received=repr(name)[:80], rule=rule, remedy=remedy))
        try:
            out[name] = math.nan if isinstance(value, bool) or not isinstance(value, (int, float)) else float(value)
        except OverflowError:  # a whole number of more than 308 digits
            out[name] = math.inf
        if not math.isfinite(out[name]):
            place = f"{known[name].group.lower()} {known[name].label}"
            raise InputError(report(place, received=repr(value)[:80], rule="must be a finite number", remedy="type a number"))
    return out


def turned(known: Mapping[str, Control], values: Values) -> dict[str, float]:
    """Those values that are not what the scene's own file says."""
    return {name: value for name, value in values.items() if value != known[name].value}


def angles(direction: Vector | np.ndarray) -> tuple[float, float]:
    """Azimuth and elevation (degrees) of a direction that is not zero."""
    x, y, z = (float(c) for c in direction)
    return math.degrees(math.atan2(y, x)), math.degrees(math.atan2(z, math.hypot(x, y)))


def nice(value: float) -> float:
    """The round number (1, 2 or 5 times a power of ten) nearest above a positive value."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(f for f in (1.0, 2.0, 5.0, 10.0) if f * power >= value * (1 - 1e-9)) * power


def shown(value: float) -> float:
    """A number without the rounding of its unit's conversion."""
    return float(f"{value:.12g}")


def _field(scene: Scene) -> Iterator[Control]:
    """The uniform field, where it turns the body, and the schedule's end is what `uniform` says."""
    field, effects = scene.field, scene.effects
    if effects.magnetic_torque is None and effects.magnetic_force is None:
        return
    if field.over_time is not None and not _uniform_counts(scene):
        return
    largest = nice(1e3 * max(LEAST_FIELD, 2 * float(np.linalg.norm(field.uniform))))
    group = "Uniform field" if field.varies else "Field"
    for axis, value in zip(AXES, field.uniform, strict=True):
        yield Control(f"field.{axis}", group, f"B{axis}", "mT", -largest, largest, largest / 400, shown(1e3 * value))


def _uniform_counts(scene: Scene) -> bool:
    """True if the key `uniform` decides the field at the end of the schedule: keyframes may have their own."""
    plain = scene.with_field([0.0, 0.0, 0.0])
    other = scene.with_field([1e-3, 1e-3, 1e-3])
    return bool(np.any(places(plain.field)["uniform"] != places(other.field)["uniform"]))


def _inserted(scene: Scene) -> Iterator[Control]:
    """Slider for the length of a catheter outside its guide."""
    catheter = scene.body.catheter
    if catheter is None or catheter.clamp != "base" or scene.effects.feed is not None:
        return
    low, high = 1e3 * catheter.diameter, 1e3 * catheter.length
    if high > 1.5 * low:
        yield Control("inserted", "Length outside the guide", "length", "mm", shown(low), shown(high), 10.0 ** math.floor(
            math.log10(high / 300)), shown(high))


def _sources(scene: Scene) -> Iterator[Control]:
    """Sliders for the positions of magnets, dipoles and coils."""
    way = 1e3 * max(WAY, scene.length)
    for kind in SOURCES:
        for k, source in enumerate(getattr(scene.field, kind) or ()):
            name = {"coils": "Coil"}.get(kind, kind.capitalize())
            for axis, value in zip(AXES, source.position, strict=True):
                at = shown(1e3 * value)
                yield Control(f"{kind}.{k}.{axis}", f"{name} {k + 1}", axis, "mm", at - way, at + way, way / 400, at)


def _directions(scene: Scene) -> Iterator[Control]:
    """Two angles of each magnetized region's direction."""
    if not scene.body.shape.magnetized_by_region:
        return
    regions = scene.regions()
    for k in scene.magnetized_regions():
        azimuth, elevation = (round(angle, 9) for angle in angles(regions[k].magnetization))
        group = regions[k].name[:1].upper() + regions[k].name[1:]
        yield Control(f"direction.{k}.azimuth", group, "azimuth", "deg", -180.0, 180.0, 1.0, azimuth)
        yield Control(f"direction.{k}.elevation", group, "elevation", "deg", -90.0, 90.0, 1.0, elevation)
