"""Insertion: a catheter is pushed out of a guide, and the field at each depth lets its whole body follow the path of its tip.

A trial is a whole trajectory: one equilibrium at each depth, each an ordinary static scene (Scene.inserted), in that depth's field. What is
outside the guide at depth l is compared with the path's first l, at equal arc length from the exit on.

* body rms: root of the mean, over all depths, of the mean squared distance along the inserted length. Each depth counts the same, and in
  it each piece of its length (trapezoidal rule on STATIONS stations).
* exit error: distance of the tip from the path's end, at full insertion (at the last depth from the path's point there).
* worst depth: the largest rms of a single depth.
* smoothness of the field: its largest change between neighboring depths, and the sum of the changes, T.

The value of a trial is its body rms. Samplers that read residuals get, beside the distances, the exit's, which counts EXIT_WEIGHT as much
as all of the body: the body's rms alone would leave the tip 2 to 4 times as far away as the rest.

A depth whose solve fails is tried once more with its loads growing from zero in small steps; then the trial gets the penalty, and the
reason names the depth.
"""

from __future__ import annotations

import dataclasses
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path as File
from typing import TYPE_CHECKING, Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import SolveError
from magmpm.results.measures import centreline_at
from magmpm.results.whole_file import naming
from magmpm.scene import Scene
from studies.linear_model import Differentiate, Sensitive, stored
from studies.path import Path
from studies.rod_trajectory import RodDesign, RodTrajectory, search
from studies.search_space import SearchSpace
from studies.study import Study
from studies.trial import Outcome, Solve, penalty

if TYPE_CHECKING:
    from magmpm.results.result import Result

STATIONS = 25
EXIT_WEIGHT = 0.25
RAMP = 20  # steps in which the loads of a depth grow, where its solve has failed
STARTS, WANTED = 40, 3  # of the rod: most random starts, and how many designs are enough
NEAR = 0.01  # of the length: a rod's design that is near enough
DEPTHS = "insertion"  # user attribute: what is kept of each depth


@dataclass(frozen=True)
class Insertion:
    """The trajectory that a study asks for."""

    study: Study
    space: SearchSpace
    path: Path

    @classmethod
    def of(cls, study: Study, space: SearchSpace) -> Insertion | None:
        """None where the study has no depths."""
        return cls(study, space, Path(study.target)) if study.depths else None

    def field_number(self, depth: int) -> int:
        """Which of the design's fields a depth has."""
        return depth if self.space.fields > 1 else -1

    def scenes(self, params: Mapping[str, Any]) -> list[Scene]:
        """The scene of each depth of a design."""
        return [
            self.space.scene_of(params, self.field_number(k)).inserted(length) for k, length in enumerate(self.study.depths)
        ]

    def evaluate(self, solve: Solve, differentiate: Differentiate | None, params: Mapping[str, Any], log: File) -> Outcome:
        """Solves all depths of a design. Whatever goes wrong gives the penalty with a reason; interrupts pass through."""
        begun = time.perf_counter()

        def failed(reason: str) -> Outcome:
            return Outcome(None, penalty(self.space.scene), None, reason, time.perf_counter() - begun)

        results, slopes = [], []
        for k, scene in enumerate(self.scenes(params)):
            place = f"at {1e3 * self.study.depths[k]:.4g} mm: "
            try:
                found = self._solved(solve, differentiate, scene)
                results.append(found[0])
                if found[1] is not None:
                    slopes.append(self._slopes(found[1], params, k))
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
        stability, seconds = min(float(result.stability) for result in results), time.perf_counter() - begun
        margin = self.study.margin
        refused = margin is not None and stability < margin
        reason = f"the least stability of all depths, {stability:.3g}, is below the margin, {margin:g}" if refused else None
        rms, away = measures["rms_m"], measures["exit_error_m"]
        return Outcome(results[-1], rms, away, reason, seconds, model, stability, refused, tuple(results))

    def _solved(self, solve: Solve, differentiate: Differentiate | None, scene: Scene) -> tuple[Result, Sensitive | None]:
        """A depth's equilibrium, with derivatives if they are wanted."""

        def once(of: Scene) -> tuple[Result, Sensitive | None]:
            if differentiate is None:
                return solve(of), None
            found = differentiate(of, self.space.sensitivities)
            return found.result, found

        try:
            return once(scene)
        except SolveError:
            static = scene.solver.static.model_copy(update={"field_steps": RAMP})
            return once(scene.model_copy(update={"solver": scene.solver.model_copy(update={"static": static})}))

    def gaps(self, result: Result) -> Array:
        """Distances (STATIONS, 3) m of one depth's axis from the path."""
        s = _stations(result)
        return np.asarray(centreline_at(result, s) - self.path.at(s))

    def measures(self, results: Sequence[Result], params: Mapping[str, Any]) -> dict[str, Any]:
        """What is reported of a trajectory; see the head of this file."""
        gaps = [self.gaps(result) for result in results]
        squares = np.array([_weights() @ np.sum(gap**2, axis=1) for gap in gaps])
        fields = np.array([self.space.field(params, self.field_number(k)) for k in range(len(results))])
        changes = np.linalg.norm(np.diff(fields, axis=0), axis=1)
        return {
            "rms_m": float(np.sqrt(squares.mean())),
            "exit_error_m": float(np.linalg.norm(gaps[-1][-1])),
            "worst_m": float(np.sqrt(squares.max())),
            "worst_depth_m": float(self.study.depths[int(np.argmax(squares))]),
            "field_largest_change_T": float(changes.max(initial=0.0)),
            "field_total_variation_T": float(changes.sum()),
            DEPTHS: [
                {
                    "depth_m": depth,
                    "field_T": np.round(field, 12).tolist(),
                    "rms_m": float(np.sqrt(square)),
                    "tip_error_m": float(np.linalg.norm(gap[-1])),
                    "newton_steps": int(result.iterations),
                    "stability": result.stability,
                }
                for depth, field, square, gap, result in zip(self.study.depths, fields, squares, gaps, results, strict=True)
            ],
        }

    def _slopes(self, found: Sensitive, params: Mapping[str, Any], depth: int) -> Array:
        """Derivatives (3 STATIONS, size) of a depth's gaps by the design's embedded coordinates."""
        hidden = len(self.space.scene.regions()) - int(np.max(found.result.particle_segment)) - 1
        variables = [v if v.region is None else dataclasses.replace(v, region=v.region + hidden) for v in found.variables]  # type: ignore
        chain = self.space.chain(variables, self.space.embedded(params), field=self.field_number(depth))
        return np.asarray(found.at(_stations(found.result)).reshape(3 * STATIONS, -1) @ chain)

    def _model(self, results: Sequence[Result], slopes: list[Array]) -> dict[str, Any]:
        """The attributes that Gauss-Newton reads."""
        if not slopes:
            return {}
        roots = np.repeat(np.sqrt(_weights() / len(results)), 3)
        gaps = [self.gaps(result).reshape(-1) for result in results]
        rows = [*(roots * gap for gap in gaps), np.sqrt(EXIT_WEIGHT) * gaps[-1][-3:]]
        columns = [*(roots[:, None] * slope for slope in slopes), np.sqrt(EXIT_WEIGHT) * slopes[-1][-3:]]
        return stored(np.concatenate(rows), np.concatenate(columns))

    # designs by the rod

    def rods(self) -> RodTrajectory:
        """The trajectory as rods."""
        field_max = self.space.field_max
        assert field_max is not None
        return RodTrajectory.of(self.space.scene, self.path, self.study.depths, max_field=field_max, exit_weight=EXIT_WEIGHT)

    def rod_starts(self) -> list[dict[str, float]]:
        """Parameters of the rod's best designs, best first; none where directions or fields at each depth are not varied."""
        if self.space.field_max is None or self.space.fields != len(self.study.depths) or not self.space.segments:
            return []
        length = self.study.depths[-1]
        found = search(
            self.rods(), self.path, seed=self.study.seed, starts=STARTS, wanted=WANTED, enough=NEAR * length
        )
        return [self.parameters(design) for design in found[:WANTED]]

    def parameters(self, design: RodDesign) -> dict[str, float]:
        """A rod's design as the study's parameters; numbers within bounds stay in the middle."""
        x = np.full(self.space.size, 0.5)
        directions = [design.directions[i] for i in self.space.segments]
        x[: 3 * len(directions)] = np.concatenate(directions)
        x[3 * len(directions) : 3 * (len(directions) + self.space.fields)] = design.fields.ravel()
        return self.space.parameters_at(x)


def _stations(result: Result) -> Array:
    """Arc lengths (STATIONS,) m, exit to tip."""
    return np.linspace(0.0, float(result.centreline[-1, 0]), STATIONS)


def _weights() -> Array:
    """Trapezoidal rule, (STATIONS,); they sum to 1."""
    weights = np.full(STATIONS, 1.0 / (STATIONS - 1))
    weights[[0, -1]] /= 2
    return weights
