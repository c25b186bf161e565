"""Report of a search for a goal: what it found, as data and in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from magmpm.errors import in_words, significant, unitless
from magmpm.results.file_names import MOMENTS, MOVIE, PICTURE
from magmpm.studies.goals import Plain

REPORT = "goal.json"
PROGRESS = "progress.png"
FRONT = "front.png"
PICTURES = (
    PROGRESS,
    FRONT,
    PICTURE,
    MOMENTS,
    MOVIE,
)  # in the search's folder, where there are such


@dataclass
class GoalReport:
    """Findings of a search.

    goals: each in words, with its SI unit; limits: of measures, by their places in the file, with values of the nearest trial; values: of
    each trial, SI, None where it has none, and `ends` says why: done, failed, pruned or not run; feasible: whether each keeps the limits;
    best: number, values, measures, params and whether it keeps the limits; nearest: number of the best trial, or, where none was run, of
    that least beyond its bounds; begun: params of the scene as it is; tied: how many numbers of the scene share a parameter, where they
    are several; failed: number, reason and params; skipped: trials that break a bound whatever their answer is, and were not run; finer:
    the best on more cells; scatter: values of designs that are all but the best; why_sampler: that the file does not name; ended:
    running, done or interrupted; warnings: of the best run; out: folder of the results, whose best/ holds the best run.
    """

    name: str
    goals: list[str]
    limits: list[Plain]
    trials: int
    values: list[list[float] | None]
    feasible: list[bool]
    ends: list[str]
    best: Plain | None
    pareto: list[Plain]
    begun: Plain
    tied: dict[str, int]
    failed: list[Plain]
    pruned: int
    skipped: int
    study_file: str
    sampler: str
    storage: str
    seconds_per_trial: float
    nearest: int | None = None
    finer: Plain | None = None
    scatter: Plain | None = None
    why_sampler: str | None = None
    ended: str = "done"
    warnings: list[str] = field(default_factory=list)
    out: Path = Path()

    def __repr__(self) -> str:
        best = "none"
        if self.best is not None:
            best = f"{self.best['values']} in SI, trial {self.best['number']}"
        goals = " and ".join(self.goals)
        return f"GoalReport({self.name!r}: {goals}; {self.trials} trials; best: {best})"

    def summary(self) -> Plain:
        """Plain data."""
        return {**vars(self), "out": str(self.out)}


def shared(tied: Mapping[str, int], name: str) -> str:
    """Return how many more numbers have the value of a parameter, in words; "" where none has."""
    return f" and {tied[name] - 1} tied to it" if name in tied else ""


def spread(report: GoalReport) -> float | None:
    """Return how far apart the first goal's values of designs that are all but the best are, in SI; None where that is not known."""
    if report.scatter is None or report.best is None:
        return None
    values = [one[0] for one in report.scatter["values"] if one is not None]
    values.append(report.best["values"][0])
    return float(max(values) - min(values))


def text(report: GoalReport) -> str:
    """A report in words."""
    lines = [
        f"{report.name}: {report.trials} trials, {len(report.failed)} failed,"
        f" {report.pruned} pruned, {report.skipped} beyond a bound from the start"
    ]
    why = "" if report.why_sampler is None else f": {report.why_sampler}"
    lines.append(f"  sampler          {report.sampler}{why}")
    if report.best is not None:
        said = _said(report.goals, report.best["values"])
        lines.append(f"  best             trial {report.best['number']}: {said}")
        if not report.best["feasible"]:
            lines.append("  no trial satisfies all constraints; this one violates them least")
        lines += [
            f"    {name}{shared(report.tied, name)} ="
            f" {significant(value, 6) if isinstance(value, (int, float)) else value or 'null'}"
            for name, value in report.best["params"].items()
        ]
    elif report.nearest is not None:
        lines.append(f"  no trial was run; nearest to the constraints is trial {report.nearest}")
    else:
        lines.append("  no trial gave a design")
    lines += [
        f"    {unitless(limit['label'])}: {limit['value']} ({limit['bounds']}){limit['missed']}"
        for limit in report.limits
        if limit["value"]
    ]
    if report.finer is not None and "values" in report.finer:
        said = _said(report.goals, report.finer["values"])
        lines.append(f"  on {report.finer['cells_across']} cells       {said}")
    apart = spread(report)
    if report.scatter is not None and apart is not None:
        lines.append(
            f"  noise            {in_words(report.goals[0], apart)} between designs within"
            f" {report.scatter['nearness']:g} of each range"
        )
    if report.failed:
        lines.append(
            f"  last failure     trial {report.failed[-1]['number']}: {report.failed[-1]['why']}"
        )
    lines.append(
        f"  seconds a trial  {significant(report.seconds_per_trial, 3)}; trials in {report.storage}"
    )
    lines += [f"  warning          {warning}" for warning in report.warnings]
    if report.ended == "interrupted":
        lines.append("  interrupted; the same command continues")
    return "\n".join(lines)


def _said(goals: list[str], values: list[float]) -> str:
    return ", ".join(
        f"{unitless(goal)} {in_words(goal, value)}"
        for goal, value in zip(goals, values, strict=True)
    )
