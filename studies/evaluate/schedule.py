"""Schedules: a field over time that brings a body through given shapes at given times.

The twin of insertion: the body stays as it is, and the field at each of the times is unknown, with a magnetization (and what else varies)
that all times share. Each shape is the equilibrium that the body comes to from the one before (rod_path.py; where a field varies in
space, the one that grows from no load); between the times the field changes evenly, as keyframes of a scene do. So a schedule holds for
motions that are slow beside the body's own (`magmpm report --motion` compares with a motion).

* rms: root of the mean, over all times, of the mean squared distance from that time's target. Each time counts the same.
* worst: the largest rms of a single time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array
from magmpm.rod.cosserat import rod_model
from magmpm.rod.family import RodFamily
from magmpm.scene import Scene
from magmpm.studies.evaluate.linear_model import Sensitive
from magmpm.studies.evaluate.trajectory import Trajectory
from magmpm.studies.problem.path import Path
from magmpm.studies.problem.shape_distance import gap_derivatives, gaps
from magmpm.studies.problem.study import Study
from magmpm.studies.rods.rod_path import RodPath, search
from magmpm.studies.rods.rod_trajectory import ELEMENTS, Depth, RodTrajectory
from magmpm.studies.search.search_space import SearchSpace

if TYPE_CHECKING:
    from magmpm.results.result import Result

STARTS, WANTED = 24, 3  # of the rod: most random starts, and how many designs are enough
NEAR = 0.01  # of the length: a rod's design that is near enough
TIMES = "schedule"  # user attribute: what is kept of each time


@dataclass(frozen=True)
class Schedule(Trajectory):
    """The shapes that a study asks for, and when."""

    @classmethod
    def of(cls, study: Study, space: SearchSpace) -> Schedule | None:
        """None where the study has no times."""
        return cls(study, space) if study.keyframes else None

    @property
    def places(self) -> tuple[str, ...]:
        return tuple(f"at {frame.time:g} s" for frame in self.study.keyframes)

    def scenes(self, params: Mapping[str, Any]) -> list[Scene]:
        return [self.space.scene_of(params, self.field_number(k)) for k in range(len(self.study.keyframes))]

    def gaps(self, result: Result, number: int) -> Array:
        return gaps(result, self.study.keyframes[number].target)

    def slopes(self, found: Sensitive, number: int) -> Array:
        return gap_derivatives(found, self.study.keyframes[number].target)

    def weights(self, number: int) -> Array:
        count = len(self.study.keyframes[number].target)
        return np.full(count, 1.0 / count)

    def measures(self, results: Sequence[Result], params: Mapping[str, Any]) -> dict[str, Any]:
        squares = self.mean_squares(results)
        worst = int(np.argmax(squares))
        return {
            "rms_m": float(np.sqrt(squares.mean())),
            "worst_m": float(np.sqrt(squares[worst])),
            "worst_time_s": self.study.keyframes[worst].time,
            **self.field_changes(params),
            TIMES: [
                {
                    "time_s": frame.time,
                    "field_T": np.round(self.space.field(params, self.field_number(k)), 12).tolist(),
                    "rms_m": float(np.sqrt(squares[k])),
                    "tip_error_m": float(np.linalg.norm(self.gaps(results[k], k)[-1])),
                }
                for k, frame in enumerate(self.study.keyframes)
            ],
        }

    def rod_starts(self) -> list[dict[str, float]]:
        """Designs of rods that grow with the shapes (rod_trajectory.py); none where directions do not vary."""
        space, scene = self.space, self.space.scene
        if space.field_max is None or space.fields != len(self.study.keyframes) or not space.segments:
            return []
        near = NEAR * scene.length
        found = search(self._way(scene), self._shapes(), seed=self.study.seed, starts=STARTS, wanted=WANTED, enough=near)
        return [self._parameters(design.directions, design.fields) for design in found[:WANTED]]

    def way(self, params: Mapping[str, Any]) -> RodPath | None:
        scene = self.space.scene_of(params)
        straight = isinstance(scene.body.shape, StraightBody) and scene.body.shape.clamp == "base"
        return self._way(scene) if straight and not scene.field.varies else None

    def _way(self, scene: Scene) -> RodPath:
        shapes = self._shapes()
        times = tuple(_rod(scene, path, len(shapes.paths)) for path in shapes.paths)
        movable = np.array(scene.magnetized_regions(), dtype=int)
        return RodPath.of_fields(RodSchedule(times, self.space.field_max or 0.0, movable, len(scene.regions())))

    def _shapes(self) -> Shapes:
        return Shapes(tuple(Path(frame.target) for frame in self.study.keyframes))

    def _parameters(self, directions: Array, fields: Array) -> dict[str, float]:
        """A rod's design as the study's parameters; numbers within bounds are in the middle."""
        x = np.full(self.space.size, 0.5)
        varied = directions[list(self.space.segments)]
        x[: varied.size] = varied.ravel()
        x[varied.size : varied.size + fields.size] = fields.ravel()
        return self.space.parameters_at(x)


@dataclass(frozen=True)
class Shapes:
    """The shapes of a schedule as curves."""

    paths: tuple[Path, ...]

    def flattened(self, share: float) -> Shapes:
        """With this share of their curvature."""
        return Shapes(tuple(path.flattened(share) for path in self.paths))


class RodSchedule(RodTrajectory):
    """Rods of one length, each with a shape of its own."""

    def bent(self, path: Any, share: float) -> RodTrajectory:
        """With other shapes, and this share of the weight."""
        bent = [replace(rod.weighing(share), path=curve.at(rod.place)) for rod, curve in zip(self.depths, path.paths, strict=True)]
        return replace(self, depths=tuple(bent))


def _rod(scene: Scene, path: Path, count: int) -> Depth:
    """The rod of one time of `count`, compared with its shape up to the shape's end."""
    scene = scene.with_field([0.0, 0.0, 0.0])
    rod = rod_model(scene, max(ELEMENTS, 4 * len(scene.regions())))
    place = np.concatenate([[0.0], np.cumsum(rod.length)])
    seen = place <= path.length * (1 + 1e-9)
    roots = np.where(seen, np.sqrt(1.0 / (count * seen.sum())), 0.0)
    family = RodFamily.of(rod, scene.body.shape.segment_lengths(), scene.magnetized_regions())  # type: ignore[attr-defined]
    segments = np.array(scene.magnetized_regions(), dtype=int)
    return Depth(rod=family, segments=segments, place=place, path=path.at(np.minimum(place, path.length)), roots=roots)
