"""Settings of changes in time: `solver: {dynamic: ...}`, motion, or `solver: {quasi_static: ...}`, equilibria."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from magmpm.inputs.settings import Quantity, Settings, fault, from_file

MOST_FRAMES = 100_000


class DynamicOptions(Settings):
    """Motion in time by explicit steps."""

    duration: Annotated[float, Quantity("time", above="0 s", at_most="1e4 s")] = Field(
        description="How long the motion is followed.", examples=["0.5 s"]
    )
    output_every: Annotated[float, Quantity("time", above="0 s", at_most="1e4 s")] | None = Field(
        default=None, description="Time between frames on disk; a hundredth of the duration unless given.", examples=["5 ms"],
    )  # fmt: skip
    time_step: Annotated[float, Quantity("time", above="0 s", at_most="1 s")] | None = Field(
        default=None, description="Time step; chosen below the stable bound unless given, and refused above it.", examples=["10 us"],
    )  # fmt: skip
    safety: float = Field(
        default=0.8, gt=0, le=1, strict=True, allow_inf_nan=False,
        description="Chosen time step over the largest stable one; 0.8 unless given.", examples=[0.8],
    )  # fmt: skip
    max_disk: Annotated[float, Quantity("size", above="0 B", at_most="1e15 B")] | None = Field(
        default=None, description="What the motion's files may take; all there is unless given.", examples=["2 GB"]
    )
    max_memory: Annotated[float, Quantity("size", above="0 B", at_most="1e15 B")] | None = Field(
        default=None, description="What particles and grid may take in memory; all there is unless given.", examples=["4 GB"],
    )  # fmt: skip

    @model_validator(mode="before")
    @classmethod
    def _one_formulation(cls, given: Any, info: ValidationInfo) -> Any:
        if not isinstance(given, Mapping) or "formulation" not in given:
            return given
        if given["formulation"] not in (None, "total") or from_file(info):  # results of earlier versions hold None or total
            rule = "there is one formulation of motion, total Lagrangian, in which bodies touch themselves too, so there is no such key"
            raise fault(rule, "leave it out", ("formulation",))
        return {key: value for key, value in given.items() if key != "formulation"}

    @model_validator(mode="after")
    def _frames_can_be_counted(self) -> DynamicOptions:
        frames = self.duration / (self.output_every or self.duration)
        if frames > MOST_FRAMES * (1 + 1e-9):
            raise fault(
                f"a motion has at most {MOST_FRAMES} frames, and this would have {frames:.4g}",
                f"at least `output_every: {self.duration / MOST_FRAMES:.3g} s`, or leave it out for a hundred frames, here "
                f"`output_every: {10 * self.duration:.3g} ms`",
                ("output_every",),
            )
        return self

    @property
    def frame_interval(self) -> float:
        """Time between frames, s."""
        return self.output_every or self.duration / 100

    @property
    def frame_times(self) -> list[float]:
        """Times of the frames after the first, s: every `output_every`, and the end."""
        every = self.frame_interval
        count = int(self.duration / every * (1 + 1e-12))
        times = [k * every for k in range(1, count + 1)]
        return times if times and times[-1] > self.duration * (1 - 1e-9) else [*times, self.duration]


class QuasiStaticOptions(Settings):
    """Equilibria along time, each found from the one before."""

    steps: int | None = Field(
        default=None, strict=True, ge=1, le=MOST_FRAMES - 1,
        description="Equal steps from 0 s to the end of the field's schedule, or of `duration`; give this or `at`.", examples=[40],
    )  # fmt: skip
    at: tuple[Annotated[float, Quantity("time", at_least="0 s", at_most="1e6 s")], ...] | None = Field(
        default=None, min_length=2, max_length=MOST_FRAMES, description="Times of the equilibria, rising; give this or `steps`.",
        examples=[["0 s", "0.1 s", "0.15 s"]],
    )  # fmt: skip
    duration: Annotated[float, Quantity("time", above="0 s", at_most="1e6 s")] | None = Field(
        default=None,
        description="With `steps`: when the last equilibrium is; the end of the field's schedule unless given.",
        examples=["0.5 s"],
    )
    max_disk: Annotated[float, Quantity("size", above="0 B", at_most="1e15 B")] | None = Field(
        default=None, description="What the files of all steps may take; all there is unless given.", examples=["2 GB"]
    )

    @field_validator("at")
    @classmethod
    def _rising(cls, times: tuple[float, ...] | None) -> tuple[float, ...] | None:
        for k, (before, now) in enumerate(zip(times or (), (times or ())[1:]), start=1):
            if not now > before:
                raise fault(
                    f"times must rise; this one, {now:g} s, follows {before:g} s",
                    "sort them, each time once; a load that returns is a field whose schedule returns",
                    (k,),
                )
        return times

    @model_validator(mode="after")
    def _one_way_to_say_when(self) -> QuasiStaticOptions:
        if self.steps is None and self.at is None:
            raise fault("it must say when: `steps` or `at`", "write, say, `quasi_static: {steps: 40}`")
        if self.at is not None:
            for key in ("steps", "duration"):
                if getattr(self, key) is not None:
                    raise fault(f"`at` says when the equilibria are, and so does `{key}`", f"remove `at` or `{key}`", (key,))
        return self

    def times(self, schedule_end: float) -> list[float]:
        """Times (s) of all equilibria. schedule_end: s, when everything in the field's schedule that ends has ended."""
        if self.at is not None:
            return list(self.at)
        assert self.steps is not None  # _one_way_to_say_when
        end = self.duration if self.duration is not None else schedule_end
        return [float(time) for time in np.linspace(0.0, end, self.steps + 1)]
