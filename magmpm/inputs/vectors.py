"""Vectors in scene files: three numbers, three quantities, or a direction by two angles."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag

from magmpm.inputs.settings import Angle, Quantity, Settings, fault

Vector = tuple[float, float, float]


def from_angles(azimuth: float, elevation: float) -> Vector:
    """The unit vector of two angles, rad: (cos e cos a, cos e sin a, sin e)."""
    level = math.cos(elevation)
    return level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)


def angles_of(vector: Sequence[float]) -> tuple[float, float]:
    """Azimuth and elevation, degrees, of a vector; zeros of zeros."""
    x, y, z = vector
    return math.degrees(math.atan2(y, x)), math.degrees(math.atan2(z, math.hypot(x, y)))


def three(write: str) -> BeforeValidator:
    """Checks that a value is a list of three, before its numbers are looked at."""

    def check(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            value = value.tolist()
        if not isinstance(value, (list, tuple)) or len(value) != 3:
            raise fault("must be a list of 3, for x, y and z", f"write, say, {write}")
        return value

    return BeforeValidator(check)


def _unit_vector(value: Any) -> Vector:
    """The direction as a unit vector (or zeros), however it was written.

    Components below 1e-15 are rounding of angles and become zero. A unit vector stays as it is: a scene read back is the same bit for bit.
    """
    if isinstance(value, Angles):
        value = from_angles(value.azimuth, value.elevation)
    largest = max(abs(x) for x in value)
    if largest == 0.0:
        return (0.0, 0.0, 0.0)
    length = math.hypot(*value)
    if abs(length - 1.0) > 1e-14:
        value = tuple(
            x / largest for x in value
        )  # first, so that huge and tiny vectors can be normalized too
        length = math.hypot(*value)
        value = tuple(x / length for x in value)
    x, y, z = (0.0 if abs(x) < 1e-15 else float(x) for x in value)
    return (x, y, z)


class Angles(Settings):
    """A direction by two angles: d = (cos e cos a, cos e sin a, sin e)."""

    azimuth: Angle = Field(
        description="Turn in the x-y plane, from +x toward +y.", examples=["30 deg"]
    )
    elevation: Annotated[float, Quantity("angle", at_least="-90 deg", at_most="90 deg")] = Field(
        default=0.0,
        description="Lift from the x-y plane toward +z; 0 deg unless given.",
        examples=["10 deg"],
    )


def _not_zero(direction: Vector) -> Vector:
    if not any(direction):
        raise fault("must not be zero: it is a direction", "write, say, [0, 0, 1]")
    return direction


if TYPE_CHECKING:
    Direction = Vector
    Axis = Vector
    FluxVector = Vector
    Point = Vector
else:
    _number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
    _flux = Annotated[float, Quantity("flux density", at_least="-20 T", at_most="20 T")]
    _coordinate = Annotated[float, Quantity("length", at_least="-100 m", at_most="100 m")]
    Direction = Annotated[
        Annotated[Angles, Tag("angles")]
        | Annotated[
            tuple[_number, _number, _number],
            three("[1, 0, 0] or {azimuth: 30 deg, elevation: 10 deg}"),
            Tag("vector"),
        ],
        Discriminator(lambda value: "angles" if isinstance(value, (Mapping, Angles)) else "vector"),
        AfterValidator(_unit_vector),
    ]
    Axis = Annotated[Direction, AfterValidator(_not_zero)]
    FluxVector = Annotated[tuple[_flux, _flux, _flux], three("[0 mT, 6 mT, 8 mT]")]
    Point = Annotated[tuple[_coordinate, _coordinate, _coordinate], three("[60 mm, 0 mm, 0 mm]")]
