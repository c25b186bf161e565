"""The key `vary` of a study: what each trial may change, and within which bounds."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from magmpm.errors import InputError
from magmpm.inputs.quantities import KINDS, format_si
from magmpm.inputs.settings import Quantity, Settings, fault
from magmpm.inputs.vectors import Axis
from magmpm.materials import STIFFEST
from magmpm.scene import Scene

_Length = Annotated[float, Quantity("length", above="0 mm", at_most="10 m")]
_Diameter = Annotated[float, Quantity("length", above="0 mm", at_most="1 m")]
_Modulus = Annotated[float, Quantity("pressure", above="0 kPa", at_most=STIFFEST)]


class VaryDirections(Settings):
    """Directions of magnetization: of each magnetized segment or part, or of some; two angles each."""

    only: tuple[str, ...] | None = Field(
        default=None,
        min_length=1,
        description="Names of the segments or parts whose directions vary; all unless given.",
        examples=[["segment 1", "segment 2"]],
    )

    def regions(self, scene: Scene) -> list[int]:
        """Find the regions of a scene whose directions vary.

        Parameters
        ----------
        scene : Scene
            The scene.

        Returns
        -------
        list of int
            Their indices.

        Raises
        ------
        InputError
            For a name of no magnetized region.
        """
        names = {k: scene.regions()[k].name for k in scene.magnetized_regions()}
        for name in self.only or ():
            if name not in names.values():
                raise InputError(
                    "vary.magnetization.only",
                    received=repr(name),
                    rule="must be magnetized regions: "
                    + (", ".join(names.values()) or "the scene has none"),
                    remedy="correct the name",
                )
        return [k for k, name in names.items() if self.only is None or name in self.only]


class VaryField(Settings):
    """The uniform external field: its strength and two angles."""

    max: Annotated[float, Quantity("flux density", above="0 mT", at_most="20 T")] = Field(
        description="Greatest strength of the field.", examples=["10 mT"]
    )
    at: Literal["once", "each depth", "each time"] = Field(
        default="once",
        description=(
            "One field (once, unless given), or one at each depth of an `insertion` or each time of"
            " a `schedule`."
        ),
        examples=["each depth"],
    )


class Range(Settings):
    """Least and greatest value of a quantity."""

    kind: ClassVar[str]

    @field_validator("max", check_fields=False)
    @classmethod
    def _ordered(cls, most: float, info: ValidationInfo) -> float:
        least = info.data.get("min")
        if least is not None and not least < most:
            kind = KINDS[cls.kind]
            raise fault(
                f"max must be greater than min: max is {format_si(most, kind)}, min"
                f" {format_si(least, kind)}",
                "exchange them, or, to keep one value, write it in the scene and remove it from"
                " `vary`",
            )
        return most


class VaryLength(Range):
    """The length of each segment."""

    kind: ClassVar[str] = "length"
    min: _Length = Field(description="Least length of a segment.", examples=["4 mm"])
    max: _Length = Field(description="Greatest length of a segment.", examples=["12 mm"])
    total: Literal["keep", "free"] = Field(
        default="keep",
        description=(
            "Whether the body keeps its length (keep, unless given) or is as long as its segments"
            " (free)."
        ),
        examples=["free"],
    )


class VaryDiameter(Range):
    """The diameter of a catheter."""

    kind: ClassVar[str] = "length"
    min: _Diameter = Field(description="Least diameter.", examples=["2 mm"])
    max: _Diameter = Field(description="Greatest diameter.", examples=["4 mm"])


class VaryRemanence(Range):
    """The remanence of the magnetic materials."""

    kind: ClassVar[str] = "flux density"
    min: Annotated[float, Quantity("flux density", at_least="0 mT", at_most="3 T")] = Field(
        description="Least remanence.", examples=["50 mT"]
    )
    max: Annotated[float, Quantity("flux density", above="0 mT", at_most="3 T")] = Field(
        description="Greatest remanence.", examples=["150 mT"]
    )
    per: Literal["material", "segment"] = Field(
        default="material",
        description=(
            "One value for each magnetic material (unless given) or one for each magnetized"
            " segment."
        ),
        examples=["segment"],
    )


class VaryShearModulus(Range):
    """The stiffness of the body's materials."""

    kind: ClassVar[str] = "pressure"
    min: _Modulus = Field(description="Least shear modulus.", examples=["50 kPa"])
    max: _Modulus = Field(description="Greatest shear modulus.", examples=["500 kPa"])
    per: Literal["material", "segment"] = Field(
        default="material",
        description="One value for each material (unless given) or one for each segment.",
        examples=["segment"],
    )


class VaryOrder(Settings):
    """The order of magnetized and plain segments. No settings."""


class FreeDirection(Settings):
    """A direction: two angles, or one in a plane."""

    across: Axis | None = Field(
        default=None,
        description="It turns about this axis, in the plane across it: one angle. Free unless given.",
        examples=[[0, 1, 0]],
    )
    at_most: Annotated[float, Quantity("angle", at_least="0.1 deg", at_most="180 deg")] | None = (
        Field(
            default=None,
            description=(
                "With `across`: how far it turns from the scene's own to either side. Half a turn"
                " unless given."
            ),
            examples=["45 deg"],
        )
    )

    @model_validator(mode="after")
    def _in_a_plane(self) -> FreeDirection:
        if self.at_most is not None and self.across is None:
            raise fault(
                "at_most is for a direction in a plane",
                "add `across: [0, 1, 0]`, the axis of the turn",
                ("at_most",),
            )
        return self


class Addressed(Settings):
    """A number of the scene, or several, by their addresses."""

    of: str | tuple[str, ...] = Field(
        min_length=1,
        description=(
            "Its address: the keys of the scene's file, dots between them, [i] or [*] for lists; or"
            " a list of them."
        ),
        examples=["effects.gravity.acceleration[0]"],
    )

    @property
    def addresses(self) -> tuple[str, ...]:
        """All of its addresses."""
        return self.of if isinstance(self.of, tuple) else (self.of,)


class VaryNumber(Addressed):
    """A number of the scene, or several that share one value: bounds, choices, or a direction."""

    min: Any = Field(default=None, description="Least value, with its unit.", examples=["2 Hz"])
    max: Any = Field(default=None, description="Greatest value, with its unit.", examples=["20 Hz"])
    log: bool = Field(
        default=False, description="Whether the search is on a logarithmic scale.", examples=[True]
    )
    choices: tuple[Any, ...] | None = Field(
        default=None,
        min_length=2,
        max_length=1000,
        description="The values to choose from.",
        examples=[["0.2 mm", "0.3 mm"]],
    )
    direction: FreeDirection | None = Field(
        default=None, description="It is a direction, which turns: {}.", examples=["{}"]
    )
    within: Any = Field(
        default=None,
        description=(
            "It is a vector of at most this length, with its unit: a strength and a direction."
        ),
        examples=["10 mT"],
    )
    turned_about: Axis | None = Field(
        default=None,
        description=(
            "Of tied directions: they stand around this axis, each turned from the one before by an"
            " equal share of a full turn."
        ),
        examples=[[0, 0, 1]],
    )

    @model_validator(mode="after")
    def _one_way(self) -> VaryNumber:
        vector = self.direction is not None or self.within is not None
        if self.turned_about is not None and not (vector and isinstance(self.of, tuple)):
            raise fault(
                "turned_about is for a list of directions",
                "give `of` a list of addresses, and `direction: {}`",
                ("turned_about",),
            )
        ways = (self.min is not None, self.choices is not None, vector)
        if sum(ways) != 1 or (self.min is None) != (self.max is None):
            raise fault(
                "must have min and max, or choices, or a direction, or within",
                "write, say, `{of: field.uniform[2], min: 2 mT, max: 8 mT}`",
            )
        return self


class VaryAnything(Settings):
    """Numbers and directions of a scene that trials change."""

    magnetization: VaryDirections | None = Field(
        default=None, description="The direction of each magnetized region: {}.", examples=["{}"]
    )
    length: VaryLength | None = Field(
        default=None,
        description="The length of each segment, within bounds.",
        examples=["{min: 4 mm, max: 12 mm}"],
    )
    order: VaryOrder | None = Field(
        default=None,
        description="The order of magnetized and plain segments along the body: {}.",
        examples=["{}"],
    )
    numbers: tuple[VaryNumber, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=1000,
        description="Any numbers of the scene, by their addresses.",
        examples=[[{"of": "field.uniform[2]", "min": "2 mT", "max": "8 mT"}]],
    )

    @model_validator(mode="after")
    def _something(self) -> VaryAnything:
        if all(getattr(self, key) is None for key in type(self).model_fields):
            raise fault("a study must vary something", "add `magnetization: {}`, or `numbers`")
        return self


class Vary(VaryAnything):
    """Variables that a study with a target may change: names of addresses among them."""

    field: VaryField | None = Field(
        default=None,
        description="The external field, up to a greatest strength.",
        examples=["{max: 10 mT}"],
    )
    diameter: VaryDiameter | None = Field(
        default=None,
        description="The catheter's diameter, within bounds.",
        examples=["{min: 2 mm, max: 4 mm}"],
    )
    remanence: VaryRemanence | None = Field(
        default=None,
        description="The remanence of the magnetic materials, within bounds.",
        examples=["{min: 50 mT, max: 150 mT}"],
    )
    shear_modulus: VaryShearModulus | None = Field(
        default=None,
        description="The shear modulus of the materials, within bounds.",
        examples=["{min: 50 kPa, max: 500 kPa}"],
    )
