"""Designs within limits that the rod finds: a choice among directions has no derivative, so it is searched segment by segment."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import SolveError
from magmpm.rod.cosserat import solve_rod
from magmpm.studies.blocks import Direction
from magmpm.studies.search_space import SearchSpace

ELEMENTS = 40
MOST_SOLVES = 1500  # a second and a half of rods for each start


def improved(space: SearchSpace, target: Array, starts: Sequence[dict[str, float]]) -> list[dict[str, float]]:
    """Starts (parameters) whose directions are of the set, improved: best first, each once.

    From the snapped start, every segment is tried in every direction of the set, and the best exchange is kept, until none brings the rod
    nearer to the target rows (m, 4) m. What else varies stays: the sampler's steps change it.
    """
    limits = space.limits
    if limits is None or limits.allowed is None:
        return list(starts)
    stations = target[:, 0]

    def distance(x: Array) -> float:
        try:
            scene = space.scene_at(x)
            gap = solve_rod(scene, ELEMENTS).at(np.minimum(stations, scene.length)) - target[:, 1:]
        except SolveError:
            return np.inf
        return float(np.sqrt(np.mean(np.sum(gap**2, axis=1))))

    found: dict[tuple[float, ...], tuple[float, dict[str, float]]] = {}
    places = [at for block, at in zip(space.blocks, space.slices, strict=True) if isinstance(block, Direction)]
    for start in starts:
        x = space.embedded(start)
        for at, vector in zip(places, limits.made(np.array([x[at] for at in places])), strict=True):
            x[at] = vector
        best, solves = distance(x), 1
        while solves < MOST_SOLVES:
            tried = [(i, vector) for i in range(len(places)) for vector in limits.allowed if not np.array_equal(vector, x[places[i]])]
            if limits.at_most is not None:
                tried = [(i, v) for i, v in tried if len(np.unique(_with(x, places, i, v), axis=0)) <= limits.at_most]
            values = []
            for i, vector in tried:
                y = x.copy()
                y[places[i]] = vector
                values.append(distance(y))
            solves += len(tried)
            if not values or not min(values) < best:
                break
            i, vector = tried[int(np.argmin(values))]
            x[places[i]], best = vector, min(values)
        found.setdefault(tuple(np.round(x, 6)), (best, space.parameters_at(x)))
    return [parameters for _, parameters in sorted(found.values(), key=lambda pair: pair[0])]


def _with(x: Array, places: list[slice], i: int, vector: Array) -> Array:
    """The directions (n, 3) of a design with the i-th exchanged."""
    directions = np.array([x[at] for at in places])
    directions[i] = vector
    return directions
