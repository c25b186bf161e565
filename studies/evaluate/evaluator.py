"""Solves a study's designs and says how far each is from its target. It knows no storage, so any process can do it."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from magmpm.compiled.arrays import Plain
from magmpm.errors import InputError, in_one_line
from magmpm.studies.evaluate.trajectory import InsertionTrajectory, ScheduleTrajectory, shapes_of
from magmpm.studies.evaluate.trial import (
    Differentiate,
    Evaluation,
    Outcome,
    Solve,
    Trial,
    attributes,
    needs_derivatives,
    penalty,
)
from magmpm.studies.problem.study import Study
from magmpm.studies.search.parameters import Parameters
from magmpm.studies.search.search_space import SearchSpace

if TYPE_CHECKING:
    from magmpm.results.result import Result
    from magmpm.scene import Scene

FAILURES = "failures.log"
PICTURES = "pictures"


# Draws a trial's result to a file; returns the file (another ending is fine), or several. What it raises never harms the trial.
Picture = Callable[["Result", Path, Trial], Path | Sequence[Path]]


def evaluation_of(study: Study, space: SearchSpace) -> Evaluation:
    """Find which equilibria a study requires.

    Parameters
    ----------
    study : Study
        The study.
    space : SearchSpace
        Its search space.

    Returns
    -------
    Evaluation
        How its designs are evaluated.
    """
    return (
        InsertionTrajectory.of(study, space)
        or ScheduleTrajectory.of(study, space)
        or Evaluation(study, space)
    )


class Evaluator:
    """Solves and evaluates the designs of a study, and draws them.

    Parameters
    ----------
    study : Study
        The study.
    solve : callable
        From a scene to its Result.
    differentiate : callable or None
        From a scene to its Sensitivities; None where there are no derivatives.
    picture : Picture or None
        Draws a trial; None: there are no pictures.
    out : Path
        The study's folder.
    """

    def __init__(
        self,
        study: Study,
        solve: Solve,
        differentiate: Differentiate | None,
        picture: Picture | None,
        out: Path,
    ) -> None:
        self.study = study
        self.solve = solve
        self.differentiate = differentiate
        self.picture = picture
        self.out = out
        self.space = SearchSpace.of(study)
        self.evaluation = evaluation_of(study, self.space)

    def outcome(self, number: int, params: Parameters) -> Outcome:
        """Find the outcome of the design of a trial, with what to save. Only interrupts, and disks that take no log, end this with an
        exception.

        Parameters
        ----------
        number : int
            Of the trial.
        params : Mapping[str, Any]
            Its parameters.

        Returns
        -------
        Outcome
            The outcome.
        """
        try:
            scene = self.scene_of(params)
        except InputError as error:  # the scene allows each value, and not all of them together
            reason = in_one_line(error)
            known = {"feasible": False, "reason": reason}
            return Outcome(None, penalty(self.study.scene), None, reason, 0.0, known=known)
        differentiate = self.differentiate if needs_derivatives(self.study) else None
        outcome = self.evaluation.evaluate(self.solve, differentiate, params, self.out / FAILURES)
        known = self._known(outcome, scene, params)
        begun = time.perf_counter()
        files = self._drawn(number, outcome, known)
        return dataclasses.replace(
            outcome, known=known, files=files, drawing=time.perf_counter() - begun
        )

    def failed(self, params: Parameters, reason: str) -> Outcome:
        """Make the outcome of a design that could not be solved.

        Parameters
        ----------
        params : Mapping[str, Any]
            Its parameters.
        reason : str
            Why it could not.

        Returns
        -------
        Outcome
            The outcome, with the penalty.
        """
        outcome = Outcome(None, penalty(self.study.scene), None, reason, 0.0)
        return dataclasses.replace(
            outcome, known=self._known(outcome, self.scene_of(params), params)
        )

    def _known(self, outcome: Outcome, scene: Scene, params: Parameters) -> Plain:
        space = self.space
        return attributes(
            outcome, scene, space.directions(params), space.field(params)
        ) | space.quantities(params)

    def scene_of(self, params: Parameters) -> Scene:
        """Make the scene of a trial.

        Parameters
        ----------
        params : Mapping[str, Any]
            Its parameters.

        Returns
        -------
        Scene
            The scene; of an insertion that of its last depth, of a schedule that of its last
            time.
        """
        return self.evaluation.scenes(params)[-1]

    def _drawn(self, number: int, outcome: Outcome, known: Plain) -> list[Path]:
        """A trial's pictures; where there is none, `known` says why: a missing picture never fails a trial."""
        if outcome.result is None or self.picture is None:
            return []
        trial = trial_of(self.study, number, outcome, None)
        try:
            found = self.picture(
                outcome.result, self.out / PICTURES / f"trial_{number:03d}.png", trial
            )
            return [found] if isinstance(found, Path) else list(found)
        except Exception as error:  # drawing goes through OpenGL, worker processes and disks
            known["picture_note"] = f"{type(error).__name__}: {error}"
            return []


def trial_of(study: Study, number: int, outcome: Outcome, best: float | None) -> Trial:
    """Make a trial as callbacks see it.

    Parameters
    ----------
    study : Study
        The study.
    number : int
        Of the trial.
    outcome : Outcome
        Of its design.
    best : float, m, or None
        Value of the best trial before it.

    Returns
    -------
    Trial
        The trial.
    """
    improved = outcome.accepted and (best is None or outcome.value < best)
    return Trial(
        number,
        outcome.value,
        outcome.tip_error,
        outcome.value if improved else best,
        improved,
        outcome.reason,
        study.target,
        shapes=shapes_of(outcome.model),
    )
