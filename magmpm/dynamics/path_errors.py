"""How much the equilibria of a path on a coarse grid would move on a grid with one more cell across: where its error is the largest.

A factorization each, on a grid that is hardly finer. Two grids so alike do not tell how large an error is (statics.error_estimate), but
along one path they tell where it is large.
"""

from __future__ import annotations

import time

import numpy as np

from magmpm.dynamics.path_judged import PathSeen
from magmpm.dynamics.path_loads import FeedLoads, FieldLoads
from magmpm.dynamics.quasi_static import loads_of
from magmpm.effects import acting
from magmpm.errors import SolveError, TimeOver
from magmpm.scene import Scene, memory, time_limit
from magmpm.statics.approach import approached
from magmpm.statics.between_grids import carried
from magmpm.statics.energy import Energy
from magmpm.statics.equilibrium import one_blas_thread, solve_from
from magmpm.statics.error_estimate import distance
from magmpm.statics.ladder import Ladder


def differences(scene: Scene, seen: PathSeen, cells: int, seconds: float | None) -> dict[float, float]:
    """Time (s) and difference (m), where errors are meant, of those equilibria of a path whose shapes differ most, and of the ones around
    the largest: from there it is followed until it grows no more. inf where the finer grid has no equilibrium nearby.

    seen: of the path with so many cells across; seconds: none are begun after these. Where segments act on each other nothing is told: an
    equilibrium is no single factorization then.
    """
    if acting.feels_itself(scene):
        return {}
    begun, found = time.perf_counter(), dict[float, float]()
    times = seen.away_from_jumps()
    between = _Between(scene, seen, cells)

    def look(k: int) -> None:
        late = seconds is not None and time.perf_counter() - begun > seconds
        if 0 <= k < len(times) and times[k] not in found and not late:
            found[times[k]] = between.at(times[k])

    with one_blas_thread():
        for t in seen.unlike():
            look(times.index(t))
        while found:
            top, known = times.index(max(found, key=lambda t: found[t])), len(found)
            look(top - 1)
            look(top + 1)
            if len(found) == known:
                break
    return found


class _Between:
    """The path's own grid and the one with one more cell across. Their models are used again as long as the body's length stays."""

    def __init__(self, scene: Scene, seen: PathSeen, cells: int) -> None:
        self._ladder, self._seen = Ladder(scene, lambda on_grid: []), seen
        self._coarse, self._fine = self._loads(cells), self._loads(cells + 1)
        self._energy: Energy | None = None

    def _loads(self, cells: int) -> FieldLoads | FeedLoads:
        on_grid = self._ladder.on(cells)
        with memory.within(on_grid):
            return loads_of(on_grid, next(iter(self._seen.grids)))

    def at(self, t: float) -> float:
        """Difference (m) of a time, s."""
        ladder, coarse, fine, grid = self._ladder, self._coarse.at(t), self._fine.at(t), self._seen.grids[t]
        compared, start = ladder.points(coarse, grid), carried(coarse, grid, fine)
        if self._energy is None or self._energy.model.layout is not fine.layout:
            self._energy = Energy(fine)
        self._energy.load(fine)
        asked = ladder.asked
        near = approached(
            self._energy, start, lambda c: ladder.points(fine, c), compared, asked.length / asked.thickness, lambda *_: time_limit.check()
        )
        if near is None:
            try:
                near = solve_from(fine, start).point.grid
            except TimeOver:
                raise
            except SolveError:
                return float(np.inf)
        return distance(ladder.points(fine, near), compared)
