"""The parts of a scene: materials, catheter, field, effects, solver; each with its rules and documentation.

The descriptions and examples are what editors show (scene.schema.json) and what error messages quote.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import (
    Field,
    ValidationInfo,
    field_validator,
)

from magmpm.inputs import Part, Quantity, fault
from magmpm.vectors import Direction, three

MAX_SEGMENTS = 1000
MAX_SLENDERNESS = 500.0  # length over diameter


class Material(Part):
    """A silicone, magnetic or plain."""

    model: Literal["neo-hookean"] = Field(
        default="neo-hookean", description="Elastic law; neo-hookean unless given.", examples=["neo-hookean"]
    )
    shear_modulus: Annotated[float, Quantity("pressure", above="0 kPa", at_most="10 GPa")] = Field(
        description="Shear modulus G at small strain.", examples=["120 kPa"]
    )
    bulk_to_shear: float = Field(
        strict=True,
        allow_inf_nan=False,
        description="Bulk over shear modulus, K/G: how incompressible. 20 is usual for silicone; above 2/3, "
        "so that Poisson's ratio (3K - 2G)/(6K + 2G) is positive, and at most 10000.",
        examples=[20],
        json_schema_extra={"exclusiveMinimum": 0.6667, "maximum": 10_000},
    )
    density: Annotated[float, Quantity("density", above="0 kg/m^3", at_most="30000 kg/m^3")] | None = Field(
        default=None, description="Mass per volume; needed for gravity.", examples=["1882 kg/m^3"]
    )
    remanence: Annotated[float, Quantity("flux density", at_least="0 mT", at_most="3 T")] = Field(
        default=0.0,
        description="Remanent flux density Br; 0 mT, plain silicone, unless given.",
        examples=["138 mT"],
    )

    @field_validator("bulk_to_shear")
    @classmethod
    def _nearly_incompressible(cls, ratio: float) -> float:
        if not 2 / 3 < ratio <= 10_000:
            raise fault(
                "must be greater than 2/3 (Poisson's ratio above 0) and at most 10000 (below 0.49995)",
                "write, say, `bulk_to_shear: 20`",
            )
        return ratio


class Segment(Part):
    """A piece of the catheter with one magnetisation and one material."""

    magnetization: Direction = Field(
        default=(0.0, 0.0, 0.0),
        description="Direction in the undeformed body: [x, y, z], normalised, or "
        "{azimuth: ..., elevation: ...}; [0, 0, 0], unmagnetised, unless given.",
        examples=[[1, 0, 0]],
    )
    material: str | None = Field(
        default=None,
        description="A name from `materials`; the catheter's unless given.",
        examples=["plain silicone"],
    )
    length: Annotated[float, Quantity("length", above="0 mm", at_most="10 m")] | None = Field(
        default=None,
        description="Length of this segment; segments without one share the rest of the catheter equally.",
        examples=["8 mm"],
    )

    @property
    def magnetised(self) -> bool:
        """Whether it has a direction of magnetisation (its material may still have no remanence)."""
        return any(self.magnetization)


class Catheter(Part):
    """A straight rod, base at the origin, axis +x, clamped at its base face."""

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
    clamp: Literal["base"] = Field(
        default="base", description="The face that is held: base.", examples=["base"]
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
        return inner

    @field_validator("segments")
    @classmethod
    def _fill_the_length(cls, segments: tuple[Segment, ...], info: ValidationInfo) -> tuple[Segment, ...]:
        length = info.data.get("length")
        if length is None:
            return segments
        given = [s.length for s in segments if s.length is not None]
        total, free = math.fsum(given), len(segments) - len(given)
        text = f"{1e3 * total:g} mm, the catheter {1e3 * length:g} mm"
        if free == 0 and not math.isclose(total, length, rel_tol=1e-9):
            raise fault(
                "segment lengths must sum to the catheter's length", f"they sum to {text}: change either"
            )
        if free and total >= length * (1 - 1e-9):
            raise fault(
                "segment lengths must leave some of the catheter's length to the segments without one",
                f"those given sum to {text}: shorten them",
            )
        return segments

    def segment_lengths(self) -> list[float]:
        """Length of each segment in m, base to tip; they sum to `length`."""
        given = [s.length for s in self.segments if s.length is not None]
        free = len(self.segments) - len(given)
        share = math.fsum([self.length, *(-length for length in given)]) / free if free else 0.0
        return [share if s.length is None else s.length for s in self.segments]


CATHETER = {
    "length": "40 mm",
    "diameter": "4 mm",
    "material": "silicone",
    "segments": [{"magnetization": [1, 0, 0]}],
}


class Body(Part):
    """What moves."""

    catheter: Catheter = Field(
        description="A straight rod, base at the origin, axis +x.",
        examples=[CATHETER],
    )


_Component = Annotated[float, Quantity("flux density", at_least="-20 T", at_most="20 T")]
_AccelerationComponent = Annotated[
    float, Quantity("acceleration", at_least="-1e4 m/s^2", at_most="1e4 m/s^2")
]


class FieldSource(Part):
    """The outside magnetic field."""

    uniform: Annotated[tuple[_Component, _Component, _Component], three("[0 mT, 6 mT, 8 mT]")] = Field(
        default=(0.0, 0.0, 0.0),
        description="Flux density, the same everywhere: [x, y, z].",
        examples=[["0 mT", "6 mT", "8 mT"]],
    )


class MagneticTorque(Part):
    """The outside field turns the magnetised segments. No settings."""


class Gravity(Part):
    """Weight."""

    acceleration: Annotated[
        tuple[_AccelerationComponent, _AccelerationComponent, _AccelerationComponent],
        three("[0 m/s^2, 0 m/s^2, -9.81 m/s^2]"),
    ] = Field(
        default=(0.0, 0.0, -9.81),
        description="9.81 m/s^2 along -z unless given: [x, y, z].",
        examples=[["0 m/s^2", "0 m/s^2", "-9.81 m/s^2"]],
    )


class Effects(Part):
    """What is simulated: an effect that is not named costs nothing."""

    not_there_yet: ClassVar[Mapping[str, str]] = {
        "magnetic_force": "the pull of a field gradient",
        "magnetic_interaction": "segments acting on each other",
        "damping": "resistance of the surroundings",
        "viscosity": "losses in the material",
        "ground": "contact with a plane",
        "walls": "contact with a lumen",
        "self_contact": "the body touching itself",
        "feed": "pushing the base forward",
    }
    magnetic_torque: MagneticTorque | None = Field(
        default=None, description="The outside field turns the magnetised segments: {}.", examples=[{}]
    )
    gravity: Gravity | None = Field(
        default=None, description="Weight: {} for 9.81 m/s^2 along -z.", examples=[{}]
    )


class StaticOptions(Part):
    """Equilibrium: how it is sought."""

    anti_locking: Literal["f-bar", "none"] = Field(
        default="f-bar",
        description="Cure for volumetric locking: f-bar (unless given) or none.",
        examples=["f-bar"],
    )
    tolerance: float = Field(
        default=1e-11,
        strict=True,
        ge=1e-14,
        le=1e-2,
        allow_inf_nan=False,
        description="Stops when a step can win less than this part of the energy; 1e-11 unless given.",
        examples=[1e-11],
    )
    max_steps: int = Field(
        default=60,
        strict=True,
        ge=1,
        le=10_000,
        description="Most Newton steps; 60 unless given.",
        examples=[60],
    )
    field_steps: int | None = Field(
        default=None,
        strict=True,
        ge=1,
        le=1000,
        description="Steps in which field and gravity grow from zero; chosen by the solver unless given.",
        examples=[10],
    )


class Solver(Part):
    """Statics or dynamics."""

    not_there_yet: ClassVar[Mapping[str, str]] = {"dynamic": "motion in time"}
    static: StaticOptions = Field(
        default=StaticOptions(), description="Equilibrium: {} for the usual settings.", examples=[{}]
    )


class Resolution(Part):
    """How fine the grid is."""

    not_there_yet: ClassVar[Mapping[str, str]] = {
        "error": "the grid chosen for a wanted error",
        "seconds": "the grid chosen for a time",
    }
    cells_across: int = Field(
        default=4,
        strict=True,
        ge=2,
        le=16,
        description="Grid cells across the diameter; 4 unless given.",
        examples=[4],
    )
    particles_per_cell: int = Field(
        default=2,
        strict=True,
        ge=2,
        le=4,
        description="Particles in a cell along each direction; 2 unless given; one point can't carry a cell's second moments.",
        examples=[2],
    )
