"""The field in a scene: its sources, which add up, and how they change in time; each with its rules and documentation.

The descriptions and examples are what editors show (scene.schema.json) and what error messages quote.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from magmpm.fields.measured_map import read_map, read_schedule
from magmpm.inputs.csv_tables import TableError
from magmpm.inputs.settings import Quantity, Settings, fault, folder_of, from_file
from magmpm.inputs.vectors import Direction, Vector, three

MAX_SOURCES = 100

_Component = Annotated[float, Quantity("flux density", at_least="-20 T", at_most="20 T")]
_Coordinate = Annotated[float, Quantity("length", at_least="-100 m", at_most="100 m")]
_Size = Annotated[float, Quantity("length", above="0 mm", at_most="10 m")]
_Moment = Annotated[float, Quantity("magnetic moment", at_least="-1e6 A*m^2", at_most="1e6 A*m^2")]
_Time = Annotated[float, Quantity("time", at_least="0 s", at_most="1e6 s")]
_Duration = Annotated[float, Quantity("time", above="0 s", at_most="1e6 s")]
_Number = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e6, le=1e6)]
_Count = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1e9)]
if TYPE_CHECKING:
    FluxVector = Vector
    Point = Vector
    Moment = Vector
    Sizes = Vector
else:
    FluxVector = Annotated[tuple[_Component, _Component, _Component], three("[0 mT, 6 mT, 8 mT]")]
    Point = Annotated[tuple[_Coordinate, _Coordinate, _Coordinate], three("[60 mm, 0 mm, 0 mm]")]
    Moment = Annotated[tuple[_Moment, _Moment, _Moment], three("[0 A*m^2, 0 A*m^2, 0.5 A*m^2]")]
    Sizes = Annotated[tuple[_Size, _Size, _Size], three("[20 mm, 20 mm, 10 mm]")]


class _OneOrMore(BeforeValidator):
    """A single mapping where a list is due is a list of one."""

    def __init__(self) -> None:
        super().__init__(lambda value: [value] if isinstance(value, (Mapping, Settings)) else value)

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        schema = handler(core)
        return {"anyOf": [schema["items"], schema]}


def _no_direction(direction: Vector) -> Vector:
    if not any(direction):
        raise fault("must not be zero: it is a direction", "write, say, [0, 0, 1]")
    return direction


class Dipole(Settings):
    """A magnet far away, or a magnetised sphere: the field of a point dipole."""

    position: Point = Field(description="Where it is: [x, y, z].", examples=[["60 mm", "0 mm", "0 mm"]])
    moment: Moment = Field(
        description="Magnetic moment, Br V/mu0 of a magnet: [x, y, z].",
        examples=[["0 A*m^2", "0 A*m^2", "0.5 A*m^2"]],
    )
    diameter: _Size | None = Field(
        default=None,
        description="Of the sphere it stands for, which the body must stay out of; a point unless given.",
        examples=["10 mm"],
    )


class Cuboid(Settings):
    """A block."""

    size: Sizes = Field(
        description="Edges along x, y and the magnet's axis (z unless `axis` is given).",
        examples=[["20 mm", "20 mm", "10 mm"]],
    )


class Cylinder(Settings):
    """A round bar or disc."""

    diameter: _Size = Field(description="Diameter.", examples=["20 mm"])
    length: _Size = Field(description="Length along its axis.", examples=["20 mm"])


class Magnet(Settings):
    """A permanent magnet of finite size, magnetised evenly."""

    cuboid: Cuboid | None = Field(
        default=None, description="Its shape: a block.", examples=[{"size": ["20 mm", "20 mm", "10 mm"]}]
    )
    cylinder: Cylinder | None = Field(
        default=None, description="Its shape: a cylinder.", examples=[{"diameter": "20 mm", "length": "20 mm"}]
    )
    position: Point = Field(description="Its centre: [x, y, z].", examples=[["60 mm", "0 mm", "0 mm"]])
    axis: Direction = Field(
        default=(0.0, 0.0, 1.0),
        description="Where its axis points (a block's third edge): [x, y, z] or angles; [0, 0, 1] unless given.",
        examples=[[0, 0, 1]],
    )
    remanence: Annotated[float, Quantity("flux density", above="0 mT", at_most="3 T")] = Field(
        description="Remanent flux density Br; 1.2 to 1.45 T for neodymium.", examples=["1.3 T"]
    )
    magnetization: Direction | None = Field(
        default=None,
        description="Direction of its magnetisation in space; along its axis unless given.",
        examples=[[1, 0, 0]],
    )

    @field_validator("axis", "magnetization")
    @classmethod
    def _points_somewhere(cls, direction: Vector | None) -> Vector | None:
        return None if direction is None else _no_direction(direction)

    @model_validator(mode="after")
    def _one_shape(self) -> Magnet:
        if (self.cuboid is None) == (self.cylinder is None):
            raise fault(
                "a magnet has one shape: cuboid or cylinder",
                "write, say, `cylinder: {diameter: 20 mm, length: 20 mm}`",
            )
        return self


class Coil(Settings):
    """A thin round coil."""

    position: Point = Field(description="Its centre: [x, y, z].", examples=[["0 mm", "0 mm", "-60 mm"]])
    axis: Direction = Field(
        default=(0.0, 0.0, 1.0),
        description="Its axis; a positive current makes a field along it. [0, 0, 1] unless given.",
        examples=[[0, 0, 1]],
    )
    diameter: _Size = Field(description="Mean diameter of the winding.", examples=["80 mm"])
    current: Annotated[float, Quantity("current", at_least="-1e6 A", at_most="1e6 A")] = Field(
        description="Current in each turn.", examples=["5 A"]
    )
    turns: int = Field(
        default=1, strict=True, ge=1, le=1_000_000, description="Number of turns; 1 unless given.", examples=[200]
    )

    @field_validator("axis")
    @classmethod
    def _points_somewhere(cls, direction: Vector) -> Vector:
        return _no_direction(direction)


class Grid3(Settings):
    """A field on a regular grid, as a map is kept once it is read: SI, the values as base64 of little-endian doubles."""

    lower: tuple[float, float, float]
    spacing: tuple[float, float, float]
    shape: tuple[int, int, int]
    values: str

    def array(self) -> NDArray[np.float64]:
        """Values (N, M, K, 3) T."""
        return np.frombuffer(base64.b64decode(self.values), "<f8").reshape(*self.shape, 3)


def _read_map(value: Any, info: ValidationInfo) -> Any:
    if isinstance(value, (Mapping, Grid3)) and not from_file(info):
        return value
    if not isinstance(value, (str, Path)):
        raise fault("must be the path of a CSV table", "write, say, `table: ../measured/magnet.csv`")
    try:
        lower, spacing, values = read_map(folder_of(info) / value)
    except TableError as error:
        raise fault(f"{error.rule} ({error.place})", error.remedy) from None
    text = base64.b64encode(np.ascontiguousarray(values, "<f8").tobytes()).decode()
    return Grid3(
        lower=tuple(lower.tolist()), spacing=tuple(spacing.tolist()), shape=values.shape[:3], values=text
    )


class Map(Settings):
    """A measured or computed field on a regular grid."""

    table: Annotated[Grid3, BeforeValidator(_read_map), WithJsonSchema({"type": "string"})] = Field(
        description="Path, relative to this file, of a CSV table with columns x, y, z, Bx, By, Bz, each with its unit in the header: "
        "x_mm,y_mm,z_mm,Bx_mT,By_mT,Bz_mT.",
        examples=["../measured/magnet.csv"],
    )
    position: Point = Field(
        default=(0.0, 0.0, 0.0),
        description="Where the origin of the map lies in the scene; [0 mm, 0 mm, 0 mm] unless given.",
        examples=[["0 mm", "0 mm", "0 mm"]],
    )


class Tabulation(Settings):
    """How magnets and coils are put on a table, from which the solver takes field and gradients."""

    tolerance: float = Field(
        default=2e-3,
        strict=True,
        ge=1e-6,
        le=0.1,
        allow_inf_nan=False,
        description="Largest error of the table, of the field's size at that place; 0.002 unless given.",
        examples=[0.002],
    )
    lower: Point | None = Field(
        default=None,
        description="Lower corner of the box it covers, [x, y, z]; what the body may reach unless given.",
        examples=[["-50 mm", "-50 mm", "-50 mm"]],
    )
    upper: Point | None = Field(
        default=None, description="Upper corner of that box.", examples=[["50 mm", "50 mm", "50 mm"]]
    )

    @model_validator(mode="after")
    def _a_box(self) -> Tabulation:
        if (self.lower is None) != (self.upper is None):
            raise fault("a box has both corners, lower and upper", "give both, or neither")
        if self.lower is not None and self.upper is not None and not np.all(np.less(self.lower, self.upper)):
            raise fault("each coordinate of `upper` must exceed that of `lower`", "swap them")
        return self


class Ramp(Settings):
    """The strength grows evenly, and then stays."""

    duration: _Duration = Field(description="How long it takes.", examples=["50 ms"])
    start: _Time = Field(default=0.0, description="When it begins; 0 s unless given.", examples=["0 s"])
    begin: _Number = Field(default=0.0, description="Factor before it; 0 unless given.", examples=[0])
    end: _Number = Field(default=1.0, description="Factor after it; 1 unless given.", examples=[1])


class Rotation(Settings):
    """The field, with all its sources, turns about an axis."""

    axis: Direction = Field(
        default=(0.0, 0.0, 1.0),
        description="Axis it turns about, right-handed: [x, y, z] or angles; [0, 0, 1] unless given.",
        examples=[[0, 1, 0]],
    )
    frequency: Annotated[float, Quantity("frequency", at_least="-1e5 Hz", at_most="1e5 Hz")] = Field(
        description="Turns in a second; negative turns the other way.", examples=["2 Hz"]
    )
    center: Point = Field(
        default=(0.0, 0.0, 0.0),
        description="A point of the axis, for sources that have a place; [0 mm, 0 mm, 0 mm] unless given.",
        examples=[["60 mm", "0 mm", "0 mm"]],
    )
    start: _Time = Field(default=0.0, description="When it begins; 0 s unless given.", examples=["0 s"])
    turns: _Count | None = Field(
        default=None, description="Turns after which it stops, there; it goes on unless given.", examples=[0.25]
    )

    @field_validator("axis")
    @classmethod
    def _points_somewhere(cls, direction: Vector) -> Vector:
        return _no_direction(direction)

    @field_validator("frequency")
    @classmethod
    def _turns(cls, frequency: float) -> float:
        if frequency == 0.0:
            raise fault("must not be zero", "remove the rotation, or write, say, `frequency: 2 Hz`")
        return frequency


class Oscillation(Settings):
    """The strength swings: mean + amplitude sin(2 pi frequency (t - start) + phase)."""

    frequency: Annotated[float, Quantity("frequency", above="0 Hz", at_most="1e5 Hz")] = Field(
        description="Cycles in a second.", examples=["5 Hz"]
    )
    amplitude: _Number = Field(default=1.0, description="Factor of the swing; 1 unless given.", examples=[1])
    mean: _Number = Field(default=0.0, description="Factor it swings about; 0 unless given.", examples=[0])
    phase: Annotated[float, Quantity("angle", at_least="-360 deg", at_most="360 deg")] = Field(
        default=0.0, description="Phase at the start; 0 deg, a sine, unless given.", examples=["90 deg"]
    )
    start: _Time = Field(default=0.0, description="When it begins; 0 s unless given.", examples=["0 s"])
    cycles: _Count | None = Field(
        default=None, description="Cycles after which it stops, there; it goes on unless given.", examples=[2]
    )


class Keyframe(Settings):
    """What holds at one time; in between, values change evenly."""

    time: _Time = Field(description="When.", examples=["50 ms"])
    strength: _Number | None = Field(default=None, description="Factor of the whole field.", examples=[1])
    uniform: FluxVector | None = Field(
        default=None,
        description="The uniform field at this time, in place of `field.uniform`.",
        examples=[["0 mT", "6 mT", "8 mT"]],
    )
    move: Point | None = Field(
        default=None,
        description="How far the sources have moved by now: [x, y, z].",
        examples=[["-10 mm", "0 mm", "0 mm"]],
    )


def _read_schedule(value: Any, info: ValidationInfo) -> Any:
    if not isinstance(value, (str, Path)):
        if from_file(info):
            raise fault("must be the path of a CSV table", "write, say, `table: ../measured/current.csv`")
        return value
    try:
        return tuple(Keyframe.model_validate(row) for row in read_schedule(folder_of(info) / value))
    except TableError as error:
        raise fault(f"{error.rule} ({error.place})", error.remedy) from None


KEYFRAMES = [{"time": "0 s", "strength": 0}, {"time": "50 ms", "strength": 1}]


class OverTime(Settings):
    """How the field changes in time. Strengths of several parts multiply; then the field turns. What has ended stays as it ended."""

    ramp: Ramp | None = Field(
        default=None, description="The strength grows evenly.", examples=[{"duration": "50 ms"}]
    )
    rotation: Rotation | None = Field(
        default=None,
        description="The field turns about an axis.",
        examples=[{"axis": [0, 1, 0], "frequency": "2 Hz"}],
    )
    oscillation: Oscillation | None = Field(
        default=None, description="The strength swings.", examples=[{"frequency": "5 Hz"}]
    )
    keyframes: tuple[Keyframe, ...] | None = Field(
        default=None,
        min_length=2,
        max_length=100_000,
        description="Values at times, in rising order; even change between them.",
        examples=[KEYFRAMES],
    )
    table: Annotated[tuple[Keyframe, ...] | None, BeforeValidator(_read_schedule), WithJsonSchema({"type": "string"})] = Field(
        default=None,
        description="Keyframes from a CSV table; path relative to this file, columns time and any of strength; Bx, By, Bz; x, y, z "
        "(the sources' move), with units in the header: time_s,Bx_mT,By_mT,Bz_mT.",
        examples=["../measured/current.csv"],
    )

    @field_validator("keyframes")
    @classmethod
    def _rising(cls, frames: tuple[Keyframe, ...] | None) -> tuple[Keyframe, ...] | None:
        for k in range(1, len(frames or ())):
            before, now = frames[k - 1].time, frames[k].time  # type: ignore[index]
            if not now > before:
                raise fault(
                    f"times must rise from keyframe to keyframe; this one, {now:g} s, follows {before:g} s",
                    "sort the keyframes, each time once",
                    (k, "time"),
                )
        for k, frame in enumerate(frames or ()):
            if frame.strength is None and frame.uniform is None and frame.move is None:
                raise fault("a keyframe gives strength, uniform or move", "add, say, `strength: 1`", (k,))
        return frames

    @model_validator(mode="after")
    def _one_list(self) -> OverTime:
        if self.keyframes is not None and self.table is not None:
            raise fault("keyframes and table say the same thing", "remove one of the two")
        if not any((self.ramp, self.rotation, self.oscillation, self.keyframes, self.table)):
            raise fault(
                "something must change: ramp, rotation, oscillation, keyframes or table",
                "write, say, `ramp: {duration: 50 ms}`, or remove over_time",
            )
        return self

    @property
    def frames(self) -> tuple[Keyframe, ...]:
        """The keyframes, written out or from the table."""
        return self.keyframes or self.table or ()

    @property
    def endless(self) -> str | None:
        """The part that never ends, or None."""
        if self.rotation is not None and self.rotation.turns is None:
            return "rotation"
        if self.oscillation is not None and self.oscillation.cycles is None:
            return "oscillation"
        return None


class FieldSource(Settings):
    """The outside magnetic field: the sum of its sources."""

    uniform: FluxVector = Field(
        default=(0.0, 0.0, 0.0),
        description="Flux density, the same everywhere: [x, y, z].",
        examples=[["0 mT", "6 mT", "8 mT"]],
    )
    dipole: Annotated[tuple[Dipole, ...] | None, _OneOrMore()] = Field(
        default=None,
        min_length=1,
        max_length=MAX_SOURCES,
        description="A point dipole, or a list of them.",
        examples=[{"position": ["60 mm", "0 mm", "0 mm"], "moment": ["0 A*m^2", "0 A*m^2", "0.5 A*m^2"]}],
    )
    magnet: Annotated[tuple[Magnet, ...] | None, _OneOrMore()] = Field(
        default=None,
        min_length=1,
        max_length=MAX_SOURCES,
        description="A permanent magnet of finite size, or a list of them (needs magpylib).",
        examples=[
            {
                "cylinder": {"diameter": "20 mm", "length": "20 mm"},
                "position": ["60 mm", "0 mm", "0 mm"],
                "remanence": "1.3 T",
            }
        ],
    )
    coils: Annotated[tuple[Coil, ...] | None, _OneOrMore()] = Field(
        default=None,
        min_length=1,
        max_length=MAX_SOURCES,
        description="A round coil, or a list of them (needs magpylib).",
        examples=[{"position": ["0 mm", "0 mm", "-60 mm"], "diameter": "80 mm", "current": "5 A", "turns": 200}],
    )
    map: Map | None = Field(
        default=None,
        description="A measured field on a regular grid.",
        examples=[{"table": "../measured/magnet.csv"}],
    )
    tabulation: Tabulation | None = Field(
        default=None,
        description="How magnets and coils are put on a table; as usual unless given.",
        examples=[{"tolerance": 0.002}],
    )
    over_time: OverTime | None = Field(
        default=None,
        description="How the field changes in time; it does not unless given.",
        examples=[{"ramp": {"duration": "50 ms"}}],
    )

    @property
    def varies(self) -> bool:
        """Whether it varies in space."""
        return any((self.dipole, self.magnet, self.coils, self.map))

    @property
    def acts(self) -> bool:
        """Whether there is any field."""
        frames = self.over_time.frames if self.over_time is not None else ()
        return self.varies or any(self.uniform) or any(any(frame.uniform or ()) for frame in frames)
