"""The key `body` of a scene: one body, of one of the kinds there are."""

from __future__ import annotations

from typing import Any

from pydantic import ConfigDict, Field, field_validator, model_validator

from magmpm.bodies.assembly import Parts
from magmpm.bodies.body_shape import BodyShape
from magmpm.bodies.catheter import Catheter, Tube
from magmpm.bodies.strip import Strip
from magmpm.inputs.settings import Settings, standing_for

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
    """The body that moves: one of these."""

    model_config = ConfigDict(json_schema_extra={"minProperties": 1, "maxProperties": 1})

    catheter: Catheter | None = Field(
        default=None,
        description="A straight round rod or tube from the origin along +x.",
        examples=[CATHETER],
    )
    strip: Strip | None = Field(
        default=None, description="A strip or sheet, flat in x and y.", examples=[STRIP]
    )

    parts: Parts | None = Field(
        default=None, description="STL meshes, one a part.", examples=[PARTS]
    )

    @model_validator(mode="before")
    @classmethod
    def _of_a_shape(cls, data: Any) -> Any:
        """A catheter, strip or parts made in Python stands for the body with that key."""
        return standing_for(data, {Catheter: "catheter", Strip: "strip", Parts: "parts"})

    @field_validator("catheter", mode="before")
    @classmethod
    def _of_a_tube(cls, catheter: Any) -> Any:
        """Take a Tube, which users make in Python, as the catheter with its settings."""
        return catheter.model_dump(exclude_unset=True) if isinstance(catheter, Tube) else catheter

    one_of = ("catheter", "strip", "parts")
    written = "catheter: {length: 40 mm, diameter: 4 mm, ...}"

    @property
    def kind(self) -> str:
        """The key that is given: catheter, strip or parts."""
        return self.given

    @property
    def shape(self) -> BodyShape:
        """The body itself, of whatever kind."""
        shape: BodyShape = getattr(self, self.kind)
        return shape
