"""Changes of the field in time: the settings of `field: {over_time: ...}`. fields.schedule evaluates them.

The descriptions and examples are what editors show (scene.schema.json) and what error messages quote.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, WithJsonSchema, field_validator, model_validator

from magmpm.fields.measured_map import read_schedule
from magmpm.inputs.csv_tables import named_table
from magmpm.inputs.settings import Angle, Duration, Quantity, Settings, check_rising, fault
from magmpm.inputs.vectors import Axis, FluxVector, Point

_Time = Annotated[float, Quantity("time", at_least="0 s", at_most="1e6 s")]
_Number = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e6, le=1e6)]
_Count = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1e9)]


class Ramp(Settings):
    """The strength grows evenly, and then stays."""

    duration: Duration = Field(description="How long it takes.", examples=["50 ms"])
    start: _Time = Field(
        default=0.0, description="When it begins; 0 s unless given.", examples=["0 s"]
    )
    begin: _Number = Field(
        default=0.0, description="Factor before it; 0 unless given.", examples=[0]
    )
    end: _Number = Field(default=1.0, description="Factor after it; 1 unless given.", examples=[1])


class Rotation(Settings):
    """The field, with all its sources, turns about an axis."""

    axis: Axis = Field(
        default=(0.0, 0.0, 1.0),
        description=(
            "Axis it turns about, right-handed: [x, y, z] or angles; [0, 0, 1] unless given."
        ),
        examples=[[0, 1, 0]],
    )
    frequency: Annotated[float, Quantity("frequency", at_least="-1e5 Hz", at_most="1e5 Hz")] = (
        Field(description="Turns in a second; negative turns the other way.", examples=["2 Hz"])
    )
    center: Point = Field(
        default=(0.0, 0.0, 0.0),
        description=(
            "A point of the axis, for sources that have a place; [0 mm, 0 mm, 0 mm] unless given."
        ),
        examples=[["60 mm", "0 mm", "0 mm"]],
    )
    start: _Time = Field(
        default=0.0, description="When it begins; 0 s unless given.", examples=["0 s"]
    )
    turns: _Count | None = Field(
        default=None,
        description="Number of turns after which it stops and stays; without it, it turns to the end.",
        examples=[0.25],
    )

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
    amplitude: _Number = Field(
        default=1.0, description="Factor of the swing; 1 unless given.", examples=[1]
    )
    mean: _Number = Field(
        default=0.0, description="Factor it swings about; 0 unless given.", examples=[0]
    )
    phase: Angle = Field(
        default=0.0,
        description="Phase at the start; 0 deg, a sine, unless given.",
        examples=["90 deg"],
    )
    start: _Time = Field(
        default=0.0, description="When it begins; 0 s unless given.", examples=["0 s"]
    )
    cycles: _Count | None = Field(
        default=None,
        description="Number of cycles after which it stops and stays; without it, it runs to the end.",
        examples=[2],
    )


class Keyframe(Settings):
    """Values at one time; in between, they change evenly."""

    time: _Time = Field(description="When.", examples=["50 ms"])
    strength: _Number | None = Field(
        default=None, description="Factor of the whole field.", examples=[1]
    )
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


_TABLE = named_table(
    lambda path: tuple(Keyframe(**row) for row in read_schedule(path)),
    "table: ../measured/current.csv",
)


class OverTime(Settings):
    """Changes of the field in time. Strengths of several parts multiply; then the field turns. Parts that have ended stay as they ended."""

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
        examples=[[{"time": "0 s", "strength": 0}, {"time": "50 ms", "strength": 1}]],
    )
    table: Annotated[tuple[Keyframe, ...] | None, _TABLE, WithJsonSchema({"type": "string"})] = (
        Field(
            default=None,
            description=(
                "Keyframes from a CSV table; path relative to this file, columns time and any of"
                " strength; Bx, By, Bz; x, y, z (the sources' move), with units in the header:"
                " time_s,Bx_mT,By_mT,Bz_mT."
            ),
            examples=["../measured/current.csv"],
        )
    )

    @field_validator("keyframes")
    @classmethod
    def _rising(cls, frames: tuple[Keyframe, ...] | None) -> tuple[Keyframe, ...] | None:
        given = frames or ()
        check_rising([frame.time for frame in given], "times of keyframes", "s", "time")
        for k, frame in enumerate(given):
            if frame.strength is None and frame.uniform is None and frame.move is None:
                raise fault(
                    "a keyframe gives strength, uniform or move", "add, say, `strength: 1`", (k,)
                )
        return frames

    @model_validator(mode="after")
    def _one_list(self) -> OverTime:
        if self.keyframes is not None and self.table is not None:
            raise fault("keyframes and table both give the schedule", "remove one of the two")
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
