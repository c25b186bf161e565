"""A magnetization that varies along a body."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from magmpm.inputs.settings import Quantity, Settings, fault
from magmpm.inputs.vectors import Vector

REGIONS_A_PERIOD = 8  # regions by which a turn is shown and measured, and the fewest cells that resolve it


class Harmonic(Settings):
    """A direction of magnetization that turns steadily along the length."""

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
        description="Angle at the base, from the plane's first axis toward its second; 0 deg unless given.",
        examples=["45 deg"],
    )
    plane: Literal["xz", "xy", "yz"] = Field(
        default="xz", description="Plane in which the direction turns; xz unless given.", examples=["xz"]
    )
    turn: Literal["ccw", "cw"] = Field(
        default="ccw",
        description="Along +x the angle grows (ccw: from the plane's first axis toward its second, unless given) or shrinks (cw).",
        examples=["cw"],
    )

    @model_validator(mode="after")
    def _one_pitch(self) -> Harmonic:
        if (self.wavelength is None) == (self.periods is None):
            raise fault("give `wavelength` or `periods`, one of them", "write, say, `harmonic: {periods: 1, phase: 45 deg}`")
        return self

    def turns(self, length: float) -> float:
        """Full turns along a length (m)."""
        return self.periods if self.periods is not None else length / (self.wavelength or length)


class Profile(Settings):
    """A magnetization that varies along the length."""

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
