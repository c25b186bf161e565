"""Designs that are evaluated by several equilibria: an insertion has one at each depth, a schedule one at each time.

Magnetization and numbers are shared by all of them, and each has its own field, or all have one. Their gaps stand one after the other in
the residuals that Gauss-Newton reads; the fields of two of them do not touch each other's shapes.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array, Named, NamedNumbers, Plain
from magmpm.errors import SolveError
from magmpm.results.measures import centreline_at
from magmpm.results.whole_file import whole_file
from magmpm.rod.cosserat import rod_model
from magmpm.rod.family import RodFamily
from magmpm.scene import Scene
from magmpm.studies.evaluate.trial import Evaluation, Note, Solve, penalty, silent, stored
from magmpm.studies.problem.path import Path as Curve
from magmpm.studies.problem.study import Study
from magmpm.studies.rods.rod_path import LEAST_STEPS_PER_DEPTH, RodPath, directions_of, search
from magmpm.studies.rods.rod_trajectory import (
    TRAJECTORY_ELEMENTS,
    Depth,
    RodTrajectory,
    RodTrajectoryDesign,
)
from magmpm.studies.search.parameters import Parameters
from magmpm.studies.search.search_space import SearchSpace

if TYPE_CHECKING:
    from magmpm.results.result import Result
    from magmpm.rod.cosserat import RodShape
    from magmpm.statics.linearized import Sensitivities

STATIONS_OF_INSERTION = 25
EXIT_WEIGHT = 0.25
DEPTHS = "insertion"  # user attribute: what is kept of each depth
CATHETER = (  # ... the whole catheter, of which the last depth may leave a part in the guide
    "catheter"
)
SHAPES = "shapes"  # ... and how it is drawn: axis, and each segment's center and remanence
MOVIE = "insertion.json"
NEAR_TARGET = 0.01  # of the length: a rod's design that is near enough


@dataclass(frozen=True)
class Trajectory(Evaluation, ABC):
    """Several equilibria of each design."""

    sought = 24, 3  # of the rod: most random starts, and how many designs are enough
    end_weight = (
        0.0  # what the last gap of the last equilibrium counts besides, in what Gauss-Newton reads
    )

    @abstractmethod
    def weights(self, number: int) -> Array:
        """Find the weights of the squared lengths of an equilibrium's gaps.

        Parameters
        ----------
        number : int
            Of the equilibrium.

        Returns
        -------
        array (m,), no unit
            They sum to 1.
        """

    @abstractmethod
    def way(self, params: Parameters) -> RodPath | None:
        """Find the rods of a design on the way from each equilibrium to the next.

        Parameters
        ----------
        params : Mapping[str, Any]
            The design.

        Returns
        -------
        RodPath or None
            The rods; None where the body is no rod in a uniform field.
        """

    @abstractmethod
    def _way(self, scene: Scene) -> RodPath:
        """The rods of a scene on the way from each equilibrium to the next."""

    @property
    @abstractmethod
    def followed(self) -> Any:
        """The curve that the rods follow, or one for each of them: rod_trajectory.RodTrajectory.grown."""

    def starts(self, params: Parameters) -> Sequence[RodShape | None]:
        way = self.way(params)
        directions = directions_of(self.space.scene_of(params))
        if way is None:
            return super().starts(params)
        return [stops[-1].shape(directions) for stops in way.stops(directions, self.fields(params))]

    @cached_property
    def rods(self) -> RodPath:
        """The rods among which designs are sought: numbers within bounds are in the middle."""
        return self._way(self.space.scene)

    def rod_starts(self, note: Note = silent) -> list[NamedNumbers]:
        """None where directions or the fields of each equilibrium are not varied."""
        space, (starts, wanted) = self.space, self.sought
        if space.field_max is None or space.fields != len(self.places) or not space.segments:
            return []
        length = self.study.depths[-1] if self.study.depths else space.scene.length
        enough = NEAR_TARGET * length
        found = search(
            self.rods,
            self.followed,
            seed=self.study.seed,
            starts=starts,
            wanted=wanted,
            enough=enough,
            note=note,
        )
        return [self.parameters(design) for design in found[:wanted]]

    def parameters(self, design: RodTrajectoryDesign) -> NamedNumbers:
        """Write a rod's design as the study's parameters; numbers within bounds are in the middle.

        Parameters
        ----------
        design : RodTrajectoryDesign
            The rod's design.

        Returns
        -------
        dict[str, float]
            Parameters by name.
        """
        x = self.space.middle
        directions = design.directions[list(self.space.segments)]
        x[: directions.size] = directions.ravel()
        x[directions.size : directions.size + design.fields.size] = design.fields.ravel()
        return self.space.parameters_at(x)

    def fields(self, params: Parameters) -> Array:
        """Find the field of each equilibrium of a design.

        Parameters
        ----------
        params : Mapping[str, Any]
            The design.

        Returns
        -------
        array (n, 3), T
            The fields.
        """
        return np.array(
            [self.space.field(params, self.field_number(k)) for k in range(len(self.places))]
        )

    def penalty(self, params: Parameters) -> float:
        return penalty(self.space.scene)

    def mean_squares(self, results: Sequence[Result]) -> Array:
        """Find the mean squared gap of each equilibrium.

        Parameters
        ----------
        results : sequence of Result
            The equilibria.

        Returns
        -------
        array (n,), m^2
            Weighted means.
        """
        return np.array(
            [
                self.weights(k) @ np.sum(self.gaps(result, k) ** 2, axis=1)
                for k, result in enumerate(results)
            ]
        )

    def rows(self, results: Sequence[Result], params: Parameters) -> list[Plain]:
        """Describe each equilibrium.

        Parameters
        ----------
        results : sequence of Result
            The equilibria.
        params : Mapping[str, Any]
            The design.

        Returns
        -------
        list of dict[str, Any]
            Field (T) and distances (m) of each.
        """
        each = zip(self.fields(params), self.mean_squares(results), results, strict=True)
        return [
            {
                "field_T": np.round(field, 12).tolist(),
                "rms_m": float(np.sqrt(square)),
                "tip_error_m": float(np.linalg.norm(self.gaps(result, k)[-1])),
            }
            for k, (field, square, result) in enumerate(each)
        ]

    def field_changes(self, params: Parameters) -> NamedNumbers:
        """Find the changes of the field from one equilibrium to the next.

        Parameters
        ----------
        params : Mapping[str, Any]
            The design.

        Returns
        -------
        dict[str, float], T
            The largest change, and their sum.
        """
        changes = np.linalg.norm(np.diff(self.fields(params), axis=0), axis=1)
        return {
            "field_largest_change_T": float(changes.max(initial=0.0)),
            "field_total_variation_T": float(changes.sum()),
        }

    def hidden(self, found: Sensitivities) -> int:
        """Count the segments of the whole body, from its base, that an equilibrium does not have.

        Parameters
        ----------
        found : Sensitivities
            The equilibrium and its derivatives.

        Returns
        -------
        int
            Their number.
        """
        return 0

    def _derived(
        self, found: Sensitivities, scene: Scene, params: Parameters, number: int
    ) -> Array:
        """Derivatives (3 m, size) of an equilibrium's gaps by the design's embedded coordinates."""
        hidden = self.hidden(found)
        variables = [
            v
            if v.region is None
            else replace(v, place=(*v.place[:3], int(v.place[3]) + hidden, *v.place[4:]))
            for v in found.variables
        ]
        chain = self.space.chain(
            variables, self.space.embedded(params), field=self.field_number(number)
        )
        slopes = self.slopes(found, number)
        return np.asarray(slopes.reshape(-1, slopes.shape[-1]) @ chain)

    def _model(self, results: Sequence[Result], derived: list[Any]) -> Plain:
        """The attributes that Gauss-Newton reads; none without derivatives."""
        if not derived:
            return {}
        roots = [np.repeat(np.sqrt(self.weights(k) / len(results)), 3) for k in range(len(results))]
        gaps = [self.gaps(result, k).reshape(-1) for k, result in enumerate(results)]
        end = np.sqrt(self.end_weight)
        rows = [*(root * gap for root, gap in zip(roots, gaps, strict=True)), end * gaps[-1][-3:]]
        columns = [
            *(root[:, None] * slope for root, slope in zip(roots, derived, strict=True)),
            end * derived[-1][-3:],
        ]
        return stored(np.concatenate(rows), np.concatenate(columns))


@dataclass(frozen=True)
class ScheduleTrajectory(Trajectory):
    """A field over time that brings a body through given shapes at given times.

    The twin of insertion: the body stays as it is, and the field at each of the times is unknown,
    with a magnetization (and what else varies) that all times share. Each shape is the equilibrium
    that the body comes to from the one before (rod_path.py; where a field varies in space, the one
    that grows from no load); between the times the field changes evenly, as keyframes of a scene
    do. So a schedule holds for motions that are slow beside the body's own (`magmpm report
    --motion` compares with a motion).

    rms: root of the mean, over all times, of the mean squared distance from that time's target;
    worst: the largest rms of a single time.
    """

    @classmethod
    def of(cls, study: Study, space: SearchSpace) -> ScheduleTrajectory | None:
        """Make it for a study with times.

        Parameters
        ----------
        study : Study
            The study.
        space : SearchSpace
            Its search space.

        Returns
        -------
        ScheduleTrajectory or None
            How its designs are evaluated; None where the study has no times.
        """
        return cls(study, space) if study.keyframes else None

    @property
    def places(self) -> tuple[str, ...]:
        return tuple(f"at {frame.time:g} s" for frame in self.study.keyframes)

    def target(self, number: int) -> Array:
        return self.study.keyframes[number].target

    def weights(self, number: int) -> Array:
        count = len(self.target(number))
        return np.full(count, 1.0 / count)

    def measures(self, results: Sequence[Result], params: Parameters) -> Plain:
        squares = self.mean_squares(results)
        worst = int(np.argmax(squares))
        rows = zip(self.study.keyframes, self.rows(results, params), strict=True)
        return {
            "rms_m": float(np.sqrt(squares.mean())),
            "worst_m": float(np.sqrt(squares[worst])),
            "worst_time_s": self.study.keyframes[worst].time,
            **self.field_changes(params),
            "schedule": [{"time_s": frame.time, **row} for frame, row in rows],
            SHAPES: self._shown(results, params),
        }

    def _shown(self, results: Sequence[Result], params: Parameters) -> list[Plain]:
        """Data that pictures need of the times that they show, m and T."""
        most_times_shown = 4  # times in the picture of a schedule, at most
        fields = self.fields(params)
        found = []
        for k in np.unique(
            np.linspace(0, len(results) - 1, most_times_shown).round().astype(int)
        ).tolist():
            frame = self.study.keyframes[k]
            about = {"time_s": frame.time, "field_T": np.round(fields[k], 12).tolist()}
            target = np.round(frame.target[:, 1:], 7).tolist()
            found.append({**about, "target_m": target, **shape_of(results[k])})
        return found

    def way(self, params: Parameters) -> RodPath | None:
        scene = self.space.scene_of(params)
        straight = isinstance(scene.body.shape, StraightBody) and scene.body.shape.clamp == "base"
        return self._way(scene) if straight and not scene.field.varies else None

    def _way(self, scene: Scene) -> RodPath:
        times = tuple(_rod(scene, path, len(self.followed.paths)) for path in self.followed.paths)
        movable = np.array(scene.magnetized_regions(), dtype=int)
        rods = RodSchedule(times, self.space.field_max or 0.0, movable, len(scene.regions()))
        return RodPath(
            rods, tuple((depth,) * LEAST_STEPS_PER_DEPTH for depth in rods.depths)
        )  # of bodies that stay while the field changes

    @property
    def followed(self) -> Shapes:
        return Shapes(tuple(Curve(frame.target) for frame in self.study.keyframes))


@dataclass(frozen=True)
class Shapes:
    """The shapes of a schedule as curves.

    Attributes
    ----------
    paths : tuple of Curve
        A curve for each time.
    """

    paths: tuple[Curve, ...]

    def flattened(self, share: float) -> Shapes:
        """Make the shapes with a share of their curvature.

        Parameters
        ----------
        share : float, no unit
            0 is straight, 1 these shapes.

        Returns
        -------
        Shapes
            The flatter shapes.
        """
        return Shapes(tuple(path.flattened(share) for path in self.paths))


class RodSchedule(RodTrajectory):
    """Rods of one length, each with a shape of its own."""

    def bent(self, path: Any, share: float) -> RodTrajectory:
        """The rods with other shapes, and this share of the weight."""
        bent = [
            replace(rod.weighing(share), path=curve.at(rod.place))
            for rod, curve in zip(self.depths, path.paths, strict=True)
        ]
        return replace(self, depths=tuple(bent))


def _rod(scene: Scene, path: Curve, count: int) -> Depth:
    """The rod of one time of `count`, compared with its shape up to the shape's end."""
    scene = scene.with_field([0.0, 0.0, 0.0])
    rod = rod_model(scene, max(TRAJECTORY_ELEMENTS, 4 * len(scene.regions())))
    place = rod.places
    seen = place <= path.length * (1 + 1e-9)
    roots = np.where(seen, np.sqrt(1.0 / (count * seen.sum())), 0.0)
    family = RodFamily.of(rod, scene.body.shape.segment_lengths(), scene.magnetized_regions())  # type: ignore[attr-defined]
    segments = np.array(scene.magnetized_regions(), dtype=int)
    return Depth(
        rod=family,
        segments=segments,
        place=place,
        path=path.at(np.minimum(place, path.length)),
        roots=roots,
    )


@dataclass(frozen=True)
class InsertionTrajectory(Trajectory):
    """A catheter is pushed out of a guide, and the field at each depth lets its whole body follow the path of its tip.

    One equilibrium at each depth, each an ordinary static scene (Scene.inserted), in that depth's
    field. What is outside the guide at depth l is compared with the path's first l, at equal arc
    length from the exit on.

    * body rms: root of the mean, over all depths, of the mean squared distance along the inserted
      length (STATIONS_OF_INSERTION stations).
    * exit error: distance of the tip from the path's end, at full insertion (at the last depth from
      the path's point there).
    * worst depth: the largest rms of a single depth.
    * smoothness of the field: its largest change between neighboring depths, and the sum of the
      changes, T.

    The value of a trial is its body rms. Samplers that read residuals get the exit's as well, which
    counts EXIT_WEIGHT as much as all of the body: the body's rms alone would leave the tip 2 to 4
    times as far away as the rest.

    A body that is pushed has at each depth the equilibrium that it comes to from the depth before.
    So a rod is pushed along (rod_path.py), and each depth's equilibrium is the one near it; in a
    field that varies in space, the one on the branch that grows from no load. Where a depth has
    none, the trial gets the penalty, and the reason names the depth.

    Attributes
    ----------
    study : Study
        The study.
    space : SearchSpace
        Its search space.
    path : Curve
        The path of the insertion.
    """

    path: Curve
    sought = 40, 2
    end_weight = EXIT_WEIGHT

    @classmethod
    def of(cls, study: Study, space: SearchSpace) -> InsertionTrajectory | None:
        """Make it for a study with depths.

        Parameters
        ----------
        study : Study
            The study.
        space : SearchSpace
            Its search space.

        Returns
        -------
        InsertionTrajectory or None
            How its designs are evaluated; None where the study has no depths.
        """
        return cls(study, space, Curve(study.target)) if study.depths else None

    @property
    def places(self) -> tuple[str, ...]:
        return tuple(f"at {1e3 * depth:.4g} mm" for depth in self.study.depths)

    def scenes(self, params: Parameters) -> list[Scene]:
        """The scene of each depth of a design."""
        return [
            self.space.scene_of(params, self.field_number(k)).inserted(length)
            for k, length in enumerate(self.study.depths)
        ]

    def gaps(self, result: Result, number: int = -1) -> Array:
        """Vectors (STATIONS_OF_INSERTION, 3) m from the path to one depth's axis."""
        s = _stations(result)
        return np.asarray(centreline_at(result, s) - self.path.at(s))

    def slopes(self, found: Sensitivities, number: int) -> Array:
        return found.at(_stations(found.result))

    def weights(self, number: int) -> Array:
        """Trapezoidal rule."""
        weights = np.full(STATIONS_OF_INSERTION, 1.0 / (STATIONS_OF_INSERTION - 1))
        weights[[0, -1]] /= 2
        return weights

    def hidden(self, found: Sensitivities) -> int:
        return len(self.space.scene.regions()) - int(np.max(found.result.particle_segment)) - 1

    def measures(self, results: Sequence[Result], params: Parameters) -> Plain:
        """Measures reported of a trajectory, as the class has them."""
        squares = self.mean_squares(results)
        each = zip(self.study.depths, self.rows(results, params), results, strict=True)
        rows = [
            {
                "depth_m": depth,
                **row,
                "newton_steps": int(one.iterations),
                "stability": one.stability,
            }
            for depth, row, one in each
        ]
        return {
            "rms_m": float(np.sqrt(squares.mean())),
            "exit_error_m": rows[-1]["tip_error_m"],
            "worst_m": float(np.sqrt(squares.max())),
            "worst_depth_m": float(self.study.depths[int(np.argmax(squares))]),
            **self.field_changes(params),
            DEPTHS: rows,
            SHAPES: [shape_of(result) for result in results],
            CATHETER: self.space.scene_of(params).to_si()["body"]["catheter"],
        }

    def write_moments(
        self, folder: Path, solve: Solve, params: Parameters, note: Note = silent
    ) -> None:
        """Write the frames of the movie of a design: all depths on the way, each in a field between those of its neighbors.

        A depth that finds no equilibrium is left out.

        Parameters
        ----------
        folder : Path
            Where they are written.
        solve : callable
            From a scene to its Result.
        params : Mapping[str, Any]
            The design.
        note : Note, default silent
            Told in words what is being done.
        """
        whole = self.space.scene_of(params)
        frames = []
        for length, field, start in self._moments(params):
            note(
                f"frames of the movie: at {1e3 * length:.1f} of"
                f" {1e3 * self.study.depths[-1]:.4g} mm"
            )
            try:
                result = solve(whole.with_field(field).inserted(length), start=start)
            except SolveError:
                continue
            rms = float(np.sqrt(self.mean_squares([result])[0]))
            frames.append(
                {"depth_m": length, "field_T": field.tolist(), "rms_m": rms, **shape_of(result)}
            )
        content = {"scene": whole.to_si(), "path_m": self.path.rows.tolist(), "frames": frames}
        with whole_file(folder / MOVIE) as part:
            part.write_text(json.dumps(content) + "\n", encoding="utf-8")

    def _moments(self, params: Parameters) -> Iterator[tuple[float, Array, RodShape | None]]:
        """Depths (m), fields (3,) T and rods of the movie, from the first depth that is evaluated on."""
        fields = self.fields(params)
        way = self.way(params)
        if way is None:
            depths = np.array(self.study.depths)
            for length in np.unique(
                np.concatenate([depths, np.linspace(depths[0], depths[-1], 48)])
            ).tolist():
                yield (
                    length,
                    np.array([np.interp(length, depths, column) for column in fields.T]),
                    None,
                )
            return
        directions = directions_of(self.space.scene_of(params))
        for k, stops in enumerate(way.stops(directions, fields)):
            for stop in stops if k else stops[-1:]:
                yield float(stop.depth.place[-1]), stop.field, stop.shape(directions)

    # designs by the rod

    def way(self, params: Parameters) -> RodPath | None:
        return None if self.space.scene.field.varies else self._way(self.space.scene_of(params))

    @property
    def followed(self) -> Curve:
        return self.path

    def _way(self, scene: Scene) -> RodPath:
        most = self.space.field_max or 0.0
        return RodPath.of(
            scene, self.path, self.study.depths, max_field=most, exit_weight=EXIT_WEIGHT
        )

    @property
    def projects(self) -> bool:
        """True if samplers choose directions alone, and the rod each depth's field: where nothing else is varied."""
        space = self.space
        depths = len(self.study.depths)
        return (
            bool(space.segments)
            and space.field_max is not None
            and space.fields == depths > 1
            and len(space.blocks) == len(space.segments) + depths
            and not space.choices
        )

    def directions_alone(self) -> SearchSpace:
        """Make the search space without the fields.

        Returns
        -------
        SearchSpace
            The smaller space.
        """
        return replace(self.space, field_max=None, fields=1)

    def with_fields(self, chosen: Parameters) -> Plain:
        """Add to parameters of directions those of the field that the rod finds for each depth.

        Parameters
        ----------
        chosen : Mapping[str, Any]
            Parameters of directions.

        Returns
        -------
        dict[str, Any]
            All parameters.
        """
        fitted = self.rods.rods.fitted(self.path, self.directions_alone().directions(chosen))
        mended = None if fitted.state is None else self.rods.mended(fitted, turning=False)
        return {**self.parameters(mended or fitted), **chosen}


def shape_of(result: Result) -> Plain:
    """Collect what pictures need of one equilibrium.

    Parameters
    ----------
    result : Result
        The equilibrium.

    Returns
    -------
    dict[str, Any]
        Plain data, in m and T.
    """
    axis = centreline_at(result, _stations(result))
    rows = {
        "axis_m": axis,
        "centers_m": result.segment_center,
        "remanence_T": result.segment_remanence,
    }
    return {name: np.round(np.asarray(values), 7).tolist() for name, values in rows.items()}


def shapes_of(kept: Named) -> tuple[Plain, ...]:
    """Collect what pictures need of each depth or time.

    Parameters
    ----------
    kept : Mapping[str, Any]
        A trial's attributes, or a design.

    Returns
    -------
    tuple of dict[str, Any]
        Plain data of each; none where it is one equilibrium.
    """
    if DEPTHS not in kept:
        return tuple(kept.get(SHAPES, ()))
    whole = {key: kept[key] for key in (CATHETER,) if key in kept}
    return tuple(
        {**depth, **shape, **whole}
        for depth, shape in zip(kept.get(DEPTHS, ()), kept.get(SHAPES, ()), strict=False)
    )


def _stations(result: Result) -> Array:
    """Arc lengths (STATIONS_OF_INSERTION,) m, exit to tip."""
    return np.linspace(0.0, float(result.centreline[-1, 0]), STATIONS_OF_INSERTION)
