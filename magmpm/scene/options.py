"""Settings of a scene: materials, solver, resolution; with their rules. Bodies, fields and effects have theirs in their own rooms.

The descriptions and examples are what editors show (scene.schema.json) and what error messages quote.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from magmpm.inputs.settings import Quantity, Settings, fault, from_file
from magmpm.scene.motion_options import DynamicOptions, QuasiStaticOptions


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
    """Statics, quasi-statics or dynamics, one of them, and the settings that all share."""

    anti_locking: Literal["f-bar", "none"] = Field(
        default="f-bar",
        description="Cure for volumetric locking, in equilibrium and in motion: f-bar (unless given) or none.",
        examples=["f-bar"],
    )
    static: StaticOptions = Field(
        default=StaticOptions(),
        description="Equilibrium: {} for the usual settings; give this, `quasi_static` or `dynamic`.",
        examples=[{}],
    )
    dynamic: DynamicOptions | None = Field(
        default=None,
        description="Motion in time, from rest: at least {duration: 0.5 s}; give this, `quasi_static` or `static`.",
        examples=[{"duration": "0.5 s", "output_every": "5 ms"}],
    )
    quasi_static: QuasiStaticOptions | None = Field(
        default=None,
        description="Equilibria along time, each from the one before: {steps: 40}; give this, `dynamic` or `static`.",
        examples=[{"steps": 40}],
    )

    @model_validator(mode="after")
    def _one_solver(self, info: ValidationInfo) -> Solver:
        """One kind of solve has no use for the settings of another; plain SI data hold all three, with the usual settings of statics."""
        given = [key for key in ("quasi_static", "dynamic") if getattr(self, key) is not None]
        if "static" in self.model_fields_set and (from_file(info) or self.static != StaticOptions()):
            given.insert(0, "static")
        if len(given) > 1:
            raise fault(
                "give `static`, `quasi_static` or `dynamic`, one of them: a scene is solved for its equilibrium, for equilibria along "
                f"time, or for its motion; this has {' and '.join(f'`{key}`' for key in given)}",
                "remove one of them; what all use, `anti_locking`, stands beside them in `solver`",
            )
        return self


class Resolution(Settings):
    """How fine the grid is."""

    not_there_yet: ClassVar[Mapping[str, str]] = {
        "error": "the grid chosen for a given error",
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
