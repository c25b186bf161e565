"""Designs that are evaluated by several equilibria: an insertion has one at each depth, a schedule one at each time.

Magnetization and numbers are shared by all of them, and each has its own field, or all have one. Their gaps stand one after the other in
the residuals that Gauss-Newton reads; the fields of two of them do not touch each other's shapes.
"""

from __future__ import annotations

import dataclasses
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import SolveError
from magmpm.results.whole_file import naming
from magmpm.scene import Scene
from magmpm.studies.evaluate.linear_model import Differentiate, Sensitive, stored
from magmpm.studies.evaluate.trial import Outcome, Solve, penalty
from magmpm.studies.problem.study import Study
from magmpm.studies.rods.rod_path import RodPath, directions_of
from magmpm.studies.search.search_space import SearchSpace

if TYPE_CHECKING:
    from magmpm.results.result import Result
    from magmpm.rod.cosserat import RodShape


@dataclass(frozen=True)
class Trajectory(ABC):
    """The equilibria that a study requires of each design."""

    study: Study
    space: SearchSpace

    @property
    @abstractmethod
    def places(self) -> tuple[str, ...]:
        """Names of the equilibria in messages: at 12 mm, at 0.5 s."""

    @abstractmethod
    def scenes(self, params: Mapping[str, Any]) -> list[Scene]:
        """The scene of each equilibrium of a design."""

    def starts(self, params: Mapping[str, Any]) -> Sequence[RodShape | None]:
        """The rod near which each equilibrium is, or None where it is on the branch that grows from no load. Raises SolveError."""
        way, directions = self.way(params), directions_of(self.space.scene_of(params))
        if way is None:
            return [None] * len(self.places)
        return [stops[-1].shape(directions) for stops in way.stops(directions, self.fields(params))]

    @abstractmethod
    def way(self, params: Mapping[str, Any]) -> RodPath | None:
        """The rods of a design on the way from each equilibrium to the next; None where the body is no rod in a uniform field."""

    @abstractmethod
    def gaps(self, result: Result, number: int) -> Array:
        """Vectors (m, 3) m from the target to the shape of an equilibrium."""

    @abstractmethod
    def slopes(self, found: Sensitive, number: int) -> Array:
        """Their derivatives (m, 3, k), m per unit of each variable of `found`."""

    @abstractmethod
    def weights(self, number: int) -> Array:
        """Weights of the squared lengths of the gaps (m,); they sum to 1."""

    @abstractmethod
    def rod_starts(self) -> list[dict[str, float]]:
        """Parameters of the rod's best designs, best first."""

    @abstractmethod
    def measures(self, results: Sequence[Result], params: Mapping[str, Any]) -> dict[str, Any]:
        """Measures reported of a design: rms_m, which is its value, and more."""

    end_weight = 0.0  # what the last gap of the last equilibrium counts besides, in what Gauss-Newton reads

    def field_number(self, number: int) -> int:
        """Which of the design's fields an equilibrium has."""
        return number if self.space.fields > 1 else -1

    def fields(self, params: Mapping[str, Any]) -> Array:
        """The field of each equilibrium (n, 3), T."""
        return np.array([self.space.field(params, self.field_number(k)) for k in range(len(self.places))])

    def last_result(self, solve: Solve, params: Mapping[str, Any]) -> Result:
        """The last equilibrium of a design. Raises SolveError."""
        return solve(self.scenes(params)[-1], start=self.starts(params)[-1])

    def mean_squares(self, results: Sequence[Result]) -> Array:
        """The mean squared gap of each equilibrium, m^2."""
        return np.array([self.weights(k) @ np.sum(self.gaps(result, k) ** 2, axis=1) for k, result in enumerate(results)])

    def field_changes(self, params: Mapping[str, Any]) -> dict[str, float]:
        """Changes of the field from one equilibrium to the next: the largest change, and their sum, T."""
        changes = np.linalg.norm(np.diff(self.fields(params), axis=0), axis=1)
        return {"field_largest_change_T": float(changes.max(initial=0.0)), "field_total_variation_T": float(changes.sum())}

    def evaluate(self, solve: Solve, differentiate: Differentiate | None, params: Mapping[str, Any], log: Path) -> Outcome:
        """Solves all equilibria of a design. Whatever goes wrong gives the penalty with a reason; interrupts pass through."""
        begun = time.perf_counter()

        def failed(reason: str) -> Outcome:
            return Outcome(None, penalty(self.space.scene), None, reason, time.perf_counter() - begun)

        try:
            starts = self.starts(params)
        except SolveError as error:
            return failed(error.reason)
        results, slopes = [], []
        for k, (scene, start) in enumerate(zip(self.scenes(params), starts, strict=True)):
            place = f"{self.places[k]}: "
            try:
                found = self._solved(solve, differentiate, scene, start)
                results.append(found[0])
                if found[1] is not None:
                    slopes.append(self._by_coordinates(found[1], params, k))
            except SolveError as error:
                return failed(place + error.reason)
            except Exception as error:  # a study runs for hours: no design may end it
                with naming(log), log.open("a", encoding="utf-8") as stream:
                    stream.write(f"scene {scene.hash()}\n{traceback.format_exc()}\n")
                return failed(f"{place}{type(error).__name__}: {error}")
            if not results[-1].converged:
                return failed(place + "the solve did not converge")
        measures = self.measures(results, params)
        if not np.isfinite(measures["rms_m"]):
            return failed("the results hold numbers that are not finite")
        model = {**measures, **self._model(results, slopes)}
        tip = float(np.linalg.norm(self.gaps(results[-1], len(results) - 1)[-1]))
        return self._outcome(results, measures["rms_m"], tip, model, time.perf_counter() - begun)

    def _outcome(self, results: list[Result], rms: float, tip: float, model: dict[str, Any], seconds: float) -> Outcome:
        """The outcome of equilibria that were found: refused where the least stable of them is below the study's margin."""
        known = [getattr(result, "stability", None) for result in results]
        stability = None if None in known else min(float(value) for value in known)  # type: ignore[arg-type]
        margin, reason = self.study.margin, None
        if margin is not None and stability is None:
            reason = "the stability of the results is not known, and the study has a margin"
            return Outcome(None, penalty(self.space.scene), None, reason, seconds)
        if margin is not None and stability is not None and stability < margin:
            place = self.places[int(np.argmin([float(value or 0.0) for value in known]))]
            reason = f"the stability {place}, {stability:.3g}, is below the margin, {margin:g}"
        return Outcome(results[-1], rms, tip, reason, seconds, model, stability, reason is not None)

    def _solved(
        self, solve: Solve, differentiate: Differentiate | None, scene: Scene, start: RodShape | None
    ) -> tuple[Result, Sensitive | None]:
        """One equilibrium, with derivatives if they are wanted."""
        if differentiate is None:
            return solve(scene, start=start), None
        found = differentiate(scene, self.space.sensitivities, start=start)
        return found.result, found

    def hidden(self, found: Sensitive) -> int:
        """Number of segments of the whole body, from its base, that this equilibrium does not have."""
        return 0

    def _by_coordinates(self, found: Sensitive, params: Mapping[str, Any], number: int) -> Array:
        """Derivatives (3 m, size) of an equilibrium's gaps by the design's embedded coordinates."""
        hidden = self.hidden(found)
        variables = [v if v.region is None else dataclasses.replace(v, region=v.region + hidden) for v in found.variables]  # type: ignore
        chain = self.space.chain(variables, self.space.embedded(params), field=self.field_number(number))
        slopes = self.slopes(found, number)
        return np.asarray(slopes.reshape(-1, slopes.shape[-1]) @ chain)

    def _model(self, results: Sequence[Result], slopes: list[Array]) -> dict[str, Any]:
        """The attributes that Gauss-Newton reads; none without derivatives."""
        if not slopes:
            return {}
        roots = [np.repeat(np.sqrt(self.weights(k) / len(results)), 3) for k in range(len(results))]
        gaps = [self.gaps(result, k).reshape(-1) for k, result in enumerate(results)]
        end = np.sqrt(self.end_weight)
        rows = [*(root * gap for root, gap in zip(roots, gaps, strict=True)), end * gaps[-1][-3:]]
        columns = [*(root[:, None] * slope for root, slope in zip(roots, slopes, strict=True)), end * slopes[-1][-3:]]
        return stored(np.concatenate(rows), np.concatenate(columns))
