"""Designs that the rod finds: many descents at once on Cosserat rods, in a fraction of a second, before the body is solved at all.

The rod's shape is within a per cent of the length of the body's (its clamp does not restrain the section), and its derivatives are exact
(magmpm.rod.derivative_kernels). From points that cover the spheres of directions and the ball of fields evenly, Levenberg's and Marquardt's
method goes down in all of them at once; the worse ones are dropped on the way.

A body that bends strongly has several equilibria, and is found on the branch that grows from zero load. So each shape of a descent is
relaxed from the straight rod: from the shape of the step before, descents went down branches on which no body is. What is left is solved
again as `solve_rod` solves it, with loads that grow in small steps.

What a weaker field reaches, a stronger one reaches too. So where the field varies, other descents begin in a weak field, in which a rod has
one equilibrium, and go on as its bound grows to the study's, each bound with the designs of the one before. If all that ends farther from
the target than FAR of the length, it is searched from more points.

A field that varies in space, and its gradient, are taken at the places of the target, where the body is if the design is right. Where the
scene has no rod, there are no designs.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from magmpm.bodies.curves import linear
from magmpm.compiled.arrays import Array
from magmpm.errors import SolveError
from magmpm.rod.cosserat import rod_model, solve_rod
from magmpm.rod.family import RodFamily
from magmpm.scene import Scene
from magmpm.studies.problem.shape_distance import root_mean_square
from magmpm.studies.search.parameters import Direction, FieldVector, Parameters, across, unit
from magmpm.studies.search.search_space import SearchSpace

ELEMENTS = 8  # in each segment: the rod is a thousandth of its length from its limit, less than from the body
DESIGNS = 6
AT_TARGET = 3e-4  # of the length: a rod that is nearer is at its target, since the body is not that near to the rod
FAR = 0.05  # of the length: a best design that is farther away is searched from more points
DAMPING = 0.1  # of the first step of a descent
PULLS = 3  # times that rods relax in a pull: with one, that on the shape before, steps that are better look worse and are refused
BOUND_RATIO = math.sqrt(2.0)  # of two bounds that follow each other


@dataclass(frozen=True)
class RodDesign:
    """A design: directions (k, 3) of the varied regions, uniform field (3,) T (the scene's, where it is not varied), rms (m) of the rod,
    and its stability (1 at rest, 0 at a critical load).
    """

    directions: Array
    field: Array
    rms: float
    stability: float


@dataclass
class _Descents:
    """Designs (s, ...) on their way down: directions (s, k, 3), field (s, 3) in shares of the greatest, and what the rod says of them."""

    directions: Array
    field: Array
    quaternions: Array
    residuals: Array  # (s, m)
    slopes: Array  # (s, m, q) in the tangent space
    basis: Array  # (s, k, 3, 2)
    cost: Array  # (s,)
    damping: Array  # (s,)

    def best(self, count: int) -> _Descents:
        order = np.argsort(self.cost, kind="stable")[:count]
        return _Descents(**{name: value[order] for name, value in vars(self).items()})

    def and_those(self, others: _Descents) -> _Descents:
        """These descents and others."""
        theirs = vars(others)
        return _Descents(**{name: np.concatenate([value, theirs[name]]) for name, value in vars(self).items()})


class _Problem:
    """Rods of a scene against a target."""

    def __init__(self, scene: Scene, target: Array, regions: Sequence[int], field_max: float | None) -> None:
        rod = rod_model(scene, max(5 * ELEMENTS, ELEMENTS * len(scene.regions())))
        s = rod.places
        if field_max is not None:
            rod = replace(rod, field=np.zeros_like(rod.field))
        self.gradient: Array | None = None  # (n + 1, 3, 3) T/m
        if scene.field.varies and scene.effects.in_a_field:
            source, places = scene.outside_field(), _along_target(scene, target, s)
            without = np.zeros(3) if field_max is None else np.array(scene.field.uniform)
            rod = replace(rod, field=source.at(places) - without)
            self.gradient = source.gradient(places) if scene.effects.magnetic_force is not None else None
        self.family = RodFamily.of(rod, scene.body.shape.segment_lengths(), regions)  # type: ignore[attr-defined]
        self.field_max, self.count = field_max, len(regions)
        self.target, self.length = target, scene.length
        self.before = np.clip(np.searchsorted(s, target[:, 0], side="right") - 1, 0, len(s) - 2)  # the frames beside each station
        share = (target[:, 0] - s[self.before]) / np.diff(s)[self.before]
        self.shares = np.stack([1 - share, share]) / np.sqrt(len(target))

    def within(self, field_max: float) -> _Problem:
        """The problem with another bound of the field, T."""
        other = copy.copy(self)
        other.field_max = field_max
        return other

    @property
    def unit_field(self) -> float:
        """The field, T, that bends the rod by about a radian: M B L^2 = E I. Infinite for a rod without moments."""
        rod = self.family.rod
        moment = float(np.linalg.norm(rod.moment, axis=1).max())
        return float(rod.twist_bend[:, 1:].min()) / (moment * self.length**2) if moment > 0.0 else np.inf

    def shapes(self, directions: Array, field: Array, before: Array) -> tuple[Array, Array, Array, Array]:
        """Residuals (s, m) m, slopes (s, m, c) by directions and by shares of the greatest field, found (s,), and the rods' quaternions.

        before: quaternions of the shapes in which a field that varies pulls.
        """
        fields = None if self.field_max is None else self.field_max * field
        quaternions = self.family.straight(len(directions))
        position, slopes, found = self._relaxed(quaternions, directions, fields, before)
        goal = self.target[:, 1:] / np.sqrt(len(self.target))
        rows = (self._at_stations(position) - goal).reshape(len(position), -1)
        columns = self._at_stations(slopes).reshape(*rows.shape, -1)
        if self.field_max is not None:
            columns[:, :, -3:] *= self.field_max
        return rows, columns, found, quaternions

    def _relaxed(self, quaternions: Array, directions: Array, fields: Array | None, before: Array) -> tuple[Array, Array, Array]:
        """RodFamily.relaxed. A pull turns with the moments, so rods relax again in the pull on the shapes that they came to."""
        if self.gradient is None:
            return self.family.relaxed(quaternions, directions, fields)
        turned = before
        for _ in range(PULLS):
            pull = self.family.pull(turned, directions, self.gradient)
            found = self.family.relaxed(quaternions, directions, fields, pull=pull)
            turned = quaternions
        return found

    def _at_stations(self, values: Array) -> Array:
        """Values (s, n + 1, ...) at the frames as values (s, m, ...) at the target's m stations, over the root of m."""
        shares = self.shares.reshape(2, -1, *(1,) * (values.ndim - 2))
        return np.asarray(shares[0] * values[:, self.before] + shares[1] * values[:, self.before + 1])

    def state(self, directions: Array, field: Array, before: Array, damping: Array) -> _Descents:
        """The descents at these designs; one without a stable shape has an infinite cost. before: as of `shapes`."""
        rows, columns, found, quaternions = self.shapes(directions, field, before)
        basis = across(directions)
        count = 3 * self.count
        turned = np.einsum("smka,skab->smkb", columns[:, :, :count].reshape(*rows.shape, -1, 3), basis)
        slopes = np.concatenate([turned.reshape(*rows.shape, 2 * self.count), columns[:, :, count:]], axis=2)
        cost = np.where(found, np.einsum("sm,sm->s", rows, rows), np.inf)
        return _Descents(directions, field, quaternions, rows, slopes, basis, cost, damping)

    def step(self, at: _Descents) -> _Descents:
        """One step of all descents; those that did not get better stay, with more damping."""
        A = np.einsum("smi,smj->sij", at.slopes, at.slopes, optimize=True)
        g = np.einsum("smi,sm->si", at.slopes, at.residuals)
        if self.field_max is not None:
            _hold_at_the_bound(A, g, at.field)
        scale = np.maximum(np.einsum("sii->s", A) / A.shape[1], 1e-300)
        A += (at.damping * scale)[:, None, None] * np.eye(A.shape[1])
        p = -np.linalg.solve(A, g[:, :, None])[:, :, 0]
        turns = p[:, : 2 * self.count].reshape(len(p), self.count, 2)
        directions = _turned(at.directions, np.einsum("skab,skb->ska", at.basis, turns))
        field = at.field
        if self.field_max is not None:
            field = field + p[:, -3:]
            field = field / np.maximum(np.linalg.norm(field, axis=1, keepdims=True), 1.0)
        new = self.state(directions, field, at.quaternions, np.maximum(at.damping / 5, 1e-9))
        better = new.cost < at.cost
        kept = {name: np.where(better.reshape(-1, *(1,) * (value.ndim - 1)), getattr(new, name), value) for name, value in vars(at).items()}
        kept["damping"] = np.where(better, new.damping, np.minimum(6 * at.damping, 1e6))
        return _Descents(**kept)

    def descended(self, at: _Descents, phases: Sequence[tuple[int, int]]) -> _Descents:
        """The descents after phases of (steps, how many of the best go on); less where DESIGNS of them are at their target."""
        for steps, left in phases:
            for _ in range(steps):
                if np.sort(at.cost)[min(DESIGNS, len(at.cost)) - 1] < (AT_TARGET * self.length) ** 2:
                    break
                at = self.step(at)
            at = at.best(left)
        return at

    def begun(self, uniform: Array) -> _Descents:
        """Descents at points that numbers from 0 to 1, (s, 3 k + 3), spread over the spheres of directions and the ball of fields."""
        starts = len(uniform)
        directions = _on_sphere(uniform[:, : 3 * self.count].reshape(starts, -1, 3))
        field = _on_sphere(uniform[:, None, -3:])[:, 0] * (0.4 + 0.6 * uniform[:, -1:])
        return self.state(directions, field, self.family.straight(starts), np.full(starts, DAMPING))


def rod_designs(
    scene: Scene, target: Array, regions: Sequence[int], field_max: float | None, *, seed: int = 1, starts: int = 32, keep: int = DESIGNS
) -> list[RodDesign]:
    """The rod's best designs for target rows [s, x, y, z] (m, 4) m, best first; different from each other. None where the scene has no rod.

    regions: indices of those whose direction is varied; field_max T: greatest strength of a varied uniform field, None: the scene's stays.
    """
    try:
        problem = _Problem(scene, target, regions, field_max)
    except SolveError:
        return []
    from scipy.stats import qmc

    points = qmc.Sobol(3 * len(regions) + 3, rng=np.random.default_rng([seed]))
    first = np.asarray(points.random(starts))
    at = problem.descended(problem.begun(first), _phases(starts))
    found = _verified(scene, problem, regions, at)
    if field_max is not None and not _within(found, AT_TARGET * scene.length):
        at = _by_growing_bounds(problem, first)
        found = _best_first([*found, *_verified(scene, problem, regions, at)], scene.length)
    if not _within(found, FAR * scene.length):
        more = np.asarray(points.random(starts))
        if field_max is None:
            at = problem.descended(problem.begun(more), _phases(starts))
        else:
            at = _by_growing_bounds(problem, more, fresh=True)
        found = _best_first([*found, *_verified(scene, problem, regions, at)], scene.length)
    return found[:keep]


def _within(designs: Sequence[RodDesign], distance: float) -> bool:
    """True if a design's rms is below a distance, m."""
    return any(design.rms < distance for design in designs)


def _phases(starts: int) -> list[tuple[int, int]]:
    """Steps of descents from so many starts, and how many of them go on."""
    return [(8, max(starts // 2, 12)), (10, max(starts // 4, 12)), (12, 12)]


def _by_growing_bounds(problem: _Problem, uniform: Array, fresh: bool = False) -> _Descents:
    """Descents that begin within a weak field's bound, each next bound with the designs of the one before; the last is the problem's.

    The bounds do not depend on the last one, so what is found within one is found within every larger one. fresh: each bound, and not the
    first alone, also has the designs at the points `uniform` (Problem.begun).
    """
    last = problem.field_max
    assert last is not None
    bound = problem.unit_field
    reached = min(bound, last)
    here = problem.within(reached)
    at = here.descended(here.begun(uniform), [(8, 8)])
    while reached != last:
        bound *= BOUND_RATIO
        before = reached
        reached = min(bound, last)
        there = problem.within(reached)
        at = there.state(at.directions, at.field * (before / reached), at.quaternions, np.full(len(at.cost), DAMPING))
        if fresh:
            at = at.and_those(there.descended(there.begun(uniform), [(8, 8)]))
        at = there.descended(at, [(6, 8)])
        here = there
    return here.descended(at, [(12, 8)])


def rod_starts(space: SearchSpace, target: Array, seed: int) -> list[dict[str, float]]:
    """The rod's best designs as parameters of a study, best first. Numbers within bounds are in the middle of them."""
    middle = space.nearest(np.full(space.size, 0.5))
    order = space.choices[0].choices[0] if space.choices else None
    scene = space.scene_at(middle, order)
    found = rod_designs(scene, target, space.segments, space.field_max, seed=seed)
    starts = []
    for design in found:
        x, directions = middle.copy(), iter(design.directions)
        for block, at in space.parts:
            if isinstance(block, Direction):
                x[at] = next(directions)
            elif isinstance(block, FieldVector):
                x[at] = design.field
        starts.append(space.parameters_at(x, order))
    return starts


def _verified(scene: Scene, problem: _Problem, regions: Sequence[int], at: _Descents) -> list[RodDesign]:
    """Those designs that are different from better ones, judged by the rod under loads that grow from zero, best first."""
    target, field_max = problem.target, problem.field_max
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
        stability = problem.family.stability(at.quaternions[s], at.directions[s], np.zeros(3) if field_max is None else field)
        found.append(RodDesign(at.directions[s], field, root_mean_square(gap), stability))
    return _best_first(found, scene.length)


def _best_first(designs: Sequence[RodDesign], length: float) -> list[RodDesign]:
    """Those designs that are different from better ones, best first; length of the body, m.

    Near a critical load the body is hard to solve and its derivatives are large: a design there counts as worse than it is.
    """
    # a stability below 0.15 counts as worse, at a critical load by 0.05 of the length
    ordered = sorted(designs, key=lambda design: design.rms + max(1.0 - design.stability / 0.15, 0.0) * 0.05 * length)
    kept: list[RodDesign] = []
    for design in ordered:
        if all(_angle_between(design, other) > 0.3 for other in kept):  # rad
            kept.append(design)
    return kept


def _angle_between(one: RodDesign, other: RodDesign) -> float:
    """Root mean square angle between two designs' directions, and the field's."""
    a, b = (np.vstack([d.directions, unit(d.field[None])]) for d in (one, other))
    return float(np.sqrt(np.mean(np.arccos(np.clip(np.sum(a * b, axis=1), -1.0, 1.0)) ** 2)))


def _along_target(scene: Scene, target: Array, s: Array) -> Array:
    """Places (n + 1, 3) m of the rod's frames if it has the target's shape; beyond the target's end it goes on straight."""
    rows = target if target[0, 0] == 0.0 else np.vstack([np.zeros(4), target])
    places = linear(s, rows[:, 0], rows[:, 1:])
    end = unit(rows[-1:, 1:] - rows[-2:-1, 1:])
    line = scene.body.shape.line
    assert line is not None  # only straight bodies are rods
    return np.asarray(np.array(line.base) + places + np.maximum(s - rows[-1, 0], 0.0)[:, None] * end)


def _hold_at_the_bound(A: Array, g: Array, field: Array) -> None:
    """Keeps fields that are as strong as they may be, and would become stronger, at that strength: no step along them."""
    size = np.linalg.norm(field, axis=1)
    outward = field / np.maximum(size, 1e-300)[:, None]
    held = (size > 1 - 1e-9) & (np.einsum("si,si->s", g[:, -3:], outward) < 0)
    stiff = 1e6 * np.einsum("sii->s", A)
    A[held, -3:, -3:] += stiff[held, None, None] * outward[held, :, None] * outward[held, None, :]


def _turned(units: Array, turns: Array) -> Array:
    """Unit vectors (..., 3) after turns (..., 3) across them, rad, along great circles."""
    angle = np.linalg.norm(turns, axis=-1, keepdims=True)
    return unit(np.cos(angle) * units + np.sinc(angle / np.pi) * turns)


def _on_sphere(u: Array) -> Array:
    """Unit vectors of uniform density for numbers u (..., 3) in 0 to 1, of which the third is free."""
    x, turn = 2 * u[..., 0] - 1, 2 * np.pi * u[..., 1]
    across = np.sqrt(1 - x * x)
    return np.stack([x, across * np.cos(turn), across * np.sin(turn)], axis=-1)


def improved(space: SearchSpace, target: Array, starts: Sequence[dict[str, float]]) -> list[dict[str, float]]:
    """Starts (parameters) whose directions are of the set, improved: best first, each once. A choice has no derivative, so it is searched.

    From the snapped start, the exchange (_exchanges) that brings the rod nearest to the target rows (m, 4) m is kept, until none brings it
    nearer. What else varies stays: the sampler's steps change it.
    """
    limits = space.limits
    if limits is None or limits.allowed is None:
        return list(starts)
    found: dict[tuple[float, ...], tuple[float, dict[str, float]]] = {}
    for start in starts:
        x = space.made(space.embedded(start))
        best, solves = _distance(space, target, x), 1
        while solves < 1500:  # a second and a half
            tried = _exchanges(space, x)
            values = [_distance(space, target, y) for y in tried]
            solves += len(tried)
            if not values or not min(values) < best:
                break
            x, best = tried[int(np.argmin(values))], min(values)
        found.setdefault(_key(x), (best, space.parameters_at(x)))
    return [parameters for _, parameters in sorted(found.values(), key=lambda pair: pair[0])]


def next_exchange(space: SearchSpace, target: Array, best: Parameters, tried: Sequence[Parameters]) -> dict[str, Any] | None:
    """The best design's parameters with one direction of the set exchanged (_exchanges), as no other trial has had it: of these the one
    that brings the rod nearest to the target. None where all were tried."""
    order = best.get("order")
    known = {_key(space.made(space.embedded(one))) for one in tried if one.get("order") == order}
    new = [y for y in _exchanges(space, space.made(space.embedded(best))) if _key(y) not in known]
    if not new:
        return None
    turned = space.parameters_at(min(new, key=lambda y: _distance(space, target, y, order)), order)
    names = {name for block in space.blocks if isinstance(block, Direction) for name in block.bounds()}
    return {name: turned[name] if name in names else value for name, value in best.items()}


def _exchanges(space: SearchSpace, x: Array) -> list[Array]:
    """All designs (size,) in which one segment of x has another direction of the set; and where directions are counted, those in which
    all segments of one direction have."""
    limits, places = space.limits, [at for block, at in space.parts if isinstance(block, Direction)]
    assert limits is not None
    assert limits.allowed is not None
    sharing = [[at for at in places if np.array_equal(x[at], x[first])] for first in places] if limits.at_most is not None else []
    found = {}
    for group in [*([at] for at in places), *sharing]:
        for vector in limits.allowed:
            y = x.copy()
            for at in group:
                y[at] = vector
            if limits.at_most is None or len(np.unique([y[at] for at in places], axis=0)) <= limits.at_most:
                found[_key(y)] = y
    found.pop(_key(x), None)
    return list(found.values())


def _distance(space: SearchSpace, target: Array, x: Array, order: str | None = None) -> float:
    """Root mean square distance (m) of the rod from the target; inf where it is not found."""
    try:
        scene = space.scene_at(x, order)
        gap = solve_rod(scene, 40).at(np.minimum(target[:, 0], scene.length)) - target[:, 1:]
    except SolveError:
        return np.inf
    return root_mean_square(gap)


def _key(x: Array) -> tuple[float, ...]:
    return tuple((np.round(x, 6) + 0.0).tolist())
