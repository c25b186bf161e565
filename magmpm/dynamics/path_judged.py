"""At which of its equilibria a path is judged: those of a run on a coarse grid tell where it goes, and where it is soft."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.dynamics.quasi_static import PathState
from magmpm.results.measures import on_rows

JUDGED = 6  # equilibria at most
LOOKED = 24  # equilibria at most that are compared with another grid's, to find those with the largest errors
STATIONS = 41  # along the axis, where shapes are compared
ALIKE = 0.02  # of the length: shapes nearer to one that is judged are not judged as well
CLOSE = 0.005  # of the length: shapes nearer to one that is compared with another grid's are not compared as well
# Another grid's branch ends at a load that differs by a few per cent, its error of stiffness; toward a limit point the stability falls as
# the root of what is left of the load. So equilibria softer than this before a jump, and as long after it, differ between grids.
SOFT = 0.15


@dataclass
class PathSeen:
    """What a path's states show, one by one (`see`): of each equilibrium, by its time (s), the coefficients (planes, m) m, how far its axis
    (STATIONS, 3) m is from a straight one that begins at its base, and the stability; and the times (s) of jumps. Where all of the body is
    in its guide there is none.
    """

    length: float
    grids: dict[float, Array] = field(default_factory=dict)
    bends: list[Array] = field(default_factory=list)
    stability: list[float] = field(default_factory=list)
    jumps: list[float] = field(default_factory=list)
    softness: list[tuple[float, float]] = field(default_factory=list)  # time (s) and stability, before a checkpoint as well
    times: Collection[float] = ()  # s, at which the path is judged: these `grids` are known before a checkpoint as well

    def see(self, state: PathState) -> None:
        """Note the last equilibrium of a path."""
        self.grids = {**state.noted, **self.grids}
        if state.branch is None:
            return
        rows, known = state.shape.centreline, state.rows[-1]["stability"]
        self.jumps = [jump["time"] for jump in state.jumps]
        self.softness = [(row["time"], np.inf if row["stability"] is None else row["stability"]) for row in state.rows]
        self.grids[state.time] = state.branch.now.point.grid.copy()
        if state.time in self.times:
            state.noted[state.time] = self.grids[state.time]
        axis = on_rows(rows[:, 0], rows[:, 1:], np.linspace(0.0, rows[-1, 0], STATIONS))[0]
        straight = axis[:1] + np.linspace(0.0, self.length, STATIONS)[:, None] * [1.0, 0.0, 0.0]
        self.bends.append(axis - straight)
        self.stability.append(np.inf if known is None else known)

    def near_jumps(self) -> list[tuple[float, float]]:
        """Spans of time (s) around jumps in which other grids may be on the other branch, and no error is told."""
        spans, times = [], [t for t, _ in self.softness]
        for jump in self.jumps:
            first = sum(t < jump for t in times)
            while first > 0 and self.softness[first - 1][1] < SOFT:
                first -= 1
            begins = times[first] if first < len(times) and times[first] < jump else jump
            step = max((b - a for a, b in pairwise(times) if a <= jump <= b), default=0.0)
            spans.append((begins, min(jump + max(jump - begins, step), times[-1])))
        return spans

    def soft_at(self) -> float | None:
        """The first time (s), away from jumps, at which the body is so soft that the path may jump on another grid."""
        spans = self.near_jumps()
        return next((t for t, soft in self.softness if soft < SOFT and not any(a <= t <= b for a, b in spans)), None)

    def away_from_jumps(self) -> list[float]:
        """Times (s) of the equilibria that are not near a jump; all of them, if each is."""
        spans = self.near_jumps()
        return [t for t in self.grids if not any(a <= t <= b for a, b in spans)] or list(self.grids)

    def unlike(self) -> list[float]:
        """Times (s) of equilibria away from jumps, as unlike each other as can be: the last, the softest, the one that is bent most, and
        then the one whose shape is farthest from straight and from those before it. LOOKED at most, none nearer to another than CLOSE.
        """
        return self._unlike(LOOKED, CLOSE)

    def judged(self, differs: Mapping[float, float]) -> list[float]:
        """Times (s) at which the path is judged: the last; where the body is softest; where another grid differs more than just before and
        after; elsewhere, where it differs the most; and, where that is not known, equilibria of unlike shapes. JUDGED at most.

        differs: time (s) and difference (m) to another grid.
        """
        times = sorted(differs)
        beside = [-np.inf, *(differs[t] for t in times), -np.inf]
        peaks = {t for k, t in enumerate(times) if beside[k] < differs[t] >= beside[k + 2]}  # of equal ones the first
        chosen = self._unlike(2, ALIKE)
        bends = dict(zip(self.grids, self.bends, strict=True))
        unknown = [t for t in self._unlike(JUDGED, ALIKE) if t not in differs]
        for t in (*sorted(times, key=lambda t: (t not in peaks, -differs[t])), *unknown):
            alike = _apart(np.array([bends[one] for one in chosen]), bends[t]).min() <= ALIKE * self.length
            if t not in chosen and not (alike and t not in peaks) and len(chosen) < JUDGED:
                chosen.append(t)
        return sorted(chosen)

    def _unlike(self, most: int, alike: float) -> list[float]:
        """Times (s), in the order of `unlike`, none nearer to another than a share `alike` of the length."""
        times = self.away_from_jumps()
        index = {t: k for k, t in enumerate(self.grids)}
        rows = [index[t] for t in times]
        bends, soft = np.array(self.bends)[rows], np.array(self.stability)[rows]
        chosen = list(dict.fromkeys([len(bends) - 1, int(np.argmin(soft)), int(np.argmax(_apart(bends, 0.0 * bends[0])))]))[:most]
        away = np.min([_apart(bends, one) for one in (0.0 * bends[0], *bends[chosen])], axis=0)
        while len(chosen) < most and away.max() > alike * self.length:
            chosen.append(int(away.argmax()))
            away = np.minimum(away, _apart(bends, bends[chosen[-1]]))
        return [times[k] for k in chosen]


def _apart(bends: Array, one: Array) -> Array:
    """Largest distance (k,) m of bends (k, STATIONS, 3) m from another."""
    return np.asarray(np.linalg.norm(bends - one, axis=2).max(axis=1))
