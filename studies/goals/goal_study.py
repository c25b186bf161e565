"""A study with a goal: its file, the scene, what trials turn in it, and what their measures are worth."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from magmpm.compiled.arrays import NamedNumbers
from magmpm.errors import InputError, in_words, shown_unit
from magmpm.inputs.settings import validate
from magmpm.inputs.user_files import REMEDY, RULE, is_allowed
from magmpm.inputs.yaml_document import Document, read_yaml
from magmpm.scene import Scene, load_scene
from magmpm.scene.addresses import value_at, written
from magmpm.scene.variables import check_differentiable, variables
from magmpm.studies.goals import Bounds, Plain, evaluate
from magmpm.studies.goals.goal_file import GAUSS_NEWTON, SLSQP, GoalFile
from magmpm.studies.goals.measures import Measure
from magmpm.studies.goals.own_function import function_of, source_of
from magmpm.studies.problem.variables import Vary, VaryAnything
from magmpm.studies.search.knobs import Knob, Turning, knobs
from magmpm.studies.search.search_space import segments
from magmpm.studies.search.study_checks import check_numbers, placed


@dataclass(frozen=True)
class GoalStudy:
    """A study file with a goal, the scene it names, and what is turned in it."""

    path: Path
    name: str
    file: GoalFile
    scene: Scene
    knobs: tuple[Knob, ...]
    targets: tuple[float | None, ...]  # SI, of each goal
    bounds: tuple[Bounds, ...]  # SI, of each constraint: least, greatest

    @property
    def measures(self) -> dict[str, Measure]:
        """Every measure by its place in the file."""
        found = {f"goal[{k}].{goal.key}": goal.measure for k, goal in enumerate(self.file.goals)}
        return found | {f"subject_to[{k}]": one for k, one in enumerate(self.file.subject_to)}

    @cached_property
    def rough(self) -> str | None:
        """Reason why there are no derivatives; None where there are."""
        if self.file.several:
            return "there are several goals"
        try:
            check_differentiable(self.scene, fed=True)
        except InputError:
            return "motions, paths with friction and streams at rest have no derivatives"
        measures = self.measures
        rough = [knob.name for knob in self.knobs if not self._has_derivative(knob)]
        rough += [at for at, measure in measures.items() if not measure.smooth(self.scene)]
        if (
            self.scene.effects.feed is not None
        ):  # of which derivatives know what is out of the guide
            rough += [at for at, measure in measures.items() if measure.regions - {"tip"}]
        return f"{rough[0]} has none" if rough else None

    def _has_derivative(self, knob: Knob) -> bool:
        """True if what a knob turns has a derivative."""
        if not knob.smooth:
            return False
        whole = (self.scene.effects.auto or self.scene.resolution.requested) and self.scene.in_time
        try:
            for place in knob.places:
                vector = isinstance(value_at(self.scene, place), list)
                variables(self.scene, [written((*place, 0) if vector else place)])
        except InputError:
            return False
        return not whole

    @property
    def begun(self) -> Plain:
        """The parameters with which a search begins: those of the scene, or the nearest within bounds."""
        return {
            name: value for knob in self.knobs for name, value in knob.begun(self.scene).items()
        }

    @property
    def sampler(self) -> str:
        """The file's, or the one that its goals and variables allow."""
        if self.file.sampler is not None:
            return self.file.sampler
        if self.rough is not None:
            return "tpe"
        return GAUSS_NEWTON if (self.file.targets_alone and not self.file.subject_to) else SLSQP

    @property
    def why_sampler(self) -> str | None:
        """Reason for a sampler that the file does not name."""
        if self.file.sampler is not None:
            return None
        if self.rough is not None:
            return self.rough
        if self.sampler == GAUSS_NEWTON:
            return "all that counts is targets, and they have derivatives"
        return "goal and constraints have derivatives"

    @property
    def directions(self) -> list[Literal["minimize", "maximize"]]:
        """Direction in which Optuna seeks each value of a trial."""
        if self.file.together:
            return ["minimize"]
        return ["maximize" if goal.key == "maximize" else "minimize" for goal in self.file.goals]

    @property
    def names(self) -> list[str]:
        """Each goal in words, with its unit in SI."""
        if self.file.together:
            unit = self.file.goals[0].measure.unit
            return ["target missed by" + (f" ({unit})" if unit else "")]
        return [f"{goal.key} {goal.measure.label}" for goal in self.file.goals]

    @property
    def shown(self) -> list[tuple[str, float]]:
        """Each value of a trial as it is shown and told, and the factor from SI."""
        return [shown_unit(name.partition(" ")[2]) for name in self.names]

    def limits(self, numbers: Mapping[str, float]) -> list[Plain]:
        """Each constraint, and each of several targets: its place in the file, its label, its bounds, and in words, where it is known, its
        value and by how much that misses its bounds."""
        found = []
        for goal, at, target in zip(self.file.goals, self.measures, self.targets, strict=False):
            if self.file.together and target is not None:
                label = goal.measure.full_label
                said = f"target {in_words(label, target)}"
                found.append({"at": at, "label": label, "bounds": said, "missed": ""})
        for one, (at, bounds) in zip(self.file.subject_to, self.bounded.items(), strict=True):
            both = [
                f"{sign} {in_words(one.label, bound)}"
                for sign, bound in zip(("at least", "at most"), bounds, strict=True)
                if bound is not None
            ]
            over = max(evaluate.beyond(numbers[at], bounds, 1.0)) if at in numbers else 0.0
            missed = f", missed by {in_words(one.label, over)}" if over > 0.0 else ""
            said = ", ".join(both)
            found.append({"at": at, "label": one.full_label, "bounds": said, "missed": missed})
        for limit in found:
            value = numbers.get(limit["at"])
            limit["value"] = "" if value is None else in_words(limit["label"], value)
        return found

    @property
    def definition(self) -> str:
        """All that decides which trials are made and what they are worth."""
        said = self.file.model_dump(mode="json", exclude={"trials", "scene"}, exclude_defaults=True)
        named = sorted({of.python for of in self.measures.values() if of.python})
        said["functions"] = [source_of(text, self.path.parent) for text in named]
        return json.dumps({"scene": self.scene.hash(), **said}, sort_keys=True, default=str)

    @property
    def bounded(self) -> dict[str, Bounds]:
        """The bounds of each constraint by its place in the file."""
        return {f"subject_to[{k}]": of for k, of in enumerate(self.bounds)}

    def values(self, numbers: NamedNumbers) -> tuple[list[float], list[float]]:
        """A trial's values, as Optuna compares them, and how far it is beyond each bound, as a share of it; of targets what they miss, of
        several its root mean square."""
        values = [
            numbers[f"goal[{k}].{goal.key}"]
            if target is None
            else abs(numbers[f"goal[{k}].{goal.key}"] - target)
            for k, (goal, target) in enumerate(zip(self.file.goals, self.targets, strict=True))
        ]
        if self.file.together:
            values = [float(np.sqrt(np.mean(np.square(values))))]
        return values, self.beyond(numbers)

    def beyond(self, numbers: Mapping[str, float]) -> list[float]:
        """Find how far constraints whose measures are known are beyond each of their bounds (`evaluate.beyond`)."""
        known = [(numbers[at], bounds) for at, bounds in self.bounded.items() if at in numbers]
        return [one for value, bounds in known for one in evaluate.beyond(value, bounds)]


def has_goal(path: Path | str) -> bool:
    """True if a study file names a goal in place of a shape. Raises InputError for a file that can't be read."""
    return "goal" in read_yaml(path)


def load_goal(path: Path | str) -> GoalStudy:
    """The study that a file describes. Raises InputError."""
    document = read_yaml(path)
    file = validate(GoalFile, document)
    scene_file = document.path.parent / file.scene
    if not is_allowed(scene_file, document.path):
        raise InputError(
            f"{document.path}: scene", received=str(scene_file), rule=RULE, remedy=REMEDY
        )
    scene = load_scene(scene_file)
    turned = []
    if file.vary.length is not None or file.vary.order is not None:
        vary = Vary(length=file.vary.length, order=file.vary.order)
        check_numbers(scene, vary, file.sampler, document)
        turned.append(segments(scene, vary))
    try:
        return _checked(document, file, scene, turned)
    except InputError as error:
        raise placed(error, document) from None


def _directions(vary: VaryAnything, scene: Scene) -> list[Knob]:
    """The directions of magnetization that a study turns. Raises InputError."""
    if vary.magnetization is None:
        return []
    regions = scene.regions()
    return [
        Turning(regions[k].name, (("body", *regions[k].at, "magnetization"),))
        for k in vary.magnetization.regions(scene)
    ]


def _checked(document: Document, file: GoalFile, scene: Scene, turned: Sequence[Knob]) -> GoalStudy:
    targets = tuple(
        evaluate.in_si(goal.target.value, goal.target, f"goal[{k}].target.value")
        if goal.target is not None
        else None
        for k, goal in enumerate(file.goals)
    )
    bounds = tuple(
        (
            evaluate.in_si(one.at_least, one, f"subject_to[{k}].at_least"),
            evaluate.in_si(one.at_most, one, f"subject_to[{k}].at_most"),
        )
        for k, one in enumerate(file.subject_to)
    )
    for k, (least, most) in enumerate(bounds):
        if least is not None and most is not None and least > most:
            raise InputError(
                f"subject_to[{k}]",
                received=f"at_least {file.subject_to[k].at_least}, at_most"
                f" {file.subject_to[k].at_most}",
                rule="at_least must be below at_most",
                remedy="exchange or correct them",
            )
    study = GoalStudy(
        document.path,
        document.path.stem,
        file,
        scene,
        knobs(file.vary.numbers or (), scene, [*_directions(file.vary, scene), *turned]),
        targets,
        bounds,
    )
    for at, measure in study.measures.items():
        measure.check_moments(scene, at)
        if measure.python:
            function_of(measure.python, document.path.parent, at)
    if file.sampler in (SLSQP, GAUSS_NEWTON) and study.rough is not None:
        raise InputError(
            "sampler",
            received=file.sampler,
            rule=f"it goes along derivatives, and {study.rough}",
            remedy="write `sampler: tpe`",
        )
    if file.prune and scene.solver.dynamic is None:
        raise InputError(
            "prune", received="true", rule="only motions are pruned", remedy="remove `prune`"
        )
    return study
