"""Content of a study file with a `goal`: what it varies, what it makes larger or smaller, and within which limits.

python -m magmpm.studies.goals.goal_file         # rewrites studies/goal.schema.json, by which editors complete and explain such files
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from magmpm.inputs.settings import Settings, fault, write_json_schema
from magmpm.studies.goals.measures import Measure
from magmpm.studies.problem.study_file import Search
from magmpm.studies.problem.variables import VaryAnything

SCHEMA = Path(__file__).parents[1] / "goal.schema.json"
SLSQP = "slsqp"  # steps along derivatives
GAUSS_NEWTON = "gauss-newton"  # ... to targets alone
SAMPLERS = ("tpe", "gp", "cmaes", "nsga2", "random", SLSQP, GAUSS_NEWTON)


class Target(Measure):
    """A measure, and the value that it should have."""

    value: Any = Field(description="The value, with its unit.", examples=["3 mm"])


class Goal(Settings):
    """A goal: one of these keys."""

    maximize: Measure | None = Field(
        default=None,
        description="A measure to be as large as can be.",
        examples=["{travel: {of: body}}"],
    )
    minimize: Measure | None = Field(
        default=None,
        description="A measure to be as small as can be.",
        examples=["{contact_force: {with: walls}}"],
    )
    target: Target | None = Field(
        default=None,
        description="A measure to come near a value.",
        examples=["{displacement: {of: tip, along: [0, 0, 1]}, value: 3 mm}"],
    )

    @field_validator("maximize", "minimize", "target", mode="before")
    @classmethod
    def _single(cls, measure: Any) -> Any:
        if isinstance(measure, list):
            raise fault(
                "a goal has one measure",
                "make a list of goals: `goal: [{target: ...}, {target: ...}]`",
            )
        return measure

    one_of = ("maximize", "minimize", "target")
    written = "maximize: {travel: {of: body}}"

    @property
    def key(self) -> str:
        """Its key."""
        return self.given

    @property
    def measure(self) -> Measure:
        """Its measure."""
        found = getattr(self, self.key)
        assert isinstance(found, Measure)
        return found


class Constraint(Measure):
    """A measure, and the bounds within which it must stay."""

    at_most: Any = Field(
        default=None, description="Greatest value, with its unit.", examples=["20 mN"]
    )
    at_least: Any = Field(
        default=None, description="Least value, with its unit.", examples=["1 mm"]
    )

    @model_validator(mode="after")
    def _bounded(self) -> Constraint:
        if self.at_most is None and self.at_least is None:
            raise fault("must have at_most or at_least", "write, say, `at_most: 20 mN`")
        return self


class GoalFile(Search):
    """A study of anything: the scene, what is varied, what is sought, and how."""

    vary: VaryAnything = Field(description="What trials change.")
    goal: Annotated[
        Annotated[Goal, Tag("one")]
        | Annotated[tuple[Goal, ...], Field(min_length=1, max_length=200), Tag("list")],
        Discriminator(lambda value: "list" if isinstance(value, (list, tuple)) else "one"),
    ] = Field(
        description=(
            "What is sought; a list of up to three, of which the best compromises are kept; or a"
            " list of targets of one unit, which count together."
        )
    )
    subject_to: tuple[Constraint, ...] = Field(
        default=(), description="Measures that must stay within bounds."
    )
    prune: bool = Field(
        default=False,
        description=(
            "Whether motions that do worse than half of those before at the same time are ended."
        ),
    )
    sampler: str | None = Field(
        default=None,
        description=(
            f"One of {', '.join(SAMPLERS)}. Unless given, where goal and constraints have"
            f" derivatives {GAUSS_NEWTON} for targets alone and {SLSQP} for others, else tpe."
        ),
        examples=["tpe"],
    )

    @property
    def goals(self) -> tuple[Goal, ...]:
        """All goals of the study."""
        return self.goal if isinstance(self.goal, tuple) else (self.goal,)

    @property
    def together(self) -> bool:
        """True for several targets of one unit, which are one goal: the root mean square of what they miss."""
        units = {goal.measure.unit for goal in self.goals}
        return len(self.goals) > 1 and len(units) == 1 and self.targets_alone

    @property
    def targets_alone(self) -> bool:
        """True if a value is sought of each goal."""
        return all(goal.target is not None for goal in self.goals)

    @property
    def several(self) -> bool:
        """True if there are several goals that do not count together."""
        return len(self.goals) > 1 and not self.together

    @model_validator(mode="after")
    def _go_together(self) -> GoalFile:
        if self.sampler is not None and self.sampler not in SAMPLERS:
            raise fault(f"sampler must be one of {', '.join(SAMPLERS)}", "correct it", ("sampler",))
        if self.several and len(self.goals) > 3:
            raise fault(
                "a list of more than three goals must be of targets of one unit",
                "write targets of lengths alone, say, and the others as bounds in `subject_to`",
                ("goal",),
            )
        if self.several and self.sampler in ("cmaes", "gp", SLSQP, GAUSS_NEWTON):
            raise fault(
                f"{self.sampler} has one goal, or targets of one unit",
                "write `sampler: tpe` or `nsga2`",
                ("sampler",),
            )
        if self.sampler == GAUSS_NEWTON and (self.subject_to or not self.targets_alone):
            raise fault(
                f"{GAUSS_NEWTON} meets targets, without constraints",
                f"write `sampler: {SLSQP}`",
                ("sampler",),
            )
        if len(self.goals) > 1 and self.prune:
            raise fault("only trials of one goal are pruned", "remove `prune`", ("prune",))
        return self


if __name__ == "__main__":
    write_json_schema(GoalFile, SCHEMA)
    print(SCHEMA)
