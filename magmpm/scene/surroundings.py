"""The parts of a scene that only motion has: what the body meets, and what takes its energy. Each with its rules and documentation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, ValidationInfo, WithJsonSchema, field_validator, model_validator

from magmpm.bodies.assembly import UNITS
from magmpm.bodies.curves import curve, tightest_bend
from magmpm.bodies.surface_mesh import read_mesh, size_fault, unpack_mesh
from magmpm.compiled.arrays import Array
from magmpm.inputs.csv_tables import TableError, read_centreline
from magmpm.inputs.settings import Quantity, Settings, fault, folder_of
from magmpm.inputs.vectors import Direction, three

IN_MOTION = (
    "damping",
    "viscosity",
    "ground",
    "walls",
    "self_contact",
    "feed",
)  # keys of the effects that statics has no use for

_Friction = Annotated[float, Field(strict=True, ge=0, le=10, allow_inf_nan=False)]
_Stiffness = Annotated[float, Field(strict=True, gt=0, le=100, allow_inf_nan=False)]
_FRICTION = Field(
    default=0.0, description="Coulomb's coefficient of friction; 0, slippery, unless given.", examples=[0.3]
)
_STIFFNESS = Field(
    default=1.0,
    description="Times the usual stiffness of the contact, which lets the body in by micrometres; 1 unless given. "
    "Above about 8 the contact asks for a smaller time step than the body.",
    examples=[1.0],
)
_Place = Annotated[float, Quantity("length", at_least="-10 m", at_most="10 m")]
_Point = Annotated[tuple[_Place, _Place, _Place], three("[0 mm, 0 mm, -2 mm]")]
_PATH = {"anyOf": [{"type": "string"}, {"type": "array", "minItems": 2}]}


def _read_path(value: Any, info: ValidationInfo) -> Any:
    """The points of the table that a path names, in SI; a list is taken as it is."""
    if not isinstance(value, (str, Path)):
        return value
    try:
        return read_centreline(folder_of(info) / value)[:, 1:].tolist()
    except TableError as error:
        raise fault(f"{error.rule} ({error.place})", error.remedy) from None


class Damping(Settings):
    """The surroundings resist in proportion to mass and velocity."""

    rate: Annotated[float, Quantity("rate", at_least="0 1/s", at_most="1e6 1/s")] = Field(
        description="Velocities decay by exp(-rate t); twice a motion's angular frequency settles it soonest.",
        examples=["60 1/s"],
    )


class Viscosity(Settings):
    """Losses in the material: a viscous stress 2 eta D beside the elastic one (Kelvin-Voigt)."""

    viscosity: Annotated[float, Quantity("viscosity", at_least="0 Pa s", at_most="1e6 Pa s")] = Field(
        description="eta; a motion of angular frequency w has damping ratio eta w / (2 G).",
        examples=["5 Pa s"],
    )


class Ground(Settings):
    """A plane the body may press on, stick to and slide over."""

    point: _Point = Field(
        description="A point of the plane: [x, y, z].", examples=[["0 mm", "0 mm", "-2 mm"]]
    )
    normal: Direction = Field(
        default=(0.0, 0.0, 1.0),
        description="Away from the ground, towards the body; +z unless given.",
        examples=[[0, 0, 1]],
    )
    friction: _Friction = _FRICTION
    stiffness: _Stiffness = _STIFFNESS

    @field_validator("normal")
    @classmethod
    def _has_a_direction(cls, normal: tuple[float, float, float]) -> tuple[float, float, float]:
        if not any(normal):
            raise fault("a plane's normal must have a direction", "write, say, `normal: [0, 0, 1]`")
        return normal


class Tube(Settings):
    """A tube around a path."""

    radius: Annotated[float, Quantity("length", above="0 mm", at_most="1 m")] = Field(
        description="Inner radius.", examples=["5 mm"]
    )
    path: Annotated[tuple[_Point, ...], BeforeValidator(_read_path), WithJsonSchema(_PATH)] = Field(
        description="Points of its axis, joined by a smooth curve: a list of [x, y, z], or the path, relative to this file, of "
        "a CSV table with columns s_mm,x_mm,y_mm,z_mm. Both ends are open and go on straight.",
        examples=[[["-10 mm", "0 mm", "0 mm"], ["60 mm", "0 mm", "0 mm"]]],
    )

    @model_validator(mode="after")
    def _can_be_made(self) -> Tube:
        points = np.array(self.path)
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if len(points) < 2 or not np.all(steps > 0):
            raise fault(
                "a tube's path must have 2 or more points, each apart from the next",
                "correct the points",
                ("path",),
            )
        bend = tightest_bend(curve(points, min(float(steps.min()), self.radius) / 20))
        if not bend > self.radius:
            raise fault(
                f"a tube's path must not bend more tightly than its radius, and bends to {1e3 * bend:.3g} mm",
                "make the radius smaller, or the path smoother",
                ("path",),
            )
        return self


class Surface(Settings):
    """The inside of a closed surface."""

    mesh: Annotated[str, BeforeValidator(read_mesh), WithJsonSchema({"type": "string"})] = Field(
        description="Path, relative to this file, of an STL file: a closed surface around the lumen.",
        examples=["vessel.stl"],
    )
    unit: Literal["um", "mm", "cm", "m", "inch"] = Field(
        description="Unit of the numbers in the STL file, which does not say it.", examples=["mm"]
    )

    @model_validator(mode="after")
    def _of_usable_size(self) -> Surface:
        found = size_fault(unpack_mesh(self.mesh), self.unit, UNITS[self.unit])
        if found is not None:
            raise fault(*found, ("mesh",))
        return self

    @property
    def vertices(self) -> Array:
        """(v, 3) m."""
        return unpack_mesh(self.mesh).vertices * UNITS[self.unit]

    @property
    def faces(self) -> NDArray[np.int64]:
        """(f, 3)."""
        return unpack_mesh(self.mesh).faces


TUBE = {"radius": "5 mm", "path": [["-10 mm", "0 mm", "0 mm"], ["60 mm", "0 mm", "0 mm"]]}


class Walls(Settings):
    """A lumen the body lies in: a tube, or the inside of a surface."""

    tube: Tube | None = Field(
        default=None,
        description="The inside of a tube around a path; give this or `surface`.",
        examples=[TUBE],
    )
    surface: Surface | None = Field(
        default=None,
        description="The inside of an STL mesh; give this or `tube`.",
        examples=[{"mesh": "vessel.stl", "unit": "mm"}],
    )
    friction: _Friction = _FRICTION
    stiffness: _Stiffness = _STIFFNESS

    @model_validator(mode="after")
    def _one_lumen(self) -> Walls:
        if (self.tube is None) == (self.surface is None):
            raise fault(
                "give `tube` or `surface`, one of them", "write, say, `tube: {radius: 5 mm, path: vessel.csv}`"
            )
        return self


class SelfContact(Settings):
    """The body's parts and folds touch each other and separate again. No settings: it switches to the updated formulation."""


class Feed(Settings):
    """The base is pushed along +x through a straight guide around the x axis; what has left the guide is free."""

    speed: Annotated[float, Quantity("speed", at_least="-10 m/s", at_most="10 m/s")] = Field(
        description="Speed along +x; negative pulls back.", examples=["20 mm/s"]
    )
    exit: _Place = Field(description="Where on the x axis the guide ends.", examples=["10 mm"])
