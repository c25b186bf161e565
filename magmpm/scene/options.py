"""The parts of a scene (bodies: shapes.py, fields: field_parts.py): materials, effects, solver; their rules and documentation.

The descriptions and examples are what editors show (scene.schema.json) and what error messages quote.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from magmpm.inputs.settings import Quantity, Settings, fault, from_file
from magmpm.inputs.vectors import three
from magmpm.scene.motion_options import DynamicOptions
from magmpm.scene.surroundings import Damping, Feed, Ground, SelfContact, Viscosity, Walls


class Material(Settings):
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


_AccelerationComponent = Annotated[
    float, Quantity("acceleration", at_least="-1e4 m/s^2", at_most="1e4 m/s^2")
]


class MagneticTorque(Settings):
    """The outside field turns the magnetised segments. No settings."""


class MagneticForce(Settings):
    """An outside field that varies in space pulls the magnetised segments. No settings."""


class MagneticInteraction(Settings):
    """The magnetised segments turn and pull each other."""

    blocks_across: int = Field(
        default=3,
        strict=True,
        ge=1,
        le=5,
        description="Dipoles that stand for a segment, across its thickness (and as densely along it); 3 unless given.",
        examples=[3],
    )


class Gravity(Settings):
    """Weight."""

    acceleration: Annotated[
        tuple[_AccelerationComponent, _AccelerationComponent, _AccelerationComponent],
        three("[0 m/s^2, 0 m/s^2, -9.81 m/s^2]"),
    ] = Field(
        default=(0.0, 0.0, -9.81),
        description="9.81 m/s^2 along -z unless given: [x, y, z].",
        examples=[["0 m/s^2", "0 m/s^2", "-9.81 m/s^2"]],
    )


class Effects(Settings):
    """What is simulated: an effect that is not named costs nothing."""

    @property
    def in_a_field(self) -> bool:
        """Whether an effect of the outside field is named."""
        return self.magnetic_torque is not None or self.magnetic_force is not None

    magnetic_torque: MagneticTorque | None = Field(
        default=None, description="The outside field turns the magnetised segments: {}.", examples=[{}]
    )
    magnetic_force: MagneticForce | None = Field(
        default=None,
        description="A field that varies in space pulls the magnetised segments: {}. A uniform field does not pull.",
        examples=[{}],
    )
    magnetic_interaction: MagneticInteraction | None = Field(
        default=None, description="The magnetised segments turn and pull each other: {}.", examples=[{}]
    )
    gravity: Gravity | None = Field(
        default=None, description="Weight: {} for 9.81 m/s^2 along -z.", examples=[{}]
    )
    viscosity: Viscosity | None = Field(
        default=None,
        description="In motion: losses in the material (Kelvin-Voigt).",
        examples=[{"viscosity": "5 Pa s"}],
    )
    damping: Damping | None = Field(
        default=None,
        description="In motion: resistance of the surroundings, in proportion to mass.",
        examples=[{"rate": "60 1/s"}],
    )
    ground: Ground | None = Field(
        default=None,
        description="In motion: contact with a plane.",
        examples=[{"point": ["0 mm", "0 mm", "-2 mm"], "friction": 0.3}],
    )
    walls: Walls | None = Field(
        default=None,
        description="In motion: contact with the wall of a lumen.",
        examples=[
            {"tube": {"radius": "5 mm", "path": [["-10 mm", "0 mm", "0 mm"], ["60 mm", "0 mm", "0 mm"]]}}
        ],
    )
    self_contact: SelfContact | None = Field(
        default=None, description="In motion: the body touches itself and separates again: {}.", examples=[{}]
    )
    feed: Feed | None = Field(
        default=None,
        description="In motion: the base is pushed through a guide.",
        examples=[{"speed": "20 mm/s", "exit": "10 mm"}],
    )


class StaticOptions(Settings):
    """Equilibrium: how it is sought."""

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
        description="Most Newton steps of a solve; 60 unless given. Of STL parts, which have no rod's shape to start from, ten times this.",
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


class Solver(Settings):
    """Statics or dynamics, one of them, and the settings that both share."""

    anti_locking: Literal["f-bar", "none"] = Field(
        default="f-bar",
        description="Cure for volumetric locking, in equilibrium and in motion: f-bar (unless given) or none.",
        examples=["f-bar"],
    )
    static: StaticOptions = Field(
        default=StaticOptions(), description="Equilibrium: {} for the usual settings; give this or `dynamic`.", examples=[{}]
    )
    dynamic: DynamicOptions | None = Field(
        default=None,
        description="Motion in time, from rest: at least {duration: 0.5 s}; give this or `static`.",
        examples=[{"duration": "0.5 s", "output_every": "5 ms"}],
    )

    @model_validator(mode="after")
    def _one_solver(self, info: ValidationInfo) -> Solver:
        """A motion has no use for settings of equilibrium; plain SI data hold both, with the usual settings of statics."""
        if self.dynamic is not None and "static" in self.model_fields_set and (from_file(info) or self.static != StaticOptions()):
            raise fault(
                "give `static` or `dynamic`, one of them: a scene is solved for its equilibrium or for its motion",
                "remove one of them; what both use, `anti_locking`, stands beside them in `solver`",
            )
        return self


class Resolution(Settings):
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
        description="Grid cells across a catheter's diameter, a strip's thickness, or the thinnest part; 4 unless given.",
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
