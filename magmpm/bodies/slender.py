"""The bodies a scene can name: catheter, strip, and the parts of assembly.py; each with its rules and documentation."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, ValidationInfo, field_validator, model_validator

from magmpm.bodies.assembly import Parts
from magmpm.bodies.regions import Line, Region
from magmpm.inputs.settings import Key, Quantity, Settings, fault
from magmpm.inputs.vectors import Direction, Vector, three

MAX_SEGMENTS = 1000
MAX_SLENDERNESS = 500.0  # length over diameter, or over thickness
SHORTEST = 0.01  # of the diameter or thickness: a segment; 0.02 of a cell at 2 cells across, 0.16 at 16
THINNEST_WALL = 1e-3  # of the diameter: a hundredth of a cell at 16 cells across; what warns of walls thinner than a cell is in scene.py
REGIONS_A_PERIOD = 8  # of a profile: what its arrows and moments are shown by


class Segment(Settings):
    """A piece of a catheter or strip with one magnetisation and one material."""

    magnetization: Direction = Field(
        default=(0.0, 0.0, 0.0),
        description="Direction in the undeformed body: [x, y, z], normalised, or "
        "{azimuth: ..., elevation: ...}; [0, 0, 0], unmagnetised, unless given.",
        examples=[[1, 0, 0]],
    )
    material: str | None = Field(
        default=None,
        description="A name from `materials`; the body's unless given.",
        examples=["plain silicone"],
    )
    length: Annotated[float, Quantity("length", above="0 mm", at_most="10 m")] | None = Field(
        default=None,
        description="Length of this segment; segments without one share the rest of the length equally.",
        examples=["8 mm"],
    )

    @property
    def magnetised(self) -> bool:
        """Whether it has a direction of magnetisation (its material may still have no remanence)."""
        return any(self.magnetization)


def segment_lengths(length: float, segments: tuple[Segment, ...]) -> list[float]:
    """Length of each segment in m, base to tip; they sum to `length` (m)."""
    given = [s.length for s in segments if s.length is not None]
    free = len(segments) - len(given)
    share = math.fsum([length, *(-length for length in given)]) / free if free else 0.0
    return [share if s.length is None else s.length for s in segments]


def check_lengths(body: str, length: float, thickness: float | None, segments: tuple[Segment, ...]) -> None:
    """Segments must fill their body's length (m), each at least SHORTEST of its thickness (m; None: not known) long.

    Raises PydanticCustomError (see `fault`).
    """
    given = [s.length for s in segments if s.length is not None]
    total, free = math.fsum(given), len(segments) - len(given)
    text = f"{1e3 * total:g} mm, the {body} {1e3 * length:g} mm"
    if free == 0 and not math.isclose(total, length, rel_tol=1e-9):
        raise fault(
            f"segment lengths must sum to the {body}'s length", f"they sum to {text}: change either"
        )
    if free and total >= length * (1 - 1e-9):
        raise fault(
            f"segment lengths must leave some of the {body}'s length to the segments without one",
            f"those given sum to {text}: shorten them",
        )
    lengths = segment_lengths(length, segments)
    shortest = min(range(len(lengths)), key=lengths.__getitem__)
    if thickness is not None and lengths[shortest] < SHORTEST * thickness * (1 - 1e-9):
        across = "diameter" if body == "catheter" else "thickness"
        raise fault(
            f"a segment must be at least {SHORTEST:g} times the {body}'s {across} long, {1e3 * SHORTEST * thickness:.3g} mm here, "
            f"and segment {shortest + 1} is {1e3 * lengths[shortest]:.3g} mm",
            "check its unit, make it longer, or leave it out: the grid tells nothing finer",
            (shortest, "length") if segments[shortest].length is not None else (),
        )


class Catheter(Settings):
    """A straight rod, base at the origin, axis +x."""

    length: Annotated[float, Quantity("length", above="0 mm", at_most="10 m")] = Field(
        description="Length of the undeformed catheter.", examples=["40 mm"]
    )
    diameter: Annotated[float, Quantity("length", above="0 mm", at_most="1 m")] = Field(
        description="Outer diameter.", examples=["4 mm"]
    )
    inner_diameter: Annotated[float, Quantity("length", at_least="0 mm", at_most="1 m")] = Field(
        default=0.0, description="Diameter of the bore; 0 mm, a solid rod, unless given.", examples=["2 mm"]
    )
    material: str = Field(
        description="A name from `materials`; segments may name others.", examples=["silicone"]
    )
    clamp: Literal["base", "none"] = Field(
        default="base", description="The face that is held: base, or none (a free body).", examples=["base"]
    )
    segments: tuple[Segment, ...] = Field(
        min_length=1,
        max_length=MAX_SEGMENTS,
        description="From base to tip.",
        examples=[[{"magnetization": [1, 0, 0]}]],
    )

    @field_validator("diameter")
    @classmethod
    def _slender(cls, diameter: float, info: ValidationInfo) -> float:
        length = info.data.get("length")
        if length is not None and not diameter <= length <= MAX_SLENDERNESS * diameter:
            raise fault(
                f"the length must be 1 to {MAX_SLENDERNESS:g} times the diameter",
                f"check the units of both: length {1e3 * length:g} mm, diameter {1e3 * diameter:g} mm",
            )
        return diameter

    @field_validator("inner_diameter")
    @classmethod
    def _hollow(cls, inner: float, info: ValidationInfo) -> float:
        outer = info.data.get("diameter")
        if outer is not None and not inner < outer:
            raise fault(
                "the inner diameter must be less than the diameter",
                f"give less than {1e3 * outer:g} mm, or remove it",
            )
        if outer is not None and not (outer - inner) / 2 >= THINNEST_WALL * outer * (1 - 1e-9):
            raise fault(
                f"a tube's wall must be at least {THINNEST_WALL:g} times its diameter thick, {1e3 * THINNEST_WALL * outer:.3g} mm here",
                f"give at most {1e3 * (1 - 2 * THINNEST_WALL) * outer:g} mm",
            )
        return inner

    @field_validator("segments")
    @classmethod
    def _fill_the_length(cls, segments: tuple[Segment, ...], info: ValidationInfo) -> tuple[Segment, ...]:
        length = info.data.get("length")
        if length is not None:
            check_lengths("catheter", length, info.data.get("diameter"), segments)
        return segments

    def segment_lengths(self) -> list[float]:
        """Length of each segment in m, base to tip; they sum to `length`."""
        return segment_lengths(self.length, self.segments)

    @property
    def line(self) -> Line:
        """Its undeformed axis."""
        return Line((0.0, 0.0, 0.0), self.length)

    @property
    def clamped(self) -> bool:
        """Whether any of it is held."""
        return self.clamp != "none"

    def box(self) -> tuple[Vector, Vector]:
        """Lower and upper corner of the box around it, m."""
        return (0.0, -self.diameter / 2, -self.diameter / 2), (self.length, self.diameter / 2, self.diameter / 2)

    def regions(self) -> tuple[Region, ...]:
        """Its segments, base to tip."""
        return segment_regions("catheter", self.material, self.segments)


def segment_regions(body: str, material: str, segments: tuple[Segment, ...]) -> tuple[Region, ...]:
    """Segments as pieces, base to tip."""
    return tuple(
        Region(f"segment {i + 1}", (body, "segments", i), s.material or material, s.magnetization)
        for i, s in enumerate(segments)
    )


class Harmonic(Settings):
    """A direction of magnetisation that turns steadily along the length."""

    wavelength: Annotated[float, Quantity("length", above="0 mm", at_most="10 m")] | None = Field(
        default=None, description="Length of one full turn; give this or `periods`.", examples=["3.7 mm"]
    )
    periods: float | None = Field(
        default=None,
        strict=True,
        gt=0,
        le=100,
        allow_inf_nan=False,
        description="Full turns along the length; give this or `wavelength`.",
        examples=[1],
    )
    phase: Annotated[float, Quantity("angle", at_least="-360 deg", at_most="360 deg")] = Field(
        default=0.0,
        description="Angle at the base, from the plane's first axis towards its second; 0 deg unless given.",
        examples=["45 deg"],
    )
    plane: Literal["xz", "xy", "yz"] = Field(
        default="xz", description="Plane in which the direction turns; xz unless given.", examples=["xz"]
    )
    turn: Literal["ccw", "cw"] = Field(
        default="ccw",
        description="Along +x the angle grows (ccw: from the plane's first axis towards its second, unless given) or shrinks (cw).",
        examples=["cw"],
    )

    @model_validator(mode="after")
    def _one_pitch(self) -> Harmonic:
        if (self.wavelength is None) == (self.periods is None):
            raise fault(
                "give `wavelength` or `periods`, one of them", "write, say, `harmonic: {periods: 1, phase: 45 deg}`"
            )
        return self

    def turns(self, length: float) -> float:
        """Full turns along a length (m)."""
        return self.periods if self.periods is not None else length / (self.wavelength or length)


class Profile(Settings):
    """A magnetisation that varies along the length."""

    harmonic: Harmonic = Field(
        description="A direction that turns steadily along the length.", examples=[{"periods": 1, "phase": "45 deg"}]
    )

    def direction(self, share: float, length: float) -> Vector:
        """Unit vector at a share 0 to 1 of the length (m)."""
        h = self.harmonic
        angle = h.phase + (1.0 if h.turn == "ccw" else -1.0) * 2 * math.pi * h.turns(length) * share
        out = [0.0, 0.0, 0.0]
        out["xyz".index(h.plane[0])], out["xyz".index(h.plane[1])] = math.cos(angle), math.sin(angle)
        return (out[0], out[1], out[2])


_Coordinate = Annotated[float, Quantity("length", at_least="-10 m", at_most="10 m")]


class Strip(Settings):
    """A straight strip or sheet: length along x, width along y, thickness along z."""

    length: Annotated[float, Quantity("length", above="0 mm", at_most="10 m")] = Field(
        description="Length along x.", examples=["17.2 mm"]
    )
    width: Annotated[float, Quantity("length", above="0 mm", at_most="10 m")] = Field(
        description="Width along y.", examples=["5 mm"]
    )
    thickness: Annotated[float, Quantity("length", above="0 mm", at_most="1 m")] = Field(
        description="Thickness along z; `cells_across` counts the cells through it.", examples=["0.84 mm"]
    )
    material: str = Field(
        description="A name from `materials`; segments may name others.", examples=["silicone"]
    )
    clamp: Literal["base", "both", "none"] = Field(
        default="base",
        description="The faces that are held: base (at the lower x), both ends, or none (a free body).",
        examples=["base"],
    )
    position: Annotated[tuple[_Coordinate, _Coordinate, _Coordinate], three("[0 mm, 0 mm, 1 mm]")] = Field(
        default=(0.0, 0.0, 0.0),
        description="Centre of the base face: [x, y, z]; the origin unless given.",
        examples=[["0 mm", "0 mm", "1 mm"]],
    )
    plane_strain: bool = Field(
        default=False,
        strict=True,
        description="Nothing moves along y and nothing varies along it, as in a very wide sheet; false unless given.",
        examples=[True],
    )
    segments: tuple[Segment, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=MAX_SEGMENTS,
        description="From base to tip; give these or `magnetization_profile`.",
        examples=[[{"magnetization": [1, 0, 0]}]],
    )
    magnetization_profile: Profile | None = Field(
        default=None,
        description="A magnetisation that varies along the length; give this or `segments`.",
        examples=[{"harmonic": {"periods": 1, "phase": "45 deg"}}],
    )

    @field_validator("thickness")
    @classmethod
    def _thin(cls, thickness: float, info: ValidationInfo) -> float:
        length, width = info.data.get("length"), info.data.get("width")
        if length is not None and not thickness <= length <= MAX_SLENDERNESS * thickness:
            raise fault(
                f"the length must be 1 to {MAX_SLENDERNESS:g} times the thickness",
                f"check the units of both: length {1e3 * length:g} mm, thickness {1e3 * thickness:g} mm",
            )
        if width is not None and not 0.5 * thickness <= width <= MAX_SLENDERNESS * thickness:
            raise fault(
                f"the width must be 0.5 to {MAX_SLENDERNESS:g} times the thickness",
                f"check the units of both: width {1e3 * width:g} mm, thickness {1e3 * thickness:g} mm",
            )
        return thickness

    @field_validator("segments")
    @classmethod
    def _fill_the_length(
        cls, segments: tuple[Segment, ...] | None, info: ValidationInfo
    ) -> tuple[Segment, ...] | None:
        length = info.data.get("length")
        if length is not None and segments is not None:
            check_lengths("strip", length, info.data.get("thickness"), segments)
        return segments

    @model_validator(mode="after")
    def _one_magnetisation(self) -> Strip:
        if (self.segments is None) == (self.magnetization_profile is None):
            raise fault(
                "give `segments` or `magnetization_profile`, one of them",
                "write, say, `segments: [{magnetization: [1, 0, 0]}]`",
            )
        return self

    def segment_lengths(self) -> list[float]:
        """Length of each piece in m, base to tip; they sum to `length`."""
        if self.segments is not None:
            return segment_lengths(self.length, self.segments)
        count = len(self.regions())
        return [self.length / count] * count

    @property
    def line(self) -> Line:
        """Its undeformed axis."""
        return Line(self.position, self.length)

    @property
    def clamped(self) -> bool:
        """Whether any of it is held."""
        return self.clamp != "none"

    def box(self) -> tuple[Vector, Vector]:
        """Lower and upper corner of the box around it, m."""
        (x, y, z), w, t = self.position, self.width / 2, self.thickness / 2
        return (x, y - w, z - t), (x + self.length, y + w, z + t)

    def regions(self) -> tuple[Region, ...]:
        """Its segments, or equal pieces of its profile, base to tip."""
        if self.segments is not None:
            return segment_regions("strip", self.material, self.segments)
        profile = self.magnetization_profile
        assert profile is not None  # validated
        count = max(1, math.ceil(REGIONS_A_PERIOD * profile.harmonic.turns(self.length) - 1e-9))
        at: Key = ("strip", "magnetization_profile")
        return tuple(
            Region(f"piece {i + 1}", at, self.material, profile.direction((i + 0.5) / count, self.length))
            for i in range(count)
        )


CATHETER = {
    "length": "40 mm",
    "diameter": "4 mm",
    "material": "silicone",
    "segments": [{"magnetization": [1, 0, 0]}],
}
STRIP = {
    "length": "17.2 mm",
    "width": "5 mm",
    "thickness": "0.84 mm",
    "material": "silicone",
    "segments": [{"magnetization": [1, 0, 0]}],
}

PARTS = {
    "unit": "mm",
    "meshes": [{"mesh": "meshes/base.stl", "material": "silicone", "clamp": True}],
}


class Body(Settings):
    """What moves: one of these."""

    model_config = ConfigDict(json_schema_extra={"minProperties": 1, "maxProperties": 1})

    catheter: Catheter | None = Field(
        default=None,
        description="A straight round rod or tube from the origin along +x.",
        examples=[CATHETER],
    )
    strip: Strip | None = Field(
        default=None,
        description="A strip or sheet, flat in x and y.",
        examples=[STRIP],
    )

    parts: Parts | None = Field(
        default=None, description="STL meshes, one a part.", examples=[PARTS]
    )

    @model_validator(mode="after")
    def _one(self) -> Body:
        named = [key for key in type(self).model_fields if getattr(self, key) is not None]
        if len(named) != 1:
            raise fault(
                f"must have one of the keys {', '.join(type(self).model_fields)}",
                "keep one of them" if named else "write, say, `catheter: {length: 40 mm, diameter: 4 mm, ...}`",
            )
        return self

    @property
    def kind(self) -> str:
        """catheter, strip or parts."""
        return next(key for key in type(self).model_fields if getattr(self, key) is not None)

    @property
    def shape(self) -> Catheter | Strip | Parts:
        """The body itself, whatever its kind."""
        shape = self.catheter or self.strip or self.parts
        assert shape is not None  # validated
        return shape
