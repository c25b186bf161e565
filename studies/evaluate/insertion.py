"""Insertion: a catheter is pushed out of a guide, and the field at each depth lets its whole body follow the path of its tip.

A trial is a whole trajectory: one equilibrium at each depth, each an ordinary static scene (Scene.inserted), in that depth's field. What is
outside the guide at depth l is compared with the path's first l, at equal arc length from the exit on.

* body rms: root of the mean, over all depths, of the mean squared distance along the inserted length (STATIONS stations).
* exit error: distance of the tip from the path's end, at full insertion (at the last depth from the path's point there).
* worst depth: the largest rms of a single depth.
* smoothness of the field: its largest change between neighboring depths, and the sum of the changes, T.

The value of a trial is its body rms. Samplers that read residuals get the exit's as well, which counts EXIT_WEIGHT as much as all of the
body: the body's rms alone would leave the tip 2 to 4 times as far away as the rest.

A body that is pushed has at each depth the equilibrium that it comes to from the depth before. So a rod is pushed along (rod_path.py), and
each depth's equilibrium is the one near it; in a field that varies in space, the one on the branch that grows from no load. Where a depth
has none, the trial gets the penalty, and the reason names the depth.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path as File
from typing import TYPE_CHECKING, Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import SolveError
from magmpm.results.measures import centreline_at
from magmpm.results.whole_file import whole_file
from magmpm.scene import Scene
from magmpm.studies.evaluate.trajectory import Trajectory
from magmpm.studies.evaluate.trial import Solve
from magmpm.studies.problem.path import Path
from magmpm.studies.problem.study import Study
from magmpm.studies.rods.rod_path import RodPath, directions_of
from magmpm.studies.search.search_space import SearchSpace

if TYPE_CHECKING:
    from magmpm.results.result import Result
    from magmpm.rod.cosserat import RodShape
    from magmpm.statics.linearized import Sensitivities

STATIONS = 25
EXIT_WEIGHT = 0.25
DEPTHS = "insertion"  # user attribute: what is kept of each depth
CATHETER = "catheter"  # ... the whole catheter, of which the last depth may leave a part in the guide
SHAPES = "shapes"  # ... and how it is drawn: axis, and each segment's center and remanence
MOVIE = "insertion.json"


@dataclass(frozen=True)
class Insertion(Trajectory):
    """The trajectory that a study requests."""

    path: Path
    sought = 40, 2
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
        return [self.space.scene_of(params, self.field_number(k)).inserted(length) for k, length in enumerate(self.study.depths)]

    def gaps(self, result: Result, number: int = -1) -> Array:
        """Vectors (STATIONS, 3) m from the path to one depth's axis."""
        s = _stations(result)
        return np.asarray(centreline_at(result, s) - self.path.at(s))

    def slopes(self, found: Sensitivities, number: int) -> Array:
        return found.at(_stations(found.result))

    def weights(self, number: int) -> Array:
        return _weights()

    def hidden(self, found: Sensitivities) -> int:
        return len(self.space.scene.regions()) - int(np.max(found.result.particle_segment)) - 1

    def measures(self, results: Sequence[Result], params: Mapping[str, Any]) -> dict[str, Any]:
        """Measures reported of a trajectory; see the head of this file."""
        gaps = [self.gaps(result) for result in results]
        squares = self.mean_squares(results)
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
                for depth, field, square, gap, result in zip(self.study.depths, self.fields(params), squares, gaps, results, strict=True)
            ],
            SHAPES: [self._shape(result) for result in results],
            CATHETER: self.space.scene_of(params).to_si()["body"]["catheter"],
        }

    def _shape(self, result: Result) -> dict[str, Any]:
        """Data that pictures need of one depth, m and T."""
        rows = {
            "axis_m": centreline_at(result, _stations(result)),
            "centers_m": result.segment_center,
            "remanence_T": result.segment_remanence,
        }
        return {name: np.round(np.asarray(values), 7).tolist() for name, values in rows.items()}

    def write_moments(self, folder: File, solve: Solve, params: Mapping[str, Any]) -> None:
        """Writes the frames of the movie of a design into a folder: all depths on the way, each in a field between those of its neighbors.
        A depth that finds no equilibrium is left out.
        """
        whole, frames = self.space.scene_of(params), []
        for length, field, start in self._moments(params):
            try:
                result = solve(whole.with_field(field).inserted(length), start=start)
            except SolveError:
                continue
            gap = self.gaps(result)
            rms = float(np.sqrt(_weights() @ np.sum(gap**2, axis=1)))
            frames.append({"depth_m": length, "field_T": field.tolist(), "rms_m": rms, **self._shape(result)})
        content = {"scene": whole.to_si(), "path_m": self.path.rows.tolist(), "frames": frames}
        with whole_file(folder / MOVIE) as part:
            part.write_text(json.dumps(content) + "\n", encoding="utf-8")

    def _moments(self, params: Mapping[str, Any]) -> Iterator[tuple[float, Array, RodShape | None]]:
        """Depths (m), fields (3,) T and rods of the movie, from the first depth that is evaluated on."""
        fields, way = self.fields(params), self.way(params)
        if way is None:
            depths = np.array(self.study.depths)
            for length in np.unique(np.concatenate([depths, np.linspace(depths[0], depths[-1], 48)])).tolist():
                yield length, np.array([np.interp(length, depths, column) for column in fields.T]), None
            return
        directions = directions_of(self.space.scene_of(params))
        for k, stops in enumerate(way.stops(directions, fields)):
            for stop in stops if k else stops[-1:]:
                yield float(stop.depth.place[-1]), stop.field, stop.shape(directions)

    # designs by the rod

    def way(self, params: Mapping[str, Any]) -> RodPath | None:
        return None if self.space.scene.field.varies else self._way(self.space.scene_of(params))

    @property
    def followed(self) -> Path:
        return self.path

    def _way(self, scene: Scene) -> RodPath:
        most = self.space.field_max or 0.0
        return RodPath.of(scene, self.path, self.study.depths, max_field=most, exit_weight=EXIT_WEIGHT)

    @property
    def projects(self) -> bool:
        """True if samplers choose directions alone, and the rod each depth's field: where nothing else is varied."""
        space, depths = self.space, len(self.study.depths)
        return bool(space.segments) and space.field_max is not None and space.fields == depths > 1 and len(space.blocks) == space.count

    def directions_alone(self) -> SearchSpace:
        """The search space without the fields."""
        return dataclasses.replace(self.space, field_max=None, fields=1)

    def with_fields(self, chosen: Mapping[str, Any]) -> dict[str, Any]:
        """Parameters of directions, with those of the field that the rod finds for each depth."""
        directions = self.directions_alone().directions(chosen)
        fitted = self.rods.rods.fitted(self.path, directions)
        mended = None if fitted.state is None else self.rods.mended(fitted, turning=False)
        return {**self.parameters(mended or fitted), **chosen}


def shapes_of(kept: Mapping[str, Any]) -> tuple[dict[str, Any], ...]:
    """Data that pictures need of each depth, from a trial's attributes or a design; () where it is no insertion."""
    whole = {key: kept[key] for key in (CATHETER,) if key in kept}
    return tuple({**depth, **shape, **whole} for depth, shape in zip(kept.get(DEPTHS, ()), kept.get(SHAPES, ()), strict=False))


def _stations(result: Result) -> Array:
    """Arc lengths (STATIONS,) m, exit to tip."""
    return np.linspace(0.0, float(result.centreline[-1, 0]), STATIONS)


def _weights() -> Array:
    """Trapezoidal rule, (STATIONS,); they sum to 1."""
    weights = np.full(STATIONS, 1.0 / (STATIONS - 1))
    weights[[0, -1]] /= 2
    return weights
