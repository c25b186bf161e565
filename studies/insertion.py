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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.results.measures import centreline_at
from magmpm.scene import Scene
from studies.linear_model import Sensitive
from studies.path import Path
from studies.rod_trajectory import RodDesign, RodTrajectory, search
from studies.search_space import SearchSpace
from studies.study import Study
from studies.trajectory import Trajectory

if TYPE_CHECKING:
    from magmpm.results.result import Result

STATIONS = 25
EXIT_WEIGHT = 0.25
STARTS, WANTED = 40, 3  # of the rod: most random starts, and how many designs are enough
NEAR = 0.01  # of the length: a rod's design that is near enough
DEPTHS = "insertion"  # user attribute: what is kept of each depth


@dataclass(frozen=True)
class Insertion(Trajectory):
    """The trajectory that a study asks for."""

    path: Path
    end_weight = EXIT_WEIGHT

    @classmethod
    def of(cls, study: Study, space: SearchSpace) -> Insertion | None:
        """None where the study has no depths."""
        return cls(study, space, Path(study.target)) if study.depths else None

    @property
    def places(self) -> tuple[str, ...]:
        return tuple(f"at {1e3 * depth:.4g} mm" for depth in self.study.depths)

    def scenes(self, params: Mapping[str, Any]) -> list[Scene]:
        """The scene of each depth of a design."""
        return [
            self.space.scene_of(params, self.field_number(k)).inserted(length) for k, length in enumerate(self.study.depths)
        ]

    def gaps(self, result: Result, number: int = -1) -> Array:
        """Vectors (STATIONS, 3) m from the path to one depth's axis."""
        s = _stations(result)
        return np.asarray(centreline_at(result, s) - self.path.at(s))

    def slopes(self, found: Sensitive, number: int) -> Array:
        return found.at(_stations(found.result))

    def weights(self, number: int) -> Array:
        return _weights()

    def hidden(self, found: Sensitive) -> int:
        return len(self.space.scene.regions()) - int(np.max(found.result.particle_segment)) - 1

    def measures(self, results: Sequence[Result], params: Mapping[str, Any]) -> dict[str, Any]:
        """What is reported of a trajectory; see the head of this file."""
        gaps = [self.gaps(result) for result in results]
        squares = self.mean_squares(results)
        fields = np.array([self.space.field(params, self.field_number(k)) for k in range(len(results))])
        return {
            "rms_m": float(np.sqrt(squares.mean())),
            "exit_error_m": float(np.linalg.norm(gaps[-1][-1])),
            "worst_m": float(np.sqrt(squares.max())),
            "worst_depth_m": float(self.study.depths[int(np.argmax(squares))]),
            **self.field_changes(params),
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
