"""Content of a study file: its keys, their values, and which of them go together.

python -m magmpm.studies.problem.study_file         # rewrites studies/study.schema.json, by which editors complete and explain study files
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
    WithJsonSchema,
    field_validator,
    model_validator,
)

from magmpm.compiled.arrays import Named
from magmpm.errors import show
from magmpm.inputs.messages import Instead, plain_word
from magmpm.inputs.settings import Key, Quantity, Settings, check_rising, fault, write_json_schema
from magmpm.inputs.vectors import Axis
from magmpm.scene import Scene
from magmpm.studies.problem.sampler_names import NAMES, known_sampler
from magmpm.studies.problem.variables import Addressed, Vary

MOST_TRIALS = 1_000_000
MOST_DEPTHS = 200
SCHEMA = Path(__file__).parents[1] / "study.schema.json"


class Match(Settings):
    """Target with which the body's shape is compared: one of these."""

    centreline: str | None = Field(
        default=None,
        min_length=1,
        description="Path, relative to this file, of a CSV table with columns s_mm,x_mm,y_mm,z_mm.",
        examples=["../targets/s_shape.csv"],
    )
    path: str | None = Field(
        default=None,
        min_length=1,
        description=(
            "Of an insertion: path, relative to this file, of a CSV table of the path from the"
            " guide's exit on, columns s_mm,x_mm,y_mm,z_mm."
        ),
        examples=["../targets/vessel_s.csv"],
    )

    one_of = ("centreline", "path")
    written = "centreline: ../targets/s_shape.csv"


class MatchAt(Settings):
    """A shape of a schedule, and when the body must have it."""

    time: Annotated[float, Quantity("time", above="0 s", at_most="100000 s")] = Field(
        description="When the body must have this shape.", examples=["1 s"]
    )
    centreline: str = Field(
        min_length=1,
        description="Path, relative to this file, of a CSV table with columns s_mm,x_mm,y_mm,z_mm.",
        examples=["../targets/s_shape.csv"],
    )


class Stop(Settings):
    """Condition under which a study is done before its last trial."""

    rms: Annotated[float, Quantity("length", above="0 mm", at_most="10 m")] = Field(
        description="Root mean square distance to the target at which the study ends.",
        examples=["2 mm"],
    )


_Depth = Annotated[float, Quantity("length", above="0 mm", at_most="10 m")]


def _depths(value: Any) -> Any:
    """Checks that depths are a number or a list, before its entries are looked at."""
    if isinstance(value, bool) or not isinstance(value, (int, list, tuple)):
        raise fault(
            "must be how many depths there are, or a list of lengths",
            "write, say, `depths: 12` or `depths: [10 mm, 20 mm]`",
        )
    if isinstance(value, int) and not 1 <= value <= MOST_DEPTHS:
        raise fault(f"there must be 1 to {MOST_DEPTHS} depths", "write, say, `depths: 12`")
    return value


class Insertion(Settings):
    """Lengths of a catheter outside its guide at which its shape is compared with its path."""

    depths: Annotated[
        Annotated[int, Tag("count")]
        | Annotated[tuple[_Depth, ...], Field(min_length=1, max_length=MOST_DEPTHS), Tag("list")],
        Discriminator(lambda value: "count" if isinstance(value, int) else "list"),
        BeforeValidator(_depths),
    ] = Field(
        default=12,
        description=(
            "How many depths, equally spaced up to the whole path; or a list of inserted lengths,"
            " increasing. 12 unless given."
        ),
        examples=[12],
    )

    @field_validator("depths")
    @classmethod
    def _rising(cls, depths: int | tuple[float, ...]) -> int | tuple[float, ...]:
        if isinstance(depths, tuple):
            check_rising([1e3 * depth for depth in depths], "depths", "mm")
        return depths


class Schedule(Settings):
    """A field over time that brings the body through the shapes of `match`."""

    hold: Annotated[float, Quantity("time", at_least="0 s", at_most="100000 s")] = Field(
        default=0.0,
        description="How long the field is held after the last time; 0 s unless given.",
        examples=["0.2 s"],
    )


_Percentage = Annotated[float, Quantity("percentage", at_least="0 %", at_most="50 %")]


class RobustNumber(Addressed):
    """A number of the scene that is made with an error, or several that share one."""

    deviation: Any = Field(
        description=(
            "Its standard deviation: a percentage of its value, or in its own unit; of a direction"
            " an angle, along each of two axes across it."
        ),
        examples=["5 %"],
    )


class Robust(Settings):
    """Standard deviations of the errors that a design is made with."""

    direction: Annotated[float, Quantity("angle", at_least="0 deg", at_most="45 deg")] = Field(
        default=0.0,
        description=(
            "Of each segment's direction, along each of two axes across it; 0 deg unless given."
        ),
        examples=["5 deg"],
    )
    remanence: _Percentage = Field(
        default=0.0,
        description="Of each material's remanence, of its value; 0 % unless given.",
        examples=["5 %"],
    )
    shear_modulus: _Percentage = Field(
        default=0.0,
        description="Of each material's shear modulus, of its value; 0 % unless given.",
        examples=["5 %"],
    )
    numbers: tuple[RobustNumber, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=1000,
        description="Of any numbers of the scene, by their addresses.",
        examples=[[{"of": "field.uniform[*]", "deviation": "0.1 mT"}]],
    )

    @model_validator(mode="after")
    def _something(self) -> Robust:
        if not any((self.direction, self.remanence, self.shear_modulus, self.numbers)):
            raise fault(
                "robust must have an error that is not zero",
                "write, say, `robust: {direction: 5 deg}`",
            )
        return self


class Stability(Settings):
    """Stability that a design must have to be accepted."""

    margin: float = Field(
        strict=True,
        ge=0.0,
        lt=1.0,
        allow_inf_nan=False,
        description=(
            "Least stability of a design: the smallest eigenvalue of the tangent over that of the"
            " unloaded body, 1 at rest, 0 at a critical load."
        ),
        examples=[0.1],
    )


class Limits(Settings):
    """Limits of manufacture."""

    directions: tuple[Axis, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=100,
        description=(
            "The directions in which segments can be magnetized, each [x, y, z] or {azimuth: ...,"
            " elevation: ...}."
        ),
        examples=[[[1, 0, 0], [0, 0, 1]]],
    )
    at_most: int | None = Field(
        default=None,
        strict=True,
        ge=1,
        le=1000,
        description="How many different directions there may be.",
        examples=[3],
    )

    @model_validator(mode="after")
    def _something(self) -> Limits:
        if self.directions is None and self.at_most is None:
            raise fault("limits must limit something", "write, say, `limits: {at_most: 3}`")
        return self


class Search(Settings):
    """Keys of every study: the scene, the number of trials, and the seed."""

    scene: str = Field(
        min_length=1,
        description="Path of the scene, relative to this file.",
        examples=["../scenes/five_segments.yaml"],
    )
    trials: int = Field(
        default=35,
        strict=True,
        ge=1,
        le=MOST_TRIALS,
        description="Total number of trials; 35 unless given.",
        examples=[35],
    )
    seed: int = Field(
        default=1,
        strict=True,
        ge=0,
        le=2**32 - 1,
        description="The same seed gives the same trials; 1 unless given.",
        examples=[1],
    )


class StudyFile(Search):
    """A study: the scene, what is varied, what it must match, and how it is searched."""

    @staticmethod
    def by_other_keys(key: str, values: Named) -> Instead | None:
        """Say where keys of a scene belong."""
        if plain_word(key) not in Scene.model_fields:
            return None
        if "scene" not in values:
            return Instead("it belongs in the scene's file")
        return Instead(f"it belongs in the scene, the file {show(values['scene'])}")

    vary: Vary = Field(description="What the study may change.", examples=["{magnetization: {}}"])
    match: Annotated[
        Annotated[Match, Tag("one")]
        | Annotated[tuple[MatchAt, ...], Field(min_length=1, max_length=MOST_DEPTHS), Tag("list")],
        Discriminator(lambda value: "list" if isinstance(value, (list, tuple)) else "one"),
    ] = Field(
        description=(
            "The target shape; of an insertion its path; of a schedule a list of {time,"
            " centreline}."
        ),
        examples=["{centreline: ../targets/s_shape.csv}"],
    )
    insertion: Insertion | None = Field(
        default=None,
        description="The catheter is pushed along `match.path`: how far, and how often.",
        examples=["{depths: 12}"],
    )
    schedule: Schedule | None = Field(
        default=None,
        description="The field brings the body through the shapes of `match`: {} or {hold: 0.2 s}.",
        examples=["{}"],
    )
    minimize: tuple[Literal["rms", "largest_field", "magnetized_volume"], ...] = Field(
        default=("rms",),
        min_length=1,
        max_length=2,
        description=(
            "rms, unless given; or rms and a second objective, largest_field or magnetized_volume."
        ),
        examples=["[rms, largest_field]"],
    )
    robust: Robust | None = Field(
        default=None,
        description=(
            "Judge each design by the mean of its rms plus two standard deviations, for these"
            " errors of manufacture."
        ),
        examples=["{direction: 5 deg, remanence: 5 %, shear_modulus: 5 %}"],
    )
    stability: Stability | None = Field(
        default=None,
        description="Refuse designs whose equilibrium is nearer to a critical load than this.",
        examples=["{margin: 0.1}"],
    )
    limits: Limits | None = Field(
        default=None, description="What can be made.", examples=["{at_most: 3}"]
    )
    sampler: Annotated[
        str | None,
        BeforeValidator(known_sampler),
        WithJsonSchema({"type": "string", "enum": list(NAMES)}),
    ] = Field(
        default=None,
        description=(
            "How trials are chosen; unless given, gauss-newton where what varies has derivatives,"
            " else tpe."
        ),
        examples=["gauss-newton"],
    )
    start: Literal["rod"] | None = Field(
        default=None,
        description="Begin with the best designs of the rod model; not unless given.",
        examples=["rod"],
    )
    stop: Stop | None = Field(
        default=None,
        description="Ends the study early, when it is good enough.",
        examples=["{rms: 2 mm}"],
    )

    @field_validator("match")
    @classmethod
    def _rising(cls, match: Match | tuple[MatchAt, ...]) -> Match | tuple[MatchAt, ...]:
        if isinstance(match, tuple):
            check_rising([shape.time for shape in match], "times", "s", "time")
        return match

    @model_validator(mode="after")
    def _go_together(self) -> StudyFile:
        for broken in (
            self._of_the_match,
            self._of_the_field,
            self._of_the_limits,
            self._of_the_objectives,
        ):
            found = broken()
            if found is not None:
                raise fault(*found)
        return self

    def _of_the_match(self) -> tuple[str, str, Key] | None:
        """Fault in the combination of `match`, `insertion` and `schedule`, which need each other."""
        listed = not isinstance(self.match, Match)
        path = isinstance(self.match, Match) and self.match.path is not None
        if self.insertion is not None and not path:
            return (
                "an insertion follows a path",
                "write `match: {path: ...}`, or remove `insertion`",
                ("insertion",),
            )
        if path and self.insertion is None:
            remedy = "add `insertion: {depths: 12}`, or write `match: {centreline: ...}`"
            return "a path is followed by an insertion", remedy, ("match", "path")
        if self.schedule is not None and not listed:
            rule = "a schedule brings the body through shapes at given times"
            return (
                rule,
                "write `match: [{time: 1 s, centreline: ...}, ...]`, or remove `schedule`",
                ("schedule",),
            )
        if listed and self.schedule is None:
            return (
                "shapes at given times need a schedule",
                "add `schedule: {}`, or write `match: {centreline: ...}`",
                ("match",),
            )
        return None

    def _of_the_field(self) -> tuple[str, str, Key] | None:
        """A field at each depth needs depths, one at each time needs times."""
        field = self.vary.field
        at = "once" if field is None else field.at
        place: Key = ("vary", "field", "at")
        if at == "each depth" and self.insertion is None:
            return (
                "a field at each depth needs an insertion",
                "add `insertion` and `match.path`, or remove `at`",
                place,
            )
        if at == "each time" and self.schedule is None:
            return (
                "a field at each time needs a schedule",
                "add `schedule` and a list in `match`, or remove `at`",
                place,
            )
        if self.schedule is not None and at != "each time":
            rule = "a schedule varies the field at each time"
            return rule, "write `field: {max: 10 mT, at: each time}` in `vary`", ("vary",)
        for key, called in (("insertion", "an insertion"), ("schedule", "a schedule")):
            if self.robust is not None and getattr(self, key) is not None:
                rule = f"robust judges one equilibrium of each design, and {called} has several"
                return rule, f"remove `robust`, or `{key}`", ("robust",)
        geometry = [
            key for key in ("length", "diameter", "order") if getattr(self.vary, key) is not None
        ]
        every = [address for number in self.vary.numbers or () for address in number.addresses]
        of_body = [address for address in every if address.startswith("body.")]
        if of_body and self.insertion is not None:
            rule = (
                "an insertion pushes one catheter to many depths, which have parts of its segments"
            )
            remedy = "remove it; directions vary by `magnetization: {only: [segment 1]}`"
            return f"{rule}, so {of_body[0]} can't vary", remedy, ("vary", "numbers")
        if geometry and self.insertion is not None:
            rule = (
                "an insertion pushes one catheter to many depths, and so can't vary its"
                f" {geometry[0]}"
            )
            return rule, f"remove `{geometry[0]}`", ("vary", geometry[0])
        return None

    def _of_the_limits(self) -> tuple[str, str, Key] | None:
        """Limits of directions, for directions that vary."""
        if self.limits is not None and self.vary.magnetization is None:
            rule = "limits apply to directions that `magnetization` varies, and this study has none"
            return rule, "add `magnetization: {}` to `vary`, or remove `limits`", ("limits",)
        if self.limits is not None and self.limits.directions is not None:
            different = len(set(self.limits.directions))
            if different < len(self.limits.directions):
                return (
                    "each direction must be there once",
                    "remove those that repeat another",
                    ("limits", "directions"),
                )
            varied = [
                key for key in type(self.vary).model_fields if getattr(self.vary, key) is not None
            ]
            if different == 1 and varied == ["magnetization"]:
                rule = "a set of one direction leaves one design, and nothing else varies"
                return (
                    rule,
                    "allow two directions or more, or vary the field as well",
                    ("limits", "directions"),
                )
        return None

    def _of_the_objectives(self) -> tuple[str, str, Key] | None:
        """A second objective must be one that a trial can change, for a sampler that takes two."""
        if self.minimize[0] != "rms" or len(set(self.minimize)) < len(self.minimize):
            return (
                "the first objective is rms, the second another",
                "write, say, `minimize: [rms, largest_field]`",
                ("minimize",),
            )
        second = self.minimize[1:]
        if second == ("largest_field",) and self.vary.field is None:
            rule = "largest_field is that of `field`, which this study does not vary by this name"
            return rule, "add `field: {max: 10 mT}` to `vary`", ("minimize",)
        if (
            second == ("magnetized_volume",)
            and self.vary.length is None
            and self.vary.diameter is None
        ):
            rule = (
                "magnetized_volume is that of `length` and `diameter`, which this study does not"
                " vary by these names"
            )
            return (
                rule,
                "add `length: {min: 4 mm, max: 12 mm}` or `diameter: {...}` to `vary`",
                ("minimize",),
            )
        return None


if __name__ == "__main__":
    write_json_schema(StudyFile, SCHEMA)
    print(SCHEMA)
