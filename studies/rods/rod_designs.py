"""Designs that the rod finds: many descents at once on Cosserat rods, in a fraction of a second, before the body is solved at all.

The rod's shape is within a per cent of the length of the body's (its clamp does not restrain the section), and its derivatives are exact
(magmpm.rod.derivative_kernels). From points that cover the spheres of directions and the ball of fields evenly, Levenberg's and Marquardt's
method goes down in all of them at once; the worse ones are dropped on the way.

A body that bends strongly has several equilibria, and is found on the branch that grows from zero load. So each shape of a descent is
relaxed from the straight rod: from the shape of the step before, descents went down branches on which no body is. The few last ones relax
under a load that grows in steps, and what is left is solved again as `solve_rod` solves it, in small ones.

What a weaker field reaches, a stronger one reaches too. So where the field varies, other descents begin in a weak field, in which a rod has
one equilibrium, and go on as its bound grows to the study's, each bound with the designs of the one before; the best of each bound are
kept. If all that ends farther from the target than FAR_FROM_TARGET of the length, it is searched from more points, and then beside the
best designs again and again: where a body is about to snap, a descent ends at the edge of what it can reach without, and goes on from
designs beside it.
Source: Wales and Doye, J. Phys. Chem. A 101 (1997) 5111 (basin hopping).

A field that varies in space, and its gradient, are taken at the places of the target, where the body is if the design is right. Where the
scene has no rod, there are no designs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from magmpm.compiled.arrays import Array, NamedNumbers
from magmpm.errors import SolveError
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from magmpm.studies.problem.shape_distance import root_mean_square
from magmpm.studies.rods.rod_descents import (
    DAMPING,
    DESIGNS_SOUGHT,
    DescendingRods,
    RodDescents,
    in_ball,
)
from magmpm.studies.search.parameters import FieldVector, Parameters, SegmentDirection
from magmpm.studies.search.samplers.blocks import unit
from magmpm.studies.search.search_space import SearchSpace

if TYPE_CHECKING:
    from scipy.stats import qmc

    from magmpm.studies.search.samplers.bounded_front import Start

# of the length: a best design that is farther away is searched in other ways, and from more points
REACHED_TARGET = 1e-3
FAR_FROM_TARGET = 1e-2
STARTS_OF_DESCENTS = 32  # of descents: a power of two, as points that spread evenly want it
EACH_BOUND = 2  # designs of each bound of a ladder
BOUND_RATIO = math.sqrt(2.0)  # of two bounds that follow each other


@dataclass(frozen=True)
class RodDesign:
    """A design that the rod has found.

    Attributes
    ----------
    directions : array (k, 3), no unit
        Unit vectors of the varied regions.
    field : array (3,), T
        The uniform field; the scene's, where it is not varied.
    rms : float, m
        Distance of the rod from the target.
    stability : float, no unit
        Of the rod: 1 at rest, 0 at a critical load.
    """

    directions: Array
    field: Array
    rms: float
    stability: float


def rod_designs(
    scene: Scene,
    target: Array,
    regions: Sequence[int],
    field_max: float | None,
    *,
    seed: int = 1,
    starts: int = STARTS_OF_DESCENTS,
    keep: int = DESIGNS_SOUGHT,
) -> list[RodDesign]:
    """Find the rod's best designs for a target.

    Parameters
    ----------
    scene : Scene
        The scene.
    target : array (m, 4), m
        Rows [s, x, y, z].
    regions : sequence of int
        Indices of the regions whose directions vary.
    field_max : float, T, or None
        Greatest strength of a varied uniform field; None: the scene's field stays.
    seed : int, default 1
        Of the points that descents begin at.
    starts : int, default STARTS_OF_DESCENTS
        Number of these points.
    keep : int, default DESIGNS_SOUGHT
        Number of designs that are kept.

    Returns
    -------
    list of RodDesign
        Best first, different from each other; none where the scene has no rod.
    """
    try:
        problem = DescendingRods(scene, target, regions, field_max)
    except SolveError:
        return []
    points = _points(problem, seed)
    first = points.random(starts)
    found = _verified(scene, problem, regions, _searched(problem, first))
    for near, search in _more_searches(problem, first, points.random(starts)):
        if any(design.rms < near * scene.length for design in found):
            return found[:keep]
        for within, at in search():  # what a smaller bound allows the last one allows
            last = within.field_max == field_max
            found += _verified(scene, within, regions, at if last else at.best(EACH_BOUND))
        found = _best_first(found, scene.length)
    return _with_those_beside(scene, problem, regions, found, seed)[:keep]


def _searched(problem: DescendingRods, uniform: Array) -> RodDescents:
    """Descents from points (Problem.begun), the worse ones dropped on the way."""
    starts = len(uniform)
    at = problem.descended(
        problem.begun(uniform), [(8, max(starts // 2, 12)), (10, max(starts // 4, 12))]
    )
    return problem.carefully(at, [(12, 12)])


def _with_those_beside(
    scene: Scene,
    problem: DescendingRods,
    regions: Sequence[int],
    found: list[RodDesign],
    seed: int,
    rounds: int = 6,
) -> list[RodDesign]:
    """The designs found, and where the best is far from the target what descents from designs beside the best ones find, in `rounds`."""
    if not found or found[0].rms <= FAR_FROM_TARGET * scene.length:
        return found
    count = 12
    draw = np.random.default_rng([seed])
    chosen = (found * count)[:count]
    directions = np.stack([design.directions for design in chosen])
    field = np.stack([design.field for design in chosen]) / (problem.field_max or 1.0)
    at = problem.carefully(problem.begun_with(directions, field), [])
    for _ in range(rounds):
        more = problem.beside(at, draw, turn=0.3)
        at = at.and_those(problem.carefully(more, [(12, count)])).best(count)
    found = found + _verified(scene, problem, regions, problem.carefully(at, [(12, 8)]))
    return _best_first(found, scene.length)


def _more_searches(
    problem: DescendingRods, first: Array, more: Array
) -> Iterator[tuple[float, Callable[[], Iterable[tuple[DescendingRods, RodDescents]]]]]:
    """Searches after that from the points `first`, which give descents and the problem within whose bound they are; each with the distance,
    as a share of the length, at which it is not needed."""
    if problem.field_max is None:
        yield FAR_FROM_TARGET, lambda: [(problem, _searched(problem, more))]
    else:
        yield REACHED_TARGET, lambda: _growing_bounds(problem, first)
        yield FAR_FROM_TARGET, lambda: _growing_bounds(problem, more, fresh=True)


def rod_designs_by_bound(
    scene: Scene, target: Array, regions: Sequence[int], field_max: float, *, seed: int = 1
) -> list[RodDesign]:
    """Find the rod's best designs within each of a ladder of bounds of the field.

    Parameters
    ----------
    scene : Scene
        The scene.
    target : array (m, 4), m
        Rows [s, x, y, z].
    regions : sequence of int
        Indices of the regions whose directions vary.
    field_max : float, T
        The greatest bound.
    seed : int, default 1
        Of the points that descents begin at.

    Returns
    -------
    list of RodDesign
        Nearest to the target first; none where the scene has no rod.
    """
    try:
        problem = DescendingRods(scene, target, regions, field_max)
    except SolveError:
        return []
    found: list[RodDesign] = []
    for within, at in _growing_bounds(
        problem, _points(problem, seed).random(STARTS_OF_DESCENTS), fresh=True
    ):
        found += _verified(scene, within, regions, at)[:EACH_BOUND]
    return sorted(found, key=lambda design: design.rms)


def _points(problem: DescendingRods, seed: int) -> qmc.Sobol:
    """Points that spread evenly over the spheres of directions and the ball of fields: numbers from 0 to 1, (s, 3 k + 3)."""
    from scipy.stats import qmc  # 0.3 s to import, and few commands need it

    return qmc.Sobol(3 * problem.count + 3, rng=np.random.default_rng([seed]))


def _growing_bounds(
    problem: DescendingRods, uniform: Array, fresh: bool = False
) -> Iterator[tuple[DescendingRods, RodDescents]]:
    """Descents that begin within a weak field's bound, each next bound with the designs of the one before; the last is the problem's.

    Yields the problem within each bound, and its descents. The bounds do not depend on the last one, so what is found within one is found
    within every larger one. fresh: each bound, and not the first alone, also has the designs at the points `uniform` (Problem.begun).
    """
    last = problem.field_max
    assert last is not None
    bound = problem.unit_field
    reached = min(bound, last)
    here = problem.within(reached)
    at = here.descended(here.begun(uniform), [(8, 8)])
    while reached != last:
        yield here, at
        bound *= BOUND_RATIO
        before = reached
        reached = min(bound, last)
        there = problem.within(reached)
        at = there.state(
            at.directions,
            at.field * (before / reached),
            at.quaternions,
            np.full(len(at.cost), DAMPING),
        )
        if fresh:
            at = at.and_those(there.descended(there.begun(uniform), [(8, 8)]))
        at = there.descended(at, [(6, 8)])
        here = there
    yield here, here.carefully(at, [(12, 8)])


def rod_starts(
    space: SearchSpace, target: Array, seed: int, *, by_bound: bool = False
) -> list[NamedNumbers]:
    """Find the rod's best designs as parameters of a study. Numbers within bounds are in the middle of them.

    Parameters
    ----------
    space : SearchSpace
        The search space.
    target : array (m, 4), m
        Rows [s, x, y, z].
    seed : int
        Of the points that descents begin at.
    by_bound : bool, default False
        Those within each of a ladder of bounds of the field (rod_designs_by_bound).

    Returns
    -------
    list of dict[str, float]
        Best first.
    """
    first = {"order": space.choices["order"][0]} if space.order else {}
    scene = space.scene_at(space.middle, first)
    if by_bound and space.field_max is not None:
        found = rod_designs_by_bound(scene, target, space.segments, space.field_max, seed=seed)
    else:
        found = rod_designs(scene, target, space.segments, space.field_max, seed=seed)
    starts = []
    for design in found:
        x = space.middle
        directions = iter(design.directions)
        for _, at in space.those(SegmentDirection):
            x[at] = next(directions)
        for _, at in space.those(FieldVector):
            x[at] = design.field
        starts.append(space.parameters_at(x, first))
    return starts


class RodForetells:
    """Forecasts of the rod for a study of directions and one field: a model of a front of the distance and the field (bounded_front).

    unloaded: distance (m) of the rod from the target in no field.

    Parameters
    ----------
    space : SearchSpace
        The search space.
    problem : DescendingRods
        The descents within its greatest field.
    """

    def __init__(self, space: SearchSpace, problem: DescendingRods) -> None:
        self._space = space
        self._problem = problem
        self.unloaded = root_mean_square(self._gaps(space.scene.with_field(np.zeros(3))))
        self._made: dict[float, Any] = {}  # designs and what they became, last, by bound
        self._foretold: dict[Any, Array | None] = {}  # residuals: a plan goes through all trials

    @classmethod
    def of(cls, space: SearchSpace, target: Array) -> RodForetells | None:
        """Make it for a study.

        Parameters
        ----------
        space : SearchSpace
            The search space.
        target : array (m, 4), m
            Rows [s, x, y, z].

        Returns
        -------
        RodForetells or None
            None where the rod can't: other numbers vary than directions and one field,
            directions are of a set, or there is no rod.
        """
        others = len(space.blocks) != len(space.segments) + 1 or space.choices
        if space.field_max is None or others or space.limits is not None:
            return None
        try:
            return cls(space, DescendingRods(space.scene, target, space.segments, space.field_max))
        except SolveError:
            return None

    def _gaps(self, scene: Scene) -> Array:
        """Vectors (m, 3) m from the target to the scene's rod."""
        target = self._problem.target
        return np.asarray(solve_rod(scene).at(target[:, 0]) - target[:, 1:])

    def residuals(self, design: Mapping[str, float]) -> Array | None:
        """Find the residuals of a design's rod.

        Parameters
        ----------
        design : Mapping[str, float]
            Its parameters.

        Returns
        -------
        array (3 m,), m, or None
            Gaps over the root of m; None where the rod finds no equilibrium.
        """
        key = tuple(sorted(design.items()))
        if key not in self._foretold:
            self._foretold[key] = self._residuals(design)
        return self._foretold[key]

    def _residuals(self, design: Mapping[str, float]) -> Array | None:
        try:
            gaps = self._gaps(self._space.scene_of(design))
        except SolveError:
            return None
        return (gaps / np.sqrt(len(gaps))).reshape(-1)

    def improved(self, share: float, designs: Sequence[Parameters]) -> list[Start]:
        """Improve designs within a bound of the field.

        Parameters
        ----------
        share : float, no unit
            The bound, as a share of the greatest.
        designs : sequence of Parameters
            Of any strength.

        Returns
        -------
        list of (float, dict[str, float])
            Better ones, best first, each with the distance (m) of its rod from the target.
        """
        if share not in self._made or self._made[share][0] != list(designs):
            self._made[share] = list(designs), self._improved(share, designs)
        found: list[Start] = self._made[share][1]
        return found

    def _improved(self, share: float, designs: Sequence[Parameters]) -> list[Start]:
        if not designs:
            return []
        problem = self._problem
        space = self._space
        assert problem.field_max is not None  # `of` makes it so
        bound = share * problem.field_max
        here = problem.within(bound)
        x = np.array([space.embedded(design) for design in designs])
        field = in_ball(x[:, -3:] / bound)
        begun = here.begun_with(x[:, :-3].reshape(len(x), -1, 3), field)
        at = here.carefully(begun, [(6, 12), (8, 8)])
        found = _verified(space.scene, here, space.segments, at)
        # of the least cost of designs in weaker fields, 5 % of their distance: above it more field
        # was no help
        helped = 0.95**2
        weaker = begun.cost[np.linalg.norm(field, axis=1) < 1.0]
        if not (weaker.size and at.cost.min() < helped * weaker.min()):
            found = _with_those_beside(
                space.scene, here, space.segments, found, seed=0, rounds=3
            )  # half the rounds: each bound asks
        return [
            (
                design.rms,
                space.parameters_at(np.concatenate([design.directions.ravel(), design.field])),
            )
            for design in found
        ]


def _verified(
    scene: Scene, problem: DescendingRods, regions: Sequence[int], at: RodDescents
) -> list[RodDesign]:
    """Those designs that are different from better ones, judged by the rod under loads that grow from zero, best first."""
    target = problem.target
    field_max = problem.field_max
    fixed = np.array(scene.field.uniform, dtype=float)
    found: list[RodDesign] = []
    for s in range(len(at.cost)):
        if not np.isfinite(at.cost[s]):
            continue
        field = fixed if field_max is None else field_max * at.field[s]
        every = np.array([region.magnetization for region in scene.regions()], dtype=float)
        every[list(regions)] = at.directions[s]
        there = scene.with_magnetizations(every) if len(regions) else scene
        try:
            shape = solve_rod(there if field_max is None else there.with_field(field))
        except SolveError:
            continue
        gap = shape.at(target[:, 0]) - target[:, 1:]
        stability = problem.family.stability(
            at.quaternions[s], at.directions[s], np.zeros(3) if field_max is None else field
        )
        found.append(RodDesign(at.directions[s], field, root_mean_square(gap), stability))
    return _best_first(found, scene.length)


def _best_first(designs: Sequence[RodDesign], length: float) -> list[RodDesign]:
    """Those designs that are different from better ones, best first; length of the body, m.

    Near a critical load the body is hard to solve and its derivatives are large: a design there counts as worse than it is.
    """
    # a stability below 0.15 counts as worse, at a critical load by 0.05 of the length
    ordered = sorted(
        designs,
        key=lambda design: design.rms + max(1.0 - design.stability / 0.15, 0.0) * 0.05 * length,
    )
    kept: list[RodDesign] = []
    for design in ordered:
        if all(_angle_between(design, other) > 0.3 for other in kept):  # rad
            kept.append(design)
    return kept


def _angle_between(one: RodDesign, other: RodDesign) -> float:
    """Root mean square angle between two designs' directions, and the field's."""
    a, b = (np.vstack([d.directions, unit(d.field[None])]) for d in (one, other))
    return float(np.sqrt(np.mean(np.arccos(np.clip(np.sum(a * b, axis=1), -1.0, 1.0)) ** 2)))
