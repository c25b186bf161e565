"""Exchanges of directions of a set, which has no derivatives: every change of one direction is tried on the rod."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from magmpm.compiled.arrays import Array, NamedNumbers, Plain
from magmpm.errors import SolveError
from magmpm.rod.cosserat import solve_rod
from magmpm.studies.problem.shape_distance import root_mean_square
from magmpm.studies.search.parameters import Parameters, SegmentDirection
from magmpm.studies.search.search_space import SearchSpace

MOST_SOLVES = 1500  # of rods, for one start: a second and a half


def improved(
    space: SearchSpace, target: Array, starts: Sequence[NamedNumbers]
) -> list[NamedNumbers]:
    """Improve starts whose directions are of the set. A choice has no derivative, so it is searched.

    From the snapped start, the exchange (_exchanges) that brings the rod nearest to the target is
    kept, until none brings it nearer. What else varies stays: the sampler's steps change it.

    Parameters
    ----------
    space : SearchSpace
        The search space.
    target : array (m, 4), m
        Rows [s, x, y, z].
    starts : sequence of dict[str, float]
        Designs, as parameters.

    Returns
    -------
    list of dict[str, float]
        The improved ones, best first, each once; the starts themselves where directions are not
        of a set.
    """
    limits = space.limits
    if limits is None or limits.allowed is None:
        return list(starts)
    found: dict[tuple[float, ...], tuple[float, NamedNumbers]] = {}
    for start in starts:
        x = space.made(space.embedded(start))
        best = _distance(space, target, x)
        solves = 1
        while solves < MOST_SOLVES:
            tried = _exchanges(space, x)
            values = [_distance(space, target, y) for y in tried]
            solves += len(tried)
            if not values or not min(values) < best:
                break
            x = tried[int(np.argmin(values))]
            best = min(values)
        found.setdefault(_key(x), (best, space.parameters_at(x)))
    return [parameters for _, parameters in sorted(found.values(), key=lambda pair: pair[0])]


def next_exchange(
    space: SearchSpace, target: Array, best: Parameters, tried: Sequence[Parameters]
) -> Plain | None:
    """Exchange one direction of the best design with one of the set (_exchanges), as no other trial has had it.

    Parameters
    ----------
    space : SearchSpace
        The search space.
    target : array (m, 4), m
        Rows [s, x, y, z].
    best : Parameters
        Parameters of the best design.
    tried : sequence of Parameters
        Parameters of all trials.

    Returns
    -------
    dict[str, Any] or None
        Of these exchanges the one that brings the rod nearest to the target; None where all
        were tried.
    """
    chosen = space.chosen(best)
    known = {_key(space.made(space.embedded(o))) for o in tried if space.chosen(o) == chosen}
    new = [y for y in _exchanges(space, space.made(space.embedded(best))) if _key(y) not in known]
    if not new:
        return None
    turned = space.parameters_at(min(new, key=lambda y: _distance(space, target, y, best)), best)
    names = {name for block, _ in space.those(SegmentDirection) for name in block.bounds()}
    return {name: turned[name] if name in names else value for name, value in best.items()}


def _exchanges(space: SearchSpace, x: Array) -> list[Array]:
    """All designs (size,) in which one segment of x has another direction of the set; and where directions are counted, those in which
    all segments of one direction have."""
    limits = space.limits
    places = [at for _, at in space.those(SegmentDirection)]
    assert limits is not None
    assert limits.allowed is not None
    sharing = (
        [[at for at in places if np.array_equal(x[at], x[first])] for first in places]
        if limits.at_most is not None
        else []
    )
    found = {}
    for group in [*([at] for at in places), *sharing]:
        for vector in limits.allowed:
            y = x.copy()
            for at in group:
                y[at] = vector
            if (
                limits.at_most is None
                or len(np.unique([y[at] for at in places], axis=0)) <= limits.at_most
            ):
                found[_key(y)] = y
    found.pop(_key(x), None)
    return list(found.values())


def _distance(
    space: SearchSpace, target: Array, x: Array, chosen: Parameters | None = None
) -> float:
    """Root mean square distance (m) of the rod from the target; inf where it is not found."""
    try:
        scene = space.scene_at(x, chosen)
        gap = solve_rod(scene, 40).at(np.minimum(target[:, 0], scene.length)) - target[:, 1:]
    except SolveError:
        return np.inf
    return root_mean_square(gap)


def _key(x: Array) -> tuple[float, ...]:
    return tuple((np.round(x, 6) + 0.0).tolist())
